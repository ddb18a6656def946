/* The button that mends blindness: which one it is, whether this user may press it, and what it does. */
(function () {
    /* tab: the MOOP tab's view model. */
    function Mender(tab) {
        const self = this;
        self.tab = tab;
        self.mend = ko.pureComputed(function () {
            const status = tab.status();
            return tab.state().level === "warning" && status && status.blind
                ? MOOP.blind.mend(status.blind_code)
                : null;
        });
        self.mayPress = ko.pureComputed(function () {
            const does = self.mend() ? self.mend().does : "";
            if (does === "watch" || does === "mesh") {
                return tab.mayControl();
            }
            if (does.indexOf("setup:") === 0) {
                return tab.mayCalibrate();
            }
            return does.indexOf("settings:") !== 0 || tab.maySettings();
        });
        self.press = function () { self.act(self.mend().does); };
    }

    Mender.prototype.act = function (does) {
        const tab = this.tab;
        const what = does.split(":");
        const sidebar = {files: "#files", connection: "#connection"}[what[0]];
        if (what[0] === "setup") {
            this.openSetup(what[1]);
        } else if (what[0] === "settings") {
            tab.settings.show(what[1]);
        } else if (what[0] === "watch") {
            tab.ask("watch", OctoPrint.plugins.moop.watch(true));
        } else if (what[0] === "mesh") {
            document.getElementById("moop_mesh").open = true;
            document.getElementById("moop_mesh_file").focus();
        } else if (sidebar) {
            $(sidebar).collapse("show");
            document.querySelector(sidebar).scrollIntoView({block: "center"});
        } else {
            tab.refresh();
        }
    };

    Mender.prototype.openSetup = function (step) {
        this.tab.setup.go(step);
        $('#moop_pages a[href="#moop_setup_page"]').tab("show");
    };

    window.MOOP = Object.assign(window.MOOP || {}, {Mender: Mender});
})();
