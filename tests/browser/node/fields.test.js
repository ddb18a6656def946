"use strict";
const assert = require("node:assert");
const test = require("node:test");
const {parse} = require("../../../octoprint_moop/static/js/moop_fields.js");

const seconds = {default: 0.3, low: 0, high: 10, unit: "s"};

test("a number in range is taken, with a decimal comma too", () => {
    assert.deepStrictEqual(parse(" 0,5 ", seconds), {value: 0.5});
    assert.deepStrictEqual(parse("10", seconds), {value: 10});
    assert.deepStrictEqual(parse(0, seconds), {value: 0});
});

test("what is no number, or out of range, is told and not taken", () => {
    for (const typed of ["", "  ", "soon", "1e999", "11", "-1", null, undefined]) {
        const found = parse(typed, seconds);
        assert.ok(found.error && !("value" in found), String(typed));
    }
});

test("layers come whole", () => {
    const layers = {default: 1, low: 1, high: 1000, unit: "layers", whole: true};
    assert.ok(parse("1.5", layers).error);
    assert.deepStrictEqual(parse("2", layers), {value: 2});
});

test("text and choices are taken as they are", () => {
    assert.deepStrictEqual(parse("pause", {default: "pause"}), {value: "pause"});
    assert.deepStrictEqual(parse(false, {default: true}), {value: false});
});
