/* Step "place" of the set-up: where the camera stands, from clicked points or from the marker plate. */
(function () {
    /* Marks words for the translators; they are translated where they are said. */
    function N_(text) {
        return text;
    }

    const CORNERS = [N_("front left"), N_("front right"), N_("back right"), N_("back left")];

    /* The bed's corners in print coordinates, in the order of CORNERS. */
    function bedCorners(printer) {
        const width = printer.volume_mm.width;
        const depth = printer.volume_mm.depth;
        const x = printer.origin === "center" ? -width / 2 : 0;
        const y = printer.origin === "center" ? -depth / 2 : 0;
        return [[x, y, 0], [x + width, y, 0], [x + width, y + depth, 0], [x, y + depth, 0]];
    }

    function SetupPlace(setup) {
        const self = this;
        self.setup = setup;
        self.method = ko.observable("corners");
        self.points = ko.observableArray([]);
        self.current = ko.observable(0);
        self.markersText = ko.observable("");
        self.found = ko.observable(null); // what the server answered, not yet taken over
        self.how = "points";
        self.name = ko.observable("");
        self.lines = ko.observableArray([]);

        self.clicked = ko.pureComputed(function () {
            return self.points().filter(function (point) { return point.px() !== null; });
        });
        self.ready = ko.pureComputed(function () { return self.clicked().length >= 4 && !setup.busy(); });
        self.told = ko.pureComputed(function () {
            const found = self.found();
            if (!found) {
                return "";
            }
            return MOOP.words.say(
                "They fit to %(rms)s px. A point of the print is then sure to %(px)s px, or %(mm)s mm, on average.",
                {
                    rms: found.rms_px.toFixed(2),
                    px: found.error_px.mean === null ? "?" : found.error_px.mean.toFixed(1),
                    mm: found.error_mm.mean === null ? "?" : found.error_mm.mean.toFixed(2)
                }
            );
        });

        ko.computed(function () {
            const printer = setup.header().printer;
            if (printer && printer.volume_mm && !self.points.peek().length) {
                self.bed = JSON.stringify(printer.volume_mm);
                const mine = setup.draft.bed === self.bed && setup.draft.points; // clicks on another printer's bed are not
                const begun = mine || bedCorners(printer).map(function (mm, index) {
                    return {name: MOOP.words.say(CORNERS[index]), mm: mm, px: null};
                });
                begun.forEach(function (point) { self.addPoint(point.name, point.mm, point.px); });
            }
        });

        self.choose = function (point) { self.current(self.points.indexOf(point)); };
        self.anotherPoint = function () {
            self.addPoint(MOOP.words.say("another point"), ["", "", "0"], null);
            self.current(self.points().length - 1);
        };
        self.forget = function () {
            self.points().forEach(function (point) { point.px(null); });
            self.current(0);
            self.found(null);
            self.remember();
            self.showGuides();
        };
        /* Back in this step: with clicks that were made, their picture; else a new one. */
        self.comeBack = function () {
            if (self.clicked().length || self.found()) {
                self.showPicture().fail(function (address) {
                    if (address !== MOOP.Picture.OVERTAKEN) { // the server has begun anew
                        self.open();
                    }
                });
            } else {
                self.open();
            }
        };
        /* Takes the picture on which to click, and notes where the machine stands in it. */
        self.open = function () {
            setup.busy("picture");
            OctoPrint.plugins.moop.takePosePicture()
                .done(function (answer) {
                    setup.bed.takeReference(answer.bed_reference_mm);
                    self.points().forEach(function (point) { point.px(null); }); // they were on another picture
                    self.current(0);
                    self.found(null);
                    self.remember();
                    self.showPicture();
                })
                .fail(setup.tell)
                .always(function () { setup.busy(""); });
        };
        self.showPicture = function () {
            return setup.picture.open({frame: OctoPrint.plugins.moop.posePictureUrl()}, "plain").done(self.showGuides);
        };
        self.findFromPoints = function () {
            self.find(OctoPrint.plugins.moop.poseFromPoints(self.askedPoints()), "points");
        };
        self.findFromMarkers = function () {
            let markers = null;
            try {
                markers = self.markersText().trim() ? JSON.parse(self.markersText()) : null;
            } catch (e) {
                setup.trouble(MOOP.words.say("This is not what stands in a markers.json."));
                return;
            }
            self.find(OctoPrint.plugins.moop.poseFromMarkers(markers), "pose").done(self.showPicture);
        };
        self.makeMarkers = function () {
            setup.busy("markers");
            OctoPrint.plugins.moop.makeMarkers({})
                .done(function (made) {
                    setup.trouble("");
                    setup.saved(MOOP.words.say(
                        "%(file)s is among the files now. Print it, leave it on the bed, and come back here.", {file: made.file}
                    ));
                })
                .fail(setup.tell)
                .always(function () { setup.busy(""); });
        };
        self.marked = ko.observable(""); // address of the model with markers, once it is made
        self.putMarkersAround = function (_model, event) {
            const file = event.target.files[0];
            event.target.value = "";
            if (!file) {
                return;
            }
            setup.busy("markers");
            OctoPrint.plugins.moop.putMarkersAround(file)
                .done(function () {
                    setup.trouble("");
                    self.marked(OctoPrint.plugins.moop.markedModelUrl());
                })
                .fail(setup.tell)
                .always(function () { setup.busy(""); });
        };
        self.showGuides = function () {
            const camera = self.found() || setup.header().camera;
            if (!camera) {
                self.lines([]);
                setup.picture.draw();
                return;
            }
            setup.bed.printer()
                .then(function (printer) { return OctoPrint.plugins.moop.guides(printer, camera); })
                .done(function (answer) {
                    self.lines(answer.lines);
                    setup.picture.draw();
                })
                .fail(setup.tell);
        };
        self.keep = function () {
            const found = self.found();
            setup.bed.printer()
                .then(function (printer) {
                    const camera = _.pick(found, ["image_size_px", "K", "distortion", "model", "rvec", "tvec_mm"]);
                    return setup.keep({
                        printer: printer, camera: camera, name: self.name(), how: self.how, error_px: found.error_px
                    }, MOOP.words.say("The camera's place is kept."));
                })
                .done(function () {
                    self.found(null);
                    self.name("");
                    self.marked("");
                })
                .fail(setup.tell);
        };
        self.readFile = function (_model, event) {
            const file = event.target.files[0];
            if (file) {
                file.text().then(self.markersText);
            }
        };
    }

    /* Clicks outlive a reload of the page; their picture is kept by the server. */
    SetupPlace.prototype.remember = function () {
        this.setup.remember({
            bed: this.bed,
            points: this.points().map(function (point) {
                return {name: point.name, mm: [point.x(), point.y(), point.z()], px: point.px()};
            })
        });
    };

    SetupPlace.prototype.addPoint = function (name, mm, px) {
        this.points.push({
            name: name,
            x: ko.observable(String(mm[0])),
            y: ko.observable(String(mm[1])),
            z: ko.observable(String(mm[2])),
            px: ko.observable(px)
        });
    };

    /* A click on the picture places the current point and goes on to the next that has no place yet. */
    SetupPlace.prototype.pick = function (pixel) {
        if (this.setup.step() !== "place" || this.method() !== "corners" || !this.points().length) {
            return;
        }
        this.points()[this.current()].px([pixel.x, pixel.y]);
        const next = _.findIndex(this.points(), function (point) { return point.px() === null; });
        if (next >= 0) {
            this.current(next);
        }
        this.remember();
        this.setup.picture.draw();
    };

    SetupPlace.prototype.askedPoints = function () {
        return this.clicked().map(function (point) {
            return {
                mm: [point.x(), point.y(), point.z()].map(function (text) { return Number(String(text).replace(",", ".")); }),
                px: point.px()
            };
        });
    };

    SetupPlace.prototype.find = function (request, how) {
        const self = this;
        self.setup.busy("place");
        self.setup.saved("");
        return request
            .done(function (found) {
                self.setup.trouble("");
                self.setup.bed.takeReference(found.bed_reference_mm);
                self.how = how;
                self.found(found);
                self.showGuides();
            })
            .fail(self.setup.tell)
            .always(function () { self.setup.busy(""); });
    };

    /* The bed's grid and a box on it as the camera must see them, and the points that were clicked. */
    SetupPlace.prototype.draw = function (context, toScreen, density) {
        const path = function (pixels) {
            context.beginPath();
            pixels.forEach(function (pixel, index) {
                const at = toScreen({x: pixel[0], y: pixel[1]});
                context[index ? "lineTo" : "moveTo"](at.x, at.y);
            });
        };
        this.lines().forEach(function (line) {
            // dark under light: legible on any picture
            [["rgba(0,0,0,0.6)", 3], [line.what === "box" ? "#f0e442" : "#ffffff", line.what === "grid" ? 1 : 2]].forEach(function (pen) {
                context.strokeStyle = pen[0];
                context.lineWidth = pen[1] * density;
                context.setLineDash(line.what === "box" ? [6 * density, 3 * density] : []);
                path(line.px);
                context.stroke();
            });
        });
        context.setLineDash([]);
        if (this.setup.step() !== "place") {
            return;
        }
        context.font = 13 * density + "px sans-serif";
        this.points().forEach(function (point, index) {
            if (point.px()) {
                const at = toScreen({x: point.px()[0], y: point.px()[1]});
                const r = 7 * density;
                [["rgba(0,0,0,0.7)", 4], ["#56b4e9", 1.5]].forEach(function (pen) {
                    context.strokeStyle = pen[0];
                    context.lineWidth = pen[1] * density;
                    context.beginPath();
                    context.moveTo(at.x - r, at.y);
                    context.lineTo(at.x + r, at.y);
                    context.moveTo(at.x, at.y - r);
                    context.lineTo(at.x, at.y + r);
                    context.stroke();
                });
                context.lineWidth = 3 * density;
                context.strokeStyle = "rgba(0,0,0,0.8)";
                context.fillStyle = "#ffffff";
                context.strokeText(String(index + 1), at.x + r, at.y - r);
                context.fillText(String(index + 1), at.x + r, at.y - r);
            }
        });
    };

    window.MOOP = Object.assign(window.MOOP || {}, {SetupPlace: SetupPlace});
})();
