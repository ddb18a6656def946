/* The MOOP tab's watch page and the eye in the navigation bar: what is seen of the print now. */
$(function () {
    const words = MOOP.words;

    function MoopTabViewModel(parameters) {
        const self = this;
        self.loginState = parameters[0];
        self.access = parameters[1];
        self.settings = parameters[2];
        self.printerState = parameters[3];

        self.status = ko.observable(null);
        self.receivedAt_ms = ko.observable(0);
        self.now_ms = ko.observable(0);
        self.checks = ko.observableArray([]);
        self.selectedId = ko.observable(null); // null: follow the newest check
        self.show = ko.observable("difference");
        self.hasMasks = ko.observable(false);
        self.pictureNote = ko.observable("");
        self.liveShown = ko.observable(false);
        self.busy = ko.observable("");
        self.trouble = ko.observable("");
        self.lastAction = ko.observable("none");
        self.announcement = ko.observable("");
        self.cameraKnown = ko.observable(null); // null: not asked yet

        // OctoPrint fills in the permissions after the view models are made, so they are looked up when asked
        const allowed = function (name) {
            return ko.pureComputed(function () {
                return self.loginState.hasPermission(self.access.permissions[name]);
            });
        };
        self.mayView = allowed("PLUGIN_MOOP_VIEW");
        self.mayControl = allowed("PLUGIN_MOOP_CONTROL");
        self.mayCalibrate = allowed("PLUGIN_MOOP_CALIBRATE");
        self.mayPrint = allowed("PRINT");

        self.age_s = ko.pureComputed(function () {
            const status = self.status();
            if (!status || !status.last_check) {
                return 0;
            }
            return (status.last_check.age_s || 0) + Math.max(0, self.now_ms() - self.receivedAt_ms()) / 1000;
        });
        self.printer = ko.pureComputed(function () {
            const printer = self.printerState;
            if (printer.isPaused() || printer.isPausing()) {
                return "paused";
            }
            return printer.isPrinting() ? "printing" : "idle";
        });
        self.state = ko.pureComputed(function () {
            return words.state(self.status(), self.age_s(), self.printer());
        });
        self.stateClass = ko.pureComputed(function () {
            return {
                idle: "alert-info",
                good: "alert-success",
                warning: "",
                failed: "alert-error"
            }[self.state().level];
        });
        self.stateIcon = ko.pureComputed(function () {
            return {
                idle: "fas fa-eye",
                good: "fas fa-eye",
                warning: "fas fa-eye-slash",
                failed: "fas fa-exclamation-triangle"
            }[self.state().level];
        });
        self.blind = ko.pureComputed(function () {
            return self.state().level === "warning" && Boolean(self.status().blind);
        });
        self.renderer = ko.pureComputed(function () {
            return self.status() ? self.status().renderer : "";
        });

        self.selectedIndex = ko.pureComputed(function () {
            const id = self.selectedId();
            const checks = self.checks();
            if (id === null) {
                return checks.length - 1;
            }
            return _.findIndex(checks, function (check) { return check.id === id; });
        });
        self.selected = ko.pureComputed(function () {
            return self.checks()[self.selectedIndex()] || null;
        });
        self.following = ko.pureComputed(function () { return self.selectedId() === null; });
        self.selectedText = ko.pureComputed(function () {
            const check = self.selected();
            if (!check) {
                return words.say("No check of this print yet");
            }
            return words.say("Layer %(layer)s · E %(error)s · %(verdict)s", {
                layer: words.layerNumber(check.layer),
                error: words.percent(check.E),
                verdict: check.verdict === "failed" ? words.mode(check) : words.verdict(check)
            });
        });
        self.selectedReason = ko.pureComputed(function () {
            const check = self.selected();
            const told = check && self.failed() && check.layer === self.failed().layer; // by the box above already
            return check && check.verdict !== "ok" && !told ? check.reason : "";
        });
        self.objects = ko.pureComputed(function () {
            const check = self.selected();
            return (check && check.objects ? check.objects : []).map(function (object) {
                return {
                    name: object.name,
                    error: words.percent(object.E),
                    text: object.verdict === "failed" ? words.mode(object) : words.verdict(object),
                    icon: object.verdict === "ok" ? "fas fa-check" : "fas fa-exclamation-triangle",
                    failed: object.verdict === "failed"
                };
            });
        });
        self.hasLimit = ko.pureComputed(function () {
            return _.some(self.checks(), function (check) { return check.limit !== null && check.limit !== undefined; });
        });
        self.plotSummary = ko.pureComputed(function () {
            const checks = self.checks();
            const count = function (verdict) {
                return checks.filter(function (check) { return check.verdict === verdict; }).length;
            };
            return words.say("E by layer: %(n)s checks, %(suspect)s suspect, %(failed)s failed, %(unusable)s unusable", {
                n: checks.length,
                suspect: count("suspect"),
                failed: count("failed"),
                unusable: count("unusable")
            });
        });

        // The failure that stands, as a place in the list of checks: the last failed one, until somebody pardons it.
        self.failedIndex = ko.pureComputed(function () {
            return words.failureStands(self.status())
                ? _.findLastIndex(self.checks(), function (check) { return check.verdict === "failed"; })
                : -1;
        });
        self.failed = ko.pureComputed(function () { return self.checks()[self.failedIndex()] || null; });
        self.failure = ko.pureComputed(function () {
            const check = self.failed();
            return check
                ? words.failure(check, words.sinceLayer(self.checks(), self.failedIndex()), self.status().action)
                : null;
        });
        self.printing = ko.pureComputed(function () {
            return self.printer() !== "idle" && Boolean(self.status() && self.status().job);
        });
        self.watchText = ko.pureComputed(function () {
            return self.status() && self.status().watching
                ? words.say("Pause watching for this print")
                : words.say("Watch this print again");
        });
        self.mayCheck = ko.pureComputed(function () {
            return self.mayControl() && self.printing() && !self.busy();
        });

        // --- what the server tells -------------------------------------------------------------------------------

        self.takeStatus = function (status) {
            self.receivedAt_ms(performance.now());
            self.now_ms(performance.now());
            const before = self.status();
            self.status(status);
            if (before && status.checks < before.checks) { // a new print has begun
                self.startOver();
                self.takeChecks([]);
            }
            self.setLive();
        };

        self.takeChecks = function (checks) {
            self.checks(checks);
        };

        self.visible = function () {
            return !document.hidden && $("#moop_watch").is(":visible");
        };

        self.refresh = function () {
            if (!self.mayView()) {
                return;
            }
            OctoPrint.plugins.moop.status()
                .done(function (status) {
                    self.trouble("");
                    self.takeStatus(status);
                })
                .fail(self.tell);
            if (self.visible() && self.mayCalibrate() && self.cameraKnown() !== true) {
                OctoPrint.plugins.moop.setup().done(function (header) { self.cameraKnown(Boolean(header.camera)); });
            }
            if (self.visible()) {
                OctoPrint.plugins.moop.checks()
                    .done(function (answer) { self.takeChecks(answer.checks); })
                    .fail(self.tell);
            }
        };

        self.tell = function (request) {
            self.trouble(words.refusal(request));
        };

        self.onDataUpdaterPluginMessage = function (plugin, message) {
            if (plugin !== "moop" || !self.mayView()) {
                return;
            }
            if (message.type === "status") {
                self.takeStatus(message.status);
            } else if (message.type === "check") {
                self.addCheck(message.check);
            } else if (message.type === "failed") {
                self.notify(message.check, message.action);
            }
        };

        self.addCheck = function (check) {
            const checks = self.checks();
            const last = checks[checks.length - 1];
            if (last && check.id <= last.id) { // checks are numbered from nought in each print
                self.startOver();
                self.takeChecks([check]);
            } else {
                self.takeChecks(checks.concat([check]));
            }
        };

        self.startOver = function () {
            self.selectedId(null);
            self.pictureKey = null;
        };

        self.notify = function (check, action) {
            const told = words.failure(check, check.layer, action);
            self.announcement(told.title + ". " + told.sentence + " " + told.done);
            if (self.notice) {
                self.notice.remove();
            }
            self.notice = new PNotify({
                title: "MOOP: " + told.title,
                title_escape: true,
                text: told.sentence + " " + told.done,
                text_escape: true,
                type: "error",
                hide: false
            });
        };

        // --- what people do --------------------------------------------------------------------------------------

        self.ask = function (what, request) {
            self.busy(what);
            return request
                .done(function () { self.trouble(""); self.refresh(); })
                .fail(self.tell)
                .always(function () { self.busy(""); });
        };

        self.checkNow = function () {
            self.selectedId(null);
            return self.ask("check", OctoPrint.plugins.moop.checkNow());
        };

        self.toggleWatching = function () {
            return self.ask("watch", OctoPrint.plugins.moop.watch(!self.status().watching));
        };

        self.pardon = function () {
            return self.ask("pardon", OctoPrint.plugins.moop.pardon()).done(function () {
                if (self.notice) {
                    self.notice.remove();
                    self.notice = null;
                }
            });
        };

        self.resume = function () {
            return self.ask("resume", OctoPrint.job.resume());
        };

        self.openSetup = function () {
            $('#moop_pages a[href="#moop_setup_page"]').tab("show");
        };

        self.openTab = function () {
            $("#tab_plugin_moop_link a").tab("show");
        };

        self.step = function (by) {
            const index = self.selectedIndex() + by;
            const checks = self.checks();
            if (index >= checks.length - 1) {
                self.selectedId(null);
            } else if (index >= 0) {
                self.selectedId(checks[index].id);
            }
        };
        self.stepBack = function () { self.step(-1); };
        self.stepOn = function () { self.step(1); };
        self.follow = function () { self.selectedId(null); };

        self.zoomIn = function () { self.picture.zoomIn(); };
        self.zoomOut = function () { self.picture.zoomOut(); };
        self.zoomFit = function () { self.picture.fit(); };
        self.showWhere = function () {
            self.selectedId(self.failed().id);
            self.show("difference");
            self.drawPicture().done(function () { self.picture.zoomToDifference(); });
        };

        // --- what is drawn ---------------------------------------------------------------------------------------

        /* Shows the selected check, or the camera now where there is none; the promise tells when it is on screen. */
        self.drawPicture = function () {
            if (!self.picture || !self.visible()) {
                return $.Deferred().reject();
            }
            const check = self.selected();
            const key = check ? "check " + check.id : "now";
            if (key === self.pictureKey) {
                self.picture.draw();
                return self.opened;
            }
            self.pictureKey = key;
            self.opened = self.picture.open(self.addresses(check), self.show())
                .done(function (found) {
                    self.hasMasks(found.masks);
                    self.pictureNote(self.noteOn(check, found.masks));
                })
                .fail(function () {
                    self.pictureKey = null;
                    self.hasMasks(false);
                    self.pictureNote(check
                        ? words.say("This check's picture is no longer kept.")
                        : words.say("The webcam gives no picture."));
                });
            return self.opened;
        };

        self.addresses = function (check) {
            const moop = OctoPrint.plugins.moop;
            if (!check) {
                return {frame: moop.freshFrameUrl()};
            }
            return _.mapValues({frame: 1, seen: 1, expected: 1, ignored: 1}, function (_one, kind) {
                return moop.pictureUrl(check.id, kind);
            });
        };

        self.noteOn = function (check, hasMasks) {
            if (!check) {
                return words.say("The camera now. Comparisons appear here with the first layer.");
            }
            return hasMasks ? "" : words.say("Nothing could be compared here: only the picture was kept.");
        };

        self.drawPlot = function () {
            const box = $("#moop_plot");
            if (!self.visible() || !box.length || !box.width()) {
                return; // flot refuses to draw where there is no room
            }
            const checks = self.checks();
            const colour = getComputedStyle(box[0]).color;
            const series = MOOP.series.plotSeries(checks);
            self.plot = $.plot(box, MOOP.flot.series(series, colour), MOOP.flot.options(series, colour, self.selected()));
        };

        self.redraw = function () {
            self.drawPlot();
            self.drawPicture();
        };

        self.setLive = function () {
            // the age is counted here: no question to the server for it
            const wanted = Boolean(self.status() && self.status().last_check);
            if (wanted && !self.clock) {
                self.clock = setInterval(function () {
                    if (!document.hidden) {
                        self.now_ms(performance.now());
                    }
                }, 1000);
            }
        };

        self.show.subscribe(function (show) {
            if (self.picture) {
                self.picture.show(show);
            }
        });
        // Rate-limited: several changes make one drawing, and the computeds above have settled by then.
        ko.computed(function () { return [self.checks(), self.selected()]; })
            .extend({rateLimit: 20})
            .subscribe(function () { self.redraw(); });

        // --- OctoPrint's callbacks -------------------------------------------------------------------------------

        self.onAllBound = function () {
            self.picture = new MOOP.Picture(document.getElementById("moop_picture"));
            $("#moop_plot").on("plotclick", function (_event, position) {
                const index = MOOP.series.nearest(self.checks(), position.x);
                if (index >= 0) {
                    self.selectedId(self.checks()[index].id);
                }
            });
            $('#moop_pages a[href="#moop_watch_page"]').on("shown", self.refresh);
            $(window).on("resize", _.debounce(self.drawPlot, 200));
            document.addEventListener("visibilitychange", function () {
                if (self.visible()) {
                    self.refresh();
                }
            });
        };
        self.onStartupComplete = function () { self.refresh(); };
        self.onServerReconnect = self.onStartupComplete;
        self.onUserPermissionsChanged = self.onStartupComplete;
        self.onAfterTabChange = function (current) {
            if (current === "#tab_plugin_moop") {
                self.refresh();
            }
        };
        self.onServerDisconnect = function () {
            self.trouble(words.say("The connection to the server is lost: what stands here is old."));
        };
    }

    OCTOPRINT_VIEWMODELS.push({
        construct: MoopTabViewModel,
        name: "moopTabViewModel",
        dependencies: ["loginStateViewModel", "accessViewModel", "settingsViewModel", "printerStateViewModel"],
        elements: ["#moop_watch", "#navbar_plugin_moop"]
    });
});
