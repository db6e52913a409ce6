// The picture: the newest frame on the canvas, scaled to its size.

export class Picture {
  /** `shown(header)` is called once for every frame that came, drawn or passed over. */
  constructor(canvas, shown) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", {alpha: false, desynchronized: true});
    this.shown = shown;
    this.waiting = null;
    this.drawn = null;
    this.order = 0;
    this.newest = 0;
  }

  /** Take a frame: its image is decoded beside, and drawn with the screen's next one. */
  async take(header, bytes) {
    const order = ++this.order;
    let bitmap = null;
    try {
      bitmap = await createImageBitmap(new Blob([bytes], {type: header.format}));
    } catch {
      this.shown(header, false);
      return;
    }
    if (order < this.newest) {
      bitmap.close();
      this.shown(header, false);
      return;
    }
    this.newest = order;
    if (this.waiting) this.drop(this.waiting);
    else requestAnimationFrame(() => this.drawWaiting());
    this.waiting = {header, bitmap};
  }

  drop({header, bitmap}) {
    bitmap.close();
    this.shown(header, false);
  }

  drawWaiting() {
    const next = this.waiting;
    this.waiting = null;
    if (this.drawn) this.drawn.close();
    this.drawn = next.bitmap;
    this.draw();
    this.shown(next.header, true);
  }

  /** Scaled to the canvas's height: cameras say how much is seen from top to bottom. */
  draw() {
    const {canvas, context, drawn} = this;
    if (!drawn) return;
    const width = drawn.width * canvas.height / drawn.height;
    const left = Math.abs(width - canvas.width) < 2 ? 0 : (canvas.width - width) / 2;
    context.imageSmoothingEnabled = true;
    context.imageSmoothingQuality = "high";
    if (left > 0) context.clearRect(0, 0, canvas.width, canvas.height);
    context.drawImage(drawn, left, 0, left ? width : canvas.width, canvas.height);
  }

  /** Change the canvas's pixels, and keep what is on it until a new frame comes. */
  resize(width, height) {
    if (this.canvas.width === width && this.canvas.height === height) return;
    this.canvas.width = width;
    this.canvas.height = height;
    this.draw();
  }
}
