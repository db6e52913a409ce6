// Uploads: sends the files of a model to the server, one at a time, and opens the model there.

const MODELS = [".gltf", ".glb", ".obj", ".ply", ".stl", ".off", ".aff", ".nff"];

const bare = name => name.toLowerCase().replace(/\.gz$/, "");

/** Choose the file to open: the first model, in the order of formats above. */
export function modelOf(names) {
  for (const suffix of MODELS) {
    const found = names.find(name => bare(name).endsWith(suffix));
    if (found) return found;
  }
  return null;
}

function newName() {
  const letters = "abcdefghijklmnopqrstuvwxyz0123456789";
  const bytes = crypto.getRandomValues(new Uint8Array(24));
  return Array.from(bytes, byte => letters[byte % letters.length]).join("");
}

export class Uploads {
  /**
   * Handlers: progress(text, share), ended(), opened(upload, name), error(text). `key` is the
   * upload key from hello, `limit` the maximum bytes of an upload.
   */
  constructor(handlers) {
    this.handlers = handlers;
    this.key = "";
    this.limit = Infinity;
    this.request = null;
    this.turn = 0;
  }

  get isBusy() {
    return this.request !== null;
  }

  /** Upload files and open the model among them; one upload at a time. */
  async send(files) {
    const model = modelOf(files.map(file => file.name));
    if (!model) {
      const what = files.length === 1 ? `${files[0].name} is not a model` : "No model among these files";
      this.handlers.error(`${what}: choose a file of ${MODELS.join(" ")}, with its materials and textures.`);
      return false;
    }
    const total = files.reduce((sum, file) => sum + file.size, 0);
    if (total > this.limit) {
      const megabytes = bytes => Math.round(bytes / 2 ** 20).toLocaleString("en");
      this.handlers.error(
        `${model}: ${megabytes(total)} MiB exceeds this viewer's limit of ${megabytes(this.limit)} MiB.`);
      return false;
    }
    this.cancel();
    const turn = ++this.turn;
    const upload = newName();
    let done = 0;
    try {
      for (const file of files) {
        await this.put(upload, file, loaded => {
          const share = total ? Math.min((done + loaded) / total, 1) : 1;
          this.handlers.progress(`Uploading ${file.name}`, share);
        });
        done += file.size;
        if (turn !== this.turn) return false;
      }
    } catch (error) {
      if (turn === this.turn) {
        this.handlers.ended();
        if (error.message) this.handlers.error(error.message);
      }
      return false;
    }
    this.handlers.ended();
    this.handlers.opened(upload, model);
    return true;
  }

  put(upload, file, progress) {
    return new Promise((resolve, reject) => {
      const request = new XMLHttpRequest();
      this.request = request;
      const end = how => {
        if (this.request === request) this.request = null;
        how();
      };
      const place = `uploads/${upload}/${encodeURIComponent(file.name)}`;
      request.open("PUT", new URL(place, document.baseURI));
      request.setRequestHeader("X-Upload-Key", this.key);
      request.setRequestHeader("Content-Type", "application/octet-stream");
      request.upload.onprogress = event => progress(event.loaded);
      request.onload = () => end(() => {
        if (request.status < 300) resolve();
        else reject(new Error(refusal(file, request)));
      });
      request.onerror = () => end(() => reject(new Error(`${file.name} could not be uploaded: connection lost.`)));
      request.onabort = () => end(() => reject(new Error("")));
      progress(0);
      request.send(file);
    });
  }

  cancel() {
    this.turn += 1;
    if (!this.request) return;
    this.request.abort();
    this.handlers.ended();
  }
}

function refusal(file, request) {
  const text = request.responseText.trim();
  const said = text.length < 400 && !text.startsWith("<") ? text : "";
  return `${file.name} was rejected: ${said || `the server answered ${request.status}`}`;
}

/** List the files of a drop, including those in folders. */
export async function droppedFiles(transfer) {
  const entries = Array.from(transfer.items || [])
    .map(item => (item.webkitGetAsEntry ? item.webkitGetAsEntry() : null))
    .filter(Boolean);
  if (!entries.some(entry => entry.isDirectory)) return Array.from(transfer.files);
  const files = [];
  for (const entry of entries) await collect(entry, files);
  return files;
}

async function collect(entry, files) {
  if (files.length >= 256) return;
  if (entry.isFile) {
    files.push(await new Promise((resolve, reject) => entry.file(resolve, reject)));
    return;
  }
  const reader = entry.createReader();
  for (;;) {
    const part = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
    if (!part.length) return;
    for (const child of part) await collect(child, files);
  }
}
