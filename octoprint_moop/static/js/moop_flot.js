/* How the plot of E by layer looks in flot: told apart by line and symbol, in the page's own colour. */
(function (root) {
    // Symbols as flot calls them: shapes that differ without any colour.
    const SYMBOLS = {
        suspect: function (context, x, y, radius) {
            context.moveTo(x, y - radius);
            context.lineTo(x + radius, y + radius);
            context.lineTo(x - radius, y + radius);
            context.closePath();
        },
        failed: function (context, x, y, radius) {
            const r = radius * 1.2;
            context.moveTo(x - r, y - r);
            context.lineTo(x + r, y + r);
            context.moveTo(x - r, y + r);
            context.lineTo(x + r, y - r);
        },
        unusable: function (context, x, y, radius) {
            context.arc(x, y - radius, radius, 0, 2 * Math.PI);
        },
        camera_moved: function (context, x, y, radius) {
            context.rect(x - radius, y - radius, 2 * radius, 2 * radius);
        }
    };
    const COLOURS = {suspect: "#e69f00", failed: "#d55e00", unusable: "#999999", camera_moved: "#56b4e9"};

    function names(say) {
        return {
            suspect: say("suspect"),
            failed: say("failed"),
            unusable: say("picture unusable"),
            camera_moved: say("camera moved")
        };
    }

    function series(points, colour) {
        const say = root.MOOP.words.say;
        const labels = names(say);
        const drawn = [
            {
                label: say("usual"),
                data: points.baseline,
                color: colour,
                lines: {show: true, lineWidth: 1},
                shadowSize: 0
            },
            {
                label: say("limit"),
                data: points.limit,
                color: colour,
                dashes: {show: true, lineWidth: 1, dashLength: [6, 4]},
                lines: {show: false},
                shadowSize: 0
            },
            {label: "E", data: points.error, color: "#2a8fd0", lines: {show: true, lineWidth: 2}, shadowSize: 0}
        ];
        Object.keys(points.events).forEach(function (name) {
            if (points.events[name].length) {
                drawn.push({
                    label: labels[name],
                    data: points.events[name],
                    color: COLOURS[name],
                    points: {show: true, radius: 5, lineWidth: 2, fill: false, symbol: SYMBOLS[name]},
                    lines: {show: false},
                    shadowSize: 0
                });
            }
        });
        return drawn;
    }

    /* selected: the check whose picture is shown, or null; a line marks its layer. */
    function options(points, colour, selected) {
        const marks = selected
            ? [{xaxis: {from: selected.layer + 1, to: selected.layer + 1}, color: colour, lineWidth: 1}]
            : [];
        return {
            grid: {
                clickable: true,
                borderWidth: {top: 0, right: 0, bottom: 1, left: 1},
                borderColor: colour,
                color: colour,
                backgroundColor: null,
                markings: marks
            },
            xaxis: {minTickSize: 1, tickDecimals: 0, color: colour, tickColor: "rgba(128,128,128,0.2)"},
            yaxis: {
                min: 0,
                max: root.MOOP.series.plotTop(points),
                color: colour,
                tickColor: "rgba(128,128,128,0.2)",
                tickFormatter: function (value, axis) { return value.toFixed(axis.tickDecimals) + " %"; }
            },
            legend: {show: false}
        };
    }

    root.MOOP = Object.assign(root.MOOP || {}, {flot: {series: series, options: options}});
})(window);
