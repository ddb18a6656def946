"use strict";
const assert = require("node:assert");
const test = require("node:test");
const hue = require("../../../octoprint_moop/static/js/moop_hue.js");

const patch = (pixels) => Uint8ClampedArray.from(pixels.flatMap((rgb) => [...rgb, 255]));
// the paper's equation 12, with the strict > that the server uses
const taken = (found, [r, g, b]) => {
    const {h, s, v} = hue.rgbToHsv(r, g, b);
    return hue.inBand(h, ...found.hue_deg) && s > found.saturation_min && v > found.value_min;
};

test("hue, saturation and value of the corners of the colour cube", () => {
    assert.deepStrictEqual(hue.rgbToHsv(255, 0, 0), {h: 0, s: 1, v: 1});
    assert.deepStrictEqual(hue.rgbToHsv(0, 255, 0), {h: 120, s: 1, v: 1});
    assert.deepStrictEqual(hue.rgbToHsv(0, 0, 255), {h: 240, s: 1, v: 1});
    assert.strictEqual(hue.rgbToHsv(255, 0, 255).h, 300);
    assert.deepStrictEqual(hue.rgbToHsv(0, 0, 0), {h: 0, s: 0, v: 0});
});

test("a click on filament takes that filament, in light and in half shade", () => {
    const light = [[40, 90, 220], [44, 95, 226], [38, 88, 214], [42, 92, 222]];
    const found = hue.thresholdsFrom(patch(light));
    light.forEach((rgb) => assert.ok(taken(found, rgb)));
    assert.ok(taken(found, [26, 58, 140]));
    assert.ok(!taken(found, [120, 122, 125]));
    assert.ok(!taken(found, [220, 90, 40]));
});

test("red filament gives limits that wrap through nought", () => {
    const found = hue.thresholdsFrom(patch([[220, 20, 30], [220, 30, 20], [210, 22, 25]]));
    assert.ok(found.hue_deg[0] > found.hue_deg[1]);
    assert.ok(taken(found, [200, 20, 26]) && taken(found, [200, 26, 20]) && !taken(found, [20, 200, 20]));
});

test("a band knows its length on the ring", () => {
    assert.strictEqual(hue.hueSpan(350, 10), 20);
    assert.strictEqual(hue.hueSpan(10, 350), 340);
    assert.strictEqual(hue.hueSpan(0, 360), 360);
});
