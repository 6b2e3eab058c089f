// Now: why first and largest, then both controllers, battery, wheels, inertial unit.

import { h, setData, setHidden, setStyle, setText } from "/dom.js";
import { age, fixed } from "/format.js";
import { hasClock, messageAge, model, monotonicNow, reading, safely, stateAge } from "/model.js";
import { barOf, valueOf } from "/values.js";

const drawers = [];
const EFFECT_TONES = { stop: "bad", cut: "bad" };
const WHY_OLD_AFTER_MS = 2000; // it comes every second, and where it changes

export function build(root) {
  root.append(why(), controller("PCU1"), controller("PCU2"), battery(), wheels(), inertial());
}

export function draw() {
  for (const one of drawers) safely("now", one);
}

function panel(name, title, messages, ...children) {
  const ages = h("span.age");
  drawers.push(() => {
    const texts = messages.map((message) => age(messageAge(message)));
    setText(ages, messages.length ? `age ${texts.join(" · ")}` : "");
  });
  return h(`section.panel.${name}`, { "aria-label": title }, h("header", {}, h("h2", {}, title), ages), ...children);
}

// Why.

function why() {
  const sentence = h("p.sentence", {}, "–");
  const spoken = h("p.unseen", { role: "status" });
  let meaning = "";
  const next = h("span");
  const nextLine = h("p.next", { hidden: true }, h("b", {}, "Next: "), next);
  const line = h("p.why-line", { hidden: true });
  const causes = h("ul.causes");
  const demand = h("p.demand");
  const element = h("section.panel.why", { "aria-label": "Why" }, h("h2", {}, "Why"), sentence, spoken, h("div.reasons", {}, line, nextLine, causes, demand));
  drawers.push(() => {
    const now = model.why;
    const stop = model.state?.stop;
    if (stop) setText(sentence, stop.sentence);
    if (!now) return;
    // A stop is told by the state, and is as old as that.
    setData(element, "old", isOld(now) ? (stop ? "reasons" : "all") : null);
    if (!stop) setText(sentence, now.summary || heading(now));
    setText(line, heading(now));
    setHidden(line, !stop && !now.summary);
    // Read aloud where its words change, not its numbers.
    const said = stop ? stop.sentence : now.summary || now.sentence;
    if (said.replace(/[\d.]+/g, "") !== meaning) {
      meaning = said.replace(/[\d.]+/g, "");
      setText(spoken, said);
    }
    setText(next, now.next_step);
    setHidden(nextLine, !now.next_step);
    setData(element, "tone", now.blocks.length || now.mode === "fault" ? "bad" : now.limits.length ? "warn" : now.mode === "active" ? "good" : "calm");
    drawCauses(causes, now);
    setText(demand, now.demand ? demandText(now.demand) : "");
    setHidden(demand, !now.demand);
  });
  return element;
}

/** A reason is old where the mode has changed since, whatever its age. */
function isOld({ mode, t }) {
  return mode !== model.state?.mode || (hasClock() && monotonicNow() - t > WHY_OLD_AFTER_MS);
}

/** The gateway's sentence without what stands below it: the next step, and the demand's age. */
function heading({ sentence, next_step: next }) {
  const end = `; ${next}`;
  const text = next && sentence.endsWith(end) ? sentence.slice(0, -end.length) : sentence;
  return text.replace(/(; demand of \S+) \d+ ms old/, "$1");
}

function drawCauses(list, now) {
  const since = Math.max(0, stateAge());
  const rows = [
    ...["blocks", "limits", "alarms"].flatMap((kind) => now[kind].map((one) => ({ kind, ...one }))),
    ...now.waits.map((text) => ({ kind: "waits", effect: "waits for", subject: text, detail: "" })),
  ];
  while (list.children.length > rows.length) list.lastChild.remove();
  while (list.children.length < rows.length) {
    list.append(h("li", {}, h("span.effect"), h("span.what"), h("span.age")));
  }
  rows.forEach((row, index) => {
    const [effect, what, ages] = list.children[index].children;
    setData(list.children[index], "kind", row.kind);
    setText(effect, EFFECT_TONES[row.effect] ? row.effect.toUpperCase() : row.effect);
    setText(what, `${row.subject}${row.detail ? `: ${row.detail}` : ""}${row.stands === false ? " (gone, held a while)" : ""}`);
    setText(ages, row.since_ms == null ? "" : `for ${age(row.since_ms + (Number.isFinite(since) ? since : 0))}`);
  });
}

