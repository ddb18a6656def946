/* One past print: its checks as they were found, and what other settings would have found. */
(function () {
    const TRIED = ["sensitivity", "hue_min_deg", "hue_max_deg", "saturation_min", "value_min"];
    const POLL_MS = 700;
    const QUICK_MS = 4000; // a replay that took no longer is made anew at each touch of a slider
    const KEPT = ["sensitivity"]; // what these change is concluded anew from what the last replay has seen, in a moment

    /* past: the view model of the list. */
    function PastPrint(past) {
        const self = this;
        const words = MOOP.words;
        self.past = past;
        self.row = ko.observable(null);
        self.live = ko.observableArray([]); // checks as they were found during the print
        self.again = ko.observable(null); // {checks, summary} of the last replay
        self.busy = ko.observable(false);
        self.progress = ko.observable(null); // {done, of} of the replay that runs
        self.tried = {};
        self.run = 0;
        self.took_ms = Infinity;

        self.view = new MOOP.View({
            picture: "moop_past_picture",
            plot: "moop_past_plot",
            visible: past.visible,
            addresses: function (check) { return self.addresses(check); },
            note: function (check, hasMasks) {
                if (!check) {
                    return words.say("This print was not checked.");
                }
                return hasMasks || self.again() || !past.mayControl()
                    ? ""
                    : words.say("What was seen and expected is drawn by a trial, below.");
            }
        });
        self.outcome = ko.pureComputed(function () {
            return self.again() ? words.replayed(self.live(), self.again().summary) : "";
        });
        self.share = ko.pureComputed(function () {
            const progress = self.progress();
            return progress && progress.of ? Math.min(1, progress.done / progress.of) : 0;
        });
        self.progressText = ko.pureComputed(function () {
            const progress = self.progress();
            return progress
                ? words.say("Picture %(done)s of %(of)s", progress)
                : words.say("Reading the print …");
        });
    }

    PastPrint.prototype.addresses = function (check) {
        const moop = OctoPrint.plugins.moop;
        const name = this.row().name;
        const run = this.run;
        const kinds = this.again() && check && check.verdict !== "unusable" ? MOOP.View.KINDS : ["frame"];
        return _.zipObject(kinds, kinds.map(function (kind) { return moop.pastPictureUrl(name, check ? check.id : 0, kind, run); }));
    };

    PastPrint.prototype.readSettings = function () {
        const self = this;
        const stored = self.past.settings.settings.plugins.moop;
        TRIED.forEach(function (name) {
            if (self.tried[name]) {
                self.tried[name](stored[name]());
                return;
            }
            self.tried[name] = ko.observable(stored[name]());
        });
        self.touched = self.touched || ko.computed(function () { return JSON.stringify(self.askedSettings()); })
            .extend({rateLimit: {timeout: 250, method: "notifyWhenChangesStop"}});
        self.listening = self.listening || self.touched.subscribe(function () {
            if (self.row() && self.again() && self.isQuick()) {
                self.replay();
            }
        });
    };

    PastPrint.prototype.open = function (row) {
        const self = this;
        OctoPrint.plugins.moop.pastChecks(row.name)
            .done(function (answer) {
                self.past.trouble("");
                self.took_ms = Infinity;
                self.again(null);
                self.row(row);
                self.readSettings();
                self.live(answer.checks);
                self.view.startOver();
                self.view.hasMasks(false);
                self.view.checks(answer.checks);
                const failed = _.findIndex(answer.checks, function (check) { return check.verdict === "failed"; });
                if (failed >= 0) {
                    self.view.choose(failed);
                }
                self.view.redraw();
                document.getElementById("moop_past_opened").focus();
            })
            .fail(self.past.tell);
    };
    PastPrint.prototype.close = function () {
        this.row(null);
    };

    PastPrint.prototype.askedSettings = function () {
        return _.mapValues(this.tried, function (value, name) {
            return name === "sensitivity" ? value() : String(value()).replace(",", ".");
        });
    };

    /* Whether what has been changed since the last replay can be tried at once. */
    PastPrint.prototype.isQuick = function () {
        const before = this.replayed || {};
        const changed = _.keys(_.pick(this.askedSettings(), function (value, name) { return value !== before[name]; }));
        return changed.length > 0 && (this.took_ms < QUICK_MS || _.difference(changed, KEPT).length === 0);
    };

    /* Asks what these settings would have found. While one answer is awaited, the newest wish waits behind it. */
    PastPrint.prototype.replay = function () {
        const self = this;
        if (self.busy()) {
            self.waiting = true;
            return;
        }
        const name = self.row().name;
        const began_ms = performance.now();
        self.waiting = false;
        self.busy(true);
        self.progress(null);
        self.poll(name);
        self.replayed = self.askedSettings();
        OctoPrint.plugins.moop.replay(name, self.replayed)
            .done(function (answer) {
                if (!self.row() || self.row().name !== name) {
                    return; // another print was opened meanwhile
                }
                self.past.trouble("");
                self.took_ms = performance.now() - began_ms;
                self.run += 1;
                self.again(answer);
                self.view.checks(answer.checks);
            })
            .fail(self.past.tell)
            .always(function () {
                self.busy(false);
                if (self.waiting && self.row()) {
                    self.replay();
                }
            });
    };

    PastPrint.prototype.poll = function (name) {
        const self = this;
        setTimeout(function () {
            if (!self.busy()) {
                return;
            }
            if (!self.past.visible()) {
                self.poll(name);
                return;
            }
            OctoPrint.plugins.moop.replayProgress(name)
                .done(self.progress)
                .always(function () { self.poll(name); });
        }, POLL_MS);
    };

    PastPrint.prototype.useSettings = function () {
        const self = this;
        OctoPrint.settings.savePluginSettings("moop", self.askedSettings())
            .done(function () {
                self.past.announced(MOOP.words.say("MOOP uses these settings from now on."));
                new PNotify({title: MOOP.words.say("MOOP uses these settings now"), type: "success"});
            })
            .fail(self.past.tell);
    };

    window.MOOP = Object.assign(window.MOOP || {}, {PastPrint: PastPrint});
})();
