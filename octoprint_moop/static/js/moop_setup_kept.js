/* The calibrations that are kept for this printer profile and webcam: named, dated, exported, taken over, reverted. */
(function () {
    function SetupKept(setup) {
        const self = this;
        const words = MOOP.words;
        self.setup = setup;
        self.current = ko.observable(null);
        self.calibrations = ko.observableArray([]);

        self.rows = ko.pureComputed(function () {
            return self.calibrations().map(function (kept) {
                return {
                    id: kept.id,
                    name: ko.observable(kept.name),
                    was: kept.name,
                    told: words.calibration(kept),
                    stale: kept.stale,
                    inUse: kept.id === self.current(),
                    file: OctoPrint.plugins.moop.calibrationUrl(kept.id)
                };
            });
        });
        self.stale = ko.pureComputed(function () {
            const used = _.find(self.calibrations(), function (kept) { return kept.id === self.current(); });
            return used ? used.stale : [];
        });
        self.mayRevert = ko.pureComputed(function () { return self.calibrations().length > 1 && !setup.busy(); });

        self.isWell = function () { setup.trouble(""); };
        // Loading tells nothing of what somebody just did: a trouble that is shown stays.
        self.load = function () { return self.take(OctoPrint.plugins.moop.calibrations()); };
        self.use = function (row) {
            self.change(OctoPrint.plugins.moop.useCalibration(row.id), words.say("%(was)s is used from now on.", row));
        };
        self.revert = function () {
            self.change(OctoPrint.plugins.moop.revertCalibration(), words.say("The calibration from before is used again."));
        };
        self.rename = function (row) {
            if (row.name().trim() !== row.was) {
                self.take(OctoPrint.plugins.moop.renameCalibration(row.id, row.name())).done(self.isWell);
            }
        };
        self.remove = function (row) {
            setup.confirm(
                words.say("Delete this calibration?"), words.say("%(was)s is deleted for good.", row), words.say("Delete it"),
                function () { self.take(OctoPrint.plugins.moop.deleteCalibration(row.id)).done(self.isWell); }
            );
        };
        /* A file that was exported here or elsewhere. */
        self.readFile = function (_model, event) {
            const file = event.target.files[0];
            event.target.value = "";
            if (file) {
                file.text().then(function (text) {
                    let header = null;
                    try {
                        header = JSON.parse(text);
                    } catch (e) {
                        setup.trouble(words.say("This file is not a calibration."));
                        return;
                    }
                    OctoPrint.plugins.moop.saveSetup(header)
                        .done(function () {
                            setup.trouble("");
                            setup.saved(setup.fromNextPrint(words.say("The calibration in the file is used from now on.")));
                            self.load();
                            setup.load().done(function () { setup.place.showGuides(); });
                        })
                        .fail(setup.tell);
                });
            }
        };
    }

    SetupKept.prototype.take = function (request) {
        const self = this;
        return request
            .done(function (answer) {
                self.current(answer.current);
                self.calibrations(answer.calibrations);
            })
            .fail(self.setup.tell);
    };

    SetupKept.prototype.change = function (request, told) {
        const setup = this.setup;
        this.take(request).done(function () {
            setup.trouble("");
            setup.saved(setup.fromNextPrint(told));
            setup.load().done(function () { setup.place.showGuides(); });
        });
    };

    window.MOOP = Object.assign(window.MOOP || {}, {SetupKept: SetupKept});
})();
