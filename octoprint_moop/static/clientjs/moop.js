/* MOOP's part of OctoPrint's JavaScript client: the one place that knows URLs. */
(function (global, factory) {
    if (typeof define === "function" && define.amd) {
        define(["OctoPrintClient"], factory);
    } else {
        factory(global.OctoPrintClient);
    }
})(this, function (OctoPrintClient) {
    const PICTURES = {
        frame: "frame.jpg",
        seen: "seen.png",
        expected: "expected.png",
        ignored: "ignored.png"
    };

    function MoopClient(base) {
        this.base = base;
    }

    /* A route for the calls below, each part escaped: route("checks", 12, "frame.jpg"). */
    MoopClient.prototype.route = function () {
        const parts = Array.prototype.map.call(arguments, encodeURIComponent);
        return this.base.getBlueprintUrl("moop") + parts.join("/");
    };

    /* The same as an address that a picture or a link can use, behind any proxy prefix. */
    MoopClient.prototype.address = function () {
        return this.base.getBaseUrl() + this.route.apply(this, arguments);
    };

    MoopClient.prototype.status = function (opts) {
        return this.base.get(this.route("status"), opts);
    };

    MoopClient.prototype.checks = function (opts) {
        return this.base.get(this.route("checks"), opts);
    };

    /* Address of a check's picture; kind is one of "frame", "seen", "expected", "ignored". */
    MoopClient.prototype.pictureUrl = function (checkId, kind) {
        return this.address("checks", checkId, PICTURES[kind]);
    };

    MoopClient.prototype.checkNow = function (opts) {
        return this.base.postJson(this.route("check"), {}, opts);
    };

    /* Watch this print, or leave it alone until it ends. */
    MoopClient.prototype.watch = function (watching, opts) {
        return this.base.postJson(this.route("watch"), {watching: watching}, opts);
    };

    /* "Not a failure": what stands there now is as it should be. */
    MoopClient.prototype.pardon = function (opts) {
        return this.base.postJson(this.route("pardon"), {}, opts);
    };

    MoopClient.prototype.setup = function (opts) {
        return this.base.get(this.route("setup"), opts);
    };

    MoopClient.prototype.saveSetup = function (header, opts) {
        return this.base.postJson(this.route("setup"), header, opts);
    };

    /* Address of a picture taken now. The counter keeps the browser from answering with an old one. */
    MoopClient.prototype.freshFrameUrl = function () {
        return this.address("frame") + "?t=" + Date.now();
    };

    /* The mask that these thresholds give on the last frame: a promise of a PNG blob, or of the server's error. */
    MoopClient.prototype.previewSegmentation = function (thresholds) {
        // jQuery hands over text only, hence fetch; CSRF and session go along as in every other call
        const headers = this.base.getRequestHeaders("POST");
        headers["Content-Type"] = "application/json";
        return fetch(this.address("segment", "preview"), {
            method: "POST",
            headers: headers,
            credentials: "same-origin",
            body: JSON.stringify(thresholds)
        }).then(function (answer) {
            if (answer.ok) {
                return answer.blob();
            }
            return answer.text().then(function (text) {
                return Promise.reject({status: answer.status, responseText: text});
            });
        });
    };

    MoopClient.prototype.recordings = function (opts) {
        return this.base.get(this.route("recordings"), opts);
    };

    MoopClient.prototype.recordingUrl = function (name) {
        return this.address("recordings", name + ".zip");
    };

    MoopClient.prototype.deleteRecording = function (name, opts) {
        return this.base.delete(this.route("recordings", name), opts);
    };

    OctoPrintClient.registerPluginComponent("moop", MoopClient);
    return MoopClient;
});
