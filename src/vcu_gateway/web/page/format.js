// Numbers, ages and times as people read them; always as wide as the widest, so that nothing jumps.

const MINUS = "−";

export const UNITS = { degC: "°C", "m/s2": "m/s²", deg: "°", "deg/s": "°/s" };
export const unitText = (unit) => UNITS[unit] ?? unit;

export function fixed(value, decimals) {
  if (typeof value !== "number") return "–";
  const text = Math.abs(value).toFixed(decimals);
  const isNegative = value < 0 && Number(text) !== 0;
  return (isNegative ? MINUS : "") + text;
}

/** Digits behind the point that a signal of this resolution is worth, at most two. */
export function decimalsOf(factor) {
  return factor >= 1 ? 0 : Math.min(2, Math.ceil(-Math.log10(factor) - 1e-9));
}

export function age(ms) {
  if (typeof ms !== "number" || Number.isNaN(ms)) return "never";
  if (ms < 1000) return `${Math.round(ms)} ms`;
  if (ms < 120_000) return `${(ms / 1000).toFixed(1)} s`;
  const minutes = ms / 60_000;
  return minutes < 120 ? `${Math.round(minutes)} min` : `${(minutes / 60).toFixed(1)} h`;
}

const two = (number) => String(number).padStart(2, "0");

export function clockTime(date, milliseconds = false) {
  const time = `${two(date.getHours())}:${two(date.getMinutes())}:${two(date.getSeconds())}`;
  return milliseconds ? `${time}.${String(date.getMilliseconds()).padStart(3, "0")}` : time;
}

export function bytes(count) {
  if (typeof count !== "number") return "–";
  const units = ["B", "kB", "MB", "GB"];
  let size = count;
  let unit = 0;
  while (size >= 1000 && unit < units.length - 1) {
    size /= 1000;
    unit += 1;
  }
  return `${size.toFixed(unit && size < 100 ? 1 : 0)} ${units[unit]}`;
}

export const count = (number) => (typeof number !== "number" ? "–" : number.toLocaleString("en").replaceAll(",", " "));
