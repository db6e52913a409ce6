"use strict";
// The plan: walls, cells and the ray, drawn as SVG. y points up in the plan, so it is negated here.

const SVG = "http://www.w3.org/2000/svg";

function make(parent, name, attributes, text) {
  const one = document.createElementNS(SVG, name);
  for (const key in attributes) one.setAttribute(key, attributes[key]);
  if (text !== undefined) one.textContent = text;
  parent.append(one);
  return one;
}

function drawBox(parent, box, kind) {
  const [x0, y0, x1, y1] = box;
  return make(parent, "rect", {x: x0, y: -y1, width: x1 - x0, height: y1 - y0, class: kind});
}

function drawLine(parent, x0, y0, x1, y1, kind) {
  return make(parent, "line", {x1: x0, y1: -y0, x2: x1, y2: -y1, class: kind});
}

function drawDot(parent, x, y, radius, kind) {
  return make(parent, "circle", {cx: x, cy: -y, r: radius, class: kind});
}

const middle = box => [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2];

// The colour of a share of the maximum, interpolated on the ramp.
function heatColor(ramp, share) {
  const at = Math.max(0, Math.min(1, share)) * (ramp.length - 1), i = Math.min(Math.floor(at), ramp.length - 2);
  const mixed = [0, 1, 2].map(k => Math.round(ramp[i][k] + (at - i) * (ramp[i + 1][k] - ramp[i][k])));
  return `rgb(${mixed.join(" ")})`;
}

class Plan {
  constructor(svg, content) {
    this.svg = svg;
    this.content = content;
    this.heatLayer = make(svg, "g", {});
    this.cellLayer = make(svg, "g", {});
    this.wallLayer = make(svg, "g", {});
    this.rayLayer = make(svg, "g", {});
    const ends = content.plan.walls;
    const xs = ends.flatMap(w => [w[0], w[2]]), ys = ends.flatMap(w => [w[1], w[3]]);
    this.low = [Math.min(...xs), Math.min(...ys)];
    this.high = [Math.max(...xs), Math.max(...ys)];
    const margin = 0.055 * Math.max(this.high[0] - this.low[0], this.high[1] - this.low[1]);
    this.view = [
      this.low[0] - margin, -this.high[1] - margin,
      this.high[0] - this.low[0] + 2 * margin, this.high[1] - this.low[1] + 2 * margin,
    ];
    this.walls = ends.map((w, i) => {
      const line = drawLine(this.wallLayer, ...w, "c-wall");
      make(line, "title", {}, content.plan.names[content.plan.owners[i]]);
      return line;
    });
  }

  // A point of the ray, and where the ray leaves the view.
  at(ray, t) {
    return [ray.origin[0] + t * ray.direction[0], ray.origin[1] + t * ray.direction[1]];
  }

  farEnd(ray) {
    const [x, y, w, h] = this.view;
    return this.exit(ray, [x, -y - h], [x + w, -y]);
  }

  exit(ray, low, high) {
    let t = Infinity;
    for (const axis of [0, 1]) {
      const d = ray.direction[axis];
      if (Math.abs(d) > 1e-9) t = Math.min(t, ((d > 0 ? high : low)[axis] - ray.origin[axis]) / d);
    }
    return Math.max(t, 0);
  }

  draw(shown) {
    const {ray, drawing, steps, step, heat} = shown;
    this.cellLayer.replaceChildren();
    this.rayLayer.replaceChildren();
    const now = step ? steps[step - 1] : null;
    this.frame(shown, now);
    if (!heat) this.drawCells(drawing, steps, step, now);
    this.markWalls(steps, step, now, heat);
    if (!heat) this.drawRay(ray, now, now && ["shading", "done"].includes(shown.states[now.s]));
    else if (heat === "fan") drawDot(this.rayLayer, ...this.content.heat.fan.origin, 0.7 * this.unit, "c-origin");
  }

  frame({ray, zoom}, now) {
    let [x, y, w, h] = this.view;
    const spot = now && (now.b || now.a);
    if (zoom) {
      const t = spot ? spot[1] : 0;
      const far = spot && spot[2] !== null ? Math.min(spot[2], this.farEnd(ray)) : t;
      const [cx, cy] = this.at(ray, Math.min((t + far) / 2, t + 1.2 / Math.hypot(...ray.direction)));
      w /= 5, h /= 5, x = cx - w / 2, y = -cy - h / 2;
    }
    this.unit = w / 100;
    this.svg.setAttribute("viewBox", [x, y, w, h].map(n => n.toFixed(4)).join(" "));
  }

