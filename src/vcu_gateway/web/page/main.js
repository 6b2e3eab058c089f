// The page: header, the mark of old values, and which view is shown.

import { renderActions, startActions } from "/actions.js";
import { renderAlarm, startAlarm } from "/alarm.js";
import { byId, setData, setHidden, setText } from "/dom.js";
import { clockTime } from "/format.js";
import { OLD_AFTER_MS, failures, model, safely, stateAge, wallOf } from "/model.js";
import { checkSession, startSession } from "/session.js";
import { onSection, restart, start } from "/stream.js";
import { STAGE_WORDS, renderStop, startStop } from "/stop.js";
import * as bus from "/view-bus.js";
import * as events from "/view-events.js";
import * as now from "/view-now.js";
import * as plots from "/view-plots.js";
import * as recordings from "/view-recordings.js";
import * as signals from "/view-signals.js";
import * as tuning from "/view-tuning.js";

const TITLE = document.title;
const OLD_RENDER_MS = 250; // ages go on counting where nothing comes
const views = { why: now, signals, plots, events, bus, recordings, tuning };
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
  safely(name, () => views[name].show?.());
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
  const stage = model.state?.stop?.stage;
  setHidden(byId("cut"), !model.state?.stop);
  setText(byId("cut"), STAGE_WORDS[stage] ?? "stop");
  const pulse = byId("pulse");
  setData(pulse, "live", model.old ? "no" : "yes");
  setText(byId("pulse-text"), model.old ? "not live" : "live");
}

/** What of the gateway is not understood, what failed in this page, and what its server has to say. */
function notes() {
  const { certificate, not_understood: parts = [], versions = {} } = model.link ?? {};
  const lines = [];
  if (parts.length) lines.push(`Not understood of the gateway's answers: ${parts.join(", ")}. The page is of version ${versions.page}, the gateway of ${versions.gateway ?? "an unknown one"}.`);
  if (certificate) lines.push(certificate);
  for (const [part, error] of failures) lines.push(`A part of this page failed (${part}): ${error}`);
  setText(byId("notes"), lines.join("\n"));
  setHidden(byId("notes"), !lines.length);
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
  const parts = { header, notes, stop: renderStop, alarm: renderAlarm, actions: renderActions };
  for (const [name, draw] of Object.entries(parts)) safely(name, draw);
  if (current) safely(current, views[current].draw);
}

async function checkAgain() {
  try {
    if (await checkSession()) want();
  } catch {
    // The server is away: the banner says so, and the stream tries again.
  }
}

startStop();
startAlarm();
startActions();
for (const [name, view] of Object.entries(views)) safely(name, () => view.build(byId(`view-${name}`)));
startSession(() => {
  restart();
  safely(current, () => views[current].show?.());
  want();
});
onSection((section) => {
  if (section === "state") check();
  for (const [name, view] of Object.entries(views)) safely(name, () => view.hear?.(section));
  want();
});
new Worker("/ticker.js").onmessage = check;
addEventListener("hashchange", show);
document.addEventListener("visibilitychange", () => !document.hidden && want());
await checkAgain();
show();
start(checkAgain);
