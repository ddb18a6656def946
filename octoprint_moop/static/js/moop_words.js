/* What MOOP says to people: states, ages and failures as sentences. Pure: no page, no server. */
(function (root) {
    /* OctoPrint has its catalogue only when the page is ready, which is after this script. */
    function translate(text) {
        return typeof root.gettext === "function" ? root.gettext(text) : text;
    }

    /* Marks a sentence for the translators where it stands; it is translated where it is said. */
    function N_(text) {
        return text;
    }

    /* "layer %(n)s" with {n: 3} is "layer 3". */
    function fill(text, values) {
        return text.replace(/%\((\w+)\)s/g, function (_match, name) {
            return String(values[name]);
        });
    }

    function say(text, values) {
        return fill(translate(text), values || {});
    }

    /* What the server says in English, in the reader's language where it is known there. */
    function retold(text) {
        return root.MOOP && root.MOOP.told ? root.MOOP.told.retell(text, translate) : text;
    }

    /* 12 s, 3 min, 2 h 5 min. */
    function duration(seconds) {
        const s = Math.max(0, Math.round(seconds));
        if (s < 60) {
            return say("%(s)s s", {s: s});
        }
        const minutes = Math.floor(s / 60);
        if (minutes < 60) {
            return say("%(m)s min", {m: minutes});
        }
        return say("%(h)s h %(m)s min", {h: Math.floor(minutes / 60), m: minutes % 60});
    }

    /* People count layers from one; files and the server count from nought. */
    function layerNumber(layer) {
        return layer + 1;
    }

    /* E as people read it: 0.0423 is "4.2 %". */
    function percent(ratio) {
        if (ratio === null || ratio === undefined) {
            return "–";
        }
        const value = 100 * ratio;
        return value.toFixed(value < 9.95 ? 1 : 0) + " %";
    }

    const MODES = {
        warping: N_("Warping"),
        detachment: N_("Detached from the bed"),
        extrusion_failure: N_("No extrusion"),
        layer_shift: N_("Layers shifted"),
        stray_material: N_("Stray material"),
        unknown: N_("Does not match the model")
    };

    const VERDICTS = {
        ok: N_("all well"),
        suspect: N_("something may be wrong, looking closer"),
        failed: N_("failed"),
        unusable: N_("picture unusable"),
        camera_moved: N_("the camera has moved")
    };

    const ACTIONS = {
        none: N_("Nothing was done."),
        notify: N_("You were notified; the print goes on."),
        pause: N_("The print was paused."),
        cancel: N_("The print was cancelled."),
        cancel_object: N_("Only the failed object was cancelled; the print goes on.")
    };

    function mode(check) {
        return say(MODES[check && check.mode] || MODES.unknown);
    }

    function verdict(check) {
        return say(VERDICTS[check.verdict] || check.verdict);
    }

    const LEVELS = {idle: N_("idle"), good: N_("good"), warning: N_("warning"), failed: N_("failed")};

    /* The level of a state in one word, for those who do not see its colour. */
    function level(name) {
        return say(LEVELS[name] || name);
    }

    function action(name) {
        return say(ACTIONS[name] || ACTIONS.none);
    }

    function joined(parts) {
        return parts.filter(Boolean).join(" · ");
    }

    function where(status) {
        if (status.layer === null || status.layer === undefined) {
            return "";
        }
        const values = {layer: layerNumber(status.layer), layers: status.layers};
        const layer = status.layers ? say("layer %(layer)s of %(layers)s", values) : say("layer %(layer)s", values);
        // what the printer reads from its own storage cannot be held at the end of each layer
        const byClock = status.road === "bytes" || status.road === "height";
        return byClock ? joined([layer, say("looked at by the clock only")]) : layer;
    }

    function lastLook(check, ageSeconds) {
        return check ? say("last check %(age)s ago", {age: duration(ageSeconds)}) : say("no check yet");
    }

    /* Whether a failure stands: told, and not yet pardoned. */
    function failureStands(status) {
        return Boolean(status && status.job && status.reason);
    }

    /*
     * The state in one line, and how grave it is: {level: "idle" | "good" | "warning" | "failed", text}.
     * ageSeconds: age of the last check now. printer: "idle", "printing" or "paused".
     */
    function state(status, ageSeconds, printer) {
        if (!status) {
            return {level: "idle", text: say("Asking the server …")};
        }
        const check = status.last_check;
        const age = duration(ageSeconds);
        if (check && check.verdict === "failed" && failureStands(status)) {
            const stands = {
                idle: say("The last print failed"),
                printing: say("Failed, printing on"),
                paused: say("Print paused")
            };
            return {
                level: "failed",
                text: joined([
                    stands[printer],
                    say("layer %(layer)s", {layer: layerNumber(check.layer)}),
                    mode(check),
                    say("%(age)s ago", {age: age})
                ])
            };
        }
        if (printer === "idle") {
            return {
                level: "idle",
                text: joined([
                    status.blind ? retold(status.blind) : say("No print is running."),
                    check ? say("last check %(age)s ago", {age: age}) : "",
                    check ? verdict(check) : ""
                ])
            };
        }
        if (!status.job || status.blind) {
            const why = status.blind ? retold(status.blind) : say("it has not been taken up.");
            return {
                level: "warning",
                text: joined([
                    say("Nobody is watching this print: %(why)s", {why: why}),
                    typeof status.reading === "number" ? say("%(share)s read", {share: percent(status.reading)}) : "",
                    check ? lastLook(check, ageSeconds) : ""
                ])
            };
        }
        return {
            level: !check || check.verdict === "ok" ? "good" : "warning",
            text: joined([
                printer === "paused" ? say("Watching, print paused") : say("Watching"),
                where(status),
                lastLook(check, ageSeconds),
                check ? verdict(check) : ""
            ])
        };
    }

    /*
     * The layer in which the trouble that ends in checks[index] began: the first of the unbroken run of
     * checks that were not well. Unusable pictures say nothing, so they neither begin nor break it.
     */
    function sinceLayer(checks, index) {
        let since = checks[index].layer;
        for (let i = index - 1; i >= 0; i--) {
            const check = checks[i];
            if (check.verdict === "suspect" || check.verdict === "failed") {
                since = check.layer;
            } else if (check.verdict !== "unusable") {
                break;
            }
        }
        return since;
    }

    /* What to tell of a failed check: {title, sentence, done}. */
    function failure(check, since, actionName) {
        const failedObjects = (check.objects || [])
            .filter(function (object) { return object.verdict === "failed"; })
            .map(function (object) { return object.name; });
        const values = {
            layer: layerNumber(check.layer),
            since: layerNumber(since),
            error: percent(check.E),
            limit: percent(check.limit),
            objects: failedObjects.join(", ")
        };
        let numbers = say("E is %(error)s", values);
        if (check.limit !== null && check.limit !== undefined) {
            numbers += say(", the limit %(limit)s", values);
        }
        const named = failedObjects.every(function (name) { return (check.reason || "").indexOf(name + ":") >= 0; });
        return {
            title: say("%(mode)s at layer %(layer)s", {mode: mode(check), layer: values.layer}),
            sentence: check.reason ? retold(check.reason) : say("What the camera sees does not match the model."),
            details: joined([
                failedObjects.length && !named ? say("object: %(objects)s", values) : "",
                since < check.layer ? say("since layer %(since)s", values) : "",
                numbers
            ]),
            done: action(actionName)
        };
    }

    /* A check in one line: layer, E, what was concluded, what it cost. */
    function checkLine(check) {
        return joined([
            say("Layer %(layer)s", {layer: layerNumber(check.layer)}),
            say("E %(error)s", {error: percent(check.E)}),
            check.verdict === "failed" ? mode(check) : verdict(check),
            check.held_s ? say("took %(held)s s", {held: check.held_s.toFixed(1)}) : ""
        ]);
    }

    /* What looking has cost this print so far; "" before the first check. */
    function timeAdded(status) {
        if (!status || !status.checks || !status.held_s) {
            return "";
        }
        return say("Looking has added %(total)s to this print so far: %(each)s s a look.", {
            total: duration(status.held_s),
            each: (status.held_s / status.checks).toFixed(1)
        });
    }

    /* The plot of E in words, for those who do not see it. */
    function plotSummary(checks) {
        const count = function (name) {
            return checks.filter(function (check) { return check.verdict === name; }).length;
        };
        return say("E by layer: %(n)s checks, %(suspect)s suspect, %(failed)s failed, %(unusable)s unusable", {
            n: checks.length,
            suspect: count("suspect"),
            failed: count("failed"),
            unusable: count("unusable")
        });
    }

    /* The time that a recording's name begins with, as people write it; "" where it has none. */
    function recordingTime(name) {
        const found = /^(\d{4})-?(\d\d)-?(\d\d)[-_T]?(\d\d)-?(\d\d)/.exec(name);
        return found ? found[1] + "-" + found[2] + "-" + found[3] + " " + found[4] + ":" + found[5] : "";
    }

    function megabytes(bytes) {
        return say("%(mb)s MB", {mb: Math.max(1, Math.round(bytes / 1e6))});
    }

    /* How a recorded print went, from its entry in the list. */
    function pastVerdict(recording) {
        if (!recording.checks) {
            return say("not checked");
        }
        if (recording.verdict === "failed") {
            return say("%(mode)s at layer %(layer)s", {mode: mode(recording), layer: layerNumber(recording.layer)});
        }
        return say("%(n)s checks, no failure", {n: recording.checks});
    }

    /* What a replay would have done, beside what was done live. */
    function replayed(live, summary) {
        const told = function (layer) {
            return layer === null || layer === undefined
                ? say("no failure")
                : say("a failure at layer %(layer)s", {layer: layerNumber(layer)});
        };
        const before = live.filter(function (check) { return check.verdict === "failed"; })[0];
        return say("With these settings: %(now)s in %(n)s checks. During the print: %(before)s.", {
            now: told(summary.first_failed_layer),
            n: summary.checks,
            before: told(before ? before.layer : null)
        });
    }

    function millimetres(value) {
        return String(Math.round(10 * value) / 10);
    }

    /* What measuring the bed's motion is going to move: {from_mm, to_mm}. */
    function bedMotionPlan(plan) {
        return say(
            "Z moves from %(z0)s to %(z1)s mm, Y from %(y0)s to %(y1)s mm; a picture is taken, and both move back. " +
            "Nothing is heated. Make sure that nothing stands in the way.",
            {
                z0: millimetres(plan.from_mm.z),
                z1: millimetres(plan.to_mm.z),
                y0: millimetres(plan.from_mm.y),
                y1: millimetres(plan.to_mm.y)
            }
        );
    }

    const MOTIONS = {
        fixed: N_("Measured: the bed stands still."),
        y: N_("Measured: the bed moves forwards and backwards, with Y."),
        z: N_("Measured: the bed moves up and down, with Z.")
    };

    function bedMotion(motion) {
        return say(MOTIONS[motion] || motion);
    }

    const FOUND_BY = {pose: N_("from markers"), points: N_("from clicked points"), given: N_("taken over")};

    /* A calibration that is kept, in one line: when, how, how exact. */
    function calibration(kept) {
        return joined([
            (kept.made_at || "").slice(0, 16).replace("T", " "),
            say(FOUND_BY[kept.how] || kept.how),
            kept.error_px ? say("exact to %(px)s px", {px: kept.error_px.mean.toFixed(1)}) : ""
        ]);
    }

    const DOING = {
        picture: N_("Taking a picture …"),
        capture: N_("Looking for the board …"),
        lens: N_("Finding the lens; this may take a minute …"),
        place: N_("Finding the camera's place; this may take half a minute …"),
        markers: N_("Making the plate …"),
        move: N_("Moving and looking; this may take a minute …"),
        save: N_("Keeping it …"),
        other: N_("Working …")
    };

    /* What is being done, for whoever waits for it. */
    function busy(what) {
        return say(DOING[what] || DOING.other);
    }

    function mesh(found) {
        if (!found) {
            return say("A 3D model for this job: none");
        }
        return found.use
            ? say("Compared with the 3D model %(name)s", found)
            : say("The 3D model %(name)s is attached, and not used", found);
    }

    function meshDetails(found) {
        return say("%(name)s: %(size)s mm, %(triangles)s triangles.", {
            name: found.name,
            size: (found.size_mm || []).map(millimetres).join(" x "),
            triangles: found.triangles
        });
    }

    /* The sentence in a refused request: the server's own where it sent one. */
    function refusal(request) {
        let message = "";
        try {
            message = (request.responseJSON || JSON.parse(request.responseText)).message;
        } catch (e) {
            message = "";
        }
        if (message) {
            return retold(message);
        }
        if (request && request.status === 403) {
            return say("You do not have the permission for this.");
        }
        if (request && request.status) {
            return say("The server answered with an error (%(status)s). Its log says more.", {status: request.status});
        }
        return say("The server does not answer.");
    }

    const words = {
        say: say,
        retold: retold,
        level: level,
        duration: duration,
        layerNumber: layerNumber,
        percent: percent,
        mode: mode,
        verdict: verdict,
        action: action,
        failureStands: failureStands,
        state: state,
        sinceLayer: sinceLayer,
        failure: failure,
        checkLine: checkLine,
        timeAdded: timeAdded,
        plotSummary: plotSummary,
        recordingTime: recordingTime,
        megabytes: megabytes,
        pastVerdict: pastVerdict,
        replayed: replayed,
        bedMotionPlan: bedMotionPlan,
        bedMotion: bedMotion,
        mesh: mesh,
        meshDetails: meshDetails,
        calibration: calibration,
        busy: busy,
        refusal: refusal
    };

    root.MOOP = Object.assign(root.MOOP || {}, {words: words});
    if (typeof module === "object" && module.exports) {
        module.exports = words;
    }
})(typeof window === "object" ? window : globalThis);
