/*
 * A print's checks as picture, plot and objects, one of them chosen: what the watch page and the past prints share.
 */
(function () {
    const KINDS = ["frame", "seen", "expected", "ignored"];

    /*
     * options: picture, plot (ids of their elements), visible() (whether anybody looks), addresses(check) (of its
     * pictures, by kind; check null: none yet), note(check, hasMasks) (a sentence on the picture).
     */
    function View(options) {
        const self = this;
        const words = MOOP.words;
        self.options = options;
        self.checks = ko.observableArray([]);
        self.selectedId = ko.observable(null); // null: follow the newest check
        self.show = ko.observable("difference");
        self.hasMasks = ko.observable(false);
        self.loading = ko.observable(false);
        self.note = ko.observable("");

        // Hears of new checks before all that follows: a slider cuts its place off at the end that it knows.
        self.last = ko.computed(function () { return Math.max(0, self.checks().length - 1); });
        self.selectedIndex = ko.pureComputed(function () {
            const id = self.selectedId();
            const checks = self.checks();
            return id === null ? checks.length - 1 : _.findIndex(checks, function (check) { return check.id === id; });
        });
        self.selected = ko.pureComputed(function () { return self.checks()[self.selectedIndex()] || null; });
        self.following = ko.pureComputed(function () { return self.selectedId() === null; });
        /* The place of the chosen check, for a slider. */
        self.index = ko.pureComputed({
            read: function () { return Math.max(0, self.selectedIndex()); },
            write: function (index) { self.choose(Number(index)); }
        });
        self.selectedText = ko.pureComputed(function () {
            return self.selected() ? words.checkLine(self.selected()) : words.say("No check of this print yet");
        });
        self.objects = ko.pureComputed(function () {
            const check = self.selected();
            return (check && check.objects ? check.objects : []).map(function (object) {
                return {
                    name: object.name,
                    error: words.percent(object.E),
                    text: object.verdict === "failed" ? words.mode(object) : words.verdict(object),
                    icon: object.verdict === "ok" ? "fas fa-check" : "fas fa-exclamation-triangle"
                };
            });
        });
        self.hasLimit = ko.pureComputed(function () {
            return _.some(self.checks(), function (check) { return check.limit !== null && check.limit !== undefined; });
        });
        self.plotSummary = ko.pureComputed(function () { return words.plotSummary(self.checks()); });

        self.show.subscribe(function (show) {
            if (self.picture) {
                self.picture.show(show);
            }
        });
        // Rate-limited: several changes make one drawing, and the computeds above have settled by then.
        ko.computed(function () { return [self.checks(), self.selected()]; })
            .extend({rateLimit: 20})
            .subscribe(function () { self.redraw(); });

        _.each(["zoomIn", "zoomOut", "fit"], function (name) {
            self[name] = function () { self.picture[name](); };
        });
        self.stepBack = function () { self.choose(self.selectedIndex() - 1); };
        self.stepOn = function () { self.choose(self.selectedIndex() + 1); };
        self.follow = function () { self.selectedId(null); };
    }

    /* Once the page stands. */
    View.prototype.bind = function () {
        const self = this;
        self.picture = new MOOP.Picture(document.getElementById(self.options.picture));
        $("#" + self.options.plot).on("plotclick", function (_event, position) {
            self.choose(MOOP.series.nearest(self.checks(), position.x));
        });
        $(window).on("resize", _.debounce(function () { self.drawPlot(); }, 200));
    };

    View.prototype.startOver = function () {
        this.selectedId(null);
        this.pictureKey = null;
    };

    /* Chooses a check by its place; the last one is followed from then on. */
    View.prototype.choose = function (index) {
        const checks = this.checks();
        if (index >= checks.length - 1) {
            this.selectedId(null);
        } else if (index >= 0) {
            this.selectedId(checks[index].id);
        }
    };

    View.prototype.redraw = function () {
        this.drawPlot();
        this.drawPicture();
    };

    /* Shows the chosen check's picture; the promise tells when it is on screen. */
    View.prototype.drawPicture = function () {
        const self = this;
        if (!self.picture || !self.options.visible()) {
            return $.Deferred().reject();
        }
        const check = self.selected();
        const addresses = self.options.addresses(check);
        const key = JSON.stringify(check ? addresses : "now");
        if (key === self.pictureKey) {
            self.picture.draw();
            return self.opened;
        }
        self.pictureKey = key;
        const opened = self.opened = self.picture.open(addresses, self.show())
            .done(function (found) {
                self.hasMasks(found.masks);
                self.note(self.options.note(check, found.masks));
            })
            .fail(function (address) {
                if (address === MOOP.Picture.OVERTAKEN) {
                    return;
                }
                self.pictureKey = null;
                self.hasMasks(false);
                self.note(check
                    ? MOOP.words.say("This check's picture is no longer kept.")
                    : MOOP.words.say("The webcam gives no picture."));
            })
            .always(function () { self.loading(opened !== self.opened); });
        self.loading(opened.state() === "pending");
        return opened;
    };

    View.prototype.drawPlot = function () {
        const box = $("#" + this.options.plot);
        if (!this.options.visible() || !box.length || !box.width()) {
            return; // flot refuses to draw where there is no room
        }
        const colour = getComputedStyle(box[0]).color;
        const points = MOOP.series.plotSeries(this.checks());
        this.plot = $.plot(box, MOOP.flot.series(points, colour), MOOP.flot.options(points, colour, this.selected()));
    };

    /* Shows a check and zooms to the thickest of its trouble. */
    View.prototype.showTrouble = function (check) {
        const self = this;
        self.selectedId(check.id);
        self.show("difference");
        self.drawPicture().done(function () { self.picture.zoomToDifference(); });
    };

    View.KINDS = KINDS;
    window.MOOP = Object.assign(window.MOOP || {}, {View: View});
})();
