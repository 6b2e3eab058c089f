// Values in the page: a signal's text in a box as wide as its widest value, and bars.

import { h, setData, setHidden, setStyle } from "/dom.js";
import { reading, signalOf } from "/model.js";

/** An element for one signal, and a function that draws it anew. */
export function valueOf(key, { unit = true, tag = "span" } = {}) {
  const number = document.createTextNode("–");
  const small = h("small");
  const element = h(`${tag}.v`, {}, number);
  let sized = null;
  const draw = () => {
    const now = reading(key);
    if (now.signal && sized !== now.signal) {
      sized = now.signal;
      small.textContent = now.signal.unit;
      if (unit && now.signal.unit) element.append(" ", small);
    }
    if (number.data !== now.text) number.data = now.text;
    setData(element, "q", now.quality);
    return now;
  };
  return { element, draw };
}

/** A bar from 0 to the signal's maximum, or from its middle, with a mark for what was commanded. */
export function barOf(key, { maximum, centred = false } = {}) {
  const fill = h("i");
  const mark = h("b");
  const element = h(centred ? "span.bar.centred" : "span.bar", { "aria-hidden": "true" }, fill, ...(centred ? [] : [mark]));
  const draw = (commanded = null) => {
    const now = reading(key);
    const full = maximum ?? signalOf(key)?.maximum ?? 1;
    const share = Math.max(-1, Math.min(1, (now.value ?? 0) / full));
    setStyle(fill, "--value", share.toFixed(3));
    setHidden(mark, commanded == null);
    if (commanded != null) setStyle(mark, "--mark", `${Math.max(0, Math.min(100, (100 * commanded) / full)).toFixed(1)}%`);
    setData(element, "q", now.quality);
  };
  return { element, draw };
}
