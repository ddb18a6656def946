/* Step "bed" of the set-up: how the bed moves, as a person says or as two pictures show. Nothing moves unasked. */
(function () {
    function SetupBed(setup) {
        const self = this;
        const words = MOOP.words;
        self.setup = setup;
        self.motion = ko.observable("fixed");
        self.kept = ko.observable(false); // in this page; on the server it is kept together with the camera
        self.reference = {x: ko.observable("0"), y: ko.observable("0"), z: ko.observable("0")};
        self.measured = ko.observable("");

        self.mayMove = ko.pureComputed(function () {
            const printer = setup.printerState;
            return setup.loginState.hasPermission(setup.access.permissions.CONTROL) &&
                printer.isOperational() && !printer.isPrinting() && !printer.isPaused();
        });
        self.volumeTold = ko.pureComputed(function () {
            const volume = (setup.header().printer || {}).volume_mm;
            return volume
                ? words.say(
                    "OctoPrint's printer profile says that the bed is %(width)s x %(depth)s mm. If that is wrong, correct it there first.",
                    volume
                )
                : "";
        });
        self.camera = function () { return setup.place.found() || setup.header().camera; };

        self.keep = function () {
            self.printer()
                .done(function (printer) {
                    self.kept(true);
                    if (setup.hasCamera()) {
                        setup.keep({printer: printer}, words.say("How the bed moves is kept."));
                    } else {
                        setup.header($.extend({}, setup.header(), {printer: printer}));
                        setup.next();
                    }
                })
                .fail(setup.tell);
        };

        self.home = function () {
            setup.confirm(
                words.say("Home the printer?"),
                words.say("All axes move to their end stops. Nothing is heated. Make sure that nothing stands in the way, and that no print lies on the bed."),
                words.say("Home it"),
                function () {
                    OctoPrint.printer.home(["x", "y", "z"])
                        .done(function () { setup.saved(words.say("The printer is homing. When it stands still, go on.")); })
                        .fail(setup.tell);
                }
            );
        };

        /* Asks what would be moved, tells it, and moves only then. */
        self.measure = function () {
            setup.busy("move");
            OctoPrint.plugins.moop.bedMotionPlan()
                .done(function (plan) {
                    if (!plan.can) {
                        setup.trouble(plan.why);
                        return;
                    }
                    setup.trouble("");
                    setup.confirm(words.say("Move the printer?"), words.bedMotionPlan(plan), words.say("Move it"), function () {
                        self.ask({confirmed: true});
                    });
                })
                .fail(setup.tell)
                .always(function () { setup.busy(""); });
        };
        self.compare = function () { self.ask({moved: true}); };
    }

    /* The header's printer: OctoPrint's profile, and what only a person or a measurement can say. A promise. */
    SetupBed.prototype.printer = function () {
        const self = this;
        const position = _.mapValues(self.reference, function (value) { return Number(value().replace(",", ".")); });
        if (!_.every(position, isFinite)) {
            return $.Deferred().reject({
                responseText: JSON.stringify({message: MOOP.words.say("The position needs three numbers, in millimetres.")})
            });
        }
        return OctoPrint.plugins.moop.printerGeometry().then(function (answer) {
            return $.extend({}, answer.printer, {bed_motion: self.motion(), bed_reference_mm: position});
        });
    };

    SetupBed.prototype.take = function (printer) {
        if (!this.kept()) {
            this.motion(printer.bed_motion || "fixed");
        }
        this.takeReference(printer.bed_reference_mm);
    };

    SetupBed.prototype.takeReference = function (position) {
        if (position) {
            _.each(this.reference, function (value, axis) { value(String(position[axis] || 0)); });
        }
    };

    SetupBed.prototype.ask = function (how) {
        const self = this;
        const setup = self.setup;
        setup.busy("move");
        setup.saved("");
        OctoPrint.plugins.moop.measureBedMotion($.extend({camera: self.camera()}, how))
            .done(function (found) {
                setup.trouble("");
                self.motion(found.bed_motion);
                self.takeReference(found.bed_reference_mm);
                self.kept(true);
                self.measured(MOOP.words.bedMotion(found.bed_motion));
                if (setup.hasCamera() && !setup.place.found()) {
                    self.keep();
                } else {
                    setup.place.showGuides();
                }
            })
            .fail(setup.tell)
            .always(function () { setup.busy(""); });
    };

    window.MOOP = Object.assign(window.MOOP || {}, {SetupBed: SetupBed});
})();
