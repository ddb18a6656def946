/* The plot of E by layer: what flot draws, from checks. Pure. */
(function (root) {
    const EVENTS = ["suspect", "failed", "unusable", "camera_moved"];

    function median(values) {
        if (!values.length) {
            return null;
        }
        const sorted = values.slice().sort(function (a, b) { return a - b; });
        const middle = sorted.length >> 1;
        return sorted.length % 2 ? sorted[middle] : (sorted[middle - 1] + sorted[middle]) / 2;
    }

    function measured(check) {
        return check.verdict !== "unusable" && check.E !== null && check.E !== undefined;
    }

    /*
     * {error, limit, baseline, events}: lists of [layer number, per cent]; events by verdict, with the check's place in
     * the list as third entry. A gap (null) stands where a picture was unusable: a line across it would invent a value.
     */
    function plotSeries(checks) {
        const series = {error: [], limit: [], baseline: [], events: {}};
        EVENTS.forEach(function (name) { series.events[name] = []; });
        const calm = [];
        checks.forEach(function (check, index) {
            const layer = check.layer + 1;
            const value = measured(check) ? 100 * check.E : null;
            series.error.push(value === null ? null : [layer, value]);
            if (check.limit !== null && check.limit !== undefined) {
                series.limit.push([layer, 100 * check.limit]);
            }
            if (check.verdict === "ok" && value !== null) {
                calm.push(value);
            }
            if (series.events[check.verdict]) {
                series.events[check.verdict].push([layer, value === null ? 0 : value, index]);
            }
        });
        const usual = median(calm);
        if (usual !== null && checks.length > 1) {
            series.baseline = [[checks[0].layer + 1, usual], [checks[checks.length - 1].layer + 1, usual]];
        }
        return series;
    }

    /* The top of the plot, in per cent: room for every value and for the limit. */
    function plotTop(series) {
        const values = series.error.filter(Boolean).map(function (point) { return point[1]; });
        const limits = series.limit.map(function (point) { return point[1]; });
        const top = Math.max.apply(null, values.concat(limits, [1]));
        return 1.15 * top;
    }

    /* Place in the list of the check nearest to a layer number, or -1 where there is none. */
    function nearest(checks, layer) {
        let best = -1;
        checks.forEach(function (check, index) {
            const distance = Math.abs(check.layer + 1 - layer);
            if (best < 0 || distance <= Math.abs(checks[best].layer + 1 - layer)) {
                best = index;
            }
        });
        return best;
    }

    const series = {plotSeries: plotSeries, plotTop: plotTop, nearest: nearest};
    root.MOOP = Object.assign(root.MOOP || {}, {series: series});
    if (typeof module === "object" && module.exports) {
        module.exports = series;
    }
})(typeof window === "object" ? window : globalThis);
