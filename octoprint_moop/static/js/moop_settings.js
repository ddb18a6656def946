/* MOOP's page in OctoPrint's settings. Names, ranges and defaults come from the server with the page. */
$(function () {
    const words = MOOP.words;

    function MoopSettingsViewModel(parameters) {
        const self = this;
        self.settings = parameters[0];
        self.limits = {};
        self.fields = {};

        /*
         * A setting behind a field: `typed` is what stands there, and reaches the setting only while it is in range, so
         * that a slip of the fingers is told at the field and never saved.
         */
        self.field = function (name) {
            const limits = self.limits[name];
            const setting = self.settings.settings.plugins.moop[name];
            const wrong = ko.observable("");
            const kept = ko.observable(null); // what was typed, while it is wrong
            const typed = ko.pureComputed({
                read: function () { return kept() === null ? setting() : kept(); },
                write: function (text) {
                    const found = MOOP.fields.parse(text, limits);
                    wrong(found.error || "");
                    if (found.error) {
                        kept(text);
                    } else {
                        kept(null);
                        setting(found.value);
                        typed.notifySubscribers(found.value); // "0,30" becomes 0.3 in the field too
                    }
                }
            });
            return {
                typed: typed,
                setting: setting,
                wrong: wrong,
                isDefault: ko.pureComputed(function () {
                    return kept() === null && String(setting()) === String(limits.default);
                }),
                useDefault: function () { typed(limits.default); },
                forget: function () { kept(null); wrong(""); }
            };
        };

        self.webcams = ko.pureComputed(function () {
            const known = self.settings.webcam && self.settings.webcam.webcams ? self.settings.webcam.webcams() : [];
            const names = _.map(known, function (webcam) { return ko.unwrap(webcam.name); });
            const chosen = self.fields.webcam ? self.fields.webcam.setting() : "";
            return chosen && !_.includes(names, chosen) ? names.concat([chosen]) : names;
        });

        self.openTab = function () {
            self.settings.hide();
            $("#tab_plugin_moop_link a").tab("show");
        };

        self.lookAgain = function () { self.filament.open(); };

        self.onBeforeBinding = function () {
            self.limits = JSON.parse(document.getElementById("moop_settings_limits").textContent);
            Object.keys(self.limits).forEach(function (name) { self.fields[name] = self.field(name); });
            self.filament = new MOOP.Filament({
                hueMin: self.fields.hue_min_deg.typed,
                hueMax: self.fields.hue_max_deg.typed,
                saturationMin: self.fields.saturation_min.typed,
                valueMin: self.fields.value_min.typed
            });
        };

        self.onAllBound = function () {
            self.filament.bind(document.getElementById("moop_settings_filament"));
            $("#settings_plugin_moop_link a").on("shown", self.lookAgain);
        };

        self.onSettingsShown = function () {
            _.each(self.fields, function (field) { field.forget(); });
            if ($("#settings_plugin_moop").is(":visible")) {
                self.lookAgain();
            }
        };

        self.complain = function (text) {
            new PNotify({
                title: words.say("MOOP: not everything was saved"),
                text: text,
                text_escape: true,
                type: "error",
                hide: false
            });
        };

        self.onDataUpdaterPluginMessage = function (plugin, message) {
            if (plugin === "moop" && message.type === "refused") {
                self.complain(message.message);
            }
        };

        /* How OctoPrint's health check shows what the server has found. */
        self.getAdditionalHealthCheckHandlers = function () {
            return {
                moop: function (result, context) {
                    const items = _.map(context.problems, function (text) { return "<li>" + _.escape(text) + "</li>"; });
                    return {title: "MOOP", html: "<ul>" + items.join("") + "</ul>", result: result};
                }
            };
        };

        self.onSettingsBeforeSave = function () {
            const wrong = _.filter(self.fields, function (field) { return field.wrong(); });
            if (wrong.length) {
                self.complain(words.say(
                    "%(n)s field(s) held a value that is not allowed and keep the old one.", {n: wrong.length}
                ));
            }
        };
    }

    OCTOPRINT_VIEWMODELS.push({
        construct: MoopSettingsViewModel,
        name: "moopSettingsViewModel",
        dependencies: ["settingsViewModel"],
        elements: ["#settings_plugin_moop"]
    });
});
