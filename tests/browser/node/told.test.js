"use strict";
const assert = require("node:assert");
const test = require("node:test");
const told = require("../../../octoprint_moop/static/js/moop_told.js");

/* Marks what was looked up, so that a test sees which sentences and values were known. */
const marked = (text) => "[" + text + "]";
const backwards = (text) => ({
    "The print has come off: it lies about %(distance)s from its place.": "Off by %(distance)s.",
    "%(size)s mm to the %(side)s and the %(other_side)s": "%(other_side)s and %(side)s, %(size)s",
    left: "L", front: "F"
}[text] || text);

test("values go where the translation wants them, and are translated themselves", () => {
    assert.strictEqual(
        told.retell("The print has come off: it lies about 6 mm to the left and the front from its place.", backwards),
        "Off by F and L, 6."
    );
});

test("an object's name stays before what is said of it", () => {
    assert.strictEqual(told.retell("hook 2.stl: The print has come off.", marked), "hook 2.stl: [The print has come off.]");
});

test("each sentence is told by itself, and several that belong together as one", () => {
    assert.strictEqual(
        told.retell("The print is gone from its place. No second picture confirms it. The picture is white throughout. Lower the camera's exposure.", marked),
        "[The print is gone from its place.] [No second picture confirms it.] [The picture is white throughout. Lower the camera's exposure.]"
    );
});

test("a value at the end of a sentence does not take in the next one", () => {
    assert.strictEqual(
        told.retell("Everything above layer 3 is shifted by about 2 mm to the left. No second picture confirms it.", marked),
        "[Everything above layer 3 is shifted by about [2 mm to the [left]].] [No second picture confirms it.]"
    );
    assert.strictEqual(
        told.retell("This print is not recorded any more: the disk is almost full. Make room, and the next print is recorded again.", marked),
        "[This print is not recorded any more: [the disk is almost full].] [Make room, and the next print is recorded again.]"
    );
});

test("what is not known stays as the server says it, and what is known beside it is told", () => {
    assert.strictEqual(told.retell("A new thing: it broke (why? no idea).", marked), "A new thing: it broke (why? no idea).");
    assert.strictEqual(told.retell("Something else happened. It is being started again.", marked), "Something else happened. [It is being started again.]");
    assert.strictEqual(told.retell("", marked), "");
    assert.strictEqual(told.retell(null, marked), "");
});

test("in English every sentence comes out as it went in", () => {
    told.sentences.forEach((sentence) => {
        const said = sentence.replace(/%\(\w+\)s/g, "12");
        assert.strictEqual(told.retell("bracket: " + said, (text) => text), "bracket: " + said);
    });
});
