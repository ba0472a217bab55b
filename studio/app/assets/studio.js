// Drop zones: files and folders are streamed to the server one after the other, never held in the page's memory.
(() => {
  const files = async (entry) => {
    if (entry.isFile) return [await new Promise((resolve, reject) => entry.file(resolve, reject))];
    const reader = entry.createReader();
    const all = [];
    for (;;) {
      const some = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
      if (!some.length) return all;
      for (const one of some) all.push(...await files(one));
    }
  };
  const show = (zone, text) => { zone.querySelector(".answer").textContent = text; };

  async function send(zone, list) {
    const refused = [];
    let answer = "";
    for (const [index, file] of list.entries()) {
      show(zone, `uploading ${file.name} (${index + 1} of ${list.length}, ${(file.size / 1e6).toFixed(1)} MB)`);
      const address = `${zone.dataset.url}?name=${encodeURIComponent(file.name)}`;
      try {
        const response = await fetch(address, { method: "PUT", body: file });
        answer = await response.text();
        if (!response.ok) refused.push(answer);
      } catch (error) {
        refused.push(`${file.name}: the upload ended (${error.message}).`);
      }
    }
    show(zone, refused.length ? refused.join(" ") : `${list.length} ${list.length === 1 ? "file" : "files"} received`);
    zone.classList.toggle("refused", refused.length > 0);
    if (!refused.length && zone.dataset.goto) window.location.assign(zone.dataset.goto.replace("ANSWER", answer));
  }

  const zoneOf = (event) => event.target.closest && event.target.closest(".drop");
  document.addEventListener("dragover", (event) => {
    const zone = zoneOf(event);
    event.preventDefault(); // a file that misses the zone must not replace the page
    if (zone) zone.classList.add("over");
  });
  document.addEventListener("dragleave", (event) => zoneOf(event)?.classList.remove("over"));
  document.addEventListener("drop", async (event) => {
    event.preventDefault();
    const zone = zoneOf(event);
    if (!zone) return;
    zone.classList.remove("over");
    const entries = [...event.dataTransfer.items].map((item) => item.webkitGetAsEntry()).filter(Boolean);
    const list = [];
    for (const entry of entries) list.push(...await files(entry));
    await send(zone, list);
  });
  document.addEventListener("click", (event) => {
    const zone = event.target.matches(".choose") && zoneOf(event);
    if (!zone) return;
    const chooser = document.createElement("input");
    chooser.type = "file";
    chooser.multiple = Boolean(zone.dataset.many);
    chooser.onchange = () => send(zone, [...chooser.files]);
    chooser.click();
  });
})();
