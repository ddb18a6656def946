/* A number as somebody types it, and whether a setting may have it. Pure. */
(function (root) {
    function say(text, values) {
        return root.MOOP && root.MOOP.words ? root.MOOP.words.say(text, values) : text;
    }

    /*
     * {value} or {error} for what stands in a field. limits: {default, low, high, unit}, low and high missing for text.
     * A decimal comma is as good as a point.
     */
    function parse(typed, limits) {
        if (limits.low === undefined) {
            return {value: typed};
        }
        const text = String(typed === null || typed === undefined ? "" : typed).trim().replace(",", ".");
        const value = Number(text);
        const values = {low: limits.low, high: limits.high, unit: limits.unit ? say(limits.unit) : ""};
        if (text === "" || !isFinite(value)) {
            return {error: say("A number is needed here, from %(low)s to %(high)s %(unit)s", values).trim()};
        }
        if (value < limits.low || value > limits.high) {
            return {error: say("%(low)s to %(high)s %(unit)s is allowed", values).replace("  ", " ")};
        }
        if (limits.whole && value !== Math.round(value)) {
            return {error: say("A whole number is needed here")};
        }
        return {value: value};
    }

    const fields = {parse: parse};
    root.MOOP = Object.assign(root.MOOP || {}, {fields: fields});
    if (typeof module === "object" && module.exports) {
        module.exports = fields;
    }
})(typeof window === "object" ? window : globalThis);
