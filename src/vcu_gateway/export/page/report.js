"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const stage = document.getElementById("stage");
  const wall = data.start > 946684800;
  const AXIS = matchMedia("(max-width: 560px)").matches ? 46 : 62;
  const SEVERE = new Set(["critical", "error"]);
  const plots = [];
  let range = [0, Math.max(data.length, data.bucket)];
  const whole = range.slice();
  const leastSpan = Math.min(whole[1], Math.max(0.5, data.bucket * 4));
  let chosen = -1;
  let shown = [];

  const element = (tag, properties = {}, ...children) => {
    const made = Object.assign(document.createElement(tag), properties);
    made.append(...children);
    return made;
  };
  const { colour } = Plots;

  // Times: of day where the recording has a date, else seconds since its beginning.
  const clock = (s, digits = 3) => {
    if (!wall) return `${s.toFixed(digits)} s`;
    const text = new Date((data.start + s) * 1000 + 1e-3).toISOString(); // 2025-11-23T17:46:40.133Z
    return text.slice(11, digits ? 20 + digits : 19);
  };
  const lasting = (s) => {
    if (s < 60) return `${s < 10 ? s.toFixed(2) : s.toFixed(1)} s`;
    const whole = Math.round(s);
    return s < 3600 ? `${Math.floor(whole / 60)} min ${whole % 60} s` : `${Math.floor(whole / 3600)} h ${Math.floor(whole / 60) % 60} min`;
  };
  const STEPS = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 28800];
  const ticks = (u, axis, min, max, step) => {
    const phase = wall ? data.start % step : 0;
    const found = [];
    for (let at = Math.ceil((min + phase) / step) * step - phase; at <= max; at += step) found.push(at);
    return found;
  };
  const tickTexts = (u, splits, axis, space, step) => splits.map((s) => clock(s, step >= 1 ? 0 : step >= 0.1 ? 1 : 3));

  // Lines: differences of raw codes, low bytes first, all deflated together.
  async function unpack() {
    const packed = Uint8Array.from(atob(data.lines), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
    let place = 0;
    for (const plot of data.plots) for (const line of plot.lines) {
      line.points = line.d ? 2 * data.buckets : data.buckets;
      const size = (line.points - 1) * line.w;
      line.bytes = bytes.subarray(place, place + size);
      place += size;
    }
  }
  function values(line, points) {
    const count = line.points - 1;
    const codes = new Float64Array(line.points);
    let code = (codes[0] = line.a);
    for (let i = 0; i < count; i++) {
      let difference = 0;
      for (let k = 0; k < line.w; k++) difference += line.bytes[k * count + i] * 2 ** (8 * k);
      if (line.w === 2 ? difference >= 32768 : difference >= 2 ** 63) difference -= line.w === 2 ? 65536 : 2 ** 64;
      codes[i + 1] = code += difference;
    }
    const each = points / line.points;
    const gaps = line.g.length > 0;
    const result = gaps ? new Array(points) : new Float64Array(points);
    for (let i = 0; i < points; i++) result[i] = codes[Math.floor(i / each)] * line.factor + line.offset;
    for (const [first, count] of line.g) for (let i = first * each; i < (first + count) * each; i++) result[i] = null;
    return result;
  }

  // One range for everything.
  function zoom(min, max) {
    const span = Math.min(Math.max(max - min, leastSpan), whole[1]);
    const middle = (min + max) / 2;
    const begin = Math.max(0, Math.min(middle - span / 2, whole[1] - span));
    range = [begin, begin + span];
    for (const plot of plots) plot.setScale("x", { min: range[0], max: range[1] });
    rangeText.textContent = `${clock(range[0], span < 60 ? 3 : 0)} – ${clock(range[1], span < 60 ? 3 : 0)}${wall ? " UTC" : ""} · ${lasting(span)}`;
    buttons.whole.disabled = buttons.out.disabled = span >= whole[1] - 1e-9;
  }
  const scaled = (factor) => {
    const middle = (range[0] + range[1]) / 2, half = ((range[1] - range[0]) * factor) / 2;
    zoom(middle - half, middle + half);
  };
  const pan = (part) => zoom(range[0] + part * (range[1] - range[0]), range[1] + part * (range[1] - range[0]));

  // Scrolls the list alone: the plots stay where they are.
  function bringIntoView(row) {
    const list = row.parentElement, box = list.getBoundingClientRect(), place = row.getBoundingClientRect();
    const seen = Math.min(box.bottom, innerHeight) - box.top;
    const height = seen > 80 ? seen : list.clientHeight;
    if (place.top < box.top || place.bottom > box.top + height) list.scrollTop += place.top - box.top - height / 3;
  }
  function goTo(index) {
    if (!shown.length) return;
    chosen = Math.max(0, Math.min(index, shown.length - 1));
    const at = shown[chosen].event[0];
    const half = Math.min((range[1] - range[0]) / 2, Math.max(1.5, Math.min(10, whole[1] / 20)));
    zoom(at - half, at + half);
    for (const one of shown) one.row.firstChild.removeAttribute("aria-current");
    shown[chosen].row.firstChild.setAttribute("aria-current", "true");
    bringIntoView(shown[chosen].row);
    explain(at + 1e-6);
    for (const plot of plots) plot.redraw(false);
  }

  // Toolbar.
  const buttons = {};
  const bar = element("div", { className: "bar" });
  bar.setAttribute("role", "toolbar");
  bar.setAttribute("aria-label", "Range of time");
  const button = (name, text, title, act) => {
    buttons[name] = element("button", { type: "button", textContent: text, title, onclick: act });
    bar.append(buttons[name]);
  };
  button("whole", "Whole", "The whole recording (0)", () => zoom(...whole));
  button("in", "+", "Closer (+)", () => scaled(0.5));
  button("out", "−", "Further (−)", () => scaled(2));
  button("left", "◀", "Earlier (←)", () => pan(-0.25));
  button("right", "▶", "Later (→)", () => pan(0.25));
  if (data.events.length) {
    button("previous", "‹ event", "The event before (p)", () => goTo(chosen - 1));
    button("next", "event ›", "The next event (n)", () => goTo(chosen + 1));
  }
  for (const [name, label] of [["in", "Closer"], ["out", "Further"], ["left", "Earlier"], ["right", "Later"]]) buttons[name].setAttribute("aria-label", label);
  const rangeText = element("span", { className: "range" });
  rangeText.setAttribute("aria-live", "polite");
  bar.append(rangeText);

  const KEYS = {
    ArrowLeft: () => pan(-0.25), ArrowRight: () => pan(0.25), "+": () => scaled(0.5), "=": () => scaled(0.5),
    "-": () => scaled(2), "0": () => zoom(...whole), n: () => goTo(chosen + 1), p: () => goTo(chosen - 1),
  };
  addEventListener("keydown", (key) => {
    if (key.ctrlKey || key.metaKey || key.altKey || key.target.matches("input, summary, pre")) return;
    const act = KEYS[key.key];
    if (act) { key.preventDefault(); act(); }
  });

  // Why, at the cursor.
  const why = element("p", { className: "why" });
  function explain(at) {
    const [, sentence] = data.whys.filter(([since]) => since <= at).pop() || [0, ""];
    why.replaceChildren(element("time", { textContent: clock(at) }), sentence);
  }

  /** Draw on the canvas of a plot, and not beside its area. */
  function inside({ ctx, bbox }, draw) {
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    draw(ctx, bbox);
    ctx.restore();
  }

  // Shading of modes and lines of events, behind every plot.
  const modes = data.bands.find((band) => band.title === "mode");
  const SHADED = { active: 0.1, fault: 0.14 };
  const shade = (u) => inside(u, (ctx, bbox) => {
    for (const [begin, end, kind] of modes ? modes.spans : []) {
      if (!(kind in SHADED) || end < range[0] || begin > range[1]) continue;
      const from = u.valToPos(begin, "x", true), to = u.valToPos(end, "x", true);
      ctx.globalAlpha = SHADED[kind];
      ctx.fillStyle = colour(kind);
      ctx.fillRect(from, bbox.top, to - from, bbox.height);
    }
  });
  const mark = (u) => inside(u, (ctx, bbox) => {
    const line = (at, name, width) => {
      if (at < range[0] || at > range[1]) return;
      const x = Math.round(u.valToPos(at, "x", true));
      ctx.strokeStyle = colour(name);
      ctx.lineWidth = width * devicePixelRatio;
      ctx.beginPath();
      ctx.moveTo(x, bbox.top);
      ctx.lineTo(x, bbox.top + bbox.height);
      ctx.stroke();
    };
    for (const [at, severity] of data.events) if (SEVERE.has(severity)) line(at, "fault", 1);
    if (chosen >= 0 && shown[chosen]) line(shown[chosen].event[0], "ink", 1.5);
  });

  const axes = (values) => Plots.axes("grid",
    { ticks: { stroke: () => colour("rule"), width: 1, size: 5 }, incrs: STEPS, splits: ticks, values: tickTexts, space: 84 },
    { size: AXIS, gap: 4, space: 34, ...values },
  );
  const common = (y) => ({
    focus: { alpha: 1 },
    cursor: { sync: { key: "report" }, drag: { x: true, y: false, setScale: false }, points: { size: 6 }, bind: { dblclick: () => () => { zoom(...whole); return null; } } },
    scales: { x: { auto: false, range: (u, min, max) => [min, max] }, y },
  });
  const selected = (u) => {
    if (u.select.width > 4) {
      const from = u.posToVal(u.select.left, "x"), to = u.posToVal(u.select.left + u.select.width, "x");
      zoom(from, to);
    }
    if (u.select.width) u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
  };
  function keep(box, height, options, data) {
    const u = Plots.draw(box, () => height, options, data);
    plots.push(u);
    u.setScale("x", { min: range[0], max: range[1] });
    return u;
  }

  // Bands.
  const KINDS = { "power limit": "limit", "regen limit": "limit", "regen off": "limit", "turbo off": "limit", cap: "limit" };
  const ROW = 34, EVENT_ROW = 22;
  function timeline(card) {
    const bands = data.bands;
    const box = element("div");
    card.append(box);
    const top = data.events.length ? EVENT_ROW : 0;
    const height = top + bands.length * ROW + 34;
    if (!bands.length && !top) { card.remove(); return; }
    const draw = (u) => inside(u, (ctx, bbox) => {
      const ratio = devicePixelRatio;
      for (const [at, severity] of data.events) {
        if (at < range[0] || at > range[1]) continue;
        ctx.fillStyle = colour(SEVERE.has(severity) ? "fault" : severity === "warning" ? "limit" : "code");
        const x = u.valToPos(at, "x", true);
        ctx.fillRect(x - ratio, bbox.top + 4 * ratio, 2 * ratio, (SEVERE.has(severity) ? 16 : 10) * ratio);
      }
      ctx.textBaseline = "alphabetic";
      ctx.textAlign = "left";
      bands.forEach((band, row) => {
        const y = bbox.top + (top + row * ROW) * ratio;
        ctx.font = Plots.font(11.5 * ratio);
        ctx.fillStyle = colour(band.whatIf ? "whatif" : "muted");
        ctx.fillText(band.title + (band.whatIf && !band.title.endsWith("what if") ? " (what if)" : ""), bbox.left + 4 * ratio, y + 11 * ratio);
        for (const [begin, end, kind, text] of band.spans) {
          if (end < range[0] || begin > range[1]) continue;
          const from = Math.max(u.valToPos(begin, "x", true), bbox.left), to = Math.min(u.valToPos(end, "x", true), bbox.left + bbox.width);
          const width = Math.max(to - from, 2 * ratio), plain = kind === "";
          ctx.fillStyle = colour(plain ? "code" : KINDS[kind] || kind) || colour("code");
          ctx.globalAlpha = band.whatIf ? 0.55 : plain ? 0.35 : 0.92;
          ctx.fillRect(from, y + 15 * ratio, width, 15 * ratio);
          ctx.globalAlpha = 1;
          if (band.whatIf) { ctx.strokeStyle = colour("whatif"); ctx.lineWidth = ratio; ctx.strokeRect(from + ratio / 2, y + 15.5 * ratio, width - ratio, 14 * ratio); }
          if (plain) { ctx.fillStyle = colour("muted"); ctx.fillRect(from, y + 15 * ratio, ratio, 15 * ratio); }
          const label = kind && kind !== text ? `${kind} · ${text}` : text;
          const room = ctx.measureText(label).width + 8 * ratio;
          const short = ctx.measureText(text).width + 8 * ratio;
          if (room < width || short < width) {
            ctx.fillStyle = plain || band.whatIf ? colour("ink") : "#fff";
            if (!plain && !band.whatIf && matchMedia("(prefers-color-scheme: dark)").matches) ctx.fillStyle = "#0f1216";
            ctx.fillText(room < width ? label : text, from + 4 * ratio, y + 26.5 * ratio);
          }
        }
      });
    });
    const options = { ...common({ range: [0, 1] }), padding: [0, 26, 0, 0], series: [{}, { show: false }],
      axes: axes({ values: () => [], grid: { show: false }, splits: () => [] }), hooks: { draw: [draw, mark], setSelect: [selected], setCursor: [(u) => u.cursor.left >= 0 && explain(u.posToVal(u.cursor.left, "x"))] } };
    keep(box, height, options, [[0, whole[1]], [null, null]]);
  }

  // Plots.
  const ROLES = { commanded: "commanded", actual: "actual", "what if": "whatif" };
  const limit = (line) => line.label === "limit";
  const stroke = (line, index) => ROLES[line.role] || `l${index % 6}`;
  const rounded = (line, value) => {
    if (value == null) return "–";
    const code = Math.round((value - line.offset) / line.factor);
    if (line.names[code] !== undefined) return line.names[code];
    return value.toFixed(Math.min(4, Math.max(Plots.decimals(line.factor), Plots.decimals(line.offset))));
  };
  function draw(card, plot, times) {
    const box = element("div");
    card.append(box);
    const series = plot.lines.map((line, index) => Plots.line({
      label: line.label, scale: "y", stroke: () => colour(stroke(line, index)), dash: line.role === "what if" || limit(line) ? [6, 4] : [],
      ...(line.role === "commanded" && !limit(line) ? { width: 5, alpha: 0.5 } : {}),
      paths: line.steps ? uPlot.paths.stepped({ align: 1 }) : uPlot.paths.linear(),
    }));
    const { names } = plot.lines[0], codes = Object.keys(names).map(Number), named = codes.length > 0;
    const small = matchMedia("(max-width: 560px)").matches;
    const texts = named ? { splits: () => codes, values: (u, all) => all.map((one) => names[one] ?? "") } : {};
    const valueRange = (u, low, high) => {
      if (named) return [Math.min(...codes) - 0.25, Math.max(...codes) + 0.25];
      if (low == null) return [0, 1];
      if (low === high) return [low - 1, high + 1];
      const room = (high - low) * 0.06;
      return [low >= 0 && low < (high - low) * 0.5 ? Math.min(0, low) : low - room, high + room];
    };
    const options = { ...common({ range: valueRange }), padding: [8, 26, 0, 0], series: [{}, ...series], axes: axes(texts),
      hooks: { drawClear: [shade], draw: [mark], setSelect: [selected], setCursor: [(u) => { legend(u); if (u.cursor.left >= 0) explain(u.posToVal(u.cursor.left, "x")); }] } };
    const labels = card.querySelectorAll(".legend b");
    const legend = (u) => plot.lines.forEach((line, index) => {
      const at = u.cursor.idx;
      labels[index].textContent = at == null ? "" : rounded(line, u.data[index + 1][at]);
    });
    const u = keep(box, named ? 120 : small ? 170 : 200, options, [times, ...plot.lines.map((line) => values(line, times.length))]);
    card.querySelectorAll(".legend button").forEach((toggle, index) => {
      toggle.onclick = () => {
        const show = toggle.getAttribute("aria-pressed") === "false";
        toggle.setAttribute("aria-pressed", String(show));
        u.setSeries(index + 1, { show });
      };
    });
  }
  function plotCard(plot) {
    const card = element("section", { className: "card" });
    card.append(element("h3", {}, plot.title, element("small", { textContent: plot.unit })));
    const list = element("ul", { className: "legend" });
    plot.lines.forEach((line, index) => {
      const sample = element("i", { className: line.role === "what if" || limit(line) ? "dashed" : line.role === "commanded" ? "broad" : "" });
      sample.style.borderTopColor = `var(--${stroke(line, index)})`;
      const toggle = element("button", { type: "button" }, sample, element("span", { textContent: line.label }), element("b"));
      toggle.setAttribute("aria-pressed", "true");
      list.append(element("li", {}, toggle));
    });
    card.append(list);
    return card;
  }

  // Events.
  const MOST_ROWS = 1500;
  function events(side) {
    const together = [];
    for (const event of data.events) {
      const before = together[together.length - 1];
      if (before && before[2] === event[2] && before[3] === event[3]) before[4] += 1;
      else together.push([...event, 1]);
    }
    const filter = element("input", { type: "search", placeholder: "filter events" });
    filter.setAttribute("aria-label", "Filter events");
    const list = element("ol");
    const rows = together.map((event) => {
      const [at, severity, name, text, count] = event;
      const what = element("span", { className: "what" }, element("i", { className: "dot" }), element("strong", { textContent: name.replaceAll("_", " ") }), " ", element("span", { textContent: text }), count > 1 ? element("span", { className: "times", textContent: ` × ${count}` }) : "");
      const row = element("li", { className: severity }, element("button", { type: "button" }, element("time", { textContent: clock(at) }), what));
      return { event, row, key: `${name} ${name.replaceAll("_", " ")} ${text} ${severity}`.toLowerCase() };
    });
    const show = () => {
      const wanted = filter.value.trim().toLowerCase();
      shown = rows.filter((one) => one.key.includes(wanted)).slice(0, MOST_ROWS);
      chosen = -1;
      shown.forEach((one, index) => (one.row.firstChild.onclick = () => goTo(index)));
      list.replaceChildren(...shown.map((one) => one.row));
      count.textContent = shown.length === rows.length ? ` ${rows.length}` : ` ${shown.length} of ${rows.length}`;
    };
    const count = element("small");
    const card = element("section", { className: "card events" }, element("h3", {}, "Events", count), element("div", { className: "filter" }, filter), list);
    filter.oninput = show;
    side.append(card);
    show();
  }

  async function main() {
    stage.append(bar);
    const left = element("div", { className: "plots" }), side = element("div", { className: "side" });
    const columns = element("div", { className: "columns" }, left);
    stage.append(columns);
    const overview = element("section", { className: "card" });
    left.append(overview);
    if (data.whys.length) overview.append(why);
    timeline(overview);
    if (data.events.length) { columns.append(side); events(side); } else columns.style.gridTemplateColumns = "minmax(0, 1fr)";
    zoom(...whole);
    const severe = data.events.find((event) => SEVERE.has(event[1]));
    if (data.whys.length) explain(severe ? severe[0] + 1e-6 : whole[1]);
    if (typeof DecompressionStream === "undefined") {
      left.append(element("p", { className: "empty", textContent: "This browser is too old for the plots: Chrome 80, Firefox 113, Safari 16.4 or newer draws them." }));
      return;
    }
    await unpack();
    const each = data.plots.some((plot) => plot.lines.some((line) => line.d)) ? 2 : 1; // points a bucket
    const times = Float64Array.from({ length: each * data.buckets }, (_, i) => (i / each) * data.bucket);
    const waiting = new Map();
    const watcher = new IntersectionObserver((entries) => {
      for (const entry of entries) if (entry.isIntersecting && waiting.has(entry.target)) {
        const plot = waiting.get(entry.target);
        waiting.delete(entry.target);
        watcher.unobserve(entry.target);
        entry.target.style.minHeight = "";
        draw(entry.target, plot, times);
      }
    }, { rootMargin: "800px" });
    for (const plot of data.plots) {
      const card = plotCard(plot);
      card.style.minHeight = "250px";
      waiting.set(card, plot);
      left.append(card);
      watcher.observe(card);
    }
    if (!data.plots.length) left.append(element("p", { className: "empty", textContent: "No signal changes in this part of the recording." }));
    left.append(element("p", { className: "keys", innerHTML: "" }, "Drag to zoom. ", ...[["←", "→"], ["+", "−"], ["0"], ["n", "p"]].flatMap((keys, i) => [...keys.map((one) => element("kbd", { textContent: one })), ` ${["move", "zoom", "whole", "events"][i]}  `])));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => plots.forEach((plot) => plot.redraw(false)));
    document.body.dataset.ready = "true";
  }
  main().catch((error) => {
    stage.append(element("p", { className: "empty", textContent: `The plots cannot be drawn: ${error.message}` }));
    throw error;
  });
})();
