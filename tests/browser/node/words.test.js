"use strict";
const assert = require("node:assert");
const test = require("node:test");
const words = require("../../../octoprint_moop/static/js/moop_words.js");

const well = {layer: 40, E: 0.004, verdict: "ok", objects: []};
const failed = {layer: 72, E: 0.131, limit: 0.02, verdict: "failed", mode: "detachment", reason: "The hook is gone.", objects: []};
const status = (changes) => Object.assign(
    {watching: true, blind: null, job: "a.gcode", layer: 40, layers: 120, checks: 41, last_check: well, action: "none"}, changes
);

test("a print that goes well is told in one line", () => {
    assert.deepStrictEqual(words.state(status(), 12.3, "printing"), {
        level: "good", text: "Watching · layer 41 of 120 · last check 12 s ago · all well"
    });
});

test("a print that the printer reads from its own storage is said to be looked at by the clock only", () => {
    ["bytes", "height"].forEach((road) => assert.strictEqual(words.state(status({road: road}), 12.3, "printing").text,
        "Watching · layer 41 of 120 · looked at by the clock only · last check 12 s ago · all well"));
});

test("a print before its first check says that there is none yet", () => {
    const told = words.state(status({last_check: null, layer: 0}), 0, "printing");
    assert.strictEqual(told.text, "Watching · layer 1 of 120 · no check yet");
});

test("being blind is a warning during a print, and names the reason and the age of the last look", () => {
    const told = words.state(status({watching: false, blind: "The webcam does not answer."}), 75, "printing");
    assert.strictEqual(told.level, "warning");
    assert.strictEqual(told.text, "Nobody is watching this print: The webcam does not answer. · last check 1 min ago");
});

test("a print that the server does not know of is not called watched", () => {
    const told = words.state(status({job: null, last_check: null}), 0, "printing");
    assert.strictEqual(told.level, "warning");
    assert.match(told.text, /Nobody is watching/);
});

test("when no print runs, nobody is alarmed", () => {
    const told = words.state(status({watching: false, blind: "No print is running."}), 5, "idle");
    assert.deepStrictEqual(told, {level: "idle", text: "No print is running. · last check 5 s ago · all well"});
});

test("a failure outranks everything else until it is pardoned", () => {
    const gone = status({last_check: failed, action: "pause", reason: "The hook is gone.", blind: "whatever"});
    assert.deepStrictEqual(words.state(gone, 75, "paused"), {
        level: "failed", text: "Print paused · layer 73 · Detached from the bed · 1 min ago"
    });
    assert.notStrictEqual(words.state(Object.assign(gone, {action: "none", reason: ""}), 75, "paused").level, "failed");
});

test("a suspect check is not all well", () => {
    const told = words.state(status({last_check: Object.assign({}, well, {verdict: "suspect"})}), 5, "printing");
    assert.strictEqual(told.level, "warning");
    assert.doesNotMatch(told.text, /all well/);
});

test("ages are told in the unit that people would use", () => {
    assert.strictEqual(words.duration(59.4), "59 s");
    assert.strictEqual(words.duration(60), "1 min");
    assert.strictEqual(words.duration(3600 * 2 + 60 * 5 + 7), "2 h 5 min");
    assert.strictEqual(words.duration(-3), "0 s");
});

test("a trouble begins with the first check of its unbroken run", () => {
    const checks = ["ok", "suspect", "ok", "suspect", "unusable", "failed"].map((verdict, layer) => ({verdict, layer}));
    assert.strictEqual(words.sinceLayer(checks, 5), 3);
});

test("a failure names what, where, since when, how much, and what was done", () => {
    const told = words.failure(
        Object.assign({}, failed, {objects: [{name: "hook", verdict: "failed"}, {name: "gear", verdict: "ok"}]}), 70, "pause"
    );
    assert.deepStrictEqual(told, {
        title: "Detached from the bed at layer 73",
        sentence: "The hook is gone.",
        details: "object: hook · since layer 71 · E is 13 %, the limit 2.0 %",
        done: "The print was paused."
    });
});

test("an object that the sentence names is not named twice", () => {
    const told = words.failure(
        Object.assign({}, failed, {reason: "hook: it is gone.", objects: [{name: "hook", verdict: "failed"}]}), 72, "pause"
    );
    assert.doesNotMatch(told.details, /hook/);
});

test("a refusal is told in the server's own words where it sent some", () => {
    assert.strictEqual(words.refusal({status: 409, responseText: '{"code": "frame", "message": "It is dark."}'}), "It is dark.");
    assert.match(words.refusal({status: 403, responseText: "<html>"}), /permission/);
    assert.match(words.refusal({status: 0}), /does not answer/);
});

test("a recording's name tells when the print began", () => {
    assert.strictEqual(words.recordingTime("20261122-031502-tug"), "2026-11-22 03:15");
    assert.strictEqual(words.recordingTime("tug"), "");
});

test("a replay is told beside what happened", () => {
    const live = [{layer: 3, verdict: "ok"}, {layer: 4, verdict: "failed"}];
    assert.strictEqual(
        words.replayed(live, {first_failed_layer: null, checks: 2}),
        "With these settings: no failure in 2 checks. During the print: a failure at layer 5."
    );
});

test("how far a big file has been read is told while it is", () => {
    const told = words.state(status({watching: false, blind: "The G-code is being read.", reading: 0.42, last_check: null}), 0, "printing");
    assert.match(told.text, /being read\. · 42 % read/);
});

test("what looking costs is told by print and by look, once there is something to tell", () => {
    assert.strictEqual(words.timeAdded({checks: 0, held_s: 0}), "");
    assert.strictEqual(words.timeAdded({checks: 40, held_s: 60}), "Looking has added 1 min to this print so far: 1.5 s a look.");
});

test("a check's line says what it took", () => {
    assert.strictEqual(words.checkLine({layer: 4, E: 0.004, verdict: "ok", held_s: 0.84}), "Layer 5 · E 0.4 % · all well · took 0.8 s");
});

test("measuring the bed's motion says beforehand what will move, from where to where", () => {
    const plan = {from_mm: {x: 1, y: 20, z: 10}, to_mm: {x: 1, y: 80.04, z: 40}};
    assert.match(words.bedMotionPlan(plan), /Z moves from 10 to 40 mm, Y from 20 to 80 mm.*move back.*Nothing is heated/);
});
