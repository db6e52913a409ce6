// Panels: the controls, which become a sheet on small screens, and the help.

import {byId} from "./elements.js";

const small = matchMedia("(max-width: 760px)");

export class Panels {
  constructor() {
    this.help = byId("help");
    byId("controls-open").onclick = () => this.toggleControls();
    byId("controls-close").onclick = () => this.showControls(false);
    byId("help-open").onclick = () => this.showHelp();
    byId("help-close").onclick = () => this.help.close();
    this.help.addEventListener("click", event => {
      if (event.target === this.help) this.help.close();
    });
    small.addEventListener("change", () => this.showControls(!small.matches, false));
    this.showControls(!small.matches, false);
  }

  get areOpen() {
    return document.body.dataset.controls === "open";
  }

  showControls(shown, moveFocus = true) {
    const controls = byId("controls");
    const hadFocus = controls.contains(document.activeElement);
    document.body.dataset.controls = shown ? "open" : "closed";
    controls.inert = !shown;
    byId("controls-open").setAttribute("aria-expanded", String(shown));
    if (!moveFocus) return;
    if (shown && small.matches) byId("controls-close").focus();
    if (!shown && hadFocus) byId("controls-open").focus();
  }

  toggleControls() {
    this.showControls(!this.areOpen);
  }

  showHelp() {
    if (!this.help.open) this.help.showModal();
  }

  /** Close the topmost panel over the image; false if there is none. */
  close() {
    if (!small.matches || !this.areOpen) return false;
    this.showControls(false);
    return true;
  }
}
