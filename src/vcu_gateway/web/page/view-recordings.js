// Recordings and incidents: download, replay, and what another configuration would have done.

import { h, setHidden, setText } from "/dom.js";
import { bytes } from "/format.js";
import { model } from "/model.js";
import { request, sentence } from "/requests.js";

const REPLAY_TIMEOUT_MS = 130_000;

let list, status;

export function build(root) {
  status = h("p.muted", { role: "status" });
  list = h("div.recordings");
  const again = h("button", { type: "button", onclick: show }, "Look again");
  root.append(h("div.tools", {}, again, status), list);
}

export const draw = () => {};

export async function show() {
  setText(status, "reading …");
  try {
    if (!model.rights.has("operate")) {
      setText(status, "Recordings tell about people: they are for operators.");
      return;
    }
    const { recordings, sentence: why } = await request("GET", "/api/recordings", { timeout: REPLAY_TIMEOUT_MS });
    const all = recordings.toSorted((a, b) => b.name.localeCompare(a.name));
    list.replaceChildren(...all.map(recording));
    setText(status, why || (all.length ? `${all.length} ${all.length === 1 ? "recording" : "recordings"}` : "no recordings yet"));
  } catch (error) {
    list.replaceChildren();
    setText(status, sentence(error));
  }
}

function recording(one) {
  const path = `/api/recordings/${one.kind}s/${encodeURIComponent(one.name)}`;
  const output = h("pre", { hidden: true, tabindex: "0", role: "status" });
  const ask = async (what, options) => {
    setHidden(output, false);
    setText(output, "computing …");
    try {
      const { same, lines } = await request("POST", `${path}/${what}`, { timeout: REPLAY_TIMEOUT_MS, ...options });
      setText(output, [same ? "The same." : "It differs.", ...lines].join("\n"));
    } catch (error) {
      setText(output, sentence(error));
    }
  };
  const file = h("input", { type: "file", accept: ".yaml,.yml", onchange: () => file.files[0] && ask("what-if", { body: file.files[0] }) });
  const buttons = h("div.row", {},
    h("a", { href: `${path}/download`, download: true }, "Download"),
    h("button", { type: "button", onclick: () => ask("replay") }, "Replay"),
    h("label", {}, "What if …", file));
  return h("section.panel.recording", { "aria-label": one.name }, h("div", {}, h("p.name", {}, one.kind === "incident" ? `Incident ${one.name}` : one.name), h("p.muted", {}, details(one))), buttons, output);
}

function details(one) {
  const began = one.begun_wall_ns == null ? "" : new Date(one.begun_wall_ns / 1e6).toLocaleString();
  const gaps = one.lost == null ? "" : one.lost.gaps ? `${one.lost.gaps} gaps, ${one.lost.frames} frames missing` : "no gaps";
  const seconds = Math.round(one.duration_s);
  const lasted = one.duration_s == null ? "" : `${Math.floor(seconds / 60)} min ${seconds % 60} s`;
  const notes = [...one.reasons, ...(one.is_written ? ["being written"] : []), ...(one.kept ? ["kept"] : []), ...one.problems];
  return [began, lasted, bytes(one.size_bytes), gaps, ...notes].filter(Boolean).join(" · ");
}
