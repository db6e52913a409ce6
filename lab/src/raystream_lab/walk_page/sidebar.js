"use strict";
// The sidebar: the step in words, counts, the stack, the tree, other structures.

const byId = id => document.getElementById(id);

function element(name, attributes, ...children) {
  const one = document.createElement(name);
  for (const key in attributes) one.setAttribute(key, attributes[key]);
  one.append(...children);
  return one;
}

const KERNEL_COLORS = {
  "set up": "setup", "initialize": "setup", "traverse": "down", "down": "down", "leaf": "leaf",
  "intersect": "test", "continue": "continue", "up": "up", "shade": "shade",
};
const kernelColor = name => `var(--k-${KERNEL_COLORS[name] || "setup"})`;

// The counts of each structure by the names of raystream's counters, and their labels.
const COUNTS = {
  grid: {steps: "cells stepped through", leaves: "cells with triangles", tests: "triangles tested"},
  kdtree: {steps: "steps down", leaves: "leaves", tests: "triangles tested"},
  graph: {
    steps: "sectors stepped through", leaves: "sectors with triangles", tests: "triangles tested",
    link_nodes: "separation planes looked at",
  },
};
const TREE_COUNTS = {
  "kdtree-stack": {pushes: "pushes", pops: "pops"},
  "kdtree-restart": {restarts: "restarts"},
  "kdtree-backtrack": {backtracks: "backtracks", backtrack_steps: "steps up"},
};

function countsOf(panel) {
  return {...COUNTS[panel.split("-")[0]], ...TREE_COUNTS[panel]};
}

function number(t) {
  return t === null || t === undefined ? "∞" : t.toFixed(2);
}

function fillNow(shown) {
  const {steps, step, states, strings} = shown;
  const now = step ? steps[step - 1] : null;
  byId("kernel").textContent = now ? now.kernel : "start";
  byId("kernel").style.background = kernelColor(now ? now.kernel : "");
  const before = step > 1 ? states[steps[step - 2].s] : "starting";
  byId("change").textContent = now ? `${before} → ${states[now.s]}` : "the ray waits to be set up";
  byId("sentence").textContent = now ? strings[now.w] : "Step forward, or play.";
  byId("source").textContent = now ? strings[now.r] : "";
}

function fillCounts(shown) {
  const {steps, step, panel} = shown;
  const names = countsOf(panel), table = byId("counts");
  const total = steps.length ? steps[steps.length - 1].sum : {};
  const sum = step ? steps[step - 1].sum : {}, last = step > 1 ? steps[step - 2].sum : {};
  const head = element("tr", {}, element("td", {}), element("td", {}, "so far"), element("td", {}, "in all"));
  head.className = "head";
  const rows = Object.keys(names).map(name => {
    const value = sum[name] || 0, grown = value !== (last[name] || 0);
    return element("tr", {}, element("th", {scope: "row"}, names[name]),
      element("td", grown ? {class: "grown"} : {}, String(value)),
      element("td", {}, String(total[name] || 0)));
  });
  const now = step ? steps[step - 1] : null;
  const hit = now && now.p !== undefined ? `t = ${number(now.t)}` : "none";
  rows.push(element("tr", {}, element("th", {scope: "row"}, "nearest hit so far"),
    element("td", {colspan: 2}, hit)));
  table.replaceChildren(head, ...rows);
}

function fillStack(shown) {
  const {steps, step, panel, drawing} = shown;
  const part = byId("stack-part"), list = byId("stack");
  part.hidden = !panel.startsWith("kdtree");
  if (part.hidden) return;
  const now = step ? steps[step - 1] : null, spot = now && now.b;
  const name = i => `${drawing.children[i] ? "split" : "leaf"} ${i}`;
  if (panel === "kdtree-stack") {
    byId("stack-title").textContent = "Stack, top first";
    const spots = now && now.q || [];
    const items = spots.map(([i, t0, t1]) => element("li", {},
      element("span", {}, name(i)), element("span", {}, `t ${number(t0)} to ${number(t1)}`)));
    list.replaceChildren(...(items.length ? items : [element("li", {class: "none"}, "empty")]));
    return;
  }
  byId("stack-title").textContent = "No stack: only the interval and the node are kept";
  const kept = spot ? `${name(spot[0])}, t ${number(spot[1])} to ${number(spot[2])}` : "nothing yet";
  list.replaceChildren(element("li", {class: "none"}, kept));
}

// The tree: leaves from left to right, the root on top.
function treeLayout(drawing) {
  const {children} = drawing, places = [], parents = [];
  let leaf = 0, deepest = 0;
  const place = (i, depth) => {
    deepest = Math.max(deepest, depth);
    if (!children[i]) return places[i] = [leaf++, depth];
    const below = children[i], above = below + 1;
    parents[below] = parents[above] = i;
    const a = place(below, depth + 1), b = place(above, depth + 1);
    return places[i] = [(a[0] + b[0]) / 2, depth];
  };
  if (children.length) place(0, 0);
  return {places, parents, width: Math.max(leaf, 1), height: deepest + 1};
}

