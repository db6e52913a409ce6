// Counts rays by state and chooses the next kernel, both on the GPU: as
// raystream/graphics/multipass/device_scheduler.py, with the default of the multipass machine.

import {cached} from "./device.js";
import {shaderSource} from "./shaders.js";

const LAYOUT = ["uint", "scatter", "uniform", "gather"];

/** Words of Schedule: arguments of eight draws, 16 counts, then the rest of what is fixed. */
const COUNTS_AT = 32, LATEST_AT = 48, HEAD_WORDS = 52, STATE_COUNT = 16;
const MOST_KERNELS = 8, ARGUMENT_BYTES = 16, GROUP_SIDE = 16, NO_KERNEL = 0xffffffff;

export class Schedule {
  constructor(gpu, {shaders, schedule}, {kernels, spawns, mostPasses}) {
    this.gpu = gpu;
    this.source = shaderSource(shaders, ["multipass/schedule.wgsl"]);
    this.threshold = schedule.threshold;
    this.spawns = spawns;
    this.pipelines = new Map();
    const {intersecting} = schedule.states;
    const tests = kernels.reduce((bits, {state}, k) => bits | (state === intersecting) << k, 0);
    const words = new Uint32Array(4 + MOST_KERNELS);
    words.set([kernels.length, tests, 0, 0, ...kernels.map(({state}) => state)]);
    this.kernels = gpu.buffer("kernels", words, GPUBufferUsage.UNIFORM);
    this.bytes = 4 * (HEAD_WORDS + 2 * mostPasses);
    this.arguments = gpu.buffer("schedule", this.bytes,
      GPUBufferUsage.STORAGE | GPUBufferUsage.INDIRECT);
  }

  /** Prepare for the rays of some streams. */
  begin(streams) {
    const {gpu, threshold} = this;
    if (this.streams !== streams) {
      this.least?.destroy();
      const least = Uint32Array.from({length: streams.count + 1}, (_, n) => Math.ceil(threshold * n));
      this.least = gpu.buffer("thresholds", least);
      this.streams = streams;
      this.group = gpu.bind(LAYOUT, [streams.states, this.arguments, this.kernels, this.least]);
    }
    const head = new Uint32Array(HEAD_WORDS);
    head[LATEST_AT] = NO_KERNEL;
    gpu.write(this.arguments, head);
  }

  /** Compile the pipelines that choose among some kernels. */
  async prepare(sets) {
    const make = (entry, encoded) => cached(this.pipelines, `${entry} ${encoded}`, () => (
      this.gpu.pipeline({
        source: this.source, entry, layouts: [LAYOUT],
        constants: {SPAWNS: Number(this.spawns), ENCODED: encoded},
      })));
    this.counting = await make("count_states", 0);
    this.deciding = new Map(await Promise.all(
      sets.map(async kernels => [kernels, await make("decide", bitsOf(kernels))])));
  }

  encodeCount(pass) {
    const {width, height} = this.streams;
    pass.setBindGroup(0, this.group);
    pass.setPipeline(this.counting);
    pass.dispatchWorkgroups(Math.ceil(width / GROUP_SIDE), Math.ceil(height / GROUP_SIDE));
  }

  /** Encode counting and choosing among some kernels, those of a call of `prepare`. */
  encode(encoder, kernels, times) {
    const pass = encoder.beginComputePass({timestampWrites: times});
    this.encodeCount(pass);
    pass.setPipeline(this.deciding.get(kernels));
    pass.dispatchWorkgroups(1);
    pass.end();
  }

  /** Draw, unless another kernel was chosen. */
  draw(run, {pipeline, reference, kernel}) {
    run.setPipeline(pipeline);
    run.setStencilReference(reference);
    run.drawIndirect(this.arguments, ARGUMENT_BYTES * kernel);
  }

  /** Clear the record of passes, and the counts of an earlier `read`. */
  clear(encoder) {
    encoder.clearBuffer(this.arguments, 4 * COUNTS_AT, 4 * STATE_COUNT);
    encoder.clearBuffer(this.arguments, 4 * (LATEST_AT + 1), 4);
  }

  /** Submit, and read what ran since `clear`, and how many rays are in each state now. */
  async read(encoder) {
    const pass = encoder.beginComputePass();
    this.encodeCount(pass);
    pass.end();
    this.gpu.device.queue.submit([encoder.finish()]);
    const words = new Uint32Array(await this.gpu.read(this.arguments, this.bytes));
    const record = words.subarray(HEAD_WORDS);
    const passes = Array.from({length: words[LATEST_AT + 1]},
      (_, k) => ({kernel: record[2 * k], rays: record[2 * k + 1]}));
    return {passes, waiting: words.slice(COUNTS_AT, COUNTS_AT + STATE_COUNT)};
  }
}

const bitsOf = kernels => kernels.reduce((bits, kernel) => bits | 1 << kernel, 0);
