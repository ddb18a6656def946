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

    /* Addresses of all pictures of a check, by kind. */
    MoopClient.prototype.pictureUrls = function (checkId) {
        return _.mapValues(PICTURES, function (_file, kind) { return this.pictureUrl(checkId, kind); }.bind(this));
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

    /* {job, mesh}: the model that the selected job is compared with, or null. The next three answer the same. */
    MoopClient.prototype.mesh = function (opts) {
        return this.base.get(this.route("mesh"), opts);
    };

    MoopClient.prototype.attachMesh = function (file) {
        return this.sendFile(this.route("mesh"), file);
    };

    /* Unlike all other calls, OctoPrint's uploads hand their answers over as lists. */
    MoopClient.prototype.sendFile = function (url, file) {
        return this.base.upload(url, file).then(
            function (answer) { return answer[0]; },
            function (refused) { return $.Deferred().reject(refused[0]); }
        );
    };

    /* Whether it is used, and where it stands: any of use, x_mm, y_mm, turn_deg, layer_height_mm. */
    MoopClient.prototype.chooseMesh = function (wanted, opts) {
        return this.base.postJson(this.route("mesh", "choice"), wanted, opts);
    };

    MoopClient.prototype.removeMesh = function (opts) {
        return this.base.delete(this.route("mesh"), opts);
    };

    MoopClient.prototype.setup = function (opts) {
        return this.base.get(this.route("setup"), opts);
    };

    MoopClient.prototype.saveSetup = function (header, opts) {
        return this.base.postJson(this.route("setup"), header, opts);
    };

    /* {checks} of a past print, as they were found live. */
    MoopClient.prototype.pastChecks = function (name, opts) {
        return this.base.get(this.route("recordings", name, "checks"), opts);
    };

    MoopClient.prototype.pastPictureUrl = function (name, checkId, kind, run) {
        return this.address("recordings", name, "pictures", checkId, PICTURES[kind]) + "?run=" + run;
    };

    /* {checks, summary}: what would have happened with these settings (by name; others as they are). */
    MoopClient.prototype.replay = function (name, settings, opts) {
        return this.base.postJson(this.route("recordings", name, "replay"), settings, opts);
    };

    /* {done, of}: how many of its pictures the replay that runs has looked at. */
    MoopClient.prototype.replayProgress = function (name, opts) {
        return this.base.get(this.route("recordings", name, "replay"), opts);
    };

    // --- the set-up ---------------------------------------------------------------------------------------------

    /* The printer's geometry as OctoPrint's profile has it: {printer}. */
    MoopClient.prototype.printerGeometry = function (opts) {
        return this.base.get(this.route("calibrate", "printer"), opts);
    };

    /* Takes the picture that is to be clicked on: {bed_reference_mm}, where the printer says it stands, or null. */
    MoopClient.prototype.takePosePicture = function (opts) {
        return this.base.postJson(this.route("calibrate", "points", "picture"), {}, opts);
    };

    MoopClient.prototype.posePictureUrl = function () {
        return this.address("calibrate", "picture.jpg") + "?t=" + Date.now();
    };

    /* The camera's place from points clicked on that picture: [{mm: [x, y, z], px: [u, v]}, …]. */
    MoopClient.prototype.poseFromPoints = function (points, opts) {
        return this.base.postJson(this.route("calibrate", "points"), {points: points}, opts);
    };

    /* The camera's place from a fresh picture of the marker plate; markers is null for the plate made last. */
    MoopClient.prototype.poseFromMarkers = function (markers, opts) {
        return this.base.postJson(this.route("calibrate", "pose"), markers ? {markers: markers} : {}, opts);
    };

    /* Puts the marker plate's G-code among OctoPrint's files: {file, markers}. */
    MoopClient.prototype.makeMarkers = function (plate, opts) {
        return this.base.postJson(this.route("calibrate", "markers"), plate, opts);
    };

    /* Puts ring markers around a model: {markers}; the model is fetched from the address below. */
    MoopClient.prototype.putMarkersAround = function (file) {
        return this.sendFile(this.route("calibrate", "markers", "model"), file);
    };

    MoopClient.prototype.markedModelUrl = function () {
        return this.address("calibrate", "markers", "model.stl");
    };

    /* Where the bed's grid and a box on it must be seen: {lines: [{what, px: [[u, v], …]}, …]}. */
    MoopClient.prototype.guides = function (printer, camera, opts) {
        return this.base.postJson(this.route("calibrate", "guides"), {printer: printer, camera: camera}, opts);
    };

    /* What measuring the bed's motion would do: {can, why, from_mm, to_mm}. Nothing moves. */
    MoopClient.prototype.bedMotionPlan = function (opts) {
        return this.base.get(this.route("calibrate", "bed-motion"), opts);
    };

    /* {bed_motion, bed_reference_mm}; moves the printer where `confirmed`, not where it was `moved` by hand. */
    MoopClient.prototype.measureBedMotion = function (wanted, opts) {
        return this.base.postJson(this.route("calibrate", "bed-motion"), wanted, opts);
    };

    /* {current, calibrations}: those that are kept, the newest first. The next four answer the same. */
    MoopClient.prototype.calibrations = function (opts) {
        return this.base.get(this.route("calibrations"), opts);
    };

    MoopClient.prototype.useCalibration = function (id, opts) {
        return this.base.postJson(this.route("calibrations", id, "use"), {}, opts);
    };

    MoopClient.prototype.revertCalibration = function (opts) {
        return this.base.postJson(this.route("calibrations", "revert"), {}, opts);
    };

    MoopClient.prototype.renameCalibration = function (id, name, opts) {
        return this.base.postJson(this.route("calibrations", id), {name: name}, opts);
    };

    MoopClient.prototype.deleteCalibration = function (id, opts) {
        return this.base.delete(this.route("calibrations", id), opts);
    };

    /* Address of one of them as a file. */
    MoopClient.prototype.calibrationUrl = function (id) {
        return this.address("calibrations", id + ".json");
    };

    MoopClient.prototype.boardUrl = function (board) {
        return this.address("calibrate", "board.svg") + "?" + $.param(board);
    };

    /*
     * Takes a picture of the checkerboard: {corners_px, image_size_px, id, kept}; with keep: false in `board`, or where no
     * board is seen, it is not kept and id is null.
     */
    MoopClient.prototype.takeBoardPicture = function (board, opts) {
        return this.base.postJson(this.route("calibrate", "lens", "pictures"), board, opts);
    };

    /* {pictures: [{id, corners_px}, …], image_size_px}: those that are kept. */
    MoopClient.prototype.boardPictures = function (opts) {
        return this.base.get(this.route("calibrate", "lens", "pictures"), opts);
    };

    /* Address of the picture in which the board was looked for last. */
    MoopClient.prototype.lastBoardPictureUrl = function () {
        return this.address("calibrate", "lens", "last.jpg") + "?t=" + Date.now();
    };

    MoopClient.prototype.forgetBoardPictures = function (opts) {
        return this.base.delete(this.route("calibrate", "lens", "pictures"), opts);
    };

    MoopClient.prototype.findLens = function (board, opts) {
        return this.base.postJson(this.route("calibrate", "lens"), board, opts);
    };

    /* {lens}: the one found last for this webcam, or null. */
    MoopClient.prototype.lens = function (opts) {
        return this.base.get(this.route("calibrate", "lens"), opts);
    };

    /* Address of a picture taken now. The counter keeps the browser from answering with an old one. */
    MoopClient.prototype.freshFrameUrl = function () {
        return this.address("frame") + "?t=" + Date.now();
    };

    /* What the server says instead of a picture, which an image cannot tell: a promise; null where it has one now. */
    MoopClient.prototype.whyNoFrame = function () {
        const options = {headers: this.base.getRequestHeaders("GET"), credentials: "same-origin"};
        return fetch(this.address("frame"), options).then(function (answer) {
            return answer.ok ? null : answer.text().then(function (text) {
                return {status: answer.status, responseText: text};
            });
        }, function () { return null; });
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

    /* Address of a recording as a ZIP file, with its pictures or without. */
    MoopClient.prototype.recordingUrl = function (name, pictures) {
        return this.address("recordings", name + ".zip") + (pictures ? "" : "?pictures=0");
    };

    /* Address of a small picture of how that print ended. */
    MoopClient.prototype.thumbnailUrl = function (name) {
        return this.address("recordings", name, "thumbnail.jpg");
    };

    /* Never removed to make room, or like the others again. */
    MoopClient.prototype.keepRecording = function (name, keep, opts) {
        return this.base.postJson(this.route("recordings", name, "keep"), {keep: keep}, opts);
    };

    MoopClient.prototype.deleteRecording = function (name, opts) {
        return this.base.delete(this.route("recordings", name), opts);
    };

    OctoPrintClient.registerPluginComponent("moop", MoopClient);
    return MoopClient;
});
