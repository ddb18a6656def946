/*
 * Why nobody is watching, and what mends it. Pure: a table from the server's codes (machine/blindness.py and the codes
 * of the errors) to a sentence, a button's words, and what the button does.
 */
(function (root) {
    function say(text) {
        return root.MOOP && root.MOOP.words ? root.MOOP.words.say(text) : text;
    }

    /*
     * what the button does:
     *   setup:STEP      opens the set-up at that step       settings:ID  opens that page of OctoPrint's settings
     *   watch           looks again, from the start          files        shows OctoPrint's list of files
     *   refresh         asks the server how it stands        connection   shows OctoPrint's connection panel
     */
    const TRY_AGAIN = ["Try again", "watch"];
    const LOG = ["Open the log", "settings:settings_plugin_logging"];
    const CAMERA = ["Test the camera", "setup:camera"];
    const PLACE = ["Show where the camera stands", "setup:place"];
    const FILES = ["Show the files", "files"];
    const SETTINGS = ["MOOP's settings", "settings:settings_plugin_moop"];
    const MENDS = {
        // machine/blindness.py
        idle: ["Watching begins with the next print.", "Look again", "refresh"],
        reading: ["Watching begins as soon as the file is read; a big one takes a minute or two.", "Look again", "refresh"],
        not_local: ["Print it from OctoPrint's own files, or attach its 3D model and its layer height.", "Choose the model", "mesh"],
        not_set_up: ["Show it once where the camera stands: that takes some minutes, and holds from the next print on.",
            "Set it up", "setup:camera"],
        off: ["You can watch this print all the same.", "Watch this print", "watch"],
        off_for_print: ["It stays so until this print ends, unless you switch it on again.", "Watch it again", "watch"],
        no_layers: ["Slice the model again, or print another file.", FILES],
        not_held: ["Only a printer that OctoPrint itself feeds with G-code can be watched: connect it by its serial port.",
            "Show the connection", "connection"],
        file_changed: ["What is printed is no longer what was read. Read the file again.", TRY_AGAIN],
        restarting: ["It comes back by itself in some seconds.", "Look again", "refresh"],
        unusable: ["Checks go on with the next picture that is good. If that does not help, test the camera.", CAMERA],
        camera_moved: ["Put it back as it was, or show it anew where it stands.", PLACE],
        out_of_view: ["Turn the camera so that the print is in the picture, or have the head moved aside for each picture.",
            "Change where the head is", "settings:settings_plugin_moop"],
        bug: ["This is MOOP's own fault. The log has what a bug report needs.", LOG],
        no_report: ["The printer must answer M114. Give long moves more time in the expert settings.", SETTINGS],
        // errors
        moop: ["Try again; if it stays so, the log may say more.", TRY_AGAIN],
        gcode: ["Slice the model again, or print another file.", FILES],
        mesh: ["Choose another model for this job, or go on with the G-code alone.", "Choose the model", "mesh"],
        recording: ["The recording cannot be written or read. Make room, or switch recordings off.", SETTINGS],
        camera: ["What is kept of the camera makes no sense, or its pictures have another size now. Show it anew where it stands.", PLACE],
        calibration: ["Show it anew where the camera stands.", PLACE],
        frame: ["Test the camera: its address, its cable, its lamp.", CAMERA],
        segmentation: ["Show it which colour the filament has.", "Show the filament", "setup:filament"],
        render: ["The pictures to compare with cannot be drawn here. The log says why; \"moop doctor\" says what to install.", LOG],
        settings: ["A setting has a value that is not allowed.", SETTINGS],
        eye: ["The process that looks has ended too often. Start it once more.", TRY_AGAIN]
    };
    const OTHER = ["Try again; if it stays so, the log may say more.", TRY_AGAIN];

    /* {advice, button, does} for a code; for one that is not known, what can always be tried. */
    function mend(code) {
        const entry = [].concat.apply([], MENDS[code] || OTHER);
        return {advice: say(entry[0]), button: say(entry[1]), does: entry[2]};
    }

    const blind = {mend: mend, codes: Object.keys(MENDS)};
    root.MOOP = Object.assign(root.MOOP || {}, {blind: blind});
    if (typeof module === "object" && module.exports) {
        module.exports = blind;
    }
})(typeof window === "object" ? window : globalThis);
