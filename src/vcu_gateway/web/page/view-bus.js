// Bus and ticks: the interface, frames, lateness, the API, the process.

import { h, setData, setStyle, setText } from "/dom.js";
import { age, bytes, count, fixed } from "/format.js";
import { model, monotonicNow } from "/model.js";

const panels = [];
let histogram;

export function build(root) {
  const grid = h("div.figures");
  figures(grid, "Bus", bus);
  figures(grid, "Ticks", ticks);
  figures(grid, "Frames", frames);
  figures(grid, "API", api);
  figures(grid, "Process", process);
  figures(grid, "Configuration", configuration);
  root.append(grid);
}

export function draw() {
  if (!model.health) return;
  for (const one of panels) one(model.health);
}

function figures(grid, title, rows) {
  const lines = h("dl");
  const ages = h("span.age");
  const panel = h("section.panel", { "aria-label": title }, h("header", {}, h("h2", {}, title), ages), lines);
  if (title === "Ticks") {
    histogram = h("div.histogram", { role: "img" });
    panel.append(histogram, h("div.histogram-scale", {}, h("span", {}, "on time"), h("span", {}, "late")));
  }
  grid.append(panel);
  panels.push((health) => {
    setText(ages, `age ${age(Math.max(0, monotonicNow() - health.t))}`);
    fill(lines, understood(() => rows(health)));
    if (title === "Ticks") drawHistogram(health.ticks?.lateness_histogram);
  });
}

/** A part that is not there costs its own panel; the notes say which it is. */
function understood(rows) {
  try {
    return rows();
  } catch {
    return [["Not understood", "–", true]];
  }
}

function fill(lines, rows) {
  while (lines.children.length > 2 * rows.length) lines.lastChild.remove();
  while (lines.children.length < 2 * rows.length) lines.append(h("dt"), h("dd"));
  rows.forEach(([name, text, isBad], index) => {
    setText(lines.children[2 * index], name);
    setText(lines.children[2 * index + 1], text);
    setData(lines.children[2 * index + 1], "tone", isBad ? "bad" : null);
  });
}

function drawHistogram(told) {
  const bins = Array.isArray(told) ? told.filter((bin) => typeof bin?.ticks === "number") : [];
  const most = Math.max(1, ...bins.map((bin) => bin.ticks));
  while (histogram.children.length < bins.length) histogram.append(h("i"));
  bins.forEach((bin, index) => {
    const share = bin.ticks ? Math.max(0.03, Math.log1p(bin.ticks) / Math.log1p(most)) : 0;
    setStyle(histogram.children[index], "--share", share.toFixed(3));
  });
  const text = bins.map((bin) => `${bin.up_to_us == null ? "later" : `up to ${bin.up_to_us} µs`}: ${bin.ticks}`).join(", ");
  if (histogram.getAttribute("aria-label") !== text) histogram.setAttribute("aria-label", text);
}

const us = (value) => (typeof value !== "number" ? "–" : value < 1000 ? `${Math.round(value)} µs` : `${(value / 1000).toFixed(1)} ms`);
const reasons = (counts, name) => Object.entries(counts).map(([reason, number]) => [`${name}: ${reason}`, count(number), number > 0]);

function bus({ link }) {
  return [
    ["Interface", `${link.interface} ${link.channel}`],
    ["State", link.state, link.state !== "up"],
    ["For", age(link.since_ms)],
    ...(link.lost ? [["Lost", link.lost, true]] : []),
  ];
}

function ticks({ ticks: now }) {
  return [
    ["Period", `${now.period_ms} ms`],
    ["Done", count(now.done)],
    ["Skipped", count(now.skipped), now.skipped > 0],
    ["Silent", count(now.silent)],
    ["Lateness, median", us(now.lateness_p50_us)],
    ["Lateness, 99th percentile", us(now.lateness_p99_us)],
    ["Lateness, worst", us(now.lateness_max_us)],
  ];
}

function frames({ frames: now }) {
  return [
    ["Received", count(now.received)],
    ["Sent", count(now.sent)],
    ...Object.entries(now.confirmed).map(([name, number]) => [`Confirmed for ${name}`, count(number)]),
    ["Dropped by the kernel", count(now.dropped), now.dropped > 0],
    ["Out of order", count(now.out_of_order)],
    ["Not judged", count(now.unjudged), now.unjudged > 0],
    ...reasons(now.rejected, "Rejected"),
    ...reasons(now.unsent, "Not sent"),
    ...reasons(now.blocked_by_gate, "Blocked by the gate"),
    ...reasons(now.foreign_commands, "Foreign commands for"),
  ];
}

function api({ api: now }) {
  return [
    ["Clients", count(now.clients)],
    ["Requests", count(now.requests)],
    ["Turned away", count(now.turned_away), now.turned_away > 0],
    ["Lost updates", count(now.lost_updates), now.lost_updates > 0],
    ["Gave way", count(now.gave_way)],
    ...reasons(now.errors, "Errors"),
  ];
}

function process({ process: now, ...health }) {
  return [
    ["Runs for", age(health.uptime_ms)],
    ["Starts since boot", count(health.starts)],
    ["Unexpected restarts", count(health.unexpected_restarts), health.unexpected_restarts > 0],
    ["Processor time", `${fixed(now.cpu_time_s, 1)} s`],
    ["Memory", bytes(now.resident_memory_bytes)],
    ["Open files", `${count(now.open_fds)} of ${count(now.max_fds)}`],
    ["Log lines dropped", count(health.log_lines_dropped), health.log_lines_dropped > 0],
  ];
}

function configuration({ versions, ...health }) {
  return [
    ["vcu-gateway", versions.vcu_gateway],
    ["Python", versions.python],
    ["python-can", versions.python_can],
    ["Kernel", versions.kernel],
    ["File", health.config_file],
    ["Configuration", health.config_digest],
    ["Protocol", health.protocol_digest],
  ];
}
