"use strict";
// What the plots of the web page and those of a report have in common: how uPlot draws them.
// Loaded before either's own script; the server has it as /plots.js, a report holds it inline.
const Plots = (() => {
  const LEAST_WIDTH = 240;
  const font = (px) => `${px}px system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif`;

  /** A colour of the style sheet, as it is now: a custom property's name without its dashes. */
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

  /** Axes of time and of values: uPlot's options of each, and the name of the grid's colour. */
  function axes(grid, time, values) {
    const axis = { stroke: () => colour("muted"), grid: { stroke: () => colour(grid), width: 1 }, ticks: { show: false }, font: font(12) };
    return [{ ...axis, size: 30, ...time }, { ...axis, ...values }];
  }

  /** A line without points, of which a gap stays a gap. */
  const line = (options) => ({ width: 1.6, spanGaps: false, points: { show: false }, ...options });

  /** A plot as wide as the element that holds it, also before that is shown; `height` is asked again with each change. */
  function draw(holder, height, options, data) {
    const size = () => ({ width: Math.max(LEAST_WIDTH, holder.clientWidth), height: height() });
    const scales = { ...options.scales, x: { time: false, ...options.scales?.x } };
    const plot = new uPlot({ legend: { show: false }, ...options, scales, ...size() }, data, holder);
    const watcher = new ResizeObserver(() => plot.setSize(size()));
    watcher.observe(holder);
    plot.hooks.destroy = [() => watcher.disconnect()];
    return plot;
  }

  /** Digits behind the point of a number as it is written, such as a step of the grid. */
  const decimals = (number) => (String(number).split(".")[1] || "").length;

  return { axes, colour, decimals, draw, font, line };
})();
