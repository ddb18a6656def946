/*
 * Why nobody is watching, and what mends it. Pure: a table from the server's codes (machine/blindness.py and the codes
 * of the errors) to a sentence, a button's words, and what the button does.
 */
(function (root) {
    function say(text) {
        return root.MOOP && root.MOOP.words ? root.MOOP.words.say(text) : text;
    }

    /* Marks a sentence for the translators; it is translated where it is said. */
    function N_(text) {
        return text;
    }

    /*
     * what the button does:
     *   setup:STEP      opens the set-up at that step       settings:ID  opens that page of OctoPrint's settings
     *   watch           looks again, from the start          files        shows OctoPrint's list of files
     *   refresh         asks the server how it stands        connection   shows OctoPrint's connection panel
     */
    const TRY_AGAIN = [N_("Try again"), "watch"];
    const LOG = [N_("Open the log"), "settings:settings_plugin_logging"];
    const CAMERA = [N_("Test the camera"), "setup:camera"];
    const PLACE = [N_("Show where the camera stands"), "setup:place"];
    const FILES = [N_("Show the files"), "files"];
    const SETTINGS = [N_("MOOP's settings"), "settings:settings_plugin_moop"];
    const MENDS = {
        // machine/blindness.py
        idle: [N_("Watching begins with the next print."), N_("Look again"), "refresh"],
        reading: [N_("Watching begins as soon as the file is read; a big one takes a minute or two."), N_("Look again"), "refresh"],
        not_local: [N_("Print it from OctoPrint's own files, or attach its 3D model and its layer height."), N_("Choose the model"), "mesh"],
        not_set_up: [N_("Show it once where the camera stands: that takes some minutes, and holds from the next print on."),
            N_("Set it up"), "setup:camera"],
        off: [N_("You can watch this print all the same."), N_("Watch this print"), "watch"],
        off_for_print: [N_("It stays so until this print ends, unless you switch it on again."), N_("Watch it again"), "watch"],
        no_layers: [N_("Slice the model again, or print another file."), FILES],
        not_held: [N_("Only a printer that OctoPrint itself feeds with G-code can be watched: connect it by its serial port."),
            N_("Show the connection"), "connection"],
        file_changed: [N_("What is printed is no longer what was read. Read the file again."), TRY_AGAIN],
        restarting: [N_("It comes back by itself in some seconds."), N_("Look again"), "refresh"],
        unusable: [N_("Checks go on with the next picture that is good. If that does not help, test the camera."), CAMERA],
        camera_moved: [N_("Put it back as it was. If it has to stay so, show it anew where it stands before the next print."), PLACE],
        out_of_view: [N_("Turn the camera so that the print is in the picture, or have the head moved aside for each picture."),
            N_("Change where the head is"), "settings:settings_plugin_moop"],
        bug: [N_("This is MOOP's own fault. The log has what a bug report needs."), LOG],
        no_report: [N_("The printer must answer M114. Give long moves more time in the expert settings."), SETTINGS],
        // errors
        moop: [N_("Try again; if it stays so, the log may say more."), TRY_AGAIN],
        gcode: [N_("Slice the model again, or print another file."), FILES],
        mesh: [N_("Choose another model for this job, or go on with the G-code alone."), N_("Choose the model"), "mesh"],
        recording: [N_("The recording cannot be written or read. Make room, or switch recordings off."), SETTINGS],
        camera: [N_("What is kept of the camera makes no sense, or its pictures have another size now. Show it anew where it stands."), PLACE],
        calibration: [N_("Show it anew where the camera stands."), PLACE],
        frame: [N_("Test the camera: its address, its cable, its lamp."), CAMERA],
        segmentation: [N_("Show it which colour the filament has."), N_("Show the filament"), "setup:filament"],
        render: [N_("The pictures to compare with cannot be drawn here. The log says why; \"moop doctor\" says what to install."), LOG],
        settings: [N_("A setting has a value that is not allowed."), SETTINGS],
        eye: [N_("The process that looks has ended too often. Start it once more."), TRY_AGAIN]
    };
    const OTHER = [N_("Try again; if it stays so, the log may say more."), TRY_AGAIN];

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
