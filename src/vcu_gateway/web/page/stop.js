// The emergency stop: asked for until it is answered, and what became of it, as every state tells it.

import { byId, h, setData, setHidden, setText } from "/dom.js";
import { clockTime } from "/format.js";
import { model, monotonicNow, timeNow } from "/model.js";
import { request, sentence } from "/requests.js";

const TRY_TIMEOUT_MS = 15_000; // an answer that comes late counts
const NEXT_TRY_MS = 1800;
const MOST_TRIES_AT_ONCE = 3; // a browser has six connections to a host
const AGAIN_MS = 150;
const AGAIN_UNSIGNED_MS = 500;
const UNCONFIRMED_AFTER_MS = 1000;
const UNSIGNED_FOR_MS = 5000;
const OVER_AFTER_MS = 200; // a state of the tick before the stop says that there is none
const MANY_TRIES = 40; // then every second, for as long as the page is open
const TONES = { cut: "good", "not obeyed": "bad" };
export const STAGE_WORDS = { latched: "stop latched", sent: "stop sent", "on the bus": "stop on the bus", cut: "power cut", "not obeyed": "not obeyed" };

let asked = null; // the last press here
const parts = {};

export function startStop() {
  byId("stop").addEventListener("click", press);
  parts.said = h("strong");
  parts.steps = ["SENT", "ON THE BUS", "CONTROLLERS CUT"].map((title) => {
    const missing = h("span");
    return { missing, element: h("li", {}, h("b", {}, title), missing) };
  });
  parts.list = h("ol.steps", {}, ...parts.steps.map((one) => one.element));
  parts.request = h("p");
  parts.end = h("button", { type: "button", onclick: end });
  byId("stop-outcome").append(parts.said, parts.list, parts.request, parts.end);
}

function press() {
  if (asked && !asked.answer && !asked.ended) return; // it repeats itself
  asked = { begun: performance.now(), at: timeNow(), tries: 0, open: 0, reason: "", isUnsigned: false };
  renderStop();
  askAgainAndAgain(asked);
}

async function askAgainAndAgain(mine) {
  while (!mine.answer && !mine.ended) {
    const tried = mine.open < MOST_TRIES_AT_ONCE ? attempt(mine) : pause(NEXT_TRY_MS);
    await Promise.race([tried, pause(NEXT_TRY_MS)]);
    renderStop();
    if (mine.isUnsigned && elapsed(mine) >= UNSIGNED_FOR_MS) mine.ended ||= "nobody signed in within 5 s";
    if (mine.answer || mine.ended) break;
    await pause(mine.isUnsigned ? AGAIN_UNSIGNED_MS : mine.tries < MANY_TRIES ? AGAIN_MS : 1000);
  }
  renderStop();
}

async function attempt(mine) {
  mine.tries += 1;
  mine.open += 1;
  try {
    const answer = await request("POST", "/api/actions/estop", { timeout: TRY_TIMEOUT_MS });
    mine.answer ??= { ...answer, took: elapsed(mine), t: monotonicNow() };
  } catch (error) {
    mine.reason = sentence(error);
    mine.isUnsigned = error.status === 401;
  } finally {
    mine.open -= 1;
  }
}

const pause = (ms) => new Promise((done) => setTimeout(done, ms));
const elapsed = (mine) => performance.now() - mine.begun;

/** Cancel one that nobody is signed in for, or put away what is said of its end. */
function end() {
  if (asked && !asked.ended && asked.isUnsigned) asked.ended = "cancelled";
  else asked = null;
  renderStop();
}

/** Everything that is said of a stop, decided again at each state. */
export function renderStop() {
  const stop = model.state?.stop;
  if (asked?.answer && isOver(stop)) asked = null;
  const isPending = asked && !asked.answer;
  const told = stop && !(isPending && model.old); // what is live says more than an answer
  const now = told ? ofGateway(stop) : isPending ? ofRequest() : asked ? granted() : null;
  const box = byId("stop-outcome");
  setHidden(box, !now);
  if (!now) return;
  setData(box, "of", told ? "gateway" : "request");
  setData(box, "stage", now.stage);
  setData(box, "tone", now.tone);
  setText(parts.said, now.said);
  setHidden(parts.list, !told);
  if (told) drawSteps(stop);
  setText(parts.request, requestLine());
  setHidden(parts.end, !(asked?.ended || (isPending && asked.isUnsigned)));
  setText(parts.end, asked?.ended ? "Close" : "Cancel the stop");
}

/** What was asked for is over with the latch, in a state younger than the answer. */
function isOver(stop) {
  const isGone = stop === null || (stop === undefined && model.state?.mode !== "fault");
  return isGone && !model.old && model.state.t > asked.answer.t + OVER_AFTER_MS;
}

function ofRequest() {
  if (asked.ended) return { stage: "ended", tone: "bad", said: `Stop NOT asked for: ${asked.ended}` };
  if (elapsed(asked) < UNCONFIRMED_AFTER_MS && !asked.isUnsigned) return { stage: "asked", tone: "warn", said: "Stop asked for" };
  return { stage: "unconfirmed", tone: "bad", said: "NOT CONFIRMED: use the contactor" };
}

const granted = () => ({ stage: "granted", tone: "warn", said: "Stop granted; nothing is known yet of the bus" });

function ofGateway(stop) {
  const isWhole = stop.stage !== "cut" || isCut(stop);
  return { stage: isWhole ? stop.stage : "unknown", tone: isWhole ? TONES[stop.stage] ?? "warn" : "warn", said: stop.sentence };
}

/** Never green by a word alone: each controller says so. */
function isCut({ controllers }) {
  const all = Object.values(controllers);
  return all.length > 0 && all.every((one) => one.sent_ms != null && one.echoed_ms != null && one.obeyed === true);
}

function drawSteps({ controllers }) {
  const all = Object.entries(controllers);
  const stands = [(one) => one.sent_ms != null, (one) => one.echoed_ms != null, (one) => one.obeyed === true];
  // A controller is waited for at its first step that is not done.
  const first = (one) => stands.findIndex((isDone) => !isDone(one));
  parts.steps.forEach(({ element, missing }, index) => {
    const isDone = all.length > 0 && all.every(([, one]) => stands[index](one));
    setData(element, "done", isDone ? "" : null);
    const waiting = all.filter(([, one]) => (index === 2 && one.obeyed === false) || (one.obeyed !== false && first(one) === index));
    setText(missing, waiting.map(([name, one]) => `${name} ${one.missing}`).join(", ") || (isDone ? "" : "–"));
  });
}

function requestLine() {
  if (!asked || asked.ended) return "";
  const at = `asked for at ${clockTime(asked.at, true)}`;
  if (asked.answer) return `${at}, answered after ${Math.round(asked.answer.took)} ms`;
  if (asked.isUnsigned) {
    const left = Math.max(0, Math.ceil((UNSIGNED_FOR_MS - elapsed(asked)) / 1000));
    return `${at}: nobody is signed in here. A sign-in within ${left} s still asks for it.`;
  }
  return `${at}, tried ${asked.tries === 1 ? "once" : `${asked.tries} times`}: ${asked.reason || "no answer yet"}`;
}
