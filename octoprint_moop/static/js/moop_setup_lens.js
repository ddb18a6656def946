/* Step "lens" of the set-up: pictures of a checkerboard, which parts of the image they cover, and the lens they give. */
(function () {
    const WANTED = 12;

    function SetupLens(setup) {
        const self = this;
        self.setup = setup;
        self.columns = ko.observable("9");
        self.rows = ko.observable("6");
        self.square = ko.observable("15");
        self.views = ko.observableArray([]);
        self.rejected = ko.observableArray([]);
        self.found = ko.observable(null);
        self.known = ko.observable(false);
        self.announced = ko.observable("");

        self.count = ko.pureComputed(function () {
            return MOOP.words.say("%(n)s of about %(wanted)s pictures taken", {n: self.views().length, wanted: WANTED});
        });
        self.ready = ko.pureComputed(function () { return self.views().length >= 4 && !setup.busy(); });
        self.told = ko.pureComputed(function () {
            const found = self.found();
            return found
                ? MOOP.words.say("%(used)s pictures fit to %(rms)s px. The board was seen over %(coverage)s of the image.", {
                    used: found.images_used,
                    rms: found.rms_px.toFixed(2),
                    coverage: MOOP.words.percent(found.coverage_ratio)
                })
                : "";
        });

        self.boardUrl = ko.pureComputed(function () { return OctoPrint.plugins.moop.boardUrl(self.board()); });
        self.board = function () {
            return {board: self.columns() + "x" + self.rows(), square_mm: String(self.square()).replace(",", ".")};
        };
        self.load = function () {
            OctoPrint.plugins.moop.lens().done(function (answer) {
                self.known(Boolean(answer.lens));
            });
        };
        self.capture = function () {
            setup.busy("capture");
            OctoPrint.plugins.moop.takeBoardPicture(self.board())
                .done(function (answer) {
                    setup.trouble("");
                    if (answer.id === null) {
                        self.announced(MOOP.words.say("The whole board is not seen in this picture: it is not used."));
                        setup.takePicture();
                        return;
                    }
                    self.announced(MOOP.words.say("Good. Now tilt the board another way, or bring it to another corner."));
                    self.views.push({id: answer.id, corners_px: answer.corners_px});
                    setup.picture.open({frame: OctoPrint.plugins.moop.boardPictureUrl(answer.id)}, "plain");
                })
                .fail(setup.tell)
                .always(function () { setup.busy(""); });
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

    /* The corners of every board seen so far: where the picture shows none of them, the lens is a guess. */
    SetupLens.prototype.draw = function (context, toScreen, density) {
        const views = this.views();
        views.forEach(function (view, index) {
            const last = index === views.length - 1;
            context.fillStyle = last ? "#f0e442" : "rgba(86,180,233,0.8)";
            view.corners_px.forEach(function (corner) {
                const at = toScreen({x: corner[0], y: corner[1]});
                context.beginPath();
                context.arc(at.x, at.y, (last ? 3 : 2) * density, 0, 2 * Math.PI);
                context.fill();
            });
        });
    };

    window.MOOP = Object.assign(window.MOOP || {}, {SetupLens: SetupLens});
})();
