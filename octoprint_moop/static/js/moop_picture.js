/* A picture on a canvas with masks over it: zoom by button, Ctrl and wheel, or keyboard; drag moves it. */
(function () {
    const MAX_ZOOM = 12;
    const STEP = 1.5;

    function load(address) {
        const answer = $.Deferred();
        const image = new Image();
        image.onload = function () { answer.resolve(image); };
        image.onerror = function () { answer.reject(address); };
        image.src = address;
        return answer.promise();
    }

    /* Grey values of a mask's image, one byte a pixel. */
    function maskOf(image, width, height) {
        const canvas = document.createElement("canvas");
        canvas.width = width;
        canvas.height = height;
        const context = canvas.getContext("2d", {willReadFrequently: true});
        context.imageSmoothingEnabled = false;
        context.drawImage(image, 0, 0, width, height);
        const rgba = context.getImageData(0, 0, width, height).data;
        const mask = new Uint8Array(width * height);
        for (let i = 0; i < mask.length; i++) {
            mask[i] = rgba[4 * i] > 127 ? 255 : 0;
        }
        return mask;
    }

    /* A canvas that holds these RGBA pixels. */
    function layerOf(rgba, width, height) {
        const layer = document.createElement("canvas");
        layer.width = width;
        layer.height = height;
        layer.getContext("2d").putImageData(new ImageData(rgba, width, height), 0, 0);
        return layer;
    }

    /*
     * options.onPick({x, y}): a click at this point of the picture, in its pixels; options.onDraw(context, toScreen)
     * draws on top, toScreen({x, y}) giving canvas pixels.
     */
    function Picture(canvas, options) {
        const self = this;
        self.canvas = canvas;
        self.options = options || {};
        self.image = null;
        self.masks = null;
        self.overlay = null;
        self.zoom = 1;
        self.centre = null;
        self.generation = 0;
        self._listen();
        if (window.ResizeObserver) {
            new ResizeObserver(function () { self.draw(); }).observe(canvas);
        } else {
            $(window).on("resize", function () { self.draw(); });
        }
    }

    /*
     * Loads {frame, seen, expected, ignored} (addresses; all but frame may be missing) and shows it in the way `show`
     * ("plain", "seen", "expected", "difference"). The promise tells {masks: whether there are any}, or fails with the
     * address that could not be loaded; with Picture.OVERTAKEN where another picture was wanted meanwhile.
     */
    Picture.prototype.open = function (addresses, show) {
        const self = this;
        const own = ++self.generation;
        const answer = $.Deferred();
        const optional = function (address) {
            const found = $.Deferred();
            if (!address) {
                return found.resolve(null);
            }
            load(address).done(found.resolve).fail(function () { found.resolve(null); });
            return found;
        };
        if (self.overtake) {
            self.overtake();
        }
        self.overtake = function () { answer.reject(Picture.OVERTAKEN); };
        $.when(load(addresses.frame), optional(addresses.seen), optional(addresses.expected), optional(addresses.ignored))
            .done(function (frame, seen, expected, ignored) {
                if (own !== self.generation) {
                    return;
                }
                const width = frame.naturalWidth;
                const height = frame.naturalHeight;
                if (!self.image || self.image.naturalWidth !== width || self.image.naturalHeight !== height) {
                    self.zoom = 1;
                    self.centre = {x: width / 2, y: height / 2};
                }
                self.image = frame;
                self.canvas.style.aspectRatio = width + " / " + height;
                self.masks = seen && expected
                    ? {
                        seen: maskOf(seen, width, height),
                        expected: maskOf(expected, width, height),
                        ignored: ignored && maskOf(ignored, width, height)
                    }
                    : null;
                self.show(show);
                answer.resolve({masks: self.masks !== null});
            })
            .fail(function (address) {
                if (own === self.generation) {
                    answer.reject(address);
                }
            });
        return answer.promise();
    };

    Picture.OVERTAKEN = "overtaken";

    Picture.prototype.show = function (show) {
        this.overlay = null;
        this.classes = null;
        if (this.masks && show !== "plain") {
            const width = this.image.naturalWidth;
            const height = this.image.naturalHeight;
            const masks = this.masks;
            this.classes = MOOP.overlay.classify(masks.expected, masks.seen, masks.ignored, show);
            this.setOverlay(MOOP.overlay.paint(this.classes, width, height), width, height);
        }
        this.draw();
    };

    /* A mask (Uint8Array, the picture's size) from its address. */
    Picture.prototype.loadMask = function (address) {
        const self = this;
        return load(address).then(function (image) {
            return maskOf(image, self.image.naturalWidth, self.image.naturalHeight);
        });
    };

    /* Lays RGBA pixels of the picture's own size over it. */
    Picture.prototype.setOverlay = function (rgba, width, height) {
        this.overlay = layerOf(rgba, width, height);
    };

    Picture.prototype.part = function () {
        return MOOP.overlay.visiblePart(
            this.image.naturalWidth, this.image.naturalHeight, this.zoom, this.centre.x, this.centre.y
        );
    };

    Picture.prototype.draw = function () {
        const canvas = this.canvas;
        if (!this.image || !canvas.clientWidth) {
            return; // hidden: a resize or the next picture draws it
        }
        const density = window.devicePixelRatio || 1;
        canvas.width = Math.round(canvas.clientWidth * density);
        canvas.height = Math.round(canvas.clientWidth * density * this.image.naturalHeight / this.image.naturalWidth);
        const context = canvas.getContext("2d");
        const part = this.part();
        context.drawImage(this.image, part.x, part.y, part.width, part.height, 0, 0, canvas.width, canvas.height);
        if (this.overlay) {
            context.drawImage(this.overlay, part.x, part.y, part.width, part.height, 0, 0, canvas.width, canvas.height);
        }
        if (this.options.onDraw) {
            const scale = canvas.width / part.width;
            this.options.onDraw(context, function (point) {
                return {x: (point.x + 0.5 - part.x) * scale, y: (point.y + 0.5 - part.y) * scale};
            }, density);
        }
        if (this.options.onPick && canvas.matches(":focus-visible")) {
            this._drawCross(context, canvas.width / 2, canvas.height / 2, 10 * density);
        }
    };

    /* Where Enter picks, for those who have no pointer. */
    Picture.prototype._drawCross = function (context, x, y, r) {
        [["rgba(0,0,0,0.7)", 4], ["white", 1.5]].forEach(function (pen) {
            context.strokeStyle = pen[0];
            context.lineWidth = pen[1];
            context.beginPath();
            context.moveTo(x - r, y);
            context.lineTo(x + r, y);
            context.moveTo(x, y - r);
            context.lineTo(x, y + r);
            context.stroke();
        });
    };

    Picture.prototype.zoomBy = function (factor, at) {
        if (!this.image) {
            return;
        }
        const before = this.zoom;
        this.zoom = Math.min(MAX_ZOOM, Math.max(1, this.zoom * factor));
        if (at) {
            // what lies under the pointer stays there
            const shrink = before / this.zoom;
            this.centre = {
                x: at.x + (this.centre.x - at.x) * shrink,
                y: at.y + (this.centre.y - at.y) * shrink
            };
        }
        this._keepInside();
        this.draw();
    };

    Picture.prototype.zoomIn = function () { this.zoomBy(STEP); };
    Picture.prototype.zoomOut = function () { this.zoomBy(1 / STEP); };
    Picture.prototype.fit = function () { this.zoomBy(1 / MAX_ZOOM); };

    /* Brings the thickest of what is missing or extra into view, with its surroundings. */
    Picture.prototype.zoomToDifference = function () {
        if (!this.masks) {
            return;
        }
        const width = this.image.naturalWidth;
        const masks = this.masks;
        const height = this.image.naturalHeight;
        const classes = MOOP.overlay.classify(masks.expected, masks.seen, masks.ignored, "difference");
        const box = MOOP.overlay.differenceBox(classes, width, height);
        if (box) {
            const wanted = Math.min(width / (1.6 * box.width), height / (1.6 * box.height));
            this.zoom = Math.min(MAX_ZOOM, Math.max(1, wanted));
            this.centre = {x: box.x + box.width / 2, y: box.y + box.height / 2};
            this._keepInside();
            this.draw();
        }
    };

    Picture.prototype._keepInside = function () {
        const part = this.part();
        this.centre = {x: part.x + part.width / 2, y: part.y + part.height / 2};
    };

    /* The point of the picture under a pointer, in its pixels (pixel centres are whole numbers). */
    Picture.prototype.at = function (event) {
        const box = this.canvas.getBoundingClientRect();
        const part = this.part();
        return {
            x: part.x + (event.clientX - box.left) / box.width * part.width - 0.5,
            y: part.y + (event.clientY - box.top) / box.height * part.height - 0.5
        };
    };

    Picture.prototype._move = function (dx, dy) {
        this.centre = {x: this.centre.x + dx, y: this.centre.y + dy};
        this._keepInside();
        this.draw();
    };

    Picture.prototype._listen = function () {
        const self = this;
        const canvas = self.canvas;
        let drag = null;

        canvas.addEventListener("wheel", function (event) {
            if (self.image && (event.ctrlKey || event.metaKey)) { // a plain wheel goes on scrolling the page
                event.preventDefault();
                self.zoomBy(event.deltaY < 0 ? STEP : 1 / STEP, self.at(event));
            }
        }, {passive: false});
        canvas.addEventListener("dblclick", function (event) {
            if (self.image && !self.options.onPick) {
                self.zoomBy(STEP, self.at(event));
            }
        });
        canvas.addEventListener("pointerdown", function (event) {
            if (self.image && event.button === 0) {
                drag = {x: event.clientX, y: event.clientY, moved: false};
                if (self.zoom > 1) {
                    canvas.setPointerCapture(event.pointerId);
                }
            }
        });
        canvas.addEventListener("pointermove", function (event) {
            if (!drag) {
                return;
            }
            const dx = event.clientX - drag.x;
            const dy = event.clientY - drag.y;
            if (drag.moved || Math.hypot(dx, dy) > 4) {
                drag = {x: event.clientX, y: event.clientY, moved: true};
                if (self.zoom > 1) {
                    const scale = self.part().width / canvas.clientWidth;
                    self._move(-dx * scale, -dy * scale);
                }
            }
        });
        canvas.addEventListener("pointerup", function (event) {
            if (drag && !drag.moved && self.options.onPick) {
                self.options.onPick(self.at(event), event);
            }
            drag = null;
        });
        if (self.options.onPick) {
            canvas.addEventListener("focus", function () { self.draw(); });
            canvas.addEventListener("blur", function () { self.draw(); });
        }
        canvas.addEventListener("pointercancel", function () { drag = null; });
        canvas.addEventListener("keydown", function (event) {
            if (!self.image) {
                return;
            }
            const step = self.part().width / 10;
            const middle = self.part();
            const keys = {
                Enter: function () {
                    if (self.options.onPick) {
                        self.options.onPick({x: middle.x + middle.width / 2 - 0.5, y: middle.y + middle.height / 2 - 0.5});
                    }
                },
                "+": function () { self.zoomIn(); },
                "=": function () { self.zoomIn(); },
                "-": function () { self.zoomOut(); },
                "0": function () { self.fit(); },
                ArrowLeft: function () { self._move(-step, 0); },
                ArrowRight: function () { self._move(step, 0); },
                ArrowUp: function () { self._move(0, -step); },
                ArrowDown: function () { self._move(0, step); }
            };
            const arrow = event.key.indexOf("Arrow") === 0;
            if (keys[event.key] && !(arrow && self.zoom === 1) && !event.ctrlKey && !event.metaKey) {
                event.preventDefault();
                keys[event.key]();
            }
        });
    };

    /*
     * Small canvases of a check, one for each way in `shows`, `width` pixels wide; a promise, rejected where a picture
     * is missing.
     */
    function composePictures(addresses, shows, width) {
        return $.when(load(addresses.frame), load(addresses.seen), load(addresses.expected), load(addresses.ignored))
            .then(function (frame, seen, expected, ignored) {
                const full = {width: frame.naturalWidth, height: frame.naturalHeight};
                const masks = [expected, seen, ignored].map(function (image) { return maskOf(image, full.width, full.height); });
                return shows.map(function (show) {
                    const classes = MOOP.overlay.classify(masks[0], masks[1], masks[2], show);
                    const canvas = document.createElement("canvas");
                    canvas.width = width;
                    canvas.height = Math.round(width * full.height / full.width);
                    const context = canvas.getContext("2d");
                    const layer = layerOf(MOOP.overlay.paint(classes, full.width, full.height), full.width, full.height);
                    context.drawImage(frame, 0, 0, canvas.width, canvas.height);
                    context.drawImage(layer, 0, 0, canvas.width, canvas.height);
                    return canvas;
                });
            });
    }

    window.MOOP = Object.assign(window.MOOP || {}, {Picture: Picture, composePictures: composePictures});
})();
