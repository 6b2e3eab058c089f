// Acting: disarm, arm, reset; the stop is apart. There is no way here to ask for motion.

import { byId, setData, setText } from "/dom.js";
import { model } from "/model.js";
import { request, sentence } from "/requests.js";

const HOLD_MS = 1000;

export function startActions() {
  byId("disarm").addEventListener("click", () => act("disarm", "Disarmed"));
  holdToArm(byId("arm"));
  startReset();
}

/** What can be asked for now; disarming always can. */
export function renderActions() {
  const mode = model.old ? null : model.state?.mode;
  const operates = model.rights.has("operate");
  setDisabled(byId("arm"), !(operates && mode === "standby"));
  setDisabled(byId("reset"), !(operates && mode === "fault"));
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
    setText(said, `${done}: mode ${answer?.mode ?? "not known"}`);
  } catch (error) {
    setData(said, "kind", "refused");
    setText(said, `${name.replace("-", " ")}: ${sentence(error)}`);
  }
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
