// The picked ray: every hit along it, and its walk through the structure.

import {byId, make} from "./elements.js";
import {coordinate, count, number, point, words} from "./format.js";

const MOST_TESTED = 12;

/** A table of the hits of a message. */
function hitTable(message) {
  const head = make("tr", "", ["", "t", "Triangle", "Mesh", "Material", "Position"].map(text => {
    const cell = make("th", "", text || "Hit");
    cell.scope = "col";
    if (!text) cell.className = "order";
    return cell;
  }));
  const rows = message.hits.map((hit, index) => make("tr", "", [
    make("td", "order", String(index + 1)),
    make("td", "figure", coordinate(hit.t)),
    make("td", "figure", count(hit.prim_id)),
    make("td", "", hit.mesh || `mesh ${hit.mesh_id}`),
    make("td", "", hit.material || "–"),
    make("td", "figure place", point(hit.position)),
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

/** What a step did, in words. */
function stepLine(step) {
  const item = make("li");
  item.append(make("b", "", words(step.kernel)));
  if (step.at !== undefined && step.at !== null) {
    item.append(make("span", "at", Array.isArray(step.at) ? `(${step.at.join(", ")})` : words(step.at)));
  }
  const ends = [step.t_in, step.t_out].map(t => (t === null || t === undefined ? null : coordinate(t)));
  if (ends[0] !== null || ends[1] !== null) {
    item.append(make("span", "between", `t ${ends[0] ?? "–"} … ${ends[1] ?? "∞"}`));
  }
  const tested = step.tested || [];
  if (tested.length) {
    const left = tested.length - MOST_TESTED;
    const some = tested.slice(0, MOST_TESTED).map(one => count(one)).join(" · ");
    item.append(make("span", "tested", `tests ${some}${left > 0 ? ` and ${count(left)} more` : ""}`));
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
    part.append(make("p", "says", message.walk_reason || "There is no walk to show."));
    return part;
  }
  const way = walk.traversal ? `${walk.structure}, ${words(walk.traversal)}` : walk.structure;
  part.append(make("p", "says", `The search for the nearest hit in ${way}, step by step.`));
  const chips = Object.entries(walk.counts || {}).filter(([, n]) => n)
    .map(([name, n]) => make("span", "chip", `${words(name)} ${number(n)}`));
  part.append(make("p", "chips", chips));
  part.append(make("ol", "steps", (walk.steps || []).map(stepLine)));
  if (walk.more > 0) part.append(make("p", "says", `… and ${count(walk.more)} steps more.`));
  return part;
}

/** The hits as text that a spreadsheet takes. */
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
  /** `closed()` is called when the panel goes away. */
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

  /** Show hits; the panel stands on the side where the picked place is not. */
  show(message, place) {
    this.message = message;
    const {hits} = message;
    const total = message.total ?? hits.length;
    byId("hits-title").textContent = total === 0 ? "No hit"
      : total === 1 ? "1 hit" : `${count(total)} hits`;
    const body = byId("hits-body");
    const parts = [];
    if (hits.length) parts.push(hitTable(message));
    else parts.push(make("p", "says", "The ray through this place meets no triangle."));
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

/** Copy text, also on pages that browsers do not trust with the clipboard. */
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
