"use strict";
const assert = require("node:assert");
const test = require("node:test");
const coverage = require("../../../octoprint_moop/static/js/moop_coverage.js");

const SIZE = [640, 480];
const board = (x, y) => [[x, y], [x + 80, y], [x, y + 60], [x + 80, y + 60]];

test("only the cells in which a corner was seen count as covered", () => {
    assert.strictEqual(coverage.share([board(1, 1)], SIZE), 2 / 48);
    assert.deepStrictEqual(coverage.cells([board(1, 1)], SIZE, 2, 1).counts, [4, 0]);
    assert.strictEqual(coverage.share([[[-5, 3], [900, 2]]], SIZE), 0);
});

test("what was never seen is named as people would", () => {
    const left = coverage.missing([board(10, 10), board(10, 200), board(10, 380)], SIZE);
    assert.ok(!left.includes("upper left") && left.includes("lower right") && left.length === 6);
});

test("a board that moves is not taken, one that is held still is", () => {
    assert.strictEqual(coverage.judge(board(100, 100), null, [], SIZE).take, false);
    assert.strictEqual(coverage.judge(board(100, 100), board(160, 100), [], SIZE).take, false);
    assert.strictEqual(coverage.judge(board(100, 100), board(102, 101), [], SIZE).take, true);
});

test("a view like one that is there already teaches nothing, and it is said where to go instead", () => {
    const told = coverage.judge(board(100, 100), board(100, 100), [board(105, 100)], SIZE);
    assert.strictEqual(told.take, false);
    assert.match(told.text, /like this already/);
});

test("no board, no picture", () => {
    assert.match(coverage.judge(null, null, [], SIZE).text, /not seen/);
});
