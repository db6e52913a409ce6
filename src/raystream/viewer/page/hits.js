// The picked ray: all hits along it, and its walk through the structure.

import {byId, make} from "./elements.js";
import {capital, coordinate, count, number, point, shortPoint, words} from "./format.js";

const MOST_TESTED = 12;

/** A table of the hits of a message. */
function hitTable(message) {
  const head = make("tr", "", ["", "t", "Triangle", "Mesh", "Material", "Position"].map(text => {
    const cell = make("th", "", text || "Hit");
    cell.scope = "col";
    if (!text) cell.className = "order";
    return cell;
  }));
  const position = hit => {
    const cell = make("td", "figure place", shortPoint(hit.position));
    cell.title = point(hit.position);
    return cell;
  };
  const rows = message.hits.map((hit, index) => make("tr", "", [
    make("td", "order", String(index + 1)),
    make("td", "figure", coordinate(hit.t)),
    make("td", "figure", count(hit.prim_id)),
    make("td", "", hit.mesh || `mesh ${hit.mesh_id}`),
    make("td", "", hit.material || "–"),
    position(hit),
  ]));
  const table = make("table", "", [make("thead", "", [head]), make("tbody", "", rows)]);
  const scroller = make("div", "scroller", [table]);
  scroller.tabIndex = 0;
  scroller.setAttribute("role", "region");
  scroller.setAttribute("aria-label", "Hits along the ray");
  return scroller;
}

function rayLines(message) {
  const list = make("dl", "ray");
  list.append(make("dt", "", "From"), make("dd", "", point(message.origin)));
  list.append(make("dt", "", "Toward"), make("dd", "", point(message.direction)));
  return list;
}

/** Describe a step in words. */
function stepLine(step) {
  const item = make("li");
  item.append(make("b", "", words(step.kernel)));
  const {at} = step;
  if (at) {
    const spot = make("span", "at", `${words(at.kind)} ${count(at.number)}`);
    spot.title = `from ${point(at.low)} to ${point(at.high)}`;
    item.append(spot);
    const ends = [step.t_in ?? -Infinity, step.t_out ?? Infinity].map(coordinate);
    item.append(make("span", "between", `t ${ends.join(" … ")}`));
  }
  const tested = step.tested || [];
  if (tested.length) {
    const left = step.tested_count - Math.min(tested.length, MOST_TESTED);
    const some = tested.slice(0, MOST_TESTED).map(count).join(" · ");
    const rest = left > 0 ? ` and ${count(left)} more` : "";
    item.append(make("span", "tested", `tests ${some}${rest}`));
  }
  if (step.prim_id >= 0 && Number.isFinite(step.t)) {
    item.append(make("span", "found", `nearest ${count(step.prim_id)} at t = ${coordinate(step.t)}`));
  }
  return item;
}

function walkPart(message) {
  const {walk} = message;
  const part = make("section", "walk", [make("h3", "", "Walk through the structure")]);
  if (!walk) {
    const reason = message.walk_reason || "no walk available";
    part.append(make("p", "says", capital(reason) + "."), chips(message.counts));
    return part;
  }
  const way = walk.traversal ? `${walk.structure}, ${words(walk.traversal)}` : walk.structure;
    part.append(make("p", "says", `Step-by-step search for the nearest hit in ${way}.`));
  part.append(chips(walk.counts), make("ol", "steps", walk.steps.map(stepLine)));
  if (!walk.is_whole) part.append(make("p", "says", "… further steps omitted."));
  return part;
}

/** Show the ray's counters. */
function chips(counts) {
  const met = Object.entries(counts || {}).filter(([, n]) => n);
  return make("p", "chips", met.map(([name, n]) => make("span", "chip", `${words(name)} ${number(n)}`)));
}

/** Format the hits as tab-separated text for spreadsheets. */
export function hitsAsText(message) {
  const rows = message.hits.map(hit => [
    hit.t, hit.prim_id, hit.mesh_id, hit.mesh ?? "", hit.material ?? "", ...hit.position,
  ].join("\t"));
  return [
    `# origin\t${message.origin.join("\t")}`,
    `# direction\t${message.direction.join("\t")}`,
    "t\tprim_id\tmesh_id\tmesh\tmaterial\tx\ty\tz", ...rows, "",
  ].join("\n");
}

export class HitsPanel {
  /** `closed()` is called when the panel is closed. */
  constructor({closed, copied}) {
    this.panel = byId("hits");
    this.closed = closed;
    this.message = null;
    byId("hits-close").onclick = () => this.close();
    byId("hits-copy").onclick = async () => copied(await copy(hitsAsText(this.message)));
  }

  get isOpen() {
    return !this.panel.hidden;
  }

  /** Show hits, on the side opposite to the picked point. */
  show(message, place) {
    this.message = message;
    const {hits} = message;
    const total = message.total ?? hits.length;
    byId("hits-title").textContent = total === 0 ? "No hit"
      : total === 1 ? "1 hit" : `${count(total)} hits`;
    const body = byId("hits-body");
    const parts = [];
    if (hits.length) parts.push(hitTable(message));
    else parts.push(make("p", "says", "The ray through this pixel hits no triangle."));
    if (total > hits.length) parts.push(make("p", "says", `The nearest ${count(hits.length)} of ${count(total)}.`));
    body.replaceChildren(...parts, rayLines(message), walkPart(message));
    body.scrollTop = 0;
    this.panel.classList.toggle("beyond", Boolean(place && place[0] < 0.5));
    this.panel.hidden = false;
  }

  close() {
    if (!this.isOpen) return;
    const hadFocus = this.panel.contains(document.activeElement);
    this.panel.hidden = true;
    if (hadFocus) byId("picture").focus();
    this.closed();
  }
}

/** Copy text, also on pages without clipboard permission. */
async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    const area = make("textarea", "hidden", text);
    document.body.append(area);
    area.select();
    const done = document.execCommand("copy");
    area.remove();
    return done;
  }
}
