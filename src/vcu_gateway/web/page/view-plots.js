// Plots of any signals over the last ten minutes, which the server keeps.

import { h, setText } from "/dom.js";
import { clockTime, fixed, unitText } from "/format.js";
import { model, reading, signalKeys, signalOf, wallOf } from "/model.js";
import { request, sentence } from "/requests.js";

const MOST = 8;
const STEP_MS = 100;
const GAP_STEPS = 3;
const LONGEST_STEP_MS = 2000; // a slow network brings fewer states
const TRY_AGAIN_MS = 2000;
const COLOURS = ["#5aa9ff", "#ff9f57", "#45d69a", "#e57bd8", "#d9c24a", "#8f8cff", "#ff7a74", "#4fd4d8"];
const COMMANDED = { throttle_pct: "%", brake_pct: "%", speed_limit_rpm: "rpm", power_limit_w: "W" };
const FIRST = ["PCU1.commanded.throttle_pct", "PCU1_Status1.Throttle", "PCU1_Status2.MotorSpeed", "PCU2_Status2.MotorSpeed", "BMS_Status.PackVoltage"];

let chosen = read();
let minutes = 1;
let times = []; // monotonic, ms
let step = STEP_MS; // between two states, lately
const columns = new Map();
let loaded = "";
let isLoading = false;
let tryAfter = 0;
let charts = [];
let chips, input, list, area, status, ranges;
let drawn = 0;

function read() {
  try {
    const kept = JSON.parse(localStorage.getItem("plots"));
    return Array.isArray(kept) && kept.length ? kept.slice(0, MOST) : FIRST;
  } catch {
    return FIRST;
  }
}

export function build(root) {
  list = h("datalist", { id: "plot-names" });
  input = h("input", { type: "search", list: "plot-names", placeholder: "Add a signal", "aria-label": "Add a signal to the plots", onchange: choose });
  ranges = h("div.ranges", { role: "group", "aria-label": "Time shown" }, ...[1, 3, 10].map((one) => h("button", { type: "button", "aria-pressed": String(one === minutes), onclick: () => setMinutes(one) }, `${one} min`)));
  status = h("span.muted", { role: "status" });
  chips = h("ul.chips", { "aria-label": "Signals shown" });
  area = h("div.charts");
  root.append(h("div.tools", {}, input, list, ranges, status), chips, area);
}

export function addPlot(key) {
  if (!chosen.includes(key)) chosen = [...chosen.slice(-(MOST - 1)), key];
  changed();
  location.hash = "#plots";
}

export function show() {
  loaded = "";
  renderChips();
  load();
}

function choose() {
  const key = input.value.trim();
  if (!allKeys().includes(key)) return;
  input.value = "";
  if (chosen.length >= MOST) {
    setText(status, `at most ${MOST} signals: remove one first`);
    return;
  }
  if (!chosen.includes(key)) chosen = [...chosen, key];
  changed();
}

function changed() {
  localStorage.setItem("plots", JSON.stringify(chosen));
  renderChips();
  load();
}

function setMinutes(number) {
  minutes = number;
  [...ranges.children].forEach((button, index) => button.setAttribute("aria-pressed", String([1, 3, 10][index] === number)));
  drawCharts();
}

function allKeys() {
  const commanded = Object.keys(model.state?.commands ?? {}).flatMap((name) => Object.keys(COMMANDED).map((key) => `${name}.commanded.${key}`));
  return [...signalKeys(), ...commanded];
}

function renderChips() {
  chips.replaceChildren(...chosen.map((key, index) => {
    const remove = () => {
      chosen = chosen.filter((one) => one !== key);
      changed();
    };
    const sample = h("i");
    sample.style.background = COLOURS[index];
    return h("li", {}, h("button", { type: "button", "aria-label": `Remove ${key}`, onclick: remove }, sample, `${key} ×`));
  }));
  if (list.children.length < 8) list.replaceChildren(...allKeys().map((key) => h("option", { value: key })));
}

