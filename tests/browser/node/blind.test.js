"use strict";
const assert = require("node:assert");
const test = require("node:test");
const blind = require("../../../octoprint_moop/static/js/moop_blind.js");

test("every code has a sentence, a button's words and something that the button does", () => {
    for (const code of blind.codes) {
        const mend = blind.mend(code);
        assert.ok(/[.!]$/.test(mend.advice) && mend.button && /^[a-z]+(:\w+)?$/.test(mend.does), code);
    }
});

test("a code that nobody has heard of can still be tried again", () => {
    assert.strictEqual(blind.mend("brand_new").does, "watch");
});
