/* Step "camera" of the set-up: a picture, and whether it is good enough to measure in. */
(function () {
    const JUDGED_WIDTH = 640;

    function SetupCamera(setup) {
        const self = this;
        self.setup = setup;
        self.verdicts = ko.observableArray([]);
        self.good = ko.pureComputed(function () { return self.verdicts().length > 0 && _.every(self.verdicts(), "ok"); });
        self.openWebcamSettings = function () { setup.settings.show("settings_plugin_classicwebcam"); };
        self.openSettings = function () { setup.settings.show("settings_plugin_moop"); };

        self.take = function () {
            setup.busy("picture");
            return setup.picture.open({frame: OctoPrint.plugins.moop.freshFrameUrl()}, "plain")
                .done(function () {
                    setup.trouble("");
                    self.verdicts(judge(setup.picture.image));
                })
                .fail(function (address) {
                    if (address === MOOP.Picture.OVERTAKEN) {
                        return;
                    }
                    self.verdicts([]);
                    setup.trouble(MOOP.words.say("The webcam gives no picture."));
                    OctoPrint.plugins.moop.whyNoFrame().then(function (why) {
                        if (why && !self.verdicts().length) {
                            setup.trouble(MOOP.words.refusal(why));
                        }
                    });
                })
                .always(function () { setup.busy(""); });
        };
    }

    function judge(image) {
        const width = Math.min(JUDGED_WIDTH, image.naturalWidth);
        const height = Math.round(width * image.naturalHeight / image.naturalWidth);
        const canvas = document.createElement("canvas");
        canvas.width = width;
        canvas.height = height;
        const context = canvas.getContext("2d");
        context.drawImage(image, 0, 0, width, height);
        return MOOP.quality.judge(MOOP.quality.measure(context.getImageData(0, 0, width, height).data, width, height));
    }

    window.MOOP = Object.assign(window.MOOP || {}, {SetupCamera: SetupCamera});
})();
