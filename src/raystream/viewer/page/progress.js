// ProgressBar: a progress bar for long operations such as loading and building.

import {byId} from "./elements.js";
import {capital} from "./format.js";

const PATIENCE = 200; // ms before the bar appears: most operations finish sooner

export class ProgressBar {
  /** `cancelled()` is called when the user cancels an operation. */
  constructor(cancelled) {
    this.running = new Map();
    this.timer = null;
    byId("work-cancel").onclick = cancelled;
  }

  /** Show the progress of a kind of work, or with null its end; it may be `cancellable`. */
  show(kind, text, share, cancellable = false) {
    this.running.delete(kind);
    if (share !== null) this.running.set(kind, {text, share, cancellable});
    if (this.running.size && byId("work").hidden) {
      this.timer ??= setTimeout(() => this.draw(), PATIENCE);
      return;
    }
    this.draw();
  }

  /** Clear everything: the connection was lost. */
  clear() {
    this.running.clear();
    this.draw();
  }

  draw() {
    clearTimeout(this.timer);
    this.timer = null;
    const latest = [...this.running.values()].at(-1);
    byId("work").hidden = !latest;
    if (!latest) return;
    const {share, cancellable} = latest;
    const what = capital(latest.text || "Working");
    const known = Number.isFinite(share);
    const percent = known ? Math.round(100 * Math.min(Math.max(share, 0), 1)) : 0;
    const text = byId("work-text");
    if (text.textContent !== what) text.textContent = what;
    const bar = byId("work-bar");
    bar.classList.toggle("unknown", !known);
    bar.firstElementChild.style.width = known ? `${percent}%` : "";
    if (known) bar.setAttribute("aria-valuenow", percent);
    else bar.removeAttribute("aria-valuenow");
    byId("work-cancel").hidden = !cancellable;
  }
}
