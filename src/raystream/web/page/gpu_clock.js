// Seconds that the GPU worked: by its own timestamps where it has them, else by the page's clock.

export class GpuClock {
  constructor(gpu) {
    this.gpu = gpu;
    this.isGpus = gpu.device.features.has("timestamp-query");
    this.seconds = 0;
    this.rays = 0;
    if (!this.isGpus) return;
    const {QUERY_RESOLVE, COPY_SRC} = GPUBufferUsage;
    this.queries = gpu.device.createQuerySet({type: "timestamp", count: 2});
    this.times = gpu.device.createBuffer({size: 16, usage: QUERY_RESOLVE | COPY_SRC});
  }

  restart() {
    this.seconds = this.rays = 0;
  }

  /** What a first and a last pass of some work write: for the argument of `beginComputePass`. */
  writes(isFirst, isLast) {
    if (!this.isGpus || !(isFirst || isLast)) return undefined;
    return {
      querySet: this.queries,
      ...(isFirst && {beginningOfPassWriteIndex: 0}), ...(isLast && {endOfPassWriteIndex: 1}),
    };
  }

  /** Encode what ends the work. */
  end(encoder) {
    if (this.isGpus) encoder.resolveQuerySet(this.queries, 0, 2, this.times, 0);
    this.began = performance.now();
  }

  /** Add the time of work that was submitted, once it is done. */
  async addTime() {
    if (!this.isGpus) {
      await this.gpu.device.queue.onSubmittedWorkDone();
      this.seconds += (performance.now() - this.began) / 1000;
      return;
    }
    const [began, ended] = new BigInt64Array(await this.gpu.read(this.times, 16));
    this.seconds += Math.max(Number(ended - began), 0) / 1e9;
  }

  /** The rate as text, and whose clock it is; "" as long as there is none. */
  toString() {
    if (!(this.seconds > 0)) return "";
    const shown = (this.rays / this.seconds).toLocaleString("en",
      {notation: "compact", compactDisplay: "long", maximumSignificantDigits: 3});
    return `${shown} rays/s (${this.isGpus ? "GPU's clock" : "page's clock"})`;
  }
}
