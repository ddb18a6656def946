"use strict";
const assert = require("node:assert");
const test = require("node:test");
const overlay = require("../../../octoprint_moop/static/js/moop_overlay.js");

const expected = Uint8Array.from([255, 255, 0, 0, 255]);
const seen = Uint8Array.from([255, 0, 255, 0, 0]);
const ignored = Uint8Array.from([0, 0, 0, 0, 255]);

test("each pixel is matched, missing, extra or nothing, and what is ignored is neither", () => {
    const classes = overlay.classify(expected, seen, ignored, "difference");
    assert.deepStrictEqual(Array.from(classes), [overlay.MATCHED, overlay.MISSING, overlay.EXTRA, overlay.NONE, overlay.IGNORED]);
    assert.deepStrictEqual(overlay.counts(classes), {matched: 1, missing: 1, extra: 1, ignored: 1});
});

test("the other views show one mask only", () => {
    assert.deepStrictEqual(Array.from(overlay.classify(expected, seen, null, "seen")), [1, 0, 1, 0, 0]);
    assert.deepStrictEqual(Array.from(overlay.classify(expected, seen, null, "expected")), [1, 1, 0, 0, 1]);
});

test("the patterns differ even when all colour is taken away", () => {
    const side = 64;
    const inkOf = (kind) => {
        const rgba = overlay.paint(new Uint8Array(side * side).fill(kind), side, side);
        return Array.from({length: side * side}, (_, i) => rgba[4 * i + 3] > 200);
    };
    const kinds = [overlay.MATCHED, overlay.MISSING, overlay.EXTRA, overlay.IGNORED].map(inkOf);
    for (let a = 0; a < kinds.length; a++) {
        for (let b = a + 1; b < kinds.length; b++) {
            const differ = kinds[a].filter((ink, i) => ink !== kinds[b][i]).length;
            assert.ok(differ > 0.03 * side * side, `${a} and ${b} look alike`);
        }
    }
});

test("where nothing is, the picture shows through", () => {
    const rgba = overlay.paint(new Uint8Array(16), 4, 4);
    assert.ok(rgba.every((value) => value === 0));
});

test("the box of the trouble is round the missing part and not stretched by thin edges", () => {
    const width = 240;
    const height = 180;
    const classes = new Uint8Array(width * height);
    for (let x = 0; x < width; x++) {
        classes[10 * width + x] = overlay.EXTRA; // one pixel off, right across the picture
    }
    for (let y = 100; y < 120; y++) {
        classes.fill(overlay.MISSING, y * width + 60, y * width + 90);
    }
    const box = overlay.differenceBox(classes, width, height);
    assert.ok(box.x <= 60 && box.x >= 52 && box.y <= 100 && box.y >= 92, JSON.stringify(box));
    assert.ok(box.x + box.width >= 90 && box.x + box.width <= 98);
    assert.strictEqual(overlay.differenceBox(new Uint8Array(48), 8, 6), null);
});

test("a zoom never leaves the picture", () => {
    assert.deepStrictEqual(overlay.visiblePart(640, 480, 2, 0, 0), {x: 0, y: 0, width: 320, height: 240});
    assert.deepStrictEqual(overlay.visiblePart(640, 480, 4, 640, 480), {x: 480, y: 360, width: 160, height: 120});
});
