/* The MOOP tab's watch page and the eye in the navigation bar: how the print that runs is doing. */
$(function () {
    const words = MOOP.words;
    const CLASSES = {idle: "alert-info", good: "alert-success", warning: "", failed: "alert-error"};
    const ICONS = {
        idle: "fas fa-eye",
        good: "fas fa-eye",
        warning: "fas fa-eye-slash",
        failed: "fas fa-exclamation-triangle"
    };

    function MoopTabViewModel(parameters) {
        const self = this;
        self.loginState = parameters[0];
        self.access = parameters[1];
        self.settings = parameters[2];
        self.printerState = parameters[3];

        self.status = ko.observable(null);
        self.receivedAt_ms = ko.observable(0);
        self.now_ms = ko.observable(0);
        self.busy = ko.observable("");
        self.trouble = ko.observable("");
        self.cameraKnown = ko.observable(null); // null: not asked yet
        self.told = {status: false, checks: []}; // by the server's messages, since it was last asked
        self.stale = ko.observableArray([]); // why the calibration may not hold any more

        // OctoPrint fills in the permissions after the view models are made, so they are looked up when asked
        const allowed = function (name) {
            return ko.pureComputed(function () {
                return self.loginState.hasPermission(self.access.permissions[name]);
            });
        };
        self.mayView = allowed("PLUGIN_MOOP_VIEW");
        self.mayControl = allowed("PLUGIN_MOOP_CONTROL");
        self.mayCalibrate = allowed("PLUGIN_MOOP_CALIBRATE");
        self.maySettings = allowed("SETTINGS");
        self.mayPrint = allowed("PRINT");

        self.visible = function () { return !document.hidden && $("#moop_watch").is(":visible"); };
        self.addresses = function (check) {
            const moop = OctoPrint.plugins.moop;
            return check ? moop.pictureUrls(check.id) : {frame: moop.freshFrameUrl()};
        };
        self.view = new MOOP.View({
            picture: "moop_picture",
            plot: "moop_plot",
            visible: self.visible,
            addresses: self.addresses,
            note: function (check, hasMasks) {
                if (!check) {
                    return words.say("The camera now. Comparisons appear here with the first layer.");
                }
                return hasMasks ? "" : words.say("Nothing could be compared here: only the picture was kept.");
            }
        });
        self.failure = new MOOP.Failure(self);
        self.mender = new MOOP.Mender(self);
        self.mesh = new MOOP.Mesh(self);

        // --- the state, in one line --------------------------------------------------------------------------------

        self.age_s = ko.pureComputed(function () {
            const check = self.status() && self.status().last_check;
            return check ? (check.age_s || 0) + Math.max(0, self.now_ms() - self.receivedAt_ms()) / 1000 : 0;
        });
        self.printer = ko.pureComputed(function () {
            const printer = self.printerState;
            if (printer.isPaused() || printer.isPausing()) {
                return "paused";
            }
            return printer.isPrinting() ? "printing" : "idle";
        });
        self.state = ko.pureComputed(function () { return words.state(self.status(), self.age_s(), self.printer()); });
        self.stateClass = ko.pureComputed(function () { return CLASSES[self.state().level]; });
        self.stateIcon = ko.pureComputed(function () { return ICONS[self.state().level]; });
        self.renderer = ko.pureComputed(function () { return self.status() ? self.status().renderer : ""; });
        self.timeAdded = ko.pureComputed(function () { return words.timeAdded(self.status()); });
        self.notRecorded = ko.pureComputed(function () {
            return self.status() ? words.retold(self.status().not_recorded) : "";
        });
        self.selectedReason = ko.pureComputed(function () {
            const check = self.view.selected();
            const told = check && self.failure.check() && check.layer === self.failure.check().layer; // in the box above
            return check && check.verdict !== "ok" && !told ? words.retold(check.reason) : "";
        });
        self.printing = ko.pureComputed(function () {
            return self.printer() !== "idle" && Boolean(self.status() && self.status().job);
        });
        self.watchText = ko.pureComputed(function () {
            return self.printing() && !self.status().watching
                ? words.say("Watch this print again")
                : words.say("Pause watching for this print");
        });
        self.mayCheck = ko.pureComputed(function () { return self.mayControl() && self.printing() && !self.busy(); });

        // --- what the server tells ---------------------------------------------------------------------------------

        self.takeStatus = function (status) {
            self.receivedAt_ms(performance.now());
            self.now_ms(performance.now());
            const before = self.status();
            self.status(status);
            if (words.failureStands(before) && !words.failureStands(status)) { // pardoned here, or resumed anywhere
                self.failure.dismiss();
            }
            if (before && status.checks < before.checks) { // a new print has begun
                self.view.startOver();
                self.view.checks([]);
            }
            if (status.last_check) {
                self.startClock();
            }
        };

        /* The age of the last check is counted here: no question to the server for it. */
        self.startClock = function () {
            self.clock = self.clock || setInterval(function () {
                if (!document.hidden) {
                    self.now_ms(performance.now());
                }
            }, 1000);
        };

        self.addCheck = function (check) {
            const checks = self.view.checks();
            const last = checks[checks.length - 1];
            if (_.isEqual(_.find(checks, {id: check.id}), check)) {
                return; // both told and answered
            }
            if (last && check.id <= last.id) { // checks are numbered from nought in each print
                self.view.startOver();
                self.view.checks([check]);
            } else {
                self.view.checks(checks.concat([check]));
            }
        };

        self.refresh = function () {
            if (!self.mayView()) {
                return;
            }
            const told = self.told = {status: false, checks: []}; // while the answers are on their way
            OctoPrint.plugins.moop.status()
                .done(function (status) {
                    self.trouble("");
                    if (told === self.told && !told.status) {
                        self.takeStatus(status);
                    }
                })
                .fail(self.tell);
            if (!self.visible()) {
                return;
            }
            if (self.mayCalibrate()) {
                OctoPrint.plugins.moop.setup().done(function (header) {
                    self.cameraKnown(Boolean(header.camera));
                    self.stale(header.calibration ? header.calibration.stale : []);
                });
            }
            self.mesh.load();
            OctoPrint.plugins.moop.checks()
                .done(function (answer) {
                    if (told === self.told) {
                        self.view.checks(answer.checks);
                        told.checks.forEach(self.addCheck);
                        self.failure.drawPictures();
                    }
                })
                .fail(self.tell);
        };

        self.tell = function (request) { self.trouble(words.refusal(request)); };

        // --- what people do ----------------------------------------------------------------------------------------

        self.ask = function (what, request) {
            self.busy(what);
            return request
                .done(function () { self.trouble(""); self.refresh(); })
                .fail(self.tell)
                .always(function () { self.busy(""); });
        };
        self.checkNow = function () {
            self.view.follow();
            return self.ask("check", OctoPrint.plugins.moop.checkNow());
        };
        self.toggleWatching = function () {
            return self.ask("watch", OctoPrint.plugins.moop.watch(!self.status().watching));
        };
        self.pardon = function () {
            return self.ask("pardon", OctoPrint.plugins.moop.pardon());
        };
        self.resume = function () {
            return self.ask("resume", OctoPrint.job.resume());
        };
        self.openTab = function () { $("#tab_plugin_moop_link a").tab("show"); };

        // --- OctoPrint's callbacks ---------------------------------------------------------------------------------

        self.onAllBound = function (all) {
            self.setup = _.find(all, function (model) { return model.moopSetup; });
            self.view.bind();
            $('#moop_pages a[href="#moop_watch_page"]').on("shown", self.refresh);
            document.addEventListener("visibilitychange", function () {
                if (self.visible()) {
                    self.refresh();
                }
            });
        };
        self.onDataUpdaterPluginMessage = function (plugin, message) {
            if (plugin !== "moop" || !self.mayView()) {
                return;
            }
            if (message.type === "status") {
                self.told.status = true;
                self.takeStatus(message.status);
            } else if (message.type === "check") {
                self.told.checks.push(message.check);
                self.addCheck(message.check);
            } else if (message.type === "failed" && words.failureStands(self.status())) { // not resumed meanwhile
                self.failure.notify(message.check, message.action);
            } else if (message.type === "suspect") { // told only where the settings ask for it
                self.warn(words.say("MOOP suspects something"), words.retold(message.check.reason));
            } else if (message.type === "unwatched") {
                self.warn(words.say("MOOP could not watch this print"), words.retold(message.reason));
            }
        };
        self.warn = function (title, text) {
            new PNotify({title: title, text: text, text_escape: true, type: "notice", hide: false});
        };
        /* OctoPrint's assistant has shown our page: what it announces opens of itself. */
        self.onWizardFinish = function () {
            if (self.mayCalibrate() && document.getElementById("wizard_plugin_moop")) {
                self.openTab();
                self.mender.openSetup("camera");
            }
        };
        self.onStartupComplete = function () {
            self.started = true;
            self.refresh();
        };
        // A short interruption ends with a connect, a long one with a reconnect; either may have swallowed messages.
        self.onServerReconnect = self.refresh;
        self.onServerConnect = function () {
            if (self.started) {
                self.refresh();
            }
        };
        self.onUserPermissionsChanged = self.refresh;
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
