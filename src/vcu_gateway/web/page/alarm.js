// NOT OBEYED, across the page and with a sound: a controller that does other than it was commanded.

import { byId, setData, setHidden, setText } from "/dom.js";
import { model } from "/model.js";

const MUTE_MS = 10_000;
const MORE_OR_THE_OTHER_WAY = new Set(["throttle_echo", "echo_direction"]);
const HIGH_HZ = 960;
const LOW_HZ = 720;
const BEEP_S = 0.35;

let audio = null; // browsers allow a sound after a key or a touch only
let beeping = null;
let mutedUntil = -Infinity;

export function startAlarm() {
  for (const gesture of ["pointerdown", "keydown"]) addEventListener(gesture, allowSound, { capture: true });
  byId("alarm-mute").addEventListener("click", () => {
    mutedUntil = performance.now() + MUTE_MS;
    renderAlarm();
  });
}

function allowSound() {
  audio ??= new AudioContext();
  if (audio.state === "suspended") audio.resume();
}

/** Who does not obey, by the stop and by every cause that is held; grey and silent while old. */
export function renderAlarm() {
  const said = [...ofStop(), ...ofCauses()].join(". ");
  const isMuted = performance.now() < mutedUntil;
  setHidden(byId("alarm"), !said);
  setText(byId("alarm-what"), said);
  setText(byId("alarm-mute"), isMuted ? `Silent for ${Math.ceil((mutedUntil - performance.now()) / 1000)} s` : "Silent for 10 s");
  sound(said && !model.old && !isMuted);
  setData(byId("alarm"), "sound", beeping ? "on" : audio ? "off" : "needs a touch");
}

function ofStop() {
  const controllers = Object.entries(model.state?.stop?.controllers ?? {});
  const told = controllers.filter(([, one]) => one.obeyed === false).map(([name, one]) => `${name} ${one.missing}`);
  if (!told.length && model.state?.stop?.stage === "not obeyed") return [model.state.stop.sentence];
  return told;
}

function ofCauses() {
  const { blocks = [], limits = [], alarms = [] } = model.why ?? {};
  // Less than commanded is dangerous where one wheel alone drives: then it stops.
  const held = [...blocks, ...limits, ...alarms].filter((one) => MORE_OR_THE_OTHER_WAY.has(one.cause));
  const alone = blocks.filter((one) => one.cause === "echo_below");
  return [...held, ...alone].map((one) => `${one.subject.replace("_Status1.", " ")}: ${one.detail}`);
}

function sound(wanted) {
  if (!wanted || audio?.state !== "running") {
    beeping?.stop();
    beeping = null;
    return;
  }
  beeping ??= beeper();
}

/** Two notes in turn until it is stopped. */
function beeper() {
  const tone = new OscillatorNode(audio, { type: "square", frequency: HIGH_HZ });
  const turns = new OscillatorNode(audio, { type: "square", frequency: 1 / (2 * BEEP_S) });
  const depth = new GainNode(audio, { gain: (HIGH_HZ - LOW_HZ) / 2 });
  const volume = new GainNode(audio, { gain: 0.25 });
  turns.connect(depth).connect(tone.frequency);
  tone.connect(volume).connect(audio.destination);
  tone.start();
  turns.start();
  return { stop: () => [tone, turns].forEach((one) => (one.stop(), one.disconnect())) };
}
