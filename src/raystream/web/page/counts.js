// Counts of work per ray of each structure of a page, side by side (Foley 2005).

import {DispatchSize} from "./device.js";
import {byId, make} from "./elements.js";
import {COUNTED} from "./queries.js";

/** Most rays of a comparison. */
const MOST_RAYS = 1 << 16;

/** Columns of the table. */
const TITLES = {
  steps: "Steps down", backtrack_steps: "Steps up", leaves: "Leaves", tests: "Tests",
  restarts: "Restarts", link_nodes: "Link nodes",
};

/** Rays through an image's pixels, or every few of them: six numbers each. */
export function raysOf([width, height], rayThrough) {
  const every = Math.ceil(Math.sqrt(width * height / MOST_RAYS));
  const [columns, rows] = [width, height].map(side => Math.ceil(side / every));
  const rays = new Float64Array(6 * columns * rows);
  for (let i = 0; i < columns * rows; i++) {
    const [x, y] = [i % columns, Math.floor(i / columns)];
    rays.set(rayThrough((x + 0.5) / columns, (y + 0.5) / rows), 6 * i);
  }
  return rays;
}

/** The mean counts of some rays, by the names of COUNTED. */
export async function meanCounts(queries, rays) {
  const count = rays.length / 6;
  const sums = COUNTED.map(() => 0);
  const size = new DispatchSize(count);
  for (let first = 0; first < count;) {
    const part = rays.subarray(6 * first, 6 * (first + size.size));
    const began = performance.now();
    const tallies = await queries.counts(part);
    size.took(part.length / 6, (performance.now() - began) / 1000);
    tallies.forEach((value, k) => { sums[k % COUNTED.length] += value; });
    first += part.length / 6;
  }
  return Object.fromEntries(COUNTED.map((name, k) => [name, sums[k] / count]));
}

/** Show the means of each structure, by name; columns of zeros are left out. */
export function showCounts(means, rayCount) {
  const all = Object.values(means);
  const columns = Object.keys(TITLES).filter(name => all.some(one => one[name]));
  const header = (text, scope) => Object.assign(make("th", "", text), {scope});
  const head = ["Structure", ...columns.map(name => TITLES[name])];
  const rows = Object.entries(means).map(([name, one]) => make("tr", "", [
    header(name, "row"), ...columns.map(column => make("td", "", one[column].toFixed(2))),
  ]));
  byId("counts-title").textContent = `Mean of ${rayCount.toLocaleString()} rays of this view`;
  byId("counts-table").replaceChildren(
    make("thead", "", [make("tr", "", head.map(text => header(text, "col")))]),
    make("tbody", "", rows));
  byId("counts").hidden = false;
}
