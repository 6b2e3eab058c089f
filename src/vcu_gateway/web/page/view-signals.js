// Every signal with value, unit, quality and age; found by typing.

import { h, setData, setHidden, setText } from "/dom.js";
import { age } from "/format.js";
import { messageAge, model } from "/model.js";
import { addPlot } from "/view-plots.js";
import { valueOf } from "/values.js";

const WORDS = { live: "good", aging: "aging", stale: "stale", never: "never", range: "out of range", saturated: "saturated" };

let search;
let groups;
let found;
let built = null;
const lines = [];
const heads = [];

export function build(root) {
  search = h("input", { type: "search", placeholder: "Find a signal, unit or node", "aria-label": "Find a signal, unit or node", oninput: filter });
  found = h("span.muted", { role: "status" });
  groups = h("div.groups");
  root.append(h("div.tools", {}, search, found), groups);
}

export function show() {
  if (matchMedia("(pointer: fine)").matches) search.focus();
}

export function draw() {
  if (model.definition && built !== model.definition) rebuild();
  for (const head of heads) head();
  for (const line of lines) {
    if (!line.element.hidden) line.draw();
  }
}

function rebuild() {
  built = model.definition;
  lines.length = heads.length = 0;
  groups.replaceChildren(...built.messages.map(group));
  filter();
}

function group(message) {
  const ages = h("span.age");
  heads.push(() => {
    const row = model.state?.messages[message.name];
    const rate = row?.[1] ? ` · ${(1000 / row[1]).toFixed(1)} Hz` : "";
    setText(ages, `${age(messageAge(message.name))}${rate}`);
  });
  const body = h("tbody");
  const column = (what, text) => h(what, { scope: "col" }, text);
  const head = h("thead", {}, h("tr", {}, column("th.name", "Signal"), column("th.n", "Value"), column("th.state", "Quality and age"), h("td.plot")));
  const panel = h("section.panel", { "aria-label": message.name }, h("header", {}, h("h2", {}, message.name), ages), h("table", {}, head, body));
  for (const signal of message.signals) body.append(line(message, signal, panel));
  return panel;
}

function line(message, signal, panel) {
  const key = `${message.name}.${signal.name}`;
  const value = valueOf(key);
  const quality = h("span.quality");
  const own = h("span.own-age");
  const add = h("button.add", { type: "button", "aria-label": `Plot ${signal.name} of ${message.name}`, title: "Plot", onclick: () => addPlot(key) }, "↗");
  const element = h("tr", { title: signal.comment }, h("th.name", { scope: "row" }, ...breakable(signal.name)), h("td.n", {}, value.element), h("td.state", {}, quality, " ", own), h("td.n", {}, add));
  const text = [key, signal.unit, message.sender, message.id, signal.comment].join(" ").toLowerCase();
  const draw = () => {
    const now = value.draw();
    setText(quality, WORDS[now.quality]);
    setData(quality, "q", now.quality);
    setText(own, age(now.age));
  };
  lines.push({ element, draw, text, panel });
  return element;
}

/** A long name may break before each of its words. */
function breakable(name) {
  return name.split(/(?=[A-Z][a-z])/).flatMap((part, index) => (index ? [h("wbr"), part] : [part]));
}

function filter() {
  const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
  const shown = new Set();
  let count = 0;
  for (const one of lines) {
    const fits = words.every((word) => one.text.includes(word));
    setHidden(one.element, !fits);
    if (fits) {
      shown.add(one.panel);
      count += 1;
    }
  }
  for (const panel of groups.children) setHidden(panel, !shown.has(panel));
  setText(found, lines.length ? `${count} of ${lines.length}` : "");
  draw();
}
