// Inflates plotly.js and draws the pictures one by one; light and dark; tables that fit. Text and tables need no script.
const root = document.documentElement;
const system = matchMedia("(prefers-color-scheme: dark)");
const DARK = JSON.parse(document.getElementById("dark").textContent);
const TO_DARK = Object.fromEntries(Object.entries(DARK).map(([light, dark]) => [light.toLowerCase(), dark]));
const TO_LIGHT = Object.fromEntries(Object.entries(DARK).map(([light, dark]) => [dark, light]));
const LETTER = 7.6, LINE = 15; // px, of an axis title: width of a letter, height of a line

const isDark = () => (root.dataset.theme || (system.matches ? "dark" : "light")) === "dark";

// Replaces colours in a figure, in place; numbers are left alone.
function recolour(value, map) {
  if (!value || typeof value !== "object" || ArrayBuffer.isView(value)) return;
  if (Array.isArray(value) && typeof value[0] === "number") return;
  for (const [key, item] of Object.entries(value)) {
    if (typeof item === "string") {
      if (item.length === 7 && item[0] === "#" && map[item.toLowerCase()]) value[key] = map[item.toLowerCase()];
    } else recolour(item, map);
  }
}

// Takes the numbers off cells that are too small for them.
function thinCells(figure, width) {
  for (const trace of figure.data)
    if (trace.type === "heatmap" && trace.text && (width - 190) / trace.text[0].length < 18) delete trace.texttemplate;
}

// Wraps titles of horizontal axes that are longer than their place in the drawn picture.
async function wrapTitles(plot) {
  const { l, w } = plot._fullLayout._size;
  const change = {};
  let lines = 1;
  for (const [name, axis] of Object.entries(plot.layout)) {
    if (!/^xaxis\d*$/.test(name) || !axis.title || !axis.title.text) continue;
    const [low, high] = axis.domain || [0, 1];
    const middle = l + (w * (low + high)) / 2;
    const letters = Math.floor((2 * Math.min(middle, plot.clientWidth - middle) - 8) / LETTER);
    if (axis.title.text.length <= letters) continue;
    const rows = [""];
    for (const word of axis.title.text.split(" ")) {
      if (rows.at(-1) && rows.at(-1).length + word.length >= letters) rows.push("");
      rows.push(`${rows.pop()} ${word}`.trim());
    }
    change[`${name}.title.text`] = rows.join("<br>");
    lines = Math.max(lines, rows.length);
  }
  if (lines === 1) return;
  change["margin.b"] = plot.layout.margin.b + LINE * (lines - 1);
  change.height = plot.layout.height + LINE * (lines - 1);
  plot.style.height = `${change.height}px`;
  await Plotly.relayout(plot, change);
}

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

// The name of a picture's file: the page's, and its section's.
function fileName(plot) {
  const before = [...document.querySelectorAll("h2[id]")].filter(
    (heading) => heading.compareDocumentPosition(plot) & Node.DOCUMENT_POSITION_FOLLOWING
  );
  const place = [...document.querySelectorAll(".plot")].indexOf(plot) + 1;
  const words = [document.title, before.length ? before.at(-1).id : "", place].join(" ");
  return words.toLowerCase().replace(/[^a-z0-9]+/g, "_").replace(/^_|_$/g, "");
}

// Saves a picture as it is seen, on white.
function save(plot, format) {
  const figure = { data: structuredClone(plot.data), layout: structuredClone(plot.layout) };
  if (isDark()) recolour(figure, TO_LIGHT);
  const size = { width: plot.clientWidth, height: plot.clientHeight };
  return Plotly.downloadImage(figure, { format, filename: fileName(plot), scale: format === "png" ? 3 : 1, ...size });
}

function configuration(touched) {
  return {
    displaylogo: false,
    responsive: true,
    displayModeBar: touched ? true : "hover",
    modeBarButtonsToRemove: ["toImage"],
    modeBarButtonsToAdd: [
      { name: "png", title: "Save as PNG", icon: Plotly.Icons.camera, click: (plot) => save(plot, "png") },
      { name: "svg", title: "Save as SVG", icon: Plotly.Icons.disk, click: (plot) => save(plot, "svg") },
    ],
  };
}

// Labels a table's cells with the headings of their columns, once.
function label(table) {
  if (table.rows[0].classList.contains("heads")) return;
  const names = [...table.rows[0].cells].map((cell) => cell.textContent.trim());
  table.rows[0].classList.add("heads");
  table.setAttribute("role", "table");
  for (const row of [...table.rows].slice(1)) {
    row.setAttribute("role", "row");
    [...row.cells].forEach((cell, index) => {
      const content = document.createElement("span");
      content.className = "cell";
      content.append(...cell.childNodes);
      cell.append(content);
      cell.setAttribute("role", "cell");
      cell.dataset.label = names[index] || "";
      cell.classList.toggle("blank", !content.textContent.trim());
    });
  }
}

// No table is cut: one that is wider than its place becomes a list.
function stackTables() {
  for (const table of document.querySelectorAll("table")) {
    table.classList.remove("stacked");
    const place = table.parentElement;
    if (!place.clientWidth || table.scrollWidth <= place.clientWidth + 1) continue;
    label(table);
    table.classList.add("stacked");
  }
}

// Colours the pictures for a theme, in which they may be already.
let drawnDark = isDark();
async function colourPictures(dark) {
  if (dark === drawnDark) return;
  drawnDark = dark;
  for (const plot of document.querySelectorAll(".js-plotly-plot")) {
    recolour(plot.data, dark ? TO_DARK : TO_LIGHT);
    recolour(plot.layout, dark ? TO_DARK : TO_LIGHT);
    await Plotly.redraw(plot);
  }
}

function themeButton() {
  const button = document.getElementById("theme");
  const name = () => (button.textContent = isDark() ? "Light" : "Dark");
  button.hidden = false;
  button.onclick = () => {
    root.dataset.theme = isDark() ? "light" : "dark";
    try {
      localStorage.setItem("alula-theme", root.dataset.theme);
    } catch {} // a page from a disk may have no storage
    name();
    colourPictures(isDark());
  };
  system.addEventListener("change", () => {
    name();
    colourPictures(isDark());
  });
  name();
}

(async () => {
  themeButton();
  stackTables();
  addEventListener("resize", stackTables);
  for (const details of document.querySelectorAll("details")) details.addEventListener("toggle", stackTables);
  const plots = [...document.querySelectorAll(".plot")];
  const touched = matchMedia("(pointer: coarse)").matches;
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
  const config = configuration(touched);
  for (const plot of plots) {
    const figure = JSON.parse(plot.nextElementSibling.textContent);
    if (touched) figure.layout.dragmode = false; // a finger on a picture scrolls the page
    thinCells(figure, plot.clientWidth);
    if (drawnDark) recolour(figure, TO_DARK);
    plot.textContent = "";
    await Plotly.newPlot(plot, figure.data, figure.layout, config);
    await wrapTitles(plot);
    controls(plot, figure.layout.meta || {});
    await new Promise((resume) => setTimeout(resume));
  }
  addEventListener("beforeprint", () => colourPictures(false));
  addEventListener("afterprint", () => colourPictures(isDark()));
  root.dataset.drawn = plots.length;
})();