  drawCells(drawing, steps, step, now) {
    const layer = this.cellLayer, boxes = drawing.boxes;
    const isTree = drawing.children !== undefined;
    const seen = new Set();
    for (const one of steps.slice(0, step)) {
      if (one.a && (!isTree || drawing.children[one.a[0]] === 0)) seen.add(one.a[0]);
    }
    boxes.forEach((box, i) => {
      if (isTree && drawing.children[i] !== 0) return;
      drawBox(layer, box, seen.has(i) ? "c-visited" : "c-cell");
    });
    if (!now) return;
    for (const spot of now.q || []) drawBox(layer, boxes[spot[0]], "c-aside");
    if (drawing.links) this.drawLinks(drawing, steps, step, now);
    if (now.a && now.b && now.a[0] !== now.b[0]) drawBox(layer, boxes[now.a[0]], "c-at");
    if (now.b) drawBox(layer, boxes[now.b[0]], "c-here");
    if (isTree && now.kernel === "down") {
      const i = now.a[0], [x0, y0, x1, y1] = boxes[i], p = drawing.planes[i];
      if (drawing.axes[i] === 0) drawLine(layer, p, y0, p, y1, "c-plane");
      else drawLine(layer, x0, p, x1, p, "c-plane");
    }
  }

  drawLinks(drawing, steps, step, now) {
    const layer = this.cellLayer, boxes = drawing.boxes;
    const here = now.b ? now.b[0] : null;
    if (here !== null) {
      for (const other of drawing.links[here]) {
        drawLine(layer, ...middle(boxes[here]), ...middle(boxes[other]), "c-link");
        drawDot(layer, ...middle(boxes[other]), 0.35 * this.unit, "c-dot");
      }
    }
    for (const one of steps.slice(0, step)) {
      if (one.a && one.b && one.a[0] !== one.b[0]) {
        drawLine(layer, ...middle(boxes[one.a[0]]), ...middle(boxes[one.b[0]]), "c-went");
        drawDot(layer, ...middle(boxes[one.a[0]]), 0.5 * this.unit, "c-dot");
      }
    }
    if (here !== null) drawDot(layer, ...middle(boxes[here]), 0.6 * this.unit, "c-dot");
  }

  markWalls(steps, step, now, heat) {
    const before = new Set(), tested = new Set();
    let hit = -1;
    if (!heat) {
      for (const one of steps.slice(0, step)) for (const id of one.x || []) before.add(id >> 1);
      if (now) {
        for (const id of now.x || []) tested.add(id >> 1);
        if (now.p !== undefined) hit = now.p >> 1;
      }
    }
    this.walls.forEach((line, i) => {
      const kind = i === hit ? "c-hitwall" : tested.has(i) ? "c-tested" : before.has(i) ? "c-before" : "c-wall";
      line.setAttribute("class", kind);
    });
  }

  drawRay(ray, now, isOver) {
    const layer = this.rayLayer, far = this.farEnd(ray);
    const line = (t0, t1, kind) => {
      if (t1 > t0) drawLine(layer, ...this.at(ray, t0), ...this.at(ray, t1), kind);
    };
    // The last cells of a grid are unbounded; the part that counts ends with the scene's box.
    const end = this.exit(ray, this.low, this.high);
    const cut = t => t === null || t > end ? end : t;
    const spot = now && now.b;
    line(0, far, "c-rest");
    if (isOver && now.p !== undefined) line(0, now.t, "c-done");
    else if (spot) {
      line(0, cut(spot[1]), "c-done");
      line(cut(spot[1]), cut(spot[2]), "c-now");
    }
    if (now && now.p !== undefined) drawDot(layer, ...this.at(ray, now.t), 0.6 * this.unit, "c-hit");
    drawDot(layer, ...this.at(ray, 0), 0.7 * this.unit, "c-origin");
  }

  // Heat maps; returns the largest number, for the legend.
  drawHeat(heat, measure, panel) {
    const layer = this.heatLayer;
    layer.replaceChildren();
    this.svg.classList.toggle("heated", heat !== "");
    if (!heat) return 0;
    const found = this.content.heat[heat], ramp = this.content.heat.ramp;
    const most = Math.max(1, ...Object.values(found[measure]).flatMap(row => row));
    const values = found[measure][panel];
    if (heat === "places") {
      const [rows, columns] = found.shape, [x0, y0, x1, y1] = found.box;
      const w = (x1 - x0) / columns, h = (y1 - y0) / rows;
      values.forEach((n, i) => {
        const x = x0 + (i % columns) * w, y = y0 + Math.floor(i / columns) * h;
        const fill = heatColor(ramp, n / most);
        const one = make(layer, "rect", {x, y: -y - h, width: w, height: h, fill, stroke: fill});
        make(one, "title", {}, `${n} ${measure} per ray`);
      });
      return most;
    }
    values.forEach((n, i) => {
      const turn = 2 * Math.PI / values.length, ray = {origin: found.origin};
      const corner = k => {
        ray.direction = [Math.cos(turn * k), Math.sin(turn * k)];
        const t = found.t[i] === null ? this.farEnd(ray) : found.t[i];
        const [x, y] = this.at(ray, t);
        return `${x.toFixed(3)},${(-y).toFixed(3)}`;
      };
      const [x, y] = found.origin;
      const points = `${x},${-y} ${corner(i - 0.5)} ${corner(i + 0.5)}`;
      const fill = heatColor(ramp, n / most);
      const one = make(layer, "polygon", {points, fill, stroke: fill});
      make(one, "title", {}, `${n} ${measure}`);
    });
    return most;
  }
}