async function load() {
  const wanted = chosen.join(",");
  if (!wanted || wanted === loaded || isLoading || !model.definition || performance.now() < tryAfter) {
    if (!wanted) rebuild();
    return;
  }
  isLoading = true;
  try {
    const known = new Set(allKeys());
    const names = chosen.filter((key) => known.has(key));
    const path = `/api/history?points=2400&signals=${encodeURIComponent(names.join(","))}`;
    const history = names.length ? await request("GET", path) : { times_ms: [], values: {} };
    times = history.times_ms;
    columns.clear();
    for (const name of names) columns.set(name, history.values[name]);
    loaded = wanted;
    setText(status, "");
    rebuild();
  } catch (error) {
    setText(status, sentence(error));
    tryAfter = performance.now() + TRY_AGAIN_MS;
  } finally {
    isLoading = false;
  }
  if (chosen.join(",") !== wanted) load();
}

/** A live value is added to what the server had; a gap stays a gap. */
export function hear(section) {
  const state = model.state;
  if (section === "definition") loaded = "";
  if (section !== "state" || !columns.size || !state) return;
  const last = times.at(-1) ?? 0;
  if (state.t - last < STEP_MS) return;
  const apart = state.t - last;
  if (times.length && apart > GAP_STEPS * step) push(last + step, () => null);
  if (apart < LONGEST_STEP_MS) step = Math.max(STEP_MS, 0.8 * step + 0.2 * apart);
  push(state.t, live);
  const begin = state.t - 600_000;
  let drop = 0;
  while (times[drop] < begin) drop += 1;
  if (drop > 50) for (const column of [times, ...columns.values()]) column.splice(0, drop);
}

function push(time, value) {
  times.push(time);
  for (const [key, column] of columns) column.push(value(key));
}

function live(key) {
  const [controller, kind, name] = key.split(".");
  if (kind === "commanded") return model.state.commands[controller]?.[name] ?? null;
  const now = reading(key);
  return now.quality === "stale" || now.quality === "never" ? null : now.value;
}

const unitOf = (key) => (key.includes(".commanded.") ? COMMANDED[key.split(".")[2]] : signalOf(key)?.unit) || "code";

function rebuild() {
  for (const { plot } of charts) plot.destroy();
  const units = [...new Set([...columns.keys()].map(unitOf))];
  charts = units.map(chart);
  area.replaceChildren(...charts.map((one) => one.element));
  drawCharts();
}

const height = () => (matchMedia("(max-width: 36rem)").matches ? 190 : 240);

function chart(unit) {
  const keys = [...columns.keys()].filter((key) => unitOf(key) === unit);
  const holder = h("div", { role: "img", "aria-label": `Plot of ${keys.join(", ")}` });
  const element = h("section.panel", { "aria-label": `Plot, ${unit}` }, h("h2", {}, unitText(unit)), holder);
  const options = {
    pxAlign: 0,
    cursor: { y: false, drag: { x: false, y: false } },
    axes: Plots.axes(
      "line",
      { values: (_, splits) => splits.map((time) => clockTime(wallOf(time))), space: 90 },
      { size: 58, values: (_, splits, axis, space, step) => splits.map((value) => fixed(value, Plots.decimals(step))) },
    ),
    series: [{}, ...keys.map((key) => Plots.line({ label: key, stroke: COLOURS[chosen.indexOf(key)] }))],
  };
  return { element, plot: Plots.draw(holder, height, options, [[], ...keys.map(() => [])]), keys };
}

export function draw() {
  if (chosen.join(",") !== loaded) load();
  if (performance.now() - drawn > STEP_MS) drawCharts();
}

function drawCharts() {
  drawn = performance.now();
  if (!times.length) return;
  const end = times.at(-1);
  const begin = end - minutes * 60_000;
  const from = Math.max(0, times.findIndex((time) => time > begin) - 1); // the line comes in from the left
  for (const { plot, keys } of charts) {
    plot.setData([times, ...keys.map((key) => columns.get(key))].map((column) => column.slice(from)), false);
    plot.setScale("x", { min: begin, max: end });
  }
}
