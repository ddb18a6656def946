/*
 * The set-up: seven steps, each of which can be skipped, repeated, left and resumed. What a step finds is kept on the
 * server as soon as it is taken over; what was begun stays in the browser, through a reload of the page too.
 */
$(function () {
    const words = MOOP.words;
    const STEPS = ["camera", "bed", "lens", "place", "filament", "action", "trial"];
    const DRAFT = "plugin_moop_setup";

    function MoopSetupViewModel(parameters) {
        const self = this;
        self.loginState = parameters[0];
        self.access = parameters[1];
        self.settings = parameters[2];
        self.printerState = parameters[3];

        self.moopSetup = true; // by which the tab knows it
        self.openings = 0;
        self.draft = loadFromLocalStorage(DRAFT) || {};
        self.step = ko.observable(_.includes(STEPS, self.draft.step) ? self.draft.step : "camera");
        self.header = ko.observable({});
        self.trouble = ko.observable("");
        self.saved = ko.observable("");
        self.busy = ko.observable("");
        self.onFailed = ko.observable("pause");
        self.sensitivity = ko.observable("medium");

        self.mayCalibrate = ko.pureComputed(function () {
            return self.loginState.hasPermission(self.access.permissions.PLUGIN_MOOP_CALIBRATE);
        });
        self.hasCamera = ko.pureComputed(function () { return Boolean(self.header().camera); });
        self.camera = new MOOP.SetupCamera(self);
        self.bed = new MOOP.SetupBed(self);
        self.place = new MOOP.SetupPlace(self);
        self.lens = new MOOP.SetupLens(self);
        self.kept = new MOOP.SetupKept(self);

        self.done = {
            camera: self.camera.good,
            bed: ko.pureComputed(function () { return self.hasCamera() || self.bed.kept(); }),
            lens: self.lens.known,
            place: self.hasCamera,
            filament: ko.pureComputed(function () {
                const material = self.header().material;
                return Boolean(material) && MOOP.hue.hueSpan(material.hue_deg[0], material.hue_deg[1]) < 300;
            }),
            action: ko.observable(Boolean(self.draft.action)),
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
        self.busyText = ko.pureComputed(function () { return self.busy() ? words.busy(self.busy()) : ""; });

        // --- keeping ---------------------------------------------------------------------------------------------

        self.load = function () {
            if (!self.mayCalibrate()) {
                return $.Deferred().reject();
            }
            return OctoPrint.plugins.moop.setup()
                .done(function (header) {
                    self.header(header);
                    self.bed.take(header.printer || {});
                })
                .fail(self.tell);
        };

        /* A print keeps the calibration that it began with: whoever keeps another meanwhile is told. */
        self.fromNextPrint = function (told) {
            return self.printerState.isBusy()
                ? told + " " + words.say("The print that runs keeps what it began with; this holds from the next one on.")
                : told;
        };

        /* Takes parts of a header over on the server; `told` is the sentence for the person. */
        self.keep = function (parts, told) {
            self.busy("save");
            const own = _.pick(self.header(), ["printer", "camera", "cameras", "material"]);
            const header = $.extend({format: "moop-recording", version: 1}, own, parts);
            return OctoPrint.plugins.moop.saveSetup(header)
                .done(function () {
                    self.trouble("");
                    self.saved(self.fromNextPrint(told));
                    self.load();
                    self.kept.load();
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

        /* What was begun and is not on the server yet, for the next visit. */
        self.remember = function (parts) {
            self.draft = $.extend({}, self.draft, parts);
            saveToLocalStorage(DRAFT, self.draft);
        };

        self.tell = function (request) {
            self.saved("");
            self.trouble(words.refusal(request));
        };

        /* A question before anything moves or is lost. The texts may hold names of files: they are escaped. */
        self.confirm = function (title, message, proceed, action) {
            showConfirmationDialog({
                title: title,
                message: _.escape(message),
                question: "",
                cancel: gettext("Cancel"),
                proceed: proceed,
                proceedClass: "primary",
                onproceed: action
            });
        };

        // --- going about -----------------------------------------------------------------------------------------

        self.go = function (name) {
            self.trouble("");
            self.saved("");
            if (self.step() === name) {
                self.opened(); // which looks again, and says again what was in the way
            }
            self.step(name);
        };
        self.next = function () { self.go(STEPS[Math.min(STEPS.length - 1, STEPS.indexOf(self.step()) + 1)]); };
        self.before = function () { self.go(STEPS[Math.max(0, STEPS.indexOf(self.step()) - 1)]); };

        self.visible = function () { return !document.hidden && $("#moop_setup").is(":visible"); };

        self.step.subscribe(function (name) {
            self.remember({step: name});
            setTimeout(self.opened, 0); // the step's own part must be on screen first
        });

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
                self.place.comeBack();
                self.kept.load();
            } else if (name === "trial") {
                self.camera.take().done(self.place.showGuides);
            } else if (name === "camera" || name === "bed" || name === "lens") {
                self.camera.take();
            }
        };

        // --- 5: the filament, 6: what to do at a failure, 7: the trial ---------------------------------------------

        self.keepFilament = function () {
            const typed = self.filament.thresholds();
            self.keepSettings({
                hue_min_deg: typed.hue_deg[0],
                hue_max_deg: typed.hue_deg[1],
                saturation_min: typed.saturation_min,
                value_min: typed.value_min
            }, words.say("This colour is the filament.")).done(self.load);
        };

        /* Back to what suits every colour: what a print has shown tells its filament. */
        self.learnFilament = function () {
            const limits = JSON.parse(document.getElementById("moop_settings_limits").textContent);
            self.typed.hueMin(limits.hue_min_deg.default);
            self.typed.hueMax(limits.hue_max_deg.default);
            self.typed.saturationMin(limits.saturation_min.default);
            self.typed.valueMin(limits.value_min.default);
            self.keepSettings({
                segmentation: "adaptive",
                hue_min_deg: limits.hue_min_deg.default,
                hue_max_deg: limits.hue_max_deg.default,
                saturation_min: limits.saturation_min.default,
                value_min: limits.value_min.default
            }, words.say("The filament's colour is learned from each print.")).done(self.load);
        };

        self.keepAction = function () {
            self.keepSettings(
                {on_failed: self.onFailed(), sensitivity: self.sensitivity()}, words.say("This is what will be done.")
            ).done(function () {
                self.done.action(true);
                self.remember({action: true});
            });
        };

        self.trialLines = ko.pureComputed(function () {
            const header = self.header();
            const learned = self.settings.settings.plugins.moop.segmentation() === "adaptive";
            const line = function (step, ok, text) { return {step: step, ok: Boolean(ok), text: text}; };
            return [
                line("camera", self.camera.good(), words.say("The picture is good.")),
                line("bed", header.printer, words.say("The printer's geometry is known.")),
                line("place", header.camera, words.say("The camera's place is known: its grid must lie on the bed.")),
                line("place", header.camera && !self.kept.stale().length, words.say("The calibration is of the camera as it is now.")),
                line("filament", self.done.filament() || learned, self.done.filament()
                    ? words.say("The filament's colour is narrowed down.")
                    : words.say("The filament's colour is learned from each print.")),
                line("action", self.settings.settings.plugins.moop.watch_prints(), words.say("Every print will be watched."))
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
            $("#moop_pages a").on("shown", function (event) {
                self.remember({open: event.target.getAttribute("href") === "#moop_setup_page"});
            });
            $('#moop_pages a[href="#moop_setup_page"]').on("shown", function () {
                self.loading = self.load().done(function () {
                    self.lens.load();
                    self.kept.load();
                });
                self.opened();
            });
        };

        /* Who was in the middle of it when the page was loaded anew goes on there. */
        self.onStartupComplete = function () {
            if (self.draft.open && self.mayCalibrate()) {
                $('#moop_pages a[href="#moop_setup_page"]').tab("show");
            }
        };
        self.onAfterTabChange = function (current) {
            if (current === "#tab_plugin_moop") {
                self.opened();
            }
        };
    }

    OCTOPRINT_VIEWMODELS.push({
        construct: MoopSetupViewModel,
        name: "moopSetupViewModel",
        dependencies: ["loginStateViewModel", "accessViewModel", "settingsViewModel", "printerStateViewModel"],
        elements: ["#moop_setup"]
    });
});
