/* A failure as it is told: in the tab, in a notification, and in three small pictures. */
(function () {
    const SHOWN = ["seen", "expected", "difference"];
    const WIDTH = 220; // pixels of a small picture

    /* tab: the MOOP tab's view model. */
    function Failure(tab) {
        const self = this;
        const words = MOOP.words;
        self.tab = tab;
        self.announcement = ko.observable("");
        self.notice = null;

        // The failure that stands, as a place in the list of checks: the last failed one, until somebody pardons it.
        self.index = ko.pureComputed(function () {
            return words.failureStands(tab.status())
                ? _.findLastIndex(tab.view.checks(), function (check) { return check.verdict === "failed"; })
                : -1;
        });
        self.check = ko.pureComputed(function () { return tab.view.checks()[self.index()] || null; });
        self.told = ko.pureComputed(function () {
            const check = self.check();
            return check
                ? words.failure(check, words.sinceLayer(tab.view.checks(), self.index()), tab.status().action)
                : null;
        });
        self.showWhere = function () { tab.view.showTrouble(self.check()); };

        ko.computed(function () { return self.check() && self.check().id; })
            .extend({rateLimit: 20})
            .subscribe(function () { self.drawPictures(); });
    }

    /* Small pictures of the failure that stands, into the tab; as soon as somebody looks at it. */
    Failure.prototype.drawPictures = function () {
        const box = document.getElementById("moop_failure_pictures");
        const check = this.check();
        if (!box || !check || !this.tab.visible() || box.dataset.check === String(check.id)) {
            return;
        }
        box.dataset.check = check.id;
        fill(box, this.tab.addresses(check));
    };

    /* A notification that stays until it is closed, or the failure is pardoned. */
    Failure.prototype.notify = function (check, action) {
        const told = MOOP.words.failure(check, check.layer, action);
        this.announcement(told.title + ". " + told.sentence + " " + told.done);
        this.dismiss();
        this.notice = new PNotify({
            title: "MOOP: " + told.title,
            title_escape: true,
            text: told.sentence + " " + told.done,
            text_escape: true,
            type: "error",
            hide: false
        });
        const box = document.createElement("div");
        box.className = "moop-small-pictures";
        this.notice.get().find(".ui-pnotify-text").after(box);
        fill(box, this.tab.addresses(check));
    };

    Failure.prototype.dismiss = function () {
        if (this.notice) {
            this.notice.remove();
            this.notice = null;
        }
    };

    /* Three figures with their names under them, where the pictures are to be had; nothing otherwise. */
    function fill(box, addresses) {
        const names = {
            seen: MOOP.words.say("Seen"),
            expected: MOOP.words.say("Expected"),
            difference: MOOP.words.say("Difference")
        };
        MOOP.composePictures(addresses, SHOWN, WIDTH).done(function (canvases) {
            box.replaceChildren.apply(box, canvases.map(function (canvas, index) {
                const figure = document.createElement("figure");
                const caption = document.createElement("figcaption");
                caption.textContent = names[SHOWN[index]];
                canvas.setAttribute("role", "img");
                canvas.setAttribute("aria-label", names[SHOWN[index]]);
                figure.append(canvas, caption);
                return figure;
            }));
        });
    }

    window.MOOP = Object.assign(window.MOOP || {}, {Failure: Failure});
})();
