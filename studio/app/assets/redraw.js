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
    // The lines of a menu's entry: those of the others are hidden.
    choose(name, id) {
      const plot = document.querySelector(`#${id.choice} .js-plotly-plot`);
      const choices = plot && plot.layout && plot.layout.meta && plot.layout.meta.choices;
      const entry = choices && choices.find((one) => one.name === name);
      if (entry) window.Plotly.update(plot, { visible: entry.visible }, entry.layout);
      return window.dash_clientside.no_update;
    },
  },
});
