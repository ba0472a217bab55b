// New points for lines that are drawn already; points of lines that are no longer there are dropped.
window.dash_clientside = Object.assign({}, window.dash_clientside, {
  studio: {
    redraw(points) {
      const plot = points && document.querySelector(`#${points.graph} .js-plotly-plot`);
      if (!plot || !plot.layout || !plot.layout.meta || plot.layout.meta.lines !== points.key) return;
      if (!points.places.length) {
        window.Plotly.relayout(plot, points.layout);
        return;
      }
      const arrays = { f8: Float64Array, f4: Float32Array };
      const unpacked = ({ dtype, bdata }) => new arrays[dtype](Uint8Array.from(atob(bdata), (c) => c.charCodeAt(0)).buffer);
      window.Plotly.update(plot, { x: points.x.map(unpacked), y: points.y.map(unpacked) }, points.layout, points.places);
    },
  },
});
