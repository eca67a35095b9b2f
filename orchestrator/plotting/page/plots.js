"use strict";
/* Interactive charts: drag zooms, shift-drag pans, wheel zooms, double click shows everything; all charts of a
   page share their time axis. A chart is built when it comes into sight. */
(() => {
  const DASHES = [[], [7, 4], [2, 3], [9, 3, 2, 3]];
  const built = new Map();
  const ranges = new Map();   // of what charts show together, once somebody has zoomed
  const ready = new WeakSet();

  const chartOf = (section) => report.charts[Number(section.dataset.chart)];
  const style = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const color = (index) => style(`--series-${index % 7}`);
  const shown = (value) => (value == null ? "–" : Number(value.toPrecision(7)).toString());

  function aligned(chart) {
    const times = [...new Set(chart.series.map((one) => one.x))];
    if (times.length === 1) {
      return [report.values(times[0]), ...chart.series.map((one) => report.values(one.y, one.x))];
    }
    /* Runs with instants of their own: one table each, joined over time. */
    const order = [], tables = times.map((time) => {
      const own = chart.series.filter((one) => one.x === time);
      order.push(...own);
      return [report.values(time), ...own.map((one) => report.values(one.y, one.x))].map((c) => Array.from(c));
    });
    const joined = uPlot.join(tables);
    return [joined[0], ...chart.series.map((one) => joined[1 + order.indexOf(one)])];
  }

  const follows = (type) => type === "mousemove" || type === "mouseleave";

  function limits(plot) {
    const time = plot.data[0];
    return [time[0], time[time.length - 1]];
  }

  function show(plot, low, high) {
    const [first, last] = limits(plot);
    let width = Math.min(high - low, last - first);
    if (!(width > 0)) return;
    width = Math.max(width, (last - first) * 1e-7);
    low = Math.min(Math.max(low, first), last - width);
    plot.setScale("x", { min: low, max: low + width });
  }

  function zoom(plot, factor, at) {
    const { min, max } = plot.scales.x;
    const fixed = at === undefined ? (min + max) / 2 : at;
    show(plot, fixed - (fixed - min) * factor, fixed + (max - fixed) * factor);
  }

  function pan(plot, part) {
    const { min, max } = plot.scales.x;
    show(plot, min + part * (max - min), max + part * (max - min));
  }

  function whole(plot) { show(plot, ...limits(plot)); }

  function pass(plot, key) {
    if (key !== "x") return;
    const { min, max } = plot.scales.x;
    plot.root.closest(".chart").dataset.low = min;
    plot.root.closest(".chart").dataset.high = max;
    const group = chartOf(plot.root.closest(".chart")).x, range = ranges.get(group);
    if (!ready.has(plot) || (range && range[0] === min && range[1] === max)) return;
    ranges.set(group, [min, max]);
    for (const [section, other] of built) {
      if (other !== plot && chartOf(section).x === group) other.setScale("x", { min, max });
    }
  }

  function mouse(plot) {
    const over = plot.over;
    over.addEventListener("wheel", (event) => {
      event.preventDefault();
      zoom(plot, event.deltaY < 0 ? 0.8 : 1.25, plot.posToVal(event.offsetX, "x"));
    }, { passive: false });
    /* Capturing: a drag with shift is ours before the library takes it for a zoom. */
    over.parentElement.addEventListener("mousedown", (event) => {
      if (event.button !== 1 && !(event.button === 0 && event.shiftKey)) return;
      event.preventDefault();
      event.stopPropagation();
      const { min, max } = plot.scales.x, from = event.clientX, scale = (max - min) / over.clientWidth;
      const move = (moved) => show(plot, min - (moved.clientX - from) * scale, max - (moved.clientX - from) * scale);
      const stop = () => { removeEventListener("mousemove", move); removeEventListener("mouseup", stop); };
      addEventListener("mousemove", move);
      addEventListener("mouseup", stop);
    }, true);
  }

  function keys(plot, box) {
    box.tabIndex = 0;
    box.setAttribute("role", "group");
    box.setAttribute("aria-label", "chart; arrow keys move, plus and minus zoom, 0 shows everything");
    const actions = {
      "+": () => zoom(plot, 0.5), "=": () => zoom(plot, 0.5), "-": () => zoom(plot, 2), "0": () => whole(plot),
      ArrowLeft: () => pan(plot, -0.2), ArrowRight: () => pan(plot, 0.2),
    };
    box.addEventListener("keydown", (event) => {
      if (event.target !== box || !actions[event.key] || event.ctrlKey || event.metaKey) return;
      event.preventDefault();
      actions[event.key]();
    });
    const bar = document.createElement("div");
    bar.className = "tools";
    for (const [text, title, action] of [
      ["+", "zoom in", () => zoom(plot, 0.5)], ["−", "zoom out", () => zoom(plot, 2)],
      ["◀", "earlier", () => pan(plot, -0.2)], ["▶", "later", () => pan(plot, 0.2)],
      ["all", "show everything", () => whole(plot)],
    ]) {
      const button = document.createElement("button");
      Object.assign(button, { type: "button", textContent: text, title });
      button.setAttribute("aria-label", title);
      button.addEventListener("click", action);
      bar.append(button);
    }
    box.prepend(bar);
  }

  function legend(plot) {
    [...plot.root.querySelectorAll(".u-legend .u-series")].slice(1).forEach((row, index) => {
      const head = row.querySelector("th");
      const mark = () => head.setAttribute("aria-checked", String(plot.series[index + 1].show));
      head.tabIndex = 0;
      head.setAttribute("role", "checkbox");
      mark();
      head.addEventListener("click", mark);
      head.addEventListener("keydown", (event) => {
        if (event.key !== "Enter" && event.key !== " ") return;
        event.preventDefault();
        head.click();
      });
    });
  }

  function build(section) {
    const chart = chartOf(section), marked = chart.x !== "time [s]";
    const box = section.querySelector(".live");
    const data = aligned(chart);
    const axis = () => ({ stroke: () => style("--text"), grid: { stroke: () => style("--grid"), width: 1 },
      ticks: { stroke: () => style("--grid"), width: 1 }, font: "12px system-ui, sans-serif",
      values: (_, ticks) => ticks.map((v) => (v == null ? "" : Number(v.toPrecision(8)).toString())) });
    const options = {
      width: Math.max(box.clientWidth, 280), height: 260, padding: [8, 14, 0, 0],
      cursor: { sync: { key: chart.x, setSeries: false, scales: ["x", null], filters: { pub: follows } }, drag: { x: true, y: false, dist: 4 }, points: { size: 6 } },
      scales: { x: { time: false } },
      axes: [{ ...axis(), label: chart.x, labelSize: 20, size: 34, labelFont: "12px system-ui, sans-serif" },
        { ...axis(), size: 66 }],
      series: [{ label: chart.x, value: (_, v) => shown(v) },
        ...chart.series.map((one, n) => ({
          label: one.label, show: one.shown !== false, stroke: () => color(n), width: chart.joined ? 1.4 : 0,
          dash: DASHES[Math.floor(n / 7) % DASHES.length], spanGaps: true, points: { show: marked, size: 7, fill: () => color(n) },
          value: (_, v) => shown(v),
        }))],
      hooks: { setScale: [pass] },
    };
    const plot = new uPlot(options, data, box);
    built.set(section, plot);
    mouse(plot);
    keys(plot, box);
    legend(plot);
    section.classList.add("built");
    const range = ranges.get(chart.x);
    if (range) plot.setScale("x", { min: range[0], max: range[1] });
    queueMicrotask(() => ready.add(plot));
    new ResizeObserver(() => {
      const width = Math.max(box.clientWidth, 280);
      if (Math.abs(width - plot.width) > 1) plot.setSize({ width, height: plot.height });
    }).observe(box);
  }

  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      if (!entry.isIntersecting) continue;
      seen.unobserve(entry.target);
      build(entry.target);
    }
  }, { rootMargin: "300px" });
  for (const section of document.querySelectorAll(".chart")) seen.observe(section);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    for (const plot of built.values()) plot.redraw();
  });
})();
