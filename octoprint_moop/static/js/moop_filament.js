/* Choosing the filament's colour: a click on the picture, a hue ring, numbers, and the mask that they give. */
(function () {
    const PATCH = 4; // pixels each way round a click
    const INNER = 0.62;
    const OUTER = 0.86;

    /*
     * values: observables hueMin, hueMax (degrees), saturationMin, valueMin. `bind(root)` when the page stands.
     */
    function Filament(values) {
        const self = this;
        self.values = values;
        self.note = ko.observable("");
        self.share = ko.observable("");
        self.picture = null;
        self.generation = 0;

        self.thresholds = ko.pureComputed(function () {
            return {
                hue_deg: [Number(values.hueMin()), Number(values.hueMax())],
                saturation_min: Number(values.saturationMin()),
                value_min: Number(values.valueMin())
            };
        });
    }

    Filament.prototype.bind = function (root) {
        const self = this;
        self.ring = root.querySelector("canvas.moop-ring");
        self.picture = new MOOP.Picture(root.querySelector("canvas.moop-picture"), {
            onPick: function (point) { self.pick(point); }
        });
        self.thresholds.subscribe(function () { self.drawRing(); });
        self.thresholds.subscribe(_.debounce(function () { self.preview(); }, 250));
        self._listenToRing();
        self.drawRing();
    };

    /* Takes a new picture and shows what the thresholds make of it. */
    Filament.prototype.open = function () {
        const self = this;
        self.drawRing();
        return self.picture.open({frame: OctoPrint.plugins.moop.freshFrameUrl()}, "plain")
            .done(function () {
                self.note(MOOP.words.say("Click on the filament in the picture."));
                self.preview();
            })
            .fail(function (address) {
                if (address !== MOOP.Picture.OVERTAKEN) {
                    self.note(MOOP.words.say("The webcam gives no picture."));
                }
            });
    };

    Filament.prototype.pick = function (point) {
        const canvas = document.createElement("canvas");
        const side = 2 * PATCH + 1;
        canvas.width = canvas.height = side;
        const context = canvas.getContext("2d");
        context.drawImage(
            this.picture.image, Math.round(point.x) - PATCH, Math.round(point.y) - PATCH, side, side, 0, 0, side, side
        );
        const found = MOOP.hue.thresholdsFrom(context.getImageData(0, 0, side, side).data);
        this.values.hueMin(found.hue_deg[0]);
        this.values.hueMax(found.hue_deg[1]);
        this.values.saturationMin(found.saturation_min);
        this.values.valueMin(found.value_min);
    };

    Filament.prototype.preview = function () {
        const self = this;
        const own = ++self.generation;
        if (!self.picture.image || !$(self.picture.canvas).is(":visible")) {
            return;
        }
        OctoPrint.plugins.moop.previewSegmentation(self.thresholds()).then(
            function (blob) {
                const address = URL.createObjectURL(blob);
                self.picture.loadMask(address).always(function () { URL.revokeObjectURL(address); }).done(function (mask) {
                    if (own !== self.generation) {
                        return; // overtaken by a later change
                    }
                    const image = self.picture.image;
                    const classes = MOOP.overlay.classify(mask, mask, null, "seen");
                    const share = MOOP.overlay.counts(classes).matched / classes.length;
                    self.share(MOOP.words.say("%(share)s of the picture counts as filament", {share: MOOP.words.percent(share)}));
                    self.picture.setOverlay(
                        MOOP.overlay.paint(classes, image.naturalWidth, image.naturalHeight),
                        image.naturalWidth, image.naturalHeight
                    );
                    self.picture.draw();
                });
            },
            function (refused) {
                if (own === self.generation) {
                    self.note(MOOP.words.refusal(refused));
                }
            }
        );
    };

    // --- the ring: hue 0 to the right, growing clockwise ------------------------------------------------------------

    Filament.prototype.drawRing = function () {
        const canvas = this.ring;
        if (!canvas || !canvas.clientWidth) {
            return;
        }
        const density = window.devicePixelRatio || 1;
        const side = Math.round(canvas.clientWidth * density);
        canvas.width = canvas.height = side;
        const context = canvas.getContext("2d");
        const r = side / 2;
        context.translate(r, r);
        for (let hue = 0; hue < 360; hue += 2) {
            context.beginPath();
            context.arc(0, 0, r * OUTER, (hue - 1.2) * Math.PI / 180, (hue + 1.2) * Math.PI / 180);
            context.arc(0, 0, r * INNER, (hue + 1.2) * Math.PI / 180, (hue - 1.2) * Math.PI / 180, true);
            context.closePath();
            context.fillStyle = "hsl(" + hue + ", 90%, 50%)";
            context.fill();
        }
        const ink = getComputedStyle(canvas).color;
        const limits = this.thresholds().hue_deg;
        const span = MOOP.hue.hueSpan(limits[0], limits[1]);
        context.strokeStyle = context.fillStyle = ink;
        context.lineWidth = r * 0.07;
        context.beginPath();
        context.arc(0, 0, r * 0.92, limits[0] * Math.PI / 180, (limits[0] + span) * Math.PI / 180);
        context.stroke();
        limits.forEach(function (hue) {
            const x = Math.cos(hue * Math.PI / 180);
            const y = Math.sin(hue * Math.PI / 180);
            context.lineWidth = 2 * density;
            context.beginPath();
            context.moveTo(x * r * (INNER - 0.08), y * r * (INNER - 0.08));
            context.lineTo(x * r * 0.92, y * r * 0.92);
            context.stroke();
            context.beginPath();
            context.arc(x * r * 0.92, y * r * 0.92, r * 0.08, 0, 2 * Math.PI);
            context.fill();
        });
    };

    Filament.prototype._listenToRing = function () {
        const self = this;
        let held = null;
        const hueAt = function (event) {
            const box = self.ring.getBoundingClientRect();
            const y = event.clientY - box.top - box.height / 2;
            const x = event.clientX - box.left - box.width / 2;
            return Math.round(Math.atan2(y, x) * 180 / Math.PI + 360) % 360;
        };
        const distance = function (a, b) {
            return Math.abs((Number(a) - b + 540) % 360 - 180);
        };
        self.ring.addEventListener("pointerdown", function (event) {
            const hue = hueAt(event);
            const nearMin = distance(self.values.hueMin(), hue) < distance(self.values.hueMax(), hue);
            held = nearMin ? self.values.hueMin : self.values.hueMax;
            self.ring.setPointerCapture(event.pointerId);
            held(hue);
        });
        self.ring.addEventListener("pointermove", function (event) {
            if (held) {
                held(hueAt(event));
            }
        });
        self.ring.addEventListener("pointerup", function () { held = null; });
        self.ring.addEventListener("pointercancel", function () { held = null; });
    };

    window.MOOP = Object.assign(window.MOOP || {}, {Filament: Filament});
})();
