/* Colours as the filament's thresholds see them: hue 0..360, saturation and value 0..1 (Smith's hexcone). Pure. */
(function (root) {
    function rgbToHsv(r, g, b) {
        const high = Math.max(r, g, b);
        const chroma = high - Math.min(r, g, b);
        let hue = 0;
        if (chroma > 0) {
            if (high === r) {
                hue = 60 * ((g - b) / chroma);
            } else if (high === g) {
                hue = 60 * ((b - r) / chroma) + 120;
            } else {
                hue = 60 * ((r - g) / chroma) + 240;
            }
        }
        return {h: (hue + 360) % 360, s: high === 0 ? 0 : chroma / high, v: high / 255};
    }

    /* How far it is from one hue to another, going up through 360. */
    function hueSpan(from, to) {
        return from === 0 && to === 360 ? 360 : (to - from + 360) % 360;
    }

    function inBand(hue, min, max) {
        return min <= max ? hue >= min && hue <= max : hue >= min || hue <= max;
    }

    function quantile(sorted, q) {
        return sorted[Math.min(sorted.length - 1, Math.floor(q * sorted.length))];
    }

    function ascending(a, b) {
        return a - b;
    }

    /*
     * Thresholds from the pixels round a click on filament, RGBA bytes: the hues that occur there with a margin, and
     * well below the saturation and value that occur, since other parts of the print lie in shade.
     * {hue_deg: [min, max], saturation_min, value_min}
     */
    function thresholdsFrom(rgba) {
        const hues = [];
        const saturations = [];
        const values = [];
        let x = 0;
        let y = 0;
        for (let i = 0; i < rgba.length; i += 4) {
            const colour = rgbToHsv(rgba[i], rgba[i + 1], rgba[i + 2]);
            // a grey pixel's hue means nothing: each counts by its saturation
            x += colour.s * Math.cos(colour.h * Math.PI / 180);
            y += colour.s * Math.sin(colour.h * Math.PI / 180);
            hues.push(colour.h);
            saturations.push(colour.s);
            values.push(colour.v);
        }
        const middle = (Math.atan2(y, x) * 180 / Math.PI + 360) % 360;
        const offsets = hues.map(function (hue) { return Math.abs((hue - middle + 540) % 360 - 180); }).sort(ascending);
        const reach = Math.min(60, Math.max(12, 1.5 * quantile(offsets, 0.9) + 6));
        return {
            hue_deg: [Math.round(middle - reach + 360) % 360, Math.round(middle + reach) % 360],
            saturation_min: Math.round(60 * quantile(saturations.sort(ascending), 0.2)) / 100,
            value_min: Math.round(50 * quantile(values.sort(ascending), 0.2)) / 100
        };
    }

    const hue = {rgbToHsv: rgbToHsv, hueSpan: hueSpan, inBand: inBand, thresholdsFrom: thresholdsFrom};
    root.MOOP = Object.assign(root.MOOP || {}, {hue: hue});
    if (typeof module === "object" && module.exports) {
        module.exports = hue;
    }
})(typeof window === "object" ? window : globalThis);
