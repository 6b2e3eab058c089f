// Acting: stop, disarm, arm, reset. There is no way here to ask for motion.

import { byId, h, setData, setHidden, setText } from "/dom.js";
import { clockTime } from "/format.js";
import { model } from "/model.js";
import { request, sentence } from "/requests.js";

const HOLD_MS = 1000;
const STOP_TIMEOUT_MS = 1800;
const STOP_AGAIN_MS = 150;
const NOT_CONFIRMED_AFTER_MS = 1000;
const MANY_TRIES = 40; // then every second, for as long as the page is open

let stopping = null;

export function startActions() {
  byId("stop").addEventListener("click", stop);
  byId("disarm").addEventListener("click", () => act("disarm", "Disarmed"));
  holdToArm(byId("arm"));
  startReset();
}

/** What can be asked for now; the stop and disarming always can. */
export function renderActions() {
  const mode = model.old ? null : model.state?.mode;
  const operates = model.rights.has("operate");
  setDisabled(byId("arm"), !(operates && mode === "standby"));
  setDisabled(byId("reset"), !(operates && mode === "fault"));
  if (stopping?.state === "confirmed" && mode && mode !== "fault") finishStop();
}

function setDisabled(button, disabled) {
  if (button.disabled !== disabled) button.disabled = disabled;
}

async function act(name, done, options) {
  const said = byId("said");
  setData(said, "kind", null);
  setText(said, "…");
  try {
    const answer = await request("POST", `/api/actions/${name}`, { timeout: 3000, ...options });
    setText(said, `${done}: mode ${answer.mode}`);
  } catch (error) {
    setData(said, "kind", "refused");
    setText(said, `${name.replace("-", " ")}: ${sentence(error)}`);
  }
}

// Emergency stop.

function stop() {
  if (stopping && stopping.state !== "confirmed") return; // it repeats itself
  stopping = { state: "sent", begun: performance.now(), at: new Date(), tries: 0, reason: "" };
  const mine = stopping;
  setTimeout(() => fail(mine), NOT_CONFIRMED_AFTER_MS);
  showStop();
  repeatStop(mine);
}

async function repeatStop(mine) {
  while (mine.state !== "confirmed") {
    mine.tries += 1;
    try {
      const options = { timeout: STOP_TIMEOUT_MS };
      const answer = await request("POST", "/api/actions/estop", options);
      mine.answered = true;
      mine.reason = answer.sentence;
      if (answer.confirmed) confirm(mine, answer);
    } catch (error) {
      mine.reason = sentence(error);
      if (error.status === 401) mine.reason = "this browser is not signed in";
    }
    if (mine.state === "confirmed") return;
    showStop();
    await new Promise((done) => setTimeout(done, mine.tries < MANY_TRIES ? STOP_AGAIN_MS : 1000));
  }
}

function confirm(mine, answer) {
  mine.state = "confirmed";
  mine.took = performance.now() - mine.begun;
  mine.answer = answer;
  showStop();
}

function fail(mine) {
  if (mine.state !== "sent") return;
  mine.state = "failed";
  showStop();
}

function finishStop() {
  stopping = null;
  setHidden(byId("stop-outcome"), true);
}

function showStop() {
  const box = byId("stop-outcome");
  const { state, at, took, tries, reason, answer } = stopping;
  setData(box, "state", state);
  const sent = `SENT ${clockTime(at, true)}`;
  const lines = {
    sent: ["SENT", `${sent}: waiting for the gateway`],
    failed: ["NOT CONFIRMED: use the contactor", `${sent}, tried ${tries === 1 ? "once" : `${tries} times`}: ${reason || "no answer yet"}`],
    confirmed: ["CONFIRMED: power is cut", `${sent} → CONFIRMED after ${Math.round(took ?? 0)} ms, mode ${answer?.mode}`],
  }[state];
  const frames = Object.entries(answer?.frames ?? {});
  const shown = frames.map(([name, frame]) => h("p", {}, `${name} `, h("span.bytes", {}, frame ?? "silent")));
  box.replaceChildren(h("strong", {}, lines[0]), h("p", {}, lines[1]), ...shown);
  setHidden(box, false);
}

// Arm by holding for one second, with a pointer or a key.

function holdToArm(button) {
  let timer = null;
  const release = () => {
    clearTimeout(timer);
    timer = null;
    setData(button, "held", null);
  };
  const press = () => {
    if (button.disabled || timer) return;
    setData(button, "held", "");
    timer = setTimeout(() => {
      release();
      if (!model.old) act("arm", "Armed");
    }, HOLD_MS);
  };
  button.addEventListener("pointerdown", (event) => event.isPrimary && event.button === 0 && press());
  for (const end of ["pointerup", "pointercancel", "pointerleave", "blur"]) button.addEventListener(end, release);
  button.addEventListener("keydown", (event) => {
    if (event.key !== " " && event.key !== "Enter") return;
    event.preventDefault();
    press();
  });
  button.addEventListener("keyup", release);
  button.addEventListener("contextmenu", (event) => event.preventDefault());
  document.addEventListener("visibilitychange", release);
}

// Reset, with the reason before it.

function startReset() {
  const dialog = byId("reset-dialog");
  let level = "driver";
  byId("reset").addEventListener("click", () => {
    const latch = model.why?.latch;
    level = latch?.fault_class ?? "driver";
    const reason = latch ? `Latched: ${latch.reason}` : "Nothing is latched.";
    setText(byId("reset-reason"), reason);
    const may = level === "driver" || model.rights.has("service");
    const needs = `It needs a reset at ${level} level.`;
    setText(byId("reset-level"), may ? needs : `${needs} This role may not ask for that.`);
    setDisabled(byId("reset-do"), !may);
    dialog.show(); // not modal: the emergency stop stays in reach
    byId(may ? "reset-do" : "reset-leave").focus();
  });
  dialog.addEventListener("keydown", (event) => event.key === "Escape" && dialog.close());
  byId("reset-leave").addEventListener("click", () => dialog.close());
  byId("reset-do").addEventListener("click", () => {
    dialog.close();
    act(`reset-${level}`, "Reset");
  });
}
