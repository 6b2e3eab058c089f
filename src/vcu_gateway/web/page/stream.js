// One stream for all tabs of a browser: it allows six connections to a host, and a tab takes one.
// The tab that holds the lock has the stream and passes on what comes; if it hangs, another takes over.

import { isClockDoubtful, safely, setClock, take } from "/model.js";
import { SECTIONS } from "/sections.js";

const SILENT_AFTER_MS = 2000;
const AGAIN_MS = 500;
const CLOCK_EVERY_MS = 10_000;
const DOUBTFUL_CLOCK_EVERY_MS = 2000;

const channel = new BroadcastChannel("vcu-gateway");
const latest = new Map(); // text of each section
const listeners = new Set();
let source = null;
let heard = 0;
let asked = 0; // the time, last
let leads = false;
let refused = () => {};

/** Called with the name of each section that comes. */
export const onSection = (listener) => listeners.add(listener);

export function start(onRefused) {
  refused = onRefused;
  heard = performance.now();
  channel.onmessage = ({ data }) => hearTab(data);
  channel.postMessage({ hello: true });
  wantLead({});
  setInterval(watch, AGAIN_MS);
  synchronise();
  addEventListener("pagehide", () => source?.close());
}

/** Open the stream anew: after signing in, or where it is silent. */
export function restart() {
  if (leads) open();
  else channel.postMessage({ restart: true });
}

function wantLead(options) {
  if (!navigator.locks) {
    leads = true;
    open();
    return;
  }
  navigator.locks
    .request("vcu-gateway-stream", options, () => {
      leads = true;
      open();
      return new Promise(() => {}); // held for as long as the tab lives
    })
    .catch(() => {
      // Another tab took it from this one, which hung.
      leads = false;
      source?.close();
      source = null;
      wantLead({});
    });
}

function open() {
  source?.close();
  heard = performance.now();
  source = new EventSource("/api/stream");
  for (const section of SECTIONS) {
    source.addEventListener(section, ({ data }) => {
      channel.postMessage({ section, data });
      hear(section, data);
    });
  }
  source.onerror = () => {
    if (source.readyState === EventSource.CLOSED) refused();
  };
}

export function hear(section, data) {
  heard = performance.now();
  latest.set(section, data);
  if (!safely(section, () => take(section, JSON.parse(data)))) return;
  for (const listener of listeners) safely(section, () => listener(section));
}

function hearTab(message) {
  if (message.section) {
    if (!leads) hear(message.section, message.data);
  } else if (message.alive) {
    if (!leads) heard = Math.max(heard, performance.now());
  } else if (leads && message.hello) {
    for (const [section, data] of latest) channel.postMessage({ section, data });
  } else if (leads && message.restart) {
    open();
  }
}

function watch() {
  const clockAge = performance.now() - asked;
  if (clockAge > (isClockDoubtful() ? DOUBTFUL_CLOCK_EVERY_MS : CLOCK_EVERY_MS)) synchronise();
  const silent = performance.now() - heard > SILENT_AFTER_MS;
  if (leads) {
    channel.postMessage({ alive: true });
    // A connection that died without a word stays open for ever: no browser notices.
    if (silent || source?.readyState === EventSource.CLOSED) open();
  } else if (silent && navigator.locks) {
    heard = performance.now();
    wantLead({ steal: true });
  }
}

async function synchronise() {
  const sent = performance.now();
  asked = sent;
  try {
    const response = await fetch("/api/clock", { signal: AbortSignal.timeout(2000) });
    const received = performance.now();
    if (response.ok) setClock(await response.json(), sent, received);
  } catch {
    // The stream tells whether the server is there.
  }
}
