"use strict";
// Choices, steps and playback; they are part of the page's address.
//
// A step: k kernel, s state after it, w sentence, r source (numbers of strings); c counts that
// it added, as [column, number]; a where the ray was, b where it is, q its stack, each as [number,
// t_in, t_out] with null for infinity; x triangles tested; t and p the nearest hit so far.

const content = JSON.parse(byId("content").textContent);
const plan = new Plan(byId("plan"), content);
const chosen = {ray: 0, panel: content.panels[0].key, step: 0, heat: "", measure: "steps", zoom: false, theme: ""};
let timer = null;

for (const key in content.drawings) {
  const same = content.drawings[key].same;
  if (same) content.drawings[key] = content.drawings[same];
}
for (const ray of content.rays) {
  for (const key in ray.walks) {
    let sum = {}, depth = 0;
    for (const step of ray.walks[key]) {
      step.kernel = content.strings[step.k];
      sum = {...sum};
      for (const [column, n] of step.c) {
        const name = content.columns[column];
        sum[name] = (sum[name] || 0) + n;
      }
      const grown = (step.q || []).length - depth;
      if (grown > 0) sum.pushes = (sum.pushes || 0) + grown;
      if (grown < 0) sum.pops = (sum.pops || 0) - grown;
      depth += grown;
      step.sum = sum;
    }
  }
}

const steps = () => content.rays[chosen.ray].walks[chosen.panel];

function readAddress() {
  const given = new URLSearchParams(location.hash.slice(1));
  const known = content.panels.map(panel => panel.key);
  const whole = (name, most) => Math.max(0, Math.min(most, parseInt(given.get(name), 10) || 0));
  chosen.ray = whole("ray", content.rays.length - 1);
  chosen.panel = known.includes(given.get("structure")) ? given.get("structure") : known[0];
  chosen.step = whole("step", steps().length);
  chosen.heat = ["fan", "places"].includes(given.get("heat")) ? given.get("heat") : "";
  chosen.measure = given.get("measure") === "tests" ? "tests" : "steps";
  chosen.zoom = given.get("zoom") === "1";
  chosen.theme = ["light", "dark"].includes(given.get("theme")) ? given.get("theme") : "";
}

function writeAddress() {
  const given = new URLSearchParams({ray: chosen.ray, step: chosen.step, structure: chosen.panel});
  if (chosen.heat) given.set("heat", chosen.heat);
  if (chosen.measure !== "steps") given.set("measure", chosen.measure);
  if (chosen.zoom) given.set("zoom", "1");
  if (chosen.theme) given.set("theme", chosen.theme);
  try {
    history.replaceState(null, "", `#${given}`);
  } catch { /* no address to update, as in a frame */ }
}

function show() {
  const ray = content.rays[chosen.ray], walk = steps();
  const shown = {
    ...chosen, content, ray, walks: ray.walks, steps: walk, drawing: content.drawings[chosen.panel],
    states: content.states, strings: content.strings,
  };
  if (chosen.theme) document.documentElement.dataset.theme = chosen.theme;
  else delete document.documentElement.dataset.theme;
  byId("ray").value = chosen.ray;
  byId("heat").value = chosen.heat;
  byId("measure").value = chosen.measure;
  byId("measure").disabled = !chosen.heat;
  byId("zoom").checked = chosen.zoom;
  byId("slider").max = walk.length;
  byId("slider").value = chosen.step;
  byId("where").textContent = `${chosen.step} of ${walk.length}`;
  byId("note").textContent = ray.note;
  for (const tab of byId("tabs").children) {
    const selected = tab.dataset.key === chosen.panel;
    tab.setAttribute("aria-selected", selected);
    tab.tabIndex = selected ? 0 : -1;
  }
  const title = content.panels.find(panel => panel.key === chosen.panel).title;
  byId("plan-title").textContent = `${title}: ${ray.name}, step ${chosen.step} of ${walk.length}`;
  const most = plan.drawHeat(chosen.heat, chosen.measure, chosen.panel);
  plan.draw(shown);
  fillNow(shown);
  fillCounts(shown);
  fillStack(shown);
  fillTree(shown);
  fillComparison(shown, choosePanel);
  fillLegend(shown, most);
  drawStrip(walk);
  writeAddress();
}

