/* A page opened as a file may not start a worker. This runs the worker's script in a hidden frame,
   so that the search works without a server. */
if (location.protocol === "file:") {
  window.IFrameWorker = class extends EventTarget {
    constructor(url) {
      super();
      this.onmessage = null;
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      document.body.appendChild(this.frame);
      const inside = this.frame.contentWindow;
      inside.document.open();
      inside.document.write(
        "<!DOCTYPE html><html><body><script>" +
          "postMessage = function (data) { parent.dispatchEvent(" +
          "new MessageEvent('frameworker', { data: data, source: window })); };" +
          "importScripts = function () { return Array.from(arguments).reduce(function (before, url) {" +
          "return before.then(function () { return new Promise(function (resolve, reject) {" +
          "var script = document.createElement('script'); script.src = url;" +
          "script.onload = resolve; script.onerror = reject;" +
          "document.body.appendChild(script); }); }); }, Promise.resolve()); };" +
          "<\/script><script src=\"" + url + "\"><\/script></body></html>"
      );
      inside.document.close();
      this.ready = new Promise((resolve) => inside.addEventListener("load", resolve));
      addEventListener("frameworker", (event) => {
        if (event.source === inside) {
          const message = new MessageEvent("message", { data: event.data });
          this.dispatchEvent(message);
          if (this.onmessage) this.onmessage(message);
        }
      });
    }

    postMessage(data) {
      this.ready.then(() =>
        this.frame.contentWindow.dispatchEvent(new MessageEvent("message", { data: data }))
      );
    }

    terminate() {
      this.frame.remove();
    }
  };
  window.Worker = window.IFrameWorker;
}
