/* The 3D model that the selected job is compared with, where somebody has attached one. */
(function () {
    const PLACED = ["x_mm", "y_mm", "turn_deg", "layer_height_mm"];

    /* tab: the MOOP tab's view model. */
    function Mesh(tab) {
        const self = this;
        const words = MOOP.words;
        self.tab = tab;
        self.job = ko.observable(null);
        self.mesh = ko.observable(null);
        self.trouble = ko.observable("");
        self.busy = ko.observable(false);
        self.sent = ko.observable(null); // share of an upload
        self.busyText = ko.pureComputed(function () {
            if (!self.busy()) {
                return "";
            }
            return self.sent() !== null && self.sent() < 1
                ? words.say("%(share)s sent", {share: words.percent(self.sent())})
                : words.say("The model is being read …");
        });
        self.typed = _.zipObject(PLACED, PLACED.map(function () { return ko.observable(""); }));

        self.summary = ko.pureComputed(function () { return words.mesh(self.mesh()); });
        self.details = ko.pureComputed(function () { return self.mesh() ? words.meshDetails(self.mesh()) : ""; });
        self.notes = ko.pureComputed(function () { return self.mesh() ? self.mesh().notes || [] : []; });
        self.used = ko.pureComputed({
            read: function () { return Boolean(self.mesh() && self.mesh().use); },
            write: function (use) { self.choose({use: use}); }
        });

        self.place = function () {
            const wanted = {};
            const wrong = PLACED.filter(function (name) {
                const text = String(self.typed[name]() === null ? "" : self.typed[name]()).trim().replace(",", ".");
                wanted[name] = text === "" ? null : Number(text);
                return !(wanted[name] === null || isFinite(wanted[name]));
            });
            if (wrong.length) {
                self.trouble(words.say("Each of these is a number, or empty."));
            } else {
                self.choose(wanted);
            }
        };
        self.remove = function () { self.ask(OctoPrint.plugins.moop.removeMesh()); };
        self.attach = function (_model, event) {
            const file = event.target.files[0];
            event.target.value = "";
            if (file) {
                self.ask(OctoPrint.plugins.moop.attachMesh(file));
            }
        };
        /* Another file has been selected, perhaps elsewhere. */
        tab.printerState.filepath.subscribe(_.debounce(function () { self.load(); }, 300));
    }

    Mesh.prototype.load = function () {
        if (this.tab.visible() && this.tab.mayView()) {
            OctoPrint.plugins.moop.mesh().done(this.take.bind(this)).fail(this.take.bind(this, {job: null, mesh: null}));
        }
    };

    Mesh.prototype.take = function (answer) {
        const self = this;
        self.job(answer.job);
        self.mesh(answer.mesh);
        PLACED.forEach(function (name) {
            const value = answer.mesh ? answer.mesh[name] : null;
            self.typed[name](value === null || value === undefined ? "" : String(value));
        });
    };

    Mesh.prototype.choose = function (wanted) {
        this.ask(OctoPrint.plugins.moop.chooseMesh(wanted));
    };

    Mesh.prototype.ask = function (request) {
        const self = this;
        self.busy(true);
        self.sent(null);
        return request
            .progress(function (sent) { self.sent(sent && sent.total ? sent.loaded / sent.total : null); })
            .done(function (answer) {
                self.trouble("");
                self.take(answer);
            })
            .fail(function (refused) { self.trouble(MOOP.words.refusal(refused)); })
            .always(function () { self.busy(false); });
    };

    window.MOOP = Object.assign(window.MOOP || {}, {Mesh: Mesh});
})();
