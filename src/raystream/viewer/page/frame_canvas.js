// The canvas: shows the newest frame, scaled to its size.

export class FrameCanvas {
  /** `shown(header)` is called once for every frame, drawn or skipped. */
  constructor(canvas, shown) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", {alpha: false, desynchronized: true});
    this.shown = shown;
    this.waiting = null;
    this.drawn = null;
    this.order = 0;
    this.newest = 0;
  }

  /** Decode a frame asynchronously, and draw it with the next animation frame. */
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

  /** Draw scaled to the canvas's height, since cameras define the vertical field of view. */
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

  /** Resize the canvas, keeping its content until a new frame arrives. */
  resize(width, height) {
    if (this.canvas.width === width && this.canvas.height === height) return;
    this.canvas.width = width;
    this.canvas.height = height;
    this.draw();
  }
}
