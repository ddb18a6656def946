/*
 * The set-up: seven steps, each of which can be skipped, repeated, left and resumed. What a step finds is kept on the
 * server as soon as it is taken over; what was begun stays in the page while one goes back and forth.
 */
$(function () {
    const words = MOOP.words;
    const STEPS = ["camera", "bed", "lens", "place", "filament", "action", "trial"];

    function MoopSetupViewModel(parameters) {
        const self = this;
        self.loginState = parameters[0];
        self.access = parameters[1];
        self.settings = parameters[2];
        self.printerState = parameters[3];

        self.moopSetup = true; // by which the tab knows it
        self.openings = 0;
        self.step = ko.observable("camera");
        self.header = ko.observable({});
        self.trouble = ko.observable("");
        self.saved = ko.observable("");
        self.busy = ko.observable("");
        self.verdicts = ko.observableArray([]);

        self.bedMotion = ko.observable("fixed");
        self.bedKept = ko.observable(false); // in this page; on the server it is kept together with the camera
        self.reference = {x: ko.observable("0"), y: ko.observable("0"), z: ko.observable("0")};
        self.onFailed = ko.observable("pause");
        self.sensitivity = ko.observable("medium");
        self.trialTold = ko.observable("");

        self.mayCalibrate = ko.pureComputed(function () {
            return self.loginState.hasPermission(self.access.permissions.PLUGIN_MOOP_CALIBRATE);
        });
        self.mayMove = ko.pureComputed(function () {
            return self.loginState.hasPermission(self.access.permissions.CONTROL) &&
                self.printerState.isOperational() && !self.printerState.isPrinting() && !self.printerState.isPaused();
        });
        self.hasCamera = ko.pureComputed(function () { return Boolean(self.header().camera); });
        self.volumeTold = ko.pureComputed(function () {
            const volume = (self.header().printer || {}).volume_mm;
            return volume
                ? words.say(
                    "OctoPrint's printer profile says that the bed is %(width)s x %(depth)s mm. If that is wrong, correct it there first.",
                    volume
                )
                : "";
        });
        self.place = new MOOP.SetupPlace(self);
        self.lens = new MOOP.SetupLens(self);

        self.done = {
            camera: ko.pureComputed(function () { return self.verdicts().length > 0 && _.every(self.verdicts(), "ok"); }),
            bed: ko.pureComputed(function () { return self.hasCamera() || self.bedKept(); }),
            lens: ko.pureComputed(function () { return self.lens.known(); }),
            place: self.hasCamera,
            filament: ko.pureComputed(function () {
                const material = self.header().material;
                return Boolean(material) && MOOP.hue.hueSpan(material.hue_deg[0], material.hue_deg[1]) < 300;
            }),
            action: ko.observable(false),
            trial: ko.observable(false)
        };
        const titles = {
            camera: words.say("Camera"),
            bed: words.say("Bed"),
            lens: words.say("Lens"),
            place: words.say("Place"),
            filament: words.say("Filament"),
            action: words.say("Failure"),
            trial: words.say("Trial")
        };
        self.steps = STEPS.map(function (name, index) {
            return {
                name: name,
                title: titles[name],
                number: index + 1,
                current: ko.pureComputed(function () { return self.step() === name; }),
                done: self.done[name]
            };
        });

        // --- keeping ---------------------------------------------------------------------------------------------

        self.load = function () {
            if (!self.mayCalibrate()) {
                return $.Deferred().reject();
            }
            return OctoPrint.plugins.moop.setup().done(self.takeHeader).fail(self.tell);
        };

        self.takeHeader = function (header) {
            self.header(header);
            const printer = header.printer || {};
            self.bedMotion(printer.bed_motion || "fixed");
            self.takeReference(printer.bed_reference_mm);
        };

        self.takeReference = function (position) {
            if (position) {
                _.each(self.reference, function (value, axis) { value(String(position[axis] || 0)); });
            }
        };

        /* Takes parts of a header over on the server; `told` is the sentence for the person. */
        self.keep = function (parts, told) {
            self.busy("save");
            const header = $.extend({format: "moop-recording", version: 1}, self.header(), parts);
            return OctoPrint.plugins.moop.saveSetup(header)
                .done(function () {
                    self.trouble("");
                    self.saved(told);
                    self.load();
                })
                .fail(self.tell)
                .always(function () { self.busy(""); });
        };

        self.keepSettings = function (values, told) {
            return OctoPrint.settings.savePluginSettings("moop", values)
                .done(function () {
                    self.trouble("");
                    self.saved(told);
                })
                .fail(self.tell);
        };

        self.tell = function (request) {
            self.saved("");
            self.trouble(words.refusal(request));
        };

        // --- going about -----------------------------------------------------------------------------------------

        self.go = function (name) {
            self.trouble("");
            self.saved("");
            self.step(name);
        };
        self.next = function () { self.go(STEPS[Math.min(STEPS.length - 1, STEPS.indexOf(self.step()) + 1)]); };
        self.before = function () { self.go(STEPS[Math.max(0, STEPS.indexOf(self.step()) - 1)]); };

        self.visible = function () { return !document.hidden && $("#moop_setup").is(":visible"); };

        self.step.subscribe(function () { setTimeout(self.opened, 0); }); // the step's own part must be on screen first

        /* Shows the step that has been reached; of several wishes in a row, only the last is granted. */
        self.opened = function () {
            const own = ++self.openings;
            $.when(self.loading).always(function () {
                if (own === self.openings && self.visible() && self.mayCalibrate()) {
                    self.showStep();
                }
            });
        };

        self.showStep = function () {
            const name = self.step();
            if (name === "filament") {
                self.filament.open();
            } else if (name === "place") {
                self.place.open();
            } else if (name === "trial") {
                self.takePicture().done(self.place.showGuides);
            } else if (name === "camera" || name === "bed" || name === "lens") {
                self.takePicture();
            }
        };

        // --- 1: the camera ---------------------------------------------------------------------------------------

        self.takePicture = function () {
            self.busy("picture");
            return self.picture.open({frame: OctoPrint.plugins.moop.freshFrameUrl()}, "plain")
                .done(function () {
                    self.trouble("");
                    self.judge();
                })
                .fail(function () {
                    self.verdicts([]);
                    self.trouble(words.say(
                        "The webcam gives no picture. Enter its snapshot address in OctoPrint's settings, under Classic Webcam."
                    ));
                })
                .always(function () { self.busy(""); });
        };

        self.judge = function () {
            const image = self.picture.image;
            const width = Math.min(640, image.naturalWidth);
            const height = Math.round(width * image.naturalHeight / image.naturalWidth);
            const canvas = document.createElement("canvas");
            canvas.width = width;
            canvas.height = height;
            const context = canvas.getContext("2d");
            context.drawImage(image, 0, 0, width, height);
            const rgba = context.getImageData(0, 0, width, height).data;
            self.verdicts(MOOP.quality.judge(MOOP.quality.measure(rgba, width, height)));
        };

        self.openWebcamSettings = function () { self.settings.show("settings_plugin_classicwebcam"); };
        self.openSettings = function () { self.settings.show("settings_plugin_moop"); };

        // --- 2: how the bed moves --------------------------------------------------------------------------------

        /* The header's printer: OctoPrint's profile, and what only a person can say. A promise. */
        self.printerHeader = function () {
            const position = _.mapValues(self.reference, function (value) { return Number(value().replace(",", ".")); });
            if (!_.every(position, isFinite)) {
                return $.Deferred().reject({
                    responseText: JSON.stringify({message: words.say("The position needs three numbers, in millimetres.")})
                });
            }
            return OctoPrint.plugins.moop.printerGeometry().then(function (answer) {
                return $.extend({}, answer.printer, {bed_motion: self.bedMotion(), bed_reference_mm: position});
            });
        };

        self.keepBed = function () {
            self.printerHeader()
                .done(function (printer) {
                    self.bedKept(true);
                    if (self.hasCamera()) {
                        self.keep({printer: printer}, words.say("How the bed moves is kept."));
                    } else {
                        self.header($.extend({}, self.header(), {printer: printer}));
                        self.next();
                    }
                })
                .fail(self.tell);
        };

        /* Moves one axis to and fro, after asking, and takes a picture at each end for the person to compare. */
        self.tryMove = function (axis) {
            const by = axis === "z" ? 10 : 30;
            showConfirmationDialog({
                title: words.say("Move the printer?"),
                message: words.say(
                    "The %(axis)s axis moves %(by)s mm up and back again. Nothing is heated. Make sure that nothing is in the way.",
                    {axis: axis.toUpperCase(), by: by}
                ),
                question: "",
                cancel: gettext("Cancel"),
                proceed: words.say("Move it"),
                proceedClass: "primary",
                onproceed: function () {
                    self.busy("move");
                    const there = {};
                    there[axis] = by;
                    const back = {};
                    back[axis] = -by;
                    OctoPrint.printer.jog(there)
                        .then(function () { return self.wait(4000); })
                        .then(function () { return self.takePicture(); })
                        .then(function () { return self.wait(1500); })
                        .then(function () { return OctoPrint.printer.jog(back); })
                        .then(function () { return self.wait(4000); })
                        .then(function () { return self.takePicture(); })
                        .fail(self.tell)
                        .always(function () { self.busy(""); });
                }
            });
        };
        self.tryY = function () { self.tryMove("y"); };
        self.tryZ = function () { self.tryMove("z"); };

        self.wait = function (duration_ms) {
            const over = $.Deferred();
            setTimeout(over.resolve, duration_ms);
            return over;
        };

        // --- 6: what to do at a failure ----------------------------------------------------------------------------

        self.keepAction = function () {
            self.keepSettings(
                {on_failed: self.onFailed(), sensitivity: self.sensitivity()}, words.say("This is what will be done.")
            ).done(function () { self.done.action(true); });
        };

        self.keepFilament = function () {
            const typed = self.filament.thresholds();
            self.keepSettings({
                hue_min_deg: typed.hue_deg[0],
                hue_max_deg: typed.hue_deg[1],
                saturation_min: typed.saturation_min,
                value_min: typed.value_min
            }, words.say("This colour is the filament.")).done(self.load);
        };

        // --- 7: the trial ------------------------------------------------------------------------------------------

        self.trialLines = ko.pureComputed(function () {
            const header = self.header();
            return [
                {ok: self.verdicts().length > 0 && _.every(self.verdicts(), "ok"), text: words.say("The picture is good.")},
                {ok: Boolean(header.printer), text: words.say("The printer's geometry is known.")},
                {ok: Boolean(header.camera), text: words.say("The camera's place is known: its grid must lie on the bed.")},
                {ok: self.done.filament(), text: words.say("The filament's colour is narrowed down.")},
                {
                    ok: self.settings.settings.plugins.moop.watch_prints(),
                    text: words.say("Every print will be watched.")
                }
            ];
        });
        self.finish = function () {
            self.done.trial(true);
            $('#moop_pages a[href="#moop_watch_page"]').tab("show");
        };

        // --- OctoPrint's callbacks -----------------------------------------------------------------------------------

        self.onBeforeBinding = function () {
            const stored = self.settings.settings.plugins.moop;
            self.typed = _.mapValues(
                {hueMin: "hue_min_deg", hueMax: "hue_max_deg", saturationMin: "saturation_min", valueMin: "value_min"},
                function (name) { return ko.observable(stored[name]()); }
            );
            self.filament = new MOOP.Filament(self.typed);
            self.onFailed(stored.on_failed());
            self.sensitivity(stored.sensitivity());
        };

        self.onAllBound = function () {
            self.picture = new MOOP.Picture(document.getElementById("moop_setup_picture"), {
                onPick: function (point) { self.place.pick(point); },
                onDraw: function (context, toScreen, density) {
                    if (self.step() === "place" || self.step() === "trial") {
                        self.place.draw(context, toScreen, density);
                    } else if (self.step() === "lens") {
                        self.lens.draw(context, toScreen, density);
                    }
                }
            });
            self.filament.bind(document.getElementById("moop_setup_filament"));
            $('#moop_pages a[href="#moop_setup_page"]').on("shown", function () {
                self.loading = self.load().always(self.lens.load);
                self.opened();
            });
        };
    }

    OCTOPRINT_VIEWMODELS.push({
        construct: MoopSetupViewModel,
        name: "moopSetupViewModel",
        dependencies: ["loginStateViewModel", "accessViewModel", "settingsViewModel", "printerStateViewModel"],
        elements: ["#moop_setup"]
    });
});
