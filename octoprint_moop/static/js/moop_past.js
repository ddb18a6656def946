/* Past prints: the recordings, what was concluded, and what other settings would have concluded. */
$(function () {
    const words = MOOP.words;
    const TRIED = ["sensitivity", "hue_min_deg", "hue_max_deg", "saturation_min", "value_min"];

    function MoopPastViewModel(parameters) {
        const self = this;
        self.loginState = parameters[0];
        self.access = parameters[1];
        self.settings = parameters[2];

        self.recordings = ko.observableArray([]);
        self.asked = ko.observable(false);
        self.trouble = ko.observable("");
        self.busy = ko.observable("");
        self.opened = ko.observable(null);
        self.live = ko.observableArray([]); // checks as they were found during the print
        self.again = ko.observable(null); // {checks, summary} of the last replay
        self.index = ko.observable(0);
        self.show = ko.observable("difference");
        self.hasMasks = ko.observable(false);
        self.tried = {};
        self.run = 0;

        const allowed = function (name) {
            return ko.pureComputed(function () {
                return self.loginState.hasPermission(self.access.permissions[name]);
            });
        };
        self.mayView = allowed("PLUGIN_MOOP_VIEW");
        self.mayControl = allowed("PLUGIN_MOOP_CONTROL");
        self.maySettings = allowed("SETTINGS");

        self.rows = ko.pureComputed(function () {
            return self.recordings().map(function (recording) {
                return {
                    name: recording.name,
                    job: recording.job || recording.name,
                    time: words.recordingTime(recording.name),
                    verdict: words.pastVerdict(recording),
                    failed: recording.verdict === "failed",
                    size: Math.max(1, Math.round(recording.bytes / 1e6)) + " MB",
                    zip: OctoPrint.plugins.moop.recordingUrl(recording.name)
                };
            });
        });
        self.checks = ko.pureComputed(function () { return self.again() ? self.again().checks : self.live(); });
        self.check = ko.pureComputed(function () { return self.checks()[Number(self.index())] || null; });
        self.last = ko.pureComputed(function () { return Math.max(0, self.checks().length - 1); });
        self.checkText = ko.pureComputed(function () {
            const check = self.check();
            return check
                ? words.say("Layer %(layer)s · E %(error)s · %(verdict)s", {
                    layer: words.layerNumber(check.layer),
                    error: words.percent(check.E),
                    verdict: check.verdict === "failed" ? words.mode(check) : words.verdict(check)
                })
                : words.say("This print was not checked.");
        });
        self.outcome = ko.pureComputed(function () {
            return self.again() ? words.replayed(self.live(), self.again().summary) : "";
        });

        self.visible = function () { return !document.hidden && $("#moop_past").is(":visible"); };

        self.load = function () {
            if (!self.mayView()) {
                return;
            }
            OctoPrint.plugins.moop.recordings()
                .done(function (answer) {
                    self.trouble("");
                    self.asked(true);
                    self.recordings(answer.recordings);
                })
                .fail(self.tell);
        };

        self.tell = function (request) { self.trouble(words.refusal(request)); };

        self.open = function (row) {
            OctoPrint.plugins.moop.pastChecks(row.name)
                .done(function (answer) {
                    self.trouble("");
                    self.again(null);
                    self.live(answer.checks);
                    self.opened(row);
                    const failed = _.findIndex(answer.checks, function (check) { return check.verdict === "failed"; });
                    self.index(failed >= 0 ? failed : Math.max(0, answer.checks.length - 1));
                    _.each(self.tried, function (value, name) { value(self.settings.settings.plugins.moop[name]()); });
                    self.redraw();
                })
                .fail(self.tell);
        };
        self.close = function () { self.opened(null); };

        self.askedSettings = function () {
            return _.mapValues(self.tried, function (value, name) {
                return name === "sensitivity" ? value() : String(value()).replace(",", ".");
            });
        };

        self.replay = function () {
            self.busy("replay");
            OctoPrint.plugins.moop.replay(self.opened().name, self.askedSettings())
                .done(function (answer) {
                    self.trouble("");
                    self.run += 1;
                    self.again(answer);
                    self.redraw();
                })
                .fail(self.tell)
                .always(function () { self.busy(""); });
        };

        self.useSettings = function () {
            OctoPrint.settings.savePluginSettings("moop", self.askedSettings())
                .done(function () {
                    new PNotify({title: words.say("MOOP uses these settings now"), type: "success"});
                })
                .fail(self.tell);
        };

        self.remove = function (row) {
            showConfirmationDialog({
                title: words.say("Delete this recording?"),
                message: _.escape(words.say("The recording of %(job)s (%(time)s) is deleted for good.", row)),
                question: "",
                cancel: gettext("Cancel"),
                proceed: words.say("Delete it"),
                proceedClass: "danger",
                onproceed: function () {
                    OctoPrint.plugins.moop.deleteRecording(row.name).done(self.load).fail(self.tell);
                    if (self.opened() && self.opened().name === row.name) {
                        self.close();
                    }
                }
            });
        };

        // --- what is drawn -----------------------------------------------------------------------------------------

        self.redraw = function () {
            if (!self.visible() || !self.check()) {
                return;
            }
            const box = $("#moop_past_plot");
            if (box.width()) {
                const colour = getComputedStyle(box[0]).color;
                const points = MOOP.series.plotSeries(self.checks());
                $.plot(box, MOOP.flot.series(points, colour), MOOP.flot.options(points, colour, self.check()));
            }
            const address = function (kind) {
                return OctoPrint.plugins.moop.pastPictureUrl(self.opened().name, self.check().id, kind, self.run);
            };
            const addresses = {frame: address("frame")};
            if (self.again() && self.check().verdict !== "unusable") {
                ["seen", "expected", "ignored"].forEach(function (kind) { addresses[kind] = address(kind); });
            }
            self.picture.open(addresses, self.show())
                .done(function (found) { self.hasMasks(found.masks); })
                .fail(function () { self.hasMasks(false); });
        };

        self.show.subscribe(function (show) {
            if (self.picture.image) {
                self.picture.show(show);
            }
        });
        ko.computed(function () { return self.index(); })
            .extend({rateLimit: 60})
            .subscribe(function () { self.redraw(); });

        self.onBeforeBinding = function () {
            TRIED.forEach(function (name) {
                self.tried[name] = ko.observable(self.settings.settings.plugins.moop[name]());
            });
        };
        self.onAllBound = function () {
            self.picture = new MOOP.Picture(document.getElementById("moop_past_picture"));
            $('#moop_pages a[href="#moop_past_page"]').on("shown", self.load);
            $("#moop_past_plot").on("plotclick", function (_event, position) {
                self.index(Math.max(0, MOOP.series.nearest(self.checks(), position.x)));
            });
        };
    }

    OCTOPRINT_VIEWMODELS.push({
        construct: MoopPastViewModel,
        name: "moopPastViewModel",
        dependencies: ["loginStateViewModel", "accessViewModel", "settingsViewModel"],
        elements: ["#moop_past"]
    });
});