function drawStrip(walk) {
  const canvas = byId("strip"), ratio = devicePixelRatio || 1;
  const width = canvas.clientWidth || 600, height = canvas.clientHeight || 18;
  canvas.width = width * ratio;
  canvas.height = height * ratio;
  const pen = canvas.getContext("2d");
  const each = canvas.width / Math.max(walk.length, 1);
  const probe = element("i", {hidden: ""});
  document.body.append(probe);
  const names = [...new Set(walk.map(step => step.kernel))];
  const colors = Object.fromEntries(names.map(name => {
    probe.style.color = kernelColor(name);
    return [name, getComputedStyle(probe).color];
  }));
  probe.remove();
  walk.forEach((step, i) => {
    pen.globalAlpha = i < chosen.step ? 1 : 0.35;
    pen.fillStyle = colors[step.kernel];
    pen.fillRect(i * each, 0, Math.max(each - (each > 4 ? ratio : 0), 1), canvas.height);
  });
  pen.globalAlpha = 1;
  pen.fillStyle = getComputedStyle(document.body).color;
  if (chosen.step) pen.fillRect(chosen.step * each - 2 * ratio, 0, 2 * ratio, canvas.height);
  byId("kernels").replaceChildren(...names.map(name => {
    const mark = element("i", {});
    mark.style.background = kernelColor(name);
    return element("span", {}, mark, `${name} ${walk.filter(step => step.kernel === name).length}`);
  }));
}

function goTo(step) {
  chosen.step = Math.max(0, Math.min(steps().length, step));
  chosen.heat = "";  // it would hide the step
  if (chosen.step === steps().length) pause();
  show();
}

function pause() {
  clearInterval(timer);
  timer = null;
  byId("play").textContent = "▶ Play";
  byId("play").setAttribute("aria-label", "Play");
}

function playOrPause() {
  if (timer !== null) return pause();
  if (chosen.step === steps().length) goTo(0);
  timer = setInterval(() => goTo(chosen.step + 1), 650);
  byId("play").textContent = "Pause";
  byId("play").setAttribute("aria-label", "Pause");
}

// Another structure shows the same part of the ray: the first step that reaches as far.
function choosePanel(key) {
  const reached = step => step && (step.b || step.a) ? (step.b || step.a)[1] : -1;
  const old = steps(), was = chosen.step;
  const t = was ? reached(old[was - 1]) : -1;
  const isAtEnd = was === old.length;
  chosen.panel = key;
  const next = steps().findIndex(step => reached(step) >= t);
  chosen.step = !was ? 0 : isAtEnd || next < 0 ? steps().length : next + 1;
  show();
}

function chooseRay(number) {
  pause();
  chosen.ray = (number + content.rays.length) % content.rays.length;
  chosen.step = 0;
  show();
}

function onKey(event) {
  if (event.altKey || event.ctrlKey || event.metaKey) return;
  const isField = ["SELECT", "INPUT"].includes(event.target.tagName);
  if (isField && event.target.id !== "slider") return;
  if (event.key === " " && event.target.tagName === "BUTTON") return;
  const actions = {
    ArrowLeft: () => goTo(chosen.step - 1), ArrowRight: () => goTo(chosen.step + 1),
    Home: () => goTo(0), End: () => goTo(steps().length), " ": playOrPause,
    n: () => chooseRay(chosen.ray + 1), z: () => { chosen.zoom = !chosen.zoom; show(); },
  };
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  const panel = content.panels[parseInt(key, 10) - 1];
  const act = panel ? () => choosePanel(panel.key) : actions[key];
  if (!act) return;
  event.preventDefault();
  act();
}

content.rays.forEach((ray, i) => byId("ray").append(element("option", {value: i}, ray.name)));
for (const {key, title} of content.panels) {
  const tab = element("button", {type: "button", role: "tab", "aria-controls": "panel"}, title);
  tab.dataset.key = key;
  tab.addEventListener("click", () => choosePanel(key));
  byId("tabs").append(tab);
}
byId("ray").addEventListener("change", event => chooseRay(Number(event.target.value)));
for (const name of ["heat", "measure"]) {
  byId(name).addEventListener("change", event => { pause(); chosen[name] = event.target.value; show(); });
}
byId("zoom").addEventListener("change", event => { chosen.zoom = event.target.checked; show(); });
byId("theme").addEventListener("click", () => {
  const isDark = chosen.theme ? chosen.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  chosen.theme = isDark ? "light" : "dark";
  show();
});
byId("first").addEventListener("click", () => goTo(0));
byId("back").addEventListener("click", () => goTo(chosen.step - 1));
byId("forward").addEventListener("click", () => goTo(chosen.step + 1));
byId("last").addEventListener("click", () => goTo(steps().length));
byId("play").addEventListener("click", playOrPause);
byId("slider").addEventListener("input", event => goTo(Number(event.target.value)));
byId("strip").addEventListener("click", event => {
  const box = event.target.getBoundingClientRect();
  goTo(Math.ceil((event.clientX - box.left) / box.width * steps().length));
});
addEventListener("keydown", onKey);
addEventListener("resize", show);
addEventListener("hashchange", () => { pause(); readAddress(); show(); });
readAddress();
show();