function demandText(demand) {
  const made = demand.age_ms == null ? "" : `, made ${age(demand.age_ms)} ago`;
  return `Demand of ${demand.source}${made}${demand.fresh ? "" : ": no longer in effect"}`;
}

// A controller: commanded beside actual.

function controller(name) {
  const status1 = (signal) => `${name}_Status1.${signal}`;
  const status2 = (signal) => `${name}_Status2.${signal}`;
  const command = () => model.state?.commands[name];
  const body = h("tbody");
  const percent = (label, key, signal) =>
    body.append(compared(label, status1(signal), "%", () => command()?.[key], (value) => fixed(value, 1), 99.45, true));
  const limit = (label, key, signal, unit) =>
    body.append(compared(label, signal, unit, () => command()?.[key], (value) => `≤ ${fixed(value, 0)}`, null, false));
  const word = (label, signal, text) => body.append(worded(label, status1(signal), () => command() && text(command())));
  percent("Throttle", "throttle_pct", "Throttle");
  percent("Brake", "brake_pct", "Brake");
  word("Mode", "PowerMode", (one) => one.power_mode);
  word("Direction", "MotorReverse", (one) => either(one.motor_reverse, "reverse", "forward"));
  word("Regeneration", "RegenBrake", (one) => either(one.regen_brake, "on", "off"));
  word("Power", "PowerCut", (one) => either(one.power_cut, "cut", "normal"));
  limit("Speed", "speed_limit_rpm", status2("MotorSpeed"), "rpm");
  body.append(power(name, command));
  const more = rows(
    ["Battery", status2("BatteryVoltage"), status2("BatteryCurrent")],
    ["Phase", status2("PhaseCurrent")],
    ["Controller, motor", status1("ControllerTemperature"), status1("MotorTemperature")],
    ["Protection", status1("TemperatureProtectLevel"), status1("VoltageLevel")],
  );
  const frames = h("p.muted.frames");
  drawers.push(() => setText(frames, framesText(command())));
  const head = h("tr", {}, ...["", "Commanded", "Actual", "Deviation"].map((text, index) => h(index ? "th.n" : "td", index ? { scope: "col" } : {}, text)), h("td.bar-cell"));
  return panel("controller", name, [`${name}_Status1`, `${name}_Status2`], h("table", {}, h("thead", {}, head), body), more, frames);
}

const either = (value, yes, no) => (value == null ? null : value ? yes : no);

/** The frame that the kernel took last, and whether it was back from the bus; old ones get older. */
function framesText(command) {
  if (!command?.sent) return command?.decided ? `Not sent: ${command.decided}` : "Nothing sent";
  const { sent, echoed } = command;
  const back = !echoed ? "never back from the bus" : `back from the bus ${agoText(echoed)}${echoed.frame === sent.frame ? "" : `: ${echoed.frame}`}`;
  return `Sent ${agoText(sent)}: ${sent.frame}, ${back}`;
}

const agoText = (frame) => `${age(frame.age_ms + stateAge())} ago`;

function compared(label, key, unit, commanded, text, full, deviates) {
  const actual = valueOf(key, { unit: false });
  const bar = barOf(key, full ? { maximum: full } : {});
  const wanted = h("td.n");
  const deviation = h("td.n");
  drawers.push(() => {
    const value = commanded();
    const now = actual.draw();
    bar.draw(value);
    setText(wanted, value == null ? "–" : text(value));
    const known = deviates && value != null && now.value != null && now.quality !== "stale";
    setText(deviation, known ? signed(now.value - value) : deviates ? "–" : "");
    setOff(deviation, known && Math.abs(now.value - value) > 5);
  });
  return row(`${label} ${unit}`, wanted, actual.element, deviation, bar.element);
}

const signed = (value) => (value > 0 && fixed(value, 1) !== "0.0" ? "+" : "") + fixed(value, 1);
const setOff = (element, off) => element.classList.toggle("off", Boolean(off));

function worded(label, key, commanded) {
  const actual = valueOf(key);
  const wanted = h("td.n");
  const deviation = h("td.n");
  drawers.push(() => {
    const text = commanded();
    const now = actual.draw();
    setText(wanted, text ?? "–");
    const differs = text != null && now.value != null && now.quality !== "stale" && now.text !== text;
    setText(deviation, differs ? "differs" : "");
    setOff(deviation, differs);
  });
  return row(label, wanted, actual.element, deviation, "");
}

