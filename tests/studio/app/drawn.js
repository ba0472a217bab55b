// What each picture of a page shows: its box, finite values, panels in px, lines that no legend names, how far a scene
// reaches in its window (1: to the edge).
() => {
  const flat = (values) => Array.from(values || []).flatMap((value) => (value && typeof value === "object" ? Array.from(value) : [value]));
  const isThere = (value) => value !== null && value !== undefined && !Number.isNaN(value);
  const product = (m, v) => [0, 1, 2, 3].map((i) => m[i] * v[0] + m[i + 4] * v[1] + m[i + 8] * v[2] + m[i + 12] * v[3]);
  const named = (trace) => trace.legendgroup || trace.name;

  function reachOf({ glplot }) {
    const { projection, view, model } = glplot.cameraParams, [low, high] = glplot.bounds;
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((corner) => {
      const place = [0, 1, 2].map((axis) => ((corner >> axis) & 1 ? high[axis] : low[axis]));
      const clip = product(projection, product(view, product(model, [...place, 1])));
      return Math.max(Math.abs(clip[0] / clip[3]), Math.abs(clip[1] / clip[3]));
    });
    return Math.max(...corners);
  }

  function unnamed(traces) {
    const lines = traces.filter((trace) => (trace.mode || "").includes("lines") && !trace.fill);
    const listed = new Set(traces.filter((trace) => trace.showlegend).map(named));
    return lines
      .filter((line) => new Set(lines.filter((other) => other.yaxis === line.yaxis).map(named)).size > 1)
      .filter((line) => !listed.has(named(line)))
      .map(named);
  }

  return [...document.querySelectorAll(".js-plotly-plot")]
    .filter((plot) => !plot.closest("[hidden]"))
    .map((plot) => {
      const box = plot.getBoundingClientRect(), full = plot._fullLayout;
      const traces = plot._fullData.filter((trace) => trace.visible === true);
      const keys = Object.keys(full);
      const scenes = keys.filter((key) => /^scene\d*$/.test(key)).map((key) => full[key]._scene).filter(Boolean);
      const isFlat = traces.some((trace) => trace.xaxis);
      return {
        name: plot.closest(".dash-graph")?.id || plot.parentElement.id,
        left: box.left,
        right: box.right,
        height: box.height,
        values: traces.map((trace) => Math.min(...[trace.x, trace.y, trace.z].filter(Boolean).map((part) => flat(part).filter(isThere).length))),
        panels: isFlat ? keys.filter((key) => /^[xy]axis\d*$/.test(key)).map((key) => full[key]._length) : [],
        unnamed: unnamed(traces),
        reaches: scenes.map(reachOf),
      };
    });
}
