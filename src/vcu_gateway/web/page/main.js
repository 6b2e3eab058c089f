// The page: header, the mark of old values, and which view is shown.

import { renderActions, startActions } from "/actions.js";
import { byId, setData, setHidden, setText } from "/dom.js";
import { clockTime } from "/format.js";
import { OLD_AFTER_MS, model, stateAge, wallOf } from "/model.js";
import { checkSession, startSession } from "/session.js";
import { onSection, restart, start } from "/stream.js";
import * as bus from "/view-bus.js";
import * as events from "/view-events.js";
import * as now from "/view-now.js";
import * as plots from "/view-plots.js";
import * as recordings from "/view-recordings.js";
import * as signals from "/view-signals.js";

const TITLE = document.title;
const OLD_RENDER_MS = 250; // ages go on counting where nothing comes
const views = { why: now, signals, plots, events, bus, recordings };
let current = null;
let drawn = 0;
let wanted = false;

function show() {
  const name = location.hash.slice(1) in views ? location.hash.slice(1) : "why";
  if (current === name) return;
  current = name;
  for (const one of Object.keys(views)) setHidden(byId(`view-${one}`), one !== name);
  for (const link of byId("views").children) {
    if (link.hash === `#${name}`) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  views[name].show?.();
  draw();
}

/** Old or live, decided again every 50 ms: also where nothing comes any more. */
function check() {
  if (decide() || (model.old && performance.now() - drawn > OLD_RENDER_MS)) want();
}

/** Whether what is shown is old, and the marks of that; true where it has changed. */
function decide() {
  const age = stateAge();
  const old = age > OLD_AFTER_MS;
  const changed = old !== ("old" in document.documentElement.dataset);
  model.old = old;
  if (old || changed) mark(age);
  return changed;
}

function mark(age) {
  setData(document.documentElement, "old", model.old ? "" : null);
  const banner = byId("old");
  setHidden(banner, !model.old);
  if (!model.old) {
    document.title = TITLE;
    return;
  }
  const since = model.state ? `OLD since ${clockTime(wallOf(model.state.t))}` : "Nothing received yet";
  const title = model.state ? since : TITLE;
  if (document.title !== title) document.title = title;
  const problem = model.link?.problem ?? (Number.isFinite(age) ? "nothing comes from the page's server" : "connecting");
  if (banner.dataset.said !== since + problem) {
    banner.dataset.said = since + problem;
    const small = document.createElement("small");
    small.textContent = problem;
    banner.replaceChildren(since, small);
  }
}

function header() {
  const mode = model.state?.mode ?? "";
  setText(byId("mode"), mode || "–");
  setData(byId("mode"), "mode", mode);
  const commands = Object.values(model.state?.commands ?? {});
  setHidden(byId("cut"), !commands.some((command) => command.power_cut));
  const pulse = byId("pulse");
  setData(pulse, "live", model.old ? "no" : "yes");
  setText(byId("pulse-text"), model.old ? "not live" : "live");
}

function want() {
  if (wanted) return;
  wanted = true;
  requestAnimationFrame(() => {
    wanted = false;
    draw();
  });
}

function draw() {
  drawn = performance.now();
  decide();
  header();
  renderActions();
  if (current) views[current].draw();
}

async function checkAgain() {
  try {
    if (await checkSession()) want();
  } catch {
    // The server is away: the banner says so, and the stream tries again.
  }
}

for (const [name, view] of Object.entries(views)) view.build(byId(`view-${name}`));
startActions();
startSession(() => {
  restart();
  views[current].show?.();
  want();
});
onSection((section) => {
  if (section === "state") check();
  for (const view of Object.values(views)) view.hear?.(section);
  want();
});
new Worker("/ticker.js").onmessage = check;
addEventListener("hashchange", show);
addEventListener("themechange", () => plots.recolour());
document.addEventListener("visibilitychange", () => !document.hidden && want());
await checkAgain();
show();
start(checkAgain);
