/* Past prints: the recordings that are kept, each with what was concluded. */
$(function () {
    const words = MOOP.words;

    function MoopPastViewModel(parameters) {
        const self = this;
        self.loginState = parameters[0];
        self.access = parameters[1];
        self.settings = parameters[2];

        self.recordings = ko.observableArray([]);
        self.asked = ko.observable(false);
        self.trouble = ko.observable("");
        self.announced = ko.observable("");

        const allowed = function (name) {
            return ko.pureComputed(function () {
                return self.loginState.hasPermission(self.access.permissions[name]);
            });
        };
        self.mayView = allowed("PLUGIN_MOOP_VIEW");
        self.mayControl = allowed("PLUGIN_MOOP_CONTROL");
        self.maySettings = allowed("SETTINGS");

        self.visible = function () { return !document.hidden && $("#moop_past").is(":visible"); };
        self.opened = new MOOP.PastPrint(self);

        self.rows = ko.pureComputed(function () {
            const moop = OctoPrint.plugins.moop;
            return self.recordings().map(function (recording) {
                return {
                    name: recording.name,
                    job: recording.job || recording.name,
                    time: words.recordingTime(recording.name),
                    verdict: words.pastVerdict(recording),
                    failed: recording.verdict === "failed",
                    kept: Boolean(recording.keep),
                    size: words.megabytes(recording.bytes),
                    thumbnail: moop.thumbnailUrl(recording.name),
                    zip: moop.recordingUrl(recording.name, true),
                    zipWithoutPictures: moop.recordingUrl(recording.name, false)
                };
            });
        });
        self.room = ko.pureComputed(function () {
            const used = self.recordings().reduce(function (sum, recording) { return sum + recording.bytes; }, 0);
            return words.say("They take %(used)s of the %(room)s that they may; the oldest go first, those that you keep never.", {
                used: words.megabytes(used),
                room: words.megabytes(1e6 * self.settings.settings.plugins.moop.recordings_mb())
            });
        });

        self.load = function () {
            if (!self.mayView()) {
                return $.Deferred().reject();
            }
            return OctoPrint.plugins.moop.recordings()
                .done(function (answer) {
                    self.trouble("");
                    self.asked(true);
                    self.recordings(answer.recordings);
                })
                .fail(self.tell);
        };
        self.tell = function (request) { self.trouble(words.refusal(request)); };

        self.open = function (row) { self.opened.open(row); };

        self.toggleKeep = function (row) {
            OctoPrint.plugins.moop.keepRecording(row.name, !row.kept)
                .done(function () {
                    self.announced(row.kept
                        ? words.say("%(job)s may be removed to make room.", row)
                        : words.say("%(job)s is kept until you delete it.", row));
                    self.load();
                })
                .fail(self.tell);
        };

        self.remove = function (row) {
            showConfirmationDialog({
                title: words.say("Delete this recording?"),
                message: _.escape(words.say("The recording of %(job)s (%(time)s) is deleted for good.", row)),
                question: "",
                cancel: gettext("Cancel"),
                proceed: words.say("Delete it"),
                proceedClass: "danger",
                onproceed: function () {
                    OctoPrint.plugins.moop.deleteRecording(row.name)
                        .done(function () {
                            self.load();
                            if (self.opened.row() && self.opened.row().name === row.name) {
                                self.opened.close();
                            }
                        })
                        .fail(self.tell);
                }
            });
        };

        self.onBeforeBinding = function () { self.opened.readSettings(); };
        self.onAllBound = function () {
            self.opened.view.bind();
            $('#moop_pages a[href="#moop_past_page"]').on("shown", self.load);
        };
    }

    OCTOPRINT_VIEWMODELS.push({
        construct: MoopPastViewModel,
        name: "moopPastViewModel",
        dependencies: ["loginStateViewModel", "accessViewModel", "settingsViewModel"],
        elements: ["#moop_past"]
    });
});
