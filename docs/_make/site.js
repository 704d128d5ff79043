// Browsers refuse a Worker on a page that is opened from a folder, and the search of the site runs in one. There, its script runs in a
// hidden frame of the page instead.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.body.appendChild(frame);
      this.inside = frame.contentWindow;
      this.inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      this.inside.importScripts = async (...urls) => { for (const each of urls) await this.load(each); };
      this.ready = this.load(new URL(url, location.href));
    }
    load(url) {
      const script = this.inside.document.createElement("script");
      script.src = url;
      return new Promise((resolve, reject) => {
        script.onload = resolve;
        script.onerror = () => reject(new Error(`${url} cannot be loaded`));
        this.inside.document.body.appendChild(script);
      });
    }
    postMessage(data) {
      this.ready.then(() => this.inside.dispatchEvent(new this.inside.MessageEvent("message", { data })));
    }
  };
}

// What the theme lacks: every block of code is a landmark of one name (its button that copies), and what scrolls takes no focus.
new MutationObserver(() => {
  document.querySelectorAll("nav.md-code__nav:not([aria-label])").forEach((nav) => {
    nav.ariaLabel = `Code ${[...document.querySelectorAll("nav.md-code__nav")].indexOf(nav) + 1}`;
  });
  document.querySelectorAll("pre > code, .md-typeset__scrollwrap").forEach((box) => { if (box.tabIndex < 0) box.tabIndex = 0; });
}).observe(document.documentElement, { childList: true, subtree: true });