function power(name, command) {
  const keys = [`${name}_Status2.BatteryVoltage`, `${name}_Status2.BatteryCurrent`];
  const actual = h("span.v");
  const wanted = h("td.n");
  drawers.push(() => {
    const [voltage, current] = keys.map(reading);
    const known = voltage.value != null && current.value != null;
    setText(actual, known ? fixed(voltage.value * current.value, 0) : "–");
    setData(actual, "q", voltage.quality === "live" ? current.quality : voltage.quality);
    const limit_w = command()?.power_limit_w;
    setText(wanted, limit_w == null ? "–" : `≤ ${fixed(limit_w, 0)}`);
  });
  return row("Power W", wanted, actual, h("td.n"), "");
}

function row(label, wanted, actual, deviation, bar) {
  return h("tr", {}, h("th", { scope: "row" }, label), wanted, h("td.n", {}, actual), deviation, h("td.bar-cell", {}, bar));
}

// Battery, wheels, inertial unit.

function rows(...lines) {
  const cells = lines.flatMap(([name, ...keys]) => {
    const values = keys.map((key) => valueOf(key));
    drawers.push(() => values.forEach((one) => one.draw()));
    const shown = values.flatMap((one, index) => (index ? [" · ", one.element] : [one.element]));
    return [h("span.name", {}, name), h("span.wide", {}, ...shown)];
  });
  return h("div.rows", {}, ...cells);
}

function barred(name, key, options) {
  const value = valueOf(key);
  const bar = barOf(key, options);
  drawers.push(() => {
    value.draw();
    bar.draw();
  });
  return [h("span.name", {}, name), bar.element, h("span.n", {}, value.element)];
}

const LEVELS = ["CellOvervoltage", "CellUndervoltage", "DischargeOvercurrent", "TemperatureImbalance", "Overtemperature", "Undertemperature", "VoltageImbalance", "InternalFault"];

function battery() {
  const soc = valueOf("BMS_Status.SOC", { tag: "p" });
  soc.element.classList.add("big");
  const bar = barOf("BMS_Status.SOC");
  const levels = h("span.wide.v");
  drawers.push(() => {
    const now = soc.draw();
    bar.draw();
    setData(bar.element, "low", now.value != null && now.value <= 15 ? "" : null);
    const all = LEVELS.map((name) => [name, reading(`BMS_Status.${name}`)]);
    const wrong = all.filter(([, one]) => one.value !== 0);
    const unknown = wrong.some(([, one]) => one.value == null);
    setText(levels, unknown ? "not known" : wrong.map(([name, one]) => `${name} ${one.text}`).join(", ") || "all normal");
    setData(levels, "q", wrong.length && !unknown ? "range" : all[0][1].quality);
  });
  const temperatures = [1, 2, 3, 4, 5].map((number) => `BMS_Temperatures.PackTemperature${number}`);
  const table = rows(["Voltage", "BMS_Status.PackVoltage"], ["State", "BMS_Status.BatteryState"], ["Temperatures", ...temperatures]);
  table.append(h("span.name", {}, "Levels"), levels);
  return panel("battery", "Battery", ["BMS_Status", "BMS_Temperatures"], h("div.soc", {}, soc.element, bar.element), table);
}

function wheels() {
  const lines = [
    barred("Front left", "ARD2_SteeringWheel.WheelSpeedFL"),
    barred("Front right", "ARD2_SteeringWheel.WheelSpeedFR"),
    barred("Motor PCU1", "PCU1_Status2.MotorSpeed"),
    barred("Motor PCU2", "PCU2_Status2.MotorSpeed"),
    barred("Steering", "ARD2_SteeringWheel.SteeringAngle", { centred: true }),
  ];
  return panel("wheels", "Wheels", ["ARD2_SteeringWheel"], h("div.rows", {}, ...lines.flat()));
}

function inertial() {
  const axes = (message, maximum) => ["X", "Y", "Z"].map((axis) => barred(axis, `IMU_${message}${axis}`, { centred: true, maximum }));
  const groups = [
    ["Acceleration", axes("Acceleration.Acceleration", 20)],
    ["Angular rate", axes("AngularRate.AngularRate", 90)],
    ["Attitude", axes("Attitude.Attitude", 45)],
  ];
  const lines = groups.flatMap(([title, three]) => [h("h3", {}, title), ...three.flat()]);
  return panel("imu", "Inertial unit", ["IMU_Acceleration", "IMU_AngularRate", "IMU_Attitude"], h("div.rows", {}, ...lines));
}
