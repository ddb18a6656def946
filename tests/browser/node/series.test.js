"use strict";
const assert = require("node:assert");
const test = require("node:test");
const series = require("../../../octoprint_moop/static/js/moop_series.js");

const check = (layer, E, verdict, limit) => ({layer, E, verdict, limit});
const checks = [
    check(0, 0.01, "ok", 0.03), check(1, 0.02, "ok", 0.03), check(2, 0, "unusable", 0.03),
    check(3, 0.03, "ok", 0.03), check(4, 0.2, "failed", 0.03)
];

test("layers are counted from one and E is in per cent", () => {
    const [first] = series.plotSeries(checks).error;
    assert.deepStrictEqual(first, [1, 1]);
});

test("an unusable picture leaves a gap and not a value of nought", () => {
    assert.strictEqual(series.plotSeries(checks).error[2], null);
    assert.deepStrictEqual(series.plotSeries(checks).events.unusable, [[3, 0, 2]]);
});

test("the usual error is the median of the checks that were well", () => {
    assert.deepStrictEqual(series.plotSeries(checks).baseline, [[1, 2], [5, 2]]);
});

test("the limit is in view even when every check is far below it", () => {
    const far = [check(0, 0.001, "ok", 0.3)];
    assert.ok(series.plotTop(series.plotSeries(far)) >= 30);
});

test("no checks make an empty plot", () => {
    assert.deepStrictEqual(series.plotSeries([]).error, []);
    assert.ok(series.plotTop(series.plotSeries([])) > 0);
    assert.strictEqual(series.nearest([], 3), -1);
});

test("a click opens the nearest layer, and the newest check of it", () => {
    assert.strictEqual(series.nearest(checks, 4.4), 3);
    assert.strictEqual(series.nearest([check(0), check(4), check(4)], 9), 2);
});
