// Models: files that the user drops or opens, and the way back to the initial scene.

import {byId} from "./elements.js";
import {droppedFiles, Uploads} from "./uploads.js";

export class Models {
  /** Handlers: send(message), error(text); `work` shows the progress. */
  constructor(handlers, work) {
    this.handlers = handlers;
    this.work = work;
    this.files = null;
    this.isLoading = false;
    this.uploads = new Uploads({
      progress: (text, share) => this.work.show("sending", text, share, true),
      ended: () => this.work.show("sending", "", null),
      opened: (upload, name) => this.open(upload, name),
      error: handlers.error,
    });
    byId("open").onclick = () => byId("files").click();
    byId("files").onchange = event => {
      const files = Array.from(event.target.files);
      event.target.value = "";
      this.take(files);
    };
    byId("first-scene").onclick = () => this.home();
    this.listenToDrops();
  }

  listenToDrops() {
    const drop = byId("drop");
    const hasFiles = event => Array.from(event.dataTransfer.types).includes("Files");
    let depth = 0;
    addEventListener("dragenter", event => {
      if (!hasFiles(event)) return;
      depth += 1;
      drop.hidden = false;
    });
    addEventListener("dragleave", () => {
      depth = Math.max(depth - 1, 0);
      drop.hidden = depth === 0;
    });
    addEventListener("dragover", event => event.preventDefault());
    addEventListener("drop", async event => {
      event.preventDefault();
      depth = 0;
      drop.hidden = true;
      if (event.dataTransfer) this.take(await droppedFiles(event.dataTransfer));
    });
  }

  async take(files) {
    if (!files.length) return;
    if (await this.uploads.send(files)) this.files = files;
  }

  open(upload, name) {
    this.isLoading = true;
    this.work.show("loading", `Opening ${name}`, undefined, true);
    this.handlers.send({type: "open", upload, name});
  }

  /** A scene has arrived, or an error instead. */
  loaded(scene) {
    if (scene) byId("first-scene").hidden = !scene.own;
    if (scene && !scene.own) this.files = null;
    this.isLoading = false;
    this.work.show("loading", "", null);
  }

  cancel() {
    if (this.uploads.isBusy) {
      this.uploads.cancel();
    } else if (this.isLoading) {
      this.loaded(null);
      this.handlers.send({type: "home"});
    }
  }

  home() {
    this.cancel();
    this.handlers.send({type: "home"});
  }

  /** After a lost connection: upload the open model again. */
  again() {
    if (this.files) this.take(this.files);
  }
}
