/*
 * Masks over a picture: which pixel is matched, missing or extra, and how it is painted. Pure: typed arrays in, typed
 * arrays out. Each class has a pattern of its own, so that nobody has to tell them apart by colour.
 */
(function (root) {
    const NONE = 0;
    const MATCHED = 1;
    const MISSING = 2;
    const EXTRA = 3;
    const IGNORED = 4;

    // Okabe and Ito's palette, made to be told apart by colour-blind eyes. These lie on a photograph, not on the page.
    const COLOURS = [null, [0, 158, 115], [230, 159, 0], [204, 121, 167], [170, 170, 170]];

    function period(width) {
        return Math.max(6, Math.round(width / 64));
    }

    // Where a pattern has ink; x and y in pixels of the picture, p the period.
    const PATTERNS = [
        function () { return false; },
        function () { return false; }, // matched: outline and a light tint alone
        function (x, y, p) { return (x + y) % p < Math.max(2, p / 3); }, // missing: ////
        function (x, y, p) { // extra: cross-hatched
            const w = Math.max(1, p / 5);
            return (x + y) % p < w || (((x - y) % p) + p) % p < w;
        },
        function (x, y, p) { return x % p < 2 && y % p < 2; } // ignored: dots
    ];
    const TINTS = [0, 0.18, 0.3, 0.3, 0.12];

    /*
     * Uint8Array of classes from masks (Uint8Array, 0 or more; ignored may be null).
     * show: "difference", "seen" or "expected".
     */
    function classify(expected, seen, ignored, show) {
        const classes = new Uint8Array(expected.length);
        for (let i = 0; i < classes.length; i++) {
            if (ignored && ignored[i]) {
                classes[i] = IGNORED;
            } else if (show === "seen") {
                classes[i] = seen[i] ? MATCHED : NONE;
            } else if (show === "expected") {
                classes[i] = expected[i] ? MATCHED : NONE;
            } else if (expected[i]) {
                classes[i] = seen[i] ? MATCHED : MISSING;
            } else {
                classes[i] = seen[i] ? EXTRA : NONE;
            }
        }
        return classes;
    }

    function counts(classes) {
        const total = [0, 0, 0, 0, 0];
        for (let i = 0; i < classes.length; i++) {
            total[classes[i]]++;
        }
        return {matched: total[MATCHED], missing: total[MISSING], extra: total[EXTRA], ignored: total[IGNORED]};
    }

    function onEdge(classes, width, height, x, y) {
        const i = y * width + x;
        const own = classes[i];
        return (
            x === 0 || y === 0 || x === width - 1 || y === height - 1 ||
            classes[i - 1] !== own || classes[i + 1] !== own ||
            classes[i - width] !== own || classes[i + width] !== own
        );
    }

    /* Uint8ClampedArray RGBA for classes: tint, pattern, outline; transparent where nothing is. */
    function paint(classes, width, height) {
        const rgba = new Uint8ClampedArray(4 * width * height);
        const p = period(width);
        for (let y = 0; y < height; y++) {
            for (let x = 0; x < width; x++) {
                const own = classes[y * width + x];
                if (own === NONE) {
                    continue;
                }
                const inked = PATTERNS[own](x, y, p) || (own !== IGNORED && onEdge(classes, width, height, x, y));
                const at = 4 * (y * width + x);
                rgba[at] = COLOURS[own][0];
                rgba[at + 1] = COLOURS[own][1];
                rgba[at + 2] = COLOURS[own][2];
                rgba[at + 3] = 255 * (inked ? 0.95 : TINTS[own]);
            }
        }
        return rgba;
    }

    /*
     * The rectangle round the thickest trouble, {x, y, width, height}, or null where all matches. A calibrated camera is
     * still a pixel off along every edge, so cells with few wrong pixels do not stretch it.
     */
    function differenceBox(classes, width, height) {
        const size = Math.max(4, Math.round(width / 60));
        const columns = Math.ceil(width / size);
        const wrong = new Uint32Array(columns * Math.ceil(height / size));
        for (let i = 0; i < classes.length; i++) {
            if (classes[i] === MISSING || classes[i] === EXTRA) {
                const x = i % width;
                wrong[Math.floor((i - x) / width / size) * columns + Math.floor(x / size)]++;
            }
        }
        let peak = 0;
        wrong.forEach(function (count, cell) { peak = count > wrong[peak] ? cell : peak; });
        if (!wrong[peak]) {
            return null;
        }
        const box = {left: Infinity, right: -1, top: Infinity, bottom: -1};
        const waiting = [peak];
        const seen = new Set(waiting);
        while (waiting.length) {
            const cell = waiting.pop();
            const x = cell % columns;
            const y = Math.floor(cell / columns);
            box.left = Math.min(box.left, x);
            box.right = Math.max(box.right, x);
            box.top = Math.min(box.top, y);
            box.bottom = Math.max(box.bottom, y);
            [[x - 1, y], [x + 1, y], [x, y - 1], [x, y + 1]].forEach(function (next) {
                const other = next[1] * columns + next[0];
                if (next[0] >= 0 && next[0] < columns && wrong[other] > wrong[peak] / 4 && !seen.has(other)) {
                    seen.add(other);
                    waiting.push(other);
                }
            });
        }
        return {
            x: box.left * size,
            y: box.top * size,
            width: Math.min(width, (box.right + 1) * size) - box.left * size,
            height: Math.min(height, (box.bottom + 1) * size) - box.top * size
        };
    }

    /*
     * The part of a picture that a zoom shows: {x, y, width, height} in its pixels, zoom >= 1, kept inside the picture.
     * cx, cy: the wanted centre.
     */
    function visiblePart(width, height, zoom, cx, cy) {
        const w = width / zoom;
        const h = height / zoom;
        return {
            x: Math.min(Math.max(cx - w / 2, 0), width - w),
            y: Math.min(Math.max(cy - h / 2, 0), height - h),
            width: w,
            height: h
        };
    }

    const overlay = {
        NONE: NONE,
        MATCHED: MATCHED,
        MISSING: MISSING,
        EXTRA: EXTRA,
        IGNORED: IGNORED,
        classify: classify,
        counts: counts,
        paint: paint,
        differenceBox: differenceBox,
        visiblePart: visiblePart
    };

    root.MOOP = Object.assign(root.MOOP || {}, {overlay: overlay});
    if (typeof module === "object" && module.exports) {
        module.exports = overlay;
    }
})(typeof window === "object" ? window : globalThis);
