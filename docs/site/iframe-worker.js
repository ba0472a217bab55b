/* A page that is opened from the disk may not start a worker: the search then runs in a hidden frame. */
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(address) {
      super();
      this.waiting = [];
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      this.frame.srcdoc =
        `<script>var postMessage = data => frameElement.dispatchEvent(new MessageEvent("message", { data }));</script>` +
        `<script src="${new URL(address, location)}"></script>`;
      this.frame.addEventListener("message", event => this.dispatchEvent(new MessageEvent("message", { data: event.data })));
      this.frame.addEventListener("load", () => this.waiting.splice(0).forEach(data => this.deliver(data)));
      this.frame.addEventListener("load", () => (this.loaded = true));
      document.body.appendChild(this.frame);
    }
    deliver(data) {
      this.frame.contentWindow.dispatchEvent(new MessageEvent("message", { data }));
    }
    postMessage(data) {
      if (this.loaded) this.deliver(data);
      else this.waiting.push(data);
    }
  };
}
