/*
 * The server tells, logs and records in English, so that a recording and a bug report read alike everywhere
 * (docs/formats.md). What people read most of it is told again in their own language: each sentence is a pattern, and
 * its values may be patterns, too. What is not known here stays as the server says it. Pure.
 */
(function (root) {
    /* Marks a sentence for the translators; it is translated where it is told again. */
    function N_(text) {
        return text;
    }

    const SENTENCES = [
        // core/decision/diagnose.py
        N_("Everything above layer %(layer)s is shifted by about %(distance)s."),
        N_("No new material since layer %(layer)s."),
        N_("Too little new material since layer %(layer)s."),
        N_("Material lies where none should be, about %(area)s mm² of it."),
        N_("The print no longer looks as it should."),
        N_("The print is gone from its place."),
        N_("The print has come off: it lies about %(distance)s from its place."),
        N_("The print has come off."),
        N_("The %(corner)s has lifted by about %(size)s mm."),
        // machine/looks.py
        N_("No second picture confirms it."),
        N_("The printer did not report its position within %(seconds)s s. If that happens again, its firmware may not know M114."),
        N_("The webcam delivers the same picture again and again. Restart it."),
        N_("The picture goes on changing while the printer stands still: does the webcam lag behind?"),
        N_("The printer does not report how far it is in its file (M27), so nobody can tell what to expect."),
        N_("The printer does not stand where the file of the same name and size here would have it: it prints another one. Upload that, or print from OctoPrint's own files."),
        N_("The printer went on while its picture was taken. With a bed that moves, such a picture cannot be judged: print from OctoPrint's own files."),
        // core/checks.py, core/decision/telling.py and core/view
        N_("Filament and bed look alike here: more light, or a bed of another colour, would help."),
        N_("Something stands in the view: a hand, or a tool?"),
        N_("The print is seen badly: so much of the picture is not as expected, good as it may be, that little could be told from it. Calibrate the camera anew, see that the lamp lights the print, or clear away what has the filament's colour."),
        N_("The filament's colour is not set. Click on it in the set-up."),
        N_("The print head hides the print. Let it park for the picture."),
        N_("Nothing of the print is in view: it is out of the picture, or the head hides it. Park the head."),
        N_("Nothing in the picture is where it was: the camera was moved far, or something stands before it. The view is looked for again; if this stays, calibrate the camera anew."),
        N_("The picture is black. Is the lamp on, and the camera's lens free?"),
        N_("The picture is white throughout. Lower the camera's exposure."),
        N_("The picture shows nothing but one colour. Is something held before the lens?"),
        N_("The camera delivers the same picture again. Restart the webcam's stream."),
        N_("The picture is torn: its lower part is missing. Check the webcam's cable or network."),
        N_("The camera was moved: the picture has shifted by about %(size)s px. The view is looked for again; calibrate the camera before the next print."),
        N_("The frame is %(width)s x %(height)s px, but the camera was calibrated at %(width_then)s x %(height_then)s px. Set the webcam back, or calibrate it again."),
        // machine/webcam.py
        N_("The webcam has not answered the last request yet. Look at the stream, or restart it."),
        N_("The webcam gave no picture within %(seconds)s s. Look at its stream."),
        N_("The webcam gave no picture (%(why)s). Look at its snapshot address."),
        N_("The webcam sent more than %(size)s MB. Is this a stream's address?"),
        N_("The webcam's answer is empty. Look at its snapshot address."),
        N_("The webcam's answer is not a JPEG; it begins with %(bytes)s. Look at its snapshot address."),
        N_("The webcam's picture breaks off after %(bytes)s bytes. Look at its stream."),
        N_("OctoPrint has %(webcam)s. Choose one in the settings."),
        N_("%(webcam)s can take no snapshots. Set its snapshot address in OctoPrint."),
        // machine/recorder.py, host/api.py
        N_("This print is not recorded: %(why)s."),
        N_("This print is not recorded any more: %(why)s."),
        N_("Make room, and the next print is recorded again."),
        N_("This recording is being written. It can be deleted when the print is over."),
        // machine/watch.py, ledger.py, link.py, responding.py, host/plugin.py
        N_("No print is running."),
        N_("No print is being watched just now. Start one, then look again."),
        N_("There is no G-code to compare with. Print from OctoPrint, or give the print a model."),
        N_("There is no G-code to be read."),
        N_("With the print's layer height, the model alone is enough: enter it beside the model."),
        N_("The G-code is being read."),
        N_("This print's file is not OctoPrint's own."),
        N_("This print runs from the printer's own storage, where nobody can hold it for a look. With the same file among OctoPrint's own, or a model and its layer height attached, it can still be watched."),
        N_("This print runs from the printer's own storage. A file of the same name and size is here: it is looked at by the clock, from the first look on that finds the printer where that file has it."),
        N_("The printer's file has %(bytes)s bytes, the one of the same name here %(here)s. Upload the one that is printed, and it is watched from its next start on."),
        N_("The camera is not calibrated. Run the set-up."),
        N_("Watching is switched off in the settings."),
        N_("Watching was switched off for this print."),
        N_("The file extrudes nothing that could be watched."),
        N_("Checking failed (%(why)s). The log has the details."),
        N_("Looking failed (%(why)s). The log has the details; please report them."),
        N_("Looking took longer than %(seconds)s s and was given up."),
        N_("The process that looks at the pictures cannot be started (%(why)s)."),
        N_("The process that looks at the pictures ended (%(why)s)."),
        N_("The process that looks at the pictures ended and was started anew."),
        N_("The process that looks at the pictures hung and was ended."),
        N_("It is being started again."),
        N_("It was started again %(times)s times; this print is not watched any more."),
        N_("The print cannot be held for a look (%(why)s)."),
        N_("No line of this print comes by here: over this kind of connection it cannot be held for a look."),
        N_("The lines that are sent do not match the file. Was it changed after it was read?"),
        N_("Nobody has watched this print for %(minutes)s min.")
    ];

    const VALUES = [
        N_("%(size)s mm to the %(side)s and the %(other_side)s"),
        N_("%(size)s mm to the %(side)s"),
        N_("right"), N_("left"), N_("back"), N_("front"),
        N_("right side"), N_("left side"), N_("back side"), N_("front side"),
        N_("back-right corner"), N_("back-left corner"), N_("front-right corner"), N_("front-left corner"),
        N_("no webcam"), N_("no webcam named %(name)s"),
        N_("the disk is almost full"), N_("its recording was deleted")
    ];

    /*
     * {text, names, form} of a pattern; form is anchored and has one group for each name. A value that ends a sentence
     * ends with it: what follows is told by itself.
     */
    function compiled(text) {
        const names = [];
        const form = text.replace(/[.*+?^${}()|[\]\\]/g, "\\$&").replace(/%\\\((\w+)\\\)s(\\\.(?= |$))?/g, function (_match, name, stop) {
            names.push(name);
            return stop ? "((?:(?![.?!] ).)+?)" + stop : "(.+?)";
        });
        return {text: text, names: names, form: new RegExp("^" + form + "$")};
    }

    const COMPILED = {sentences: SENTENCES.map(compiled), values: VALUES.map(compiled)};

    /* The text by the first pattern that fits it, in the reader's language; null where none does. */
    function byPattern(text, patterns, translate) {
        for (const pattern of patterns) {
            const found = pattern.form.exec(text);
            if (found) {
                return translate(pattern.text).replace(/%\((\w+)\)s/g, function (_match, name) {
                    const value = found[1 + pattern.names.indexOf(name)];
                    const known = byPattern(value, COMPILED.values, translate);
                    return known === null ? value : known;
                });
            }
        }
        return null;
    }

    /*
     * What the server said, in the language of `translate`, sentence by sentence; a pattern may be several sentences,
     * so the longest run of them that is known comes first. A name may stand before it: "hook: The print has come off."
     */
    function retell(text, translate) {
        const parts = (text || "").split(/(?<=[.?!]) /);
        for (let n = parts.length; n > 0; n--) {
            const known = byPattern(parts.slice(0, n).join(" "), COMPILED.sentences, translate);
            if (known !== null) {
                return n < parts.length ? known + " " + retell(parts.slice(n).join(" "), translate) : known;
            }
        }
        const named = /^(.+?: )(.+)$/.exec(parts[0]);
        if (named && byPattern(named[2], COMPILED.sentences, translate) !== null) {
            return named[1] + retell([named[2]].concat(parts.slice(1)).join(" "), translate);
        }
        return parts.length > 1 ? parts[0] + " " + retell(parts.slice(1).join(" "), translate) : parts[0];
    }

    const told = {retell: retell, sentences: SENTENCES, values: VALUES};
    root.MOOP = Object.assign(root.MOOP || {}, {told: told});
    if (typeof module === "object" && module.exports) {
        module.exports = told;
    }
})(typeof window === "object" ? window : globalThis);
