// What the gateway last said, and how old each part of it is now.

import { decimalsOf, fixed, unitText } from "/format.js";
import { readSection } from "/sections.js";

/** A state older than this is not shown as live. The stream brings one every 50 ms. */
export const OLD_AFTER_MS = 400;

const QUALITIES = { g: "live", r: "range", s: "saturated", o: "stale", n: "never" };
const AGING_PERIODS = 2.2;
const LEAST_AGING_MS = 150;
const JUMP_MS = 20;
const AHEAD_MS = 100;

export const model = {
  definition: null, // messages and signals of the protocol, with names
  state: null,
  why: null,
  health: null,
  events: null,
  link: null, // whether the gateway answers the page's server
  rights: new Set(),
  old: true,
};

/** What failed in this page itself, by its part: nothing of it stops another part. */
export const failures = new Map();

/** Take a step; false where it fails, which the page says. */
export function safely(part, step) {
  try {
    step();
    return true;
  } catch (error) {
    if (!failures.has(part)) console.warn(part, error);
    failures.set(part, String(error));
    return false;
  }
}

const signals = new Map(); // "Message.Signal" -> its definition and place
const clock = { offset: null, roundTrip: Infinity, at: 0, wall: 0 };
let arrived = -Infinity;

/** A sample of the server's clock, asked at `sent` and answered at `received` here. */
export function setClock(sample, sent, received) {
  const roundTrip = received - sent;
  const offset = sample.monotonic_ms - (sent + received) / 2;
  // Further off than both ways explain: that machine was started anew, or this one has slept.
  const jumped = Math.abs(offset - clock.offset) > (roundTrip + clock.roundTrip) / 2 + JUMP_MS;
  // A sample counts for a minute, unless a better one comes: clocks drift, and networks change.
  if (!jumped && roundTrip > clock.roundTrip && received - clock.at < 60_000) return;
  clock.roundTrip = roundTrip;
  clock.at = received;
  clock.offset = offset;
  clock.wall = sample.wall_ms - sample.monotonic_ms;
}

export const hasClock = () => clock.offset !== null;
/** Whether the server's clock may be another one than was thought. */
export const isClockDoubtful = () => model.old || (model.state !== null && model.state.t - monotonicNow() > AHEAD_MS);
export const monotonicNow = () => performance.now() + (clock.offset ?? 0);
export const wallOf = (monotonic) => new Date(monotonic + clock.wall);

/** The server's time; this machine's where that is not known yet. */
export const timeNow = () => (hasClock() ? wallOf(monotonicNow()) : new Date());

export function take(section, value) {
  const read = readSection(section, value);
  if (section === "definition") define(read);
  if (section === "state") {
    if (read.t === null) return;
    arrived = performance.now();
  }
  model[section] = read;
}

/** How long ago the gateway made the latest state. What waited in a buffer is as old as it is. */
export function stateAge() {
  if (!model.state) return Infinity;
  const sinceArrival = performance.now() - arrived;
  if (!hasClock()) return sinceArrival;
  return Math.max(sinceArrival, monotonicNow() - model.state.t);
}

function define(definition) {
  signals.clear();
  for (const message of definition.messages) {
    message.signals.forEach((signal, index) => {
      const decimals = decimalsOf(signal.factor);
      const isNamed = Object.keys(signal.names).length > 0;
      const longest = isNamed
        ? Math.max(...Object.values(signal.names).map((name) => name.length))
        : Math.max(fixed(signal.minimum, decimals).length, fixed(signal.maximum, decimals).length);
      signals.set(`${message.name}.${signal.name}`, {
        ...signal, message, index, decimals, isNamed, longest, unit: unitText(signal.unit),
      });
    });
  }
}

export const signalOf = (key) => signals.get(key);
export const signalKeys = () => [...signals.keys()];

/** A message's age now, in ms; null where none has come. */
export function messageAge(name) {
  const row = model.state?.messages[name];
  return !row || typeof row[0] !== "number" ? null : row[0] + Math.min(stateAge(), 1e12);
}

/** One signal as it is to be shown: text, and how far it may be believed. */
export function reading(key) {
  const signal = signals.get(key);
  const row = signal && model.state?.messages[signal.message.name];
  if (!row) return { signal, value: null, text: "–", quality: "never", age: null };
  const [, period, stale, , values, letters] = row;
  const value = values?.[signal.index] ?? null;
  const age = messageAge(signal.message.name);
  const word = signal.names[value]?.replaceAll("_", " ");
  const text = value == null ? "–" : word ?? fixed(value, signal.decimals);
  return { signal, value, text, age, quality: quality(letters?.[signal.index], stale, period, age) };
}

function quality(letter, stale, period, age) {
  const known = QUALITIES[letter];
  if (known === "never" || known === undefined) return "never";
  if (model.old || stale || age == null) return "stale";
  if (known !== "live") return known;
  return age > Math.max(LEAST_AGING_MS, (period ?? 0) * AGING_PERIODS) ? "aging" : "live";
}
