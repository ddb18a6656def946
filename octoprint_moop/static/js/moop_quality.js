/* Whether a camera's picture is good enough to measure in: brightness, contrast, sharpness. Pure. */
(function (root) {
    function say(text, values) {
        return root.MOOP && root.MOOP.words ? root.MOOP.words.say(text, values) : text;
    }

    /* Grey values 0..255 of RGBA bytes, by the usual weights of the eye. */
    function grey(rgba) {
        const values = new Float32Array(rgba.length / 4);
        for (let i = 0; i < values.length; i++) {
            values[i] = 0.299 * rgba[4 * i] + 0.587 * rgba[4 * i + 1] + 0.114 * rgba[4 * i + 2];
        }
        return values;
    }

    /*
     * {brightness (mean, 0..1), dark and bright (share of pixels that are black or burnt out), sharpness}.
     * sharpness: the steepest edges (99.5th percentile of the step between neighbours) over the picture's contrast
     * (5th to 95th percentile); independent of light, and small where every edge is smeared over many pixels. At 640 pixels across, sharp webcam frames (photographed and
     * rendered) had 0.24 to 0.78; blurred by 4 pixels they had 0.07 to 0.18.
     */
    function measure(rgba, width, height) {
        const values = grey(rgba);
        const steps = [];
        let sum = 0;
        let dark = 0;
        let bright = 0;
        for (let y = 0; y < height; y++) {
            for (let x = 0; x < width; x++) {
                const value = values[y * width + x];
                sum += value;
                dark += value < 8 ? 1 : 0;
                bright += value > 247 ? 1 : 0;
                if (x + 1 < width && y + 1 < height) {
                    const right = values[y * width + x + 1] - value;
                    const down = values[(y + 1) * width + x] - value;
                    steps.push(Math.sqrt(right * right + down * down));
                }
            }
        }
        const sorted = Float32Array.from(values).sort();
        const stepsSorted = Float32Array.from(steps).sort();
        const at = function (list, q) { return list[Math.min(list.length - 1, Math.floor(q * list.length))]; };
        const contrast = at(sorted, 0.95) - at(sorted, 0.05);
        return {
            brightness: sum / values.length / 255,
            dark: dark / values.length,
            bright: bright / values.length,
            sharpness: contrast < 4 ? 0 : at(stepsSorted, 0.995) / contrast
        };
    }

    /* What to tell of a measured picture: [{ok, text}, …]. */
    function judge(found) {
        const verdicts = [];
        if (found.brightness < 0.12 || found.dark > 0.5) {
            verdicts.push({ok: false, text: say("It is too dark: switch on a lamp, or raise the exposure.")});
        } else if (found.brightness > 0.85 || found.bright > 0.2) {
            verdicts.push({ok: false, text: say("Much of it is burnt out: lower the exposure, or turn the lamp away.")});
        } else {
            verdicts.push({ok: true, text: say("It is bright enough.")});
        }
        verdicts.push(found.sharpness < 0.16
            ? {ok: false, text: say("It is not sharp: turn the lens until edges are crisp, and clean it.")}
            : {ok: true, text: say("It is sharp.")});
        return verdicts;
    }

    const quality = {measure: measure, judge: judge};
    root.MOOP = Object.assign(root.MOOP || {}, {quality: quality});
    if (typeof module === "object" && module.exports) {
        module.exports = quality;
    }
})(typeof window === "object" ? window : globalThis);
