/* Which parts of the picture a checkerboard has been seen in, and whether another view of it would teach anything. Pure. */
(function (root) {
    const COLUMNS = 8;
    const ROWS = 6;
    const STEADY = 0.012; // of the picture's width: a hand's tremble
    const ALIKE = 0.03;

    /* Marks words for the translators; they are translated where they are said. */
    function N_(text) {
        return text;
    }

    const NAMES = [
        [N_("upper left"), N_("upper middle"), N_("upper right")],
        [N_("left"), N_("middle"), N_("right")],
        [N_("lower left"), N_("lower middle"), N_("lower right")]
    ];

    function say(text, values) {
        return root.MOOP && root.MOOP.words ? root.MOOP.words.say(text, values) : text;
    }

    /* How often a corner was seen in each cell of a grid laid over the picture, row by row: {columns, rows, counts}. */
    function cells(views, size, columns, rows) {
        const across = columns || COLUMNS;
        const down = rows || ROWS;
        const counts = new Array(across * down).fill(0);
        views.forEach(function (corners) {
            corners.forEach(function (corner) {
                const x = Math.floor(corner[0] / size[0] * across);
                const y = Math.floor(corner[1] / size[1] * down);
                if (x >= 0 && x < across && y >= 0 && y < down) {
                    counts[y * across + x] += 1;
                }
            });
        });
        return {columns: across, rows: down, counts: counts};
    }

    /* The share of the picture in which the board was seen, 0..1. */
    function share(views, size) {
        const counts = cells(views, size).counts;
        return counts.filter(Boolean).length / counts.length;
    }

    /* Names of the ninths of the picture in which it never was. */
    function missing(views, size) {
        const counts = cells(views, size, 3, 3).counts;
        return [].concat.apply([], NAMES).filter(function (_name, place) { return !counts[place]; }).map(function (name) { return say(name); });
    }

    /* How far the corners of two views are apart on average, in pixels. */
    function distance(a, b) {
        return a.reduce(function (sum, corner, place) {
            return sum + Math.hypot(corner[0] - b[place][0], corner[1] - b[place][1]);
        }, 0) / a.length;
    }

    /*
     * Whether this view (corners, or null) is worth a picture: {take, text}. before: the view a moment ago, or null;
     * views: those taken so far.
     */
    function judge(corners, before, views, size) {
        if (!corners) {
            return {take: false, text: say("The whole board is not seen. Bring it into the picture, out of the glare.")};
        }
        if (!before || before.length !== corners.length || distance(corners, before) > STEADY * size[0]) {
            return {take: false, text: say("The board is seen. Hold it still …")};
        }
        const alike = views.some(function (view) {
            return view.length === corners.length && distance(corners, view) < ALIKE * size[0];
        });
        if (alike) {
            const empty = missing(views, size);
            return {
                take: false,
                text: empty.length
                    ? say("There is a picture like this already. Bring it to the %(where)s, or tilt it another way.", {where: empty[0]})
                    : say("There is a picture like this already. Tilt it another way.")
            };
        }
        return {take: true, text: say("Good: taken.")};
    }

    const coverage = {cells: cells, share: share, missing: missing, judge: judge};
    root.MOOP = Object.assign(root.MOOP || {}, {coverage: coverage});
    if (typeof module === "object" && module.exports) {
        module.exports = coverage;
    }
})(typeof window === "object" ? window : globalThis);
