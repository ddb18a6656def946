/* Step "lens" of the set-up: views of a checkerboard, which parts of the picture they cover, and the lens they give. */
(function () {
    const WANTED = 12;
    const LOOK_AGAIN_MS = 300;

    function SetupLens(setup) {
        const self = this;
        const words = MOOP.words;
        self.setup = setup;
        self.columns = ko.observable("9");
        self.rows = ko.observable("6");
        self.square = ko.observable("15");
        self.views = ko.observableArray([]); // {id, corners_px}
        self.rejected = ko.observableArray([]);
        self.found = ko.observable(null);
        self.known = ko.observable(false);
        self.announced = ko.observable("");
        self.live = ko.observable(false);
        self.seen = ko.observable(null); // the corners a moment ago
        self.size = [1, 1];

        self.count = ko.pureComputed(function () {
            const corners = _.map(self.views(), "corners_px");
            const empty = MOOP.coverage.missing(corners, self.size);
            const told = words.say("%(n)s of about %(wanted)s pictures taken, %(share)s of the picture covered.", {
                n: corners.length,
                wanted: WANTED,
                share: words.percent(MOOP.coverage.share(corners, self.size))
            });
            return corners.length && empty.length
                ? told + " " + words.say("Not yet: %(where)s.", {where: empty.join(", ")})
                : told;
        });
        self.ready = ko.pureComputed(function () { return self.views().length >= 4 && !setup.busy() && !self.live(); });
        self.told = ko.pureComputed(function () {
            const found = self.found();
            return found
                ? words.say("%(used)s pictures fit to %(rms)s px. The board was seen over %(coverage)s of the image.", {
                    used: found.images_used,
                    rms: found.rms_px.toFixed(2),
                    coverage: words.percent(found.coverage_ratio)
                })
                : "";
        });
        self.boardUrl = ko.pureComputed(function () { return OctoPrint.plugins.moop.boardUrl(self.board()); });

        self.capture = function () { return self.take(true); };
        self.toggleLive = function () {
            self.live(!self.live());
            self.seen(null);
            if (self.live()) {
                self.lookOn();
            }
        };
        self.solve = function () {
            setup.busy("lens");
            OctoPrint.plugins.moop.findLens(self.board())
                .done(function (found) {
                    setup.trouble("");
                    self.found(found);
                    self.known(true);
                    self.rejected(found.rejected.map(function (view) {
                        const place = _.findIndex(self.views(), function (other) { return String(other.id) === view.image; });
                        return {number: place + 1, why: view.why};
                    }));
                })
                .fail(setup.tell)
                .always(function () { setup.busy(""); });
        };
        self.startOver = function () {
            OctoPrint.plugins.moop.forgetBoardPictures()
                .done(function () {
                    self.views([]);
                    self.rejected([]);
                    self.found(null);
                    self.announced("");
                    setup.picture.draw();
                })
                .fail(setup.tell);
        };
    }

    SetupLens.prototype.board = function () {
        return {board: this.columns() + "x" + this.rows(), square_mm: String(this.square()).replace(",", ".")};
    };

    /* What the server has kept of an earlier visit. */
    SetupLens.prototype.load = function () {
        const self = this;
        OctoPrint.plugins.moop.lens().done(function (answer) { self.known(Boolean(answer.lens)); });
        OctoPrint.plugins.moop.boardPictures().done(function (answer) {
            self.size = answer.image_size_px || self.size;
            self.views(answer.pictures);
        });
    };

    /* Takes one picture; by hand it is kept where the board is seen whole. The promise tells whether it was. */
    SetupLens.prototype.take = function (keep) {
        const self = this;
        const setup = self.setup;
        const words = MOOP.words;
        if (!self.live()) {
            setup.busy("capture");
        }
        return OctoPrint.plugins.moop.takeBoardPicture($.extend({keep: keep}, self.board()))
            .done(function (answer) {
                setup.trouble("");
                self.size = answer.image_size_px;
                if (answer.id !== null) {
                    self.views.push({id: answer.id, corners_px: answer.corners_px});
                    self.announced(words.say("Good. Now tilt the board another way, or bring it to another corner."));
                } else if (keep) {
                    self.announced(words.say("The whole board is not seen in this picture: it is not used."));
                }
                if (setup.step() === "lens") {
                    setup.picture.open({frame: OctoPrint.plugins.moop.lastBoardPictureUrl()}, "plain");
                }
            })
            .fail(function (request) {
                self.live(false);
                setup.tell(request);
            })
            .always(function () { setup.busy(""); });
    };

    /* Looks again and again while both hands hold the board, and takes each view that is steady and new. */
    SetupLens.prototype.lookOn = function () {
        const self = this;
        if (!self.live()) {
            return;
        }
        if (!self.setup.visible() || self.setup.step() !== "lens") {
            self.live(false);
            return;
        }
        self.take(false).done(function (answer) {
            const verdict = MOOP.coverage.judge(
                answer.corners_px, self.seen(), _.map(self.views(), "corners_px"), answer.image_size_px
            );
            self.announced(verdict.text);
            self.seen(answer.corners_px);
            const again = function () { setTimeout(function () { self.lookOn(); }, LOOK_AGAIN_MS); };
            if (verdict.take) {
                self.take(true).always(again);
            } else {
                again();
            }
        });
    };

    /* Shade lies where no corner was seen yet: there the lens is a guess. Dots are the corners. */
    SetupLens.prototype.draw = function (context, toScreen, density) {
        const self = this;
        const views = self.views();
        const grid = MOOP.coverage.cells(_.map(views, "corners_px"), self.size);
        const cell = [self.size[0] / grid.columns, self.size[1] / grid.rows];
        if (views.length) {
            context.fillStyle = "rgba(0,0,0,0.45)";
            grid.counts.forEach(function (count, place) {
                if (!count) {
                    const x = place % grid.columns;
                    const y = Math.floor(place / grid.columns);
                    const a = toScreen({x: x * cell[0] - 0.5, y: y * cell[1] - 0.5});
                    const b = toScreen({x: (x + 1) * cell[0] - 0.5, y: (y + 1) * cell[1] - 0.5});
                    context.fillRect(a.x, a.y, b.x - a.x, b.y - a.y);
                }
            });
        }
        const dots = function (corners, radius, colour) {
            context.fillStyle = colour;
            corners.forEach(function (corner) {
                const at = toScreen({x: corner[0], y: corner[1]});
                context.beginPath();
                context.arc(at.x, at.y, radius * density, 0, 2 * Math.PI);
                context.fill();
            });
        };
        views.forEach(function (view) { dots(view.corners_px, 2, "rgba(86,180,233,0.8)"); });
        const now = self.live() ? self.seen() : views.length ? views[views.length - 1].corners_px : null;
        if (now) {
            dots(now, 3, "#f0e442");
        }
    };

    window.MOOP = Object.assign(window.MOOP || {}, {SetupLens: SetupLens});
})();