function fillTree(shown) {
  const {steps, step, drawing} = shown, svg = byId("tree");
  byId("tree-part").hidden = !drawing.children;
  if (!drawing.children) return;
  const layout = drawing.layout || (drawing.layout = treeLayout(drawing));
  const {places, parents} = layout, wide = 350 / layout.width, tall = 150 / layout.height;
  svg.setAttribute("viewBox", "0 0 356 156");
  svg.replaceChildren();
  const point = i => [3 + (places[i][0] + 0.5) * wide, 3 + (places[i][1] + 0.5) * tall];
  const edge = (i, kind) => {
    const [x0, y0] = point(parents[i]), [x1, y1] = point(i);
    make(svg, "line", {x1: x0, y1: y0, x2: x1, y2: y1, class: kind});
  };
  const dot = (i, radius, kind) => {
    const [cx, cy] = point(i);
    make(svg, "circle", {cx, cy, r: radius, class: kind});
  };
  places.forEach((_, i) => { if (i) edge(i, "t-edge"); });
  const now = step ? steps[step - 1] : null;
  const seen = new Set();
  for (const one of steps.slice(0, step)) for (const spot of [one.a, one.b]) if (spot) seen.add(spot[0]);
  if (now && now.b) for (let i = now.b[0]; parents[i] !== undefined; i = parents[i]) edge(i, "t-path");
  places.forEach((_, i) => {
    if (!seen.has(i)) dot(i, 1.1, "t-node");
    else dot(i, 2.6, drawing.children[i] ? "t-seen" : "t-leaf");
  });
  for (const spot of now && now.q || []) dot(spot[0], 3.6, "t-aside");
  if (now && now.b) dot(now.b[0], 4.6, "t-here");
}

function fillComparison(shown, choose) {
  const {content, walks, panel} = shown;
  const extra = sum => (sum.restarts || 0) + (sum.backtrack_steps || 0) + (sum.pops || 0) + (sum.link_nodes || 0);
  const head = element("tr", {}, ...["", "steps", "tests", "more", "kernels"].map((text, i) =>
    element(i ? "td" : "th", i === 3 ? {title: "pops, restarts, steps up or separation planes"} : {}, text)));
  const rows = content.panels.map(({key, title}) => {
    const steps = walks[key], sum = steps.length ? steps[steps.length - 1].sum : {};
    const button = element("button", {type: "button"}, title);
    button.addEventListener("click", () => choose(key));
    const kinds = {"kdtree-stack": "pops", "kdtree-restart": "restarts", "kdtree-backtrack": "up", "graph": "planes"};
    const more = kinds[key] ? `${extra(sum)} ${kinds[key]}` : "";
    return element("tr", key === panel ? {class: "here"} : {}, element("th", {scope: "row"}, button),
      ...[sum.steps || 0, sum.tests || 0, more, steps.length].map(n => element("td", {}, String(n))));
  });
  byId("compare").replaceChildren(head, ...rows);
}

function fillLegend(shown, most) {
  const entry = (text, style) => {
    const mark = element("i", {});
    mark.style.cssText = style;
    return element("span", {}, mark, text);
  };
  const {panel, heat, measure} = shown;
  if (heat) {
    const colors = shown.content.heat.ramp.map(([r, g, b]) => `rgb(${r} ${g} ${b})`).join(",");
    const scale = element("i", {class: "scale"});
    scale.style.background = `linear-gradient(90deg, ${colors})`;
    const unit = measure === "tests" ? "triangles tested" : "steps";
    const what = heat === "fan" ? "in each direction" : "a ray, mean of all directions";
    byId("legend").replaceChildren(
      element("span", {}, "0", scale, `${Math.round(most)} ${unit} ${what}; one scale for all five`));
    return;
  }
  const entries = [
    entry("where the ray is now", "background:var(--here);border-color:var(--edge)"),
    entry(panel === "graph" ? "sectors seen" : panel === "grid" ? "cells seen" : "leaves seen",
      "background:var(--visited);border-color:var(--cells)"),
    entry("tested now", "background:var(--tested)"),
    entry("tested before", "background:var(--before)"),
    entry("nearest hit so far", "background:var(--hit)"),
    entry("the ray's interval", "background:var(--ray);height:5px"),
  ];
  if (panel === "kdtree-stack") entries.push(entry("on the stack", "background:var(--aside);border-color:var(--aside-edge)"));
  if (panel === "graph") entries.push(entry("links of this sector", "background:var(--aside-edge);height:2px"));
  byId("legend").replaceChildren(...entries);
}
