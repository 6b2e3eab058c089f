// Tuning: the drive mode and its buttons, the pedals on CAN, and each curve with a dot where the
// vehicle is on it.

import { h, setData, setHidden, setStyle, setText } from "/dom.js";
import { model } from "/model.js";
import { request, sentence } from "/requests.js";

const EVERY_MS = 1000;
const OLD_AFTER_MS = 2500;
const WIDTH = 320;
const HEIGHT = 120;
const SVG = "http://www.w3.org/2000/svg";

let root;
let modes;
let said;
let grid;
let pedals;
let tuning = null;
let readAt = -Infinity;
let asked = -Infinity;
let problem = "";
const panels = new Map();

export function build(view) {
  root = view;
  said = h("p.muted", { role: "status" });
  modes = h("div.row", { role: "group", "aria-label": "Drive modes" });
  pedals = pedalsPanel();
  grid = h("div.figures", {}, pedals.element);
  root.append(h("section.panel", { "aria-label": "Drive mode" }, h("header", {}, h("h2", {}, "Drive mode")), modes, said), grid);
}

export function draw() {
  const now = performance.now();
  if (now - asked > EVERY_MS) {
    asked = now;
    read();
  }
  setData(root, "old", model.old || now - readAt > OLD_AFTER_MS ? "all" : null);
  if (!tuning) {
    setText(said, problem || "asking");
    return;
  }
  drawModes(tuning.drive_mode);
  drawPedals(tuning.pedals);
  drawCurves(tuning.curves);
}

async function read() {
  try {
    tuning = await request("GET", "/api/tuning", { timeout: 2000 });
    readAt = performance.now();
    problem = "";
  } catch (error) {
    problem = sentence(error);
  }
}

function drawModes(mode) {
  const names = mode?.modes ?? [];
  if (modes.children.length !== names.length) {
    modes.replaceChildren(...names.map((name) => h("button", { type: "button", onclick: () => ask(name) }, name)));
  }
  const may = model.rights.has("operate") && !model.old;
  const locked = mode?.left_by_service.includes(mode.current) && !model.rights.has("service");
  for (const button of modes.children) {
    const name = button.textContent;
    const disabled = !may || (locked && name !== mode.current);
    if (button.disabled !== disabled) button.disabled = disabled;
    button.setAttribute("aria-pressed", String(name === mode.current));
  }
  if (problem) setText(said, problem);
  else if (!mode) setText(said, "No drive modes are configured.");
  else if (mode.requested !== mode.current) setText(said, `${mode.current}; ${mode.requested} waits for the pedal's release`);
  else setText(said, locked ? `${mode.current}, left at service level` : mode.current);
}

async function ask(name) {
  const locked = tuning.drive_mode.left_by_service.includes(tuning.drive_mode.current);
  try {
    await request("POST", "/api/drive-mode", { json: { mode: name, level: locked ? "service" : "driver" }, timeout: 3000 });
    problem = "";
  } catch (error) {
    problem = `drive mode ${name}: ${sentence(error)}`;
  }
  asked = -Infinity;
}

const OF_PEDALS = [
  ["Throttle", "throttle_pct"],
  ["Second track", "throttle_track2_pct"],
  ["Difference", "difference_pct"],
  ["Brake", "brake_pct"],
];

function pedalsPanel() {
  const rows = OF_PEDALS.map(([name, key]) => {
    const fill = h("i");
    const value = h("span.n");
    const cells = [h("span.name", {}, name), h("span.bar", { "aria-hidden": "true" }, fill), value];
    return { key, fill, value, cells };
  });
  const title = h("h2", {}, "Pedals");
  const doubts = h("p.muted", { role: "status" });
  const cells = rows.flatMap((row) => row.cells);
  const element = h("section.panel", { "aria-label": "Pedals", hidden: true }, h("header", {}, title), h("div.rows", {}, ...cells), doubts);
  return { element, title, rows, doubts };
}

/** What a released pedal asks for is 0 %; what is not known has a dash. */
function drawPedals(now) {
  setHidden(pedals.element, !now);
  if (!now) return;
  setText(pedals.title, `Pedals: ${now.message}`);
  for (const { key, fill, value } of pedals.rows) {
    const percent = now[key];
    setStyle(fill, "--value", ((percent ?? 0) / 100).toFixed(3));
    setText(value, percent == null ? null : `${Math.round(percent)} %`);
  }
  setText(pedals.doubts, now.doubts.join("; "));
  setData(pedals.element, "tone", now.doubts.length ? "warn" : null);
}

function drawCurves(curves) {
  for (const [key, panel] of panels) {
    if (curves.some((one) => one.key === key)) continue;
    panel.element.remove();
    panels.delete(key);
  }
  for (const curve of curves) {
    const shape = JSON.stringify(curve.points);
    let panel = panels.get(curve.key);
    if (panel?.shape !== shape) {
      const made = curvePanel(curve, shape);
      if (panel) panel.element.replaceWith(made.element);
      else grid.append(made.element);
      panel = made;
      panels.set(curve.key, panel);
    }
    place(panel, curve);
  }
}

function curvePanel(curve, shape) {
  const xs = curve.points.map(([x]) => x);
  const ys = curve.points.map(([, y]) => y);
  const margin = (Math.max(...xs) - Math.min(...xs)) / 8;
  const span = { left: Math.min(...xs) - margin, right: Math.max(...xs) + margin, top: Math.max(...ys) || 1 };
  const at = (x, y) => [
    ((Math.min(Math.max(x, span.left), span.right) - span.left) / (span.right - span.left)) * WIDTH,
    HEIGHT - (y / span.top) * (HEIGHT - 8) - 4,
  ];
  const line = [[span.left, ys[0]], ...curve.points, [span.right, ys.at(-1)]].map(([x, y]) => at(x, y).join(",")).join(" ");
  const svg = drawn("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": curve.key, class: "curve" });
  const dot = drawn("circle", { r: 5 });
  svg.append(drawn("polyline", { points: line }), dot);
  const name = curve.key.replace("curves.", "");
  const now = h("p", {});
  const scale = h("div.histogram-scale", {}, h("span", {}, `${xs[0]} ${curve.input_unit}`), h("span", {}, `${xs.at(-1)} ${curve.input_unit}`));
  const element = h("section.panel", { "aria-label": name }, h("header", {}, h("h2", {}, name)), svg, scale, now);
  return { element, shape, at, dot, now };
}

function place(panel, curve) {
  setHidden(panel.dot, curve.x === null);
  if (curve.x !== null) {
    const [x, y] = panel.at(curve.x, curve.cap ?? 0);
    panel.dot.setAttribute("cx", x);
    panel.dot.setAttribute("cy", y);
  }
  const value = curve.x === null ? "not known" : `${+curve.x.toFixed(1)} ${curve.input_unit}`;
  const cap = curve.cap === null ? "no limit" : `at most ${Math.round(curve.cap)} ${curve.cap_unit}`;
  setText(panel.now, `${curve.input} ${value}: ${cap}`);
  setData(panel.element, "tone", curve.limits || curve.x === null ? "warn" : null);
}

function drawn(name, attributes) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  return element;
}

