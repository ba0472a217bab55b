// Saves a picture as it is seen: PNG and SVG are made by the browser, PDF by the studio, which has a printer.
(() => {
  const listed = (_, value) => (ArrayBuffer.isView(value) ? Array.from(value) : value);

  // What is drawn, without what only a screen has: a graphics card's lines are no vectors.
  function figureOf(plot) {
    const figure = JSON.parse(JSON.stringify({ data: plot.data, layout: plot.layout }, listed));
    for (const trace of figure.data) trace.type = trace.type && trace.type.replace(/gl$/, "");
    return figure;
  }

  function nameOf(plot) {
    const words = [document.querySelector("#heading")?.innerText.split("\n")[0], plot.parentElement.id];
    return words.filter(Boolean).join(" ").toLowerCase().replace(/[^a-z0-9]+/g, "_").replace(/^_|_$/g, "");
  }

  async function printed(figure, filename) {
    const body = JSON.stringify(figure);
    const response = await fetch("/picture.pdf", { method: "POST", headers: { "Content-Type": "application/json" }, body });
    if (!response.ok) throw new Error(await response.text());
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await response.blob());
    link.download = `${filename}.pdf`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
  }

  document.addEventListener("click", async (event) => {
    const button = event.target.closest && event.target.closest(".save button");
    if (!button) return;
    const plot = button.closest(".picture").querySelector(".js-plotly-plot");
    const answer = button.parentElement.querySelector(".answer");
    const format = button.dataset.format;
    const figure = figureOf(plot);
    const size = { width: plot.clientWidth, height: plot.clientHeight };
    button.disabled = true;
    answer.textContent = format === "pdf" ? "drawing" : "";
    try {
      if (format === "pdf") await printed({ ...figure, ...size }, nameOf(plot));
      else await window.Plotly.downloadImage(figure, { format, filename: nameOf(plot), scale: format === "png" ? 3 : 1, ...size });
      answer.textContent = "";
    } catch (error) {
      answer.textContent = error.message;
    } finally {
      button.disabled = false;
    }
  });
})();
