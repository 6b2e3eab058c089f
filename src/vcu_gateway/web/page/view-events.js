// Events of the gateway and of the page: the newest first, found by typing.

import { h, setText } from "/dom.js";
import { clockTime } from "/format.js";
import { model, timeNow } from "/model.js";

let body, search, found;
let shown = null;

export function build(root) {
  search = h("input", { type: "search", placeholder: "Find an event", "aria-label": "Find an event", oninput: redraw });
  found = h("span.muted", { role: "status" });
  body = h("tbody");
  const head = h("tr", {}, ...["Time", "Event", "Of", "Count", "Details"].map((text) => h("th", { scope: "col" }, text)));
  root.append(h("div.tools", {}, search, found), h("div.panel", {}, h("table.events", {}, h("thead", {}, head), body)));
}

export function draw() {
  if (model.events && shown !== model.events) redraw();
}

function redraw() {
  shown = model.events;
  if (!shown) return;
  const all = [
    ...shown.gateway.map((one) => ({ ...one, of: "gateway" })),
    ...shown.page.map((one) => ({ ...one, count: 1, of: "page" })),
  ].sort((a, b) => new Date(b.time) - new Date(a.time));
  const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
  const rows = all.filter((one) => {
    const text = `${one.name} ${one.severity} ${one.of} ${JSON.stringify(one.fields)}`.toLowerCase();
    return words.every((word) => text.includes(word));
  });
  body.replaceChildren(...rows.map(row));
  setText(found, `${rows.length} of ${all.length}`);
}

function row(event) {
  const date = new Date(event.time);
  if (Number.isNaN(date.getTime())) return rowOf(event, "–");
  const today = date.toDateString() === timeNow().toDateString();
  const time = `${today ? "" : `${date.toLocaleDateString()} `}${clockTime(date, true)}`;
  return rowOf(event, time);
}

function rowOf(event, time) {
  const fields = Object.entries(event.fields).map(([name, value]) => `${name}: ${typeof value === "object" ? JSON.stringify(value) : value}`);
  return h("tr", { "data-severity": event.severity }, h("td.time", {}, time), h("td.name", {}, event.name), h("td", {}, event.of), h("td.n", {}, `${event.count ?? "–"}×`), h("td.fields", {}, fields.join(" · ")));
}
