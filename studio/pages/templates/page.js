// Inflates plotly.js and draws the pictures one by one. Text and tables need no script.
function controls(plot, meta) {
  const bar = document.createElement("div");
  bar.className = "controls";
  if ((meta.choices || []).length > 1) {
    const menu = document.createElement("select");
    menu.setAttribute("aria-label", meta.label);
    meta.choices.forEach((choice, index) => menu.add(new Option(choice.name, index)));
    menu.onchange = () => Plotly.update(plot, { visible: meta.choices[menu.value].visible }, meta.choices[menu.value].layout);
    bar.append(menu);
  }
  for (const jump of meta.jumps || []) {
    const button = document.createElement("button");
    button.textContent = jump.name;
    button.onclick = () => Plotly.relayout(plot, { "xaxis.range": jump.range.slice(), "yaxis.autorange": true });
    bar.append(button);
  }
  if (bar.children.length) plot.before(bar);
}

(async () => {
  const plots = [...document.querySelectorAll(".plot")];
  const touched = matchMedia("(pointer: coarse)").matches;
  const config = { displaylogo: false, responsive: true, displayModeBar: touched ? true : "hover" };
  try {
    const packed = Uint8Array.from(atob(document.getElementById("plotly").textContent), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(stream).text();
    document.head.append(script);
  } catch (error) {
    for (const plot of plots) plot.textContent = `This browser cannot draw the picture (${error}); the tables hold its numbers.`;
    return;
  }
  for (const plot of plots) {
    const figure = JSON.parse(plot.nextElementSibling.textContent);
    if (touched) figure.layout.dragmode = false; // a finger on a picture scrolls the page
    plot.textContent = "";
    await Plotly.newPlot(plot, figure.data, figure.layout, config);
    controls(plot, figure.layout.meta || {});
    await new Promise((resume) => setTimeout(resume));
  }
  document.documentElement.dataset.drawn = plots.length;
})();
