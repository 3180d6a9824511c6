// Draws the curves of the page from the numbers in its #series element, with uPlot.
"use strict";
(() => {
  const series = JSON.parse(document.getElementById("series").textContent);
  const drive = document.getElementById("charts");
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const whole = { min: series.pair[0], max: series.pair[series.pair.length - 1] };
  let plots = [];
  let cursorPair = null;

  const number = (value) => {
    if (value === null || value === undefined) return "–";
    const digits = Math.abs(value) >= 100 ? 0 : value === 0 ? 0
      : Math.min(2 - Math.floor(Math.log10(Math.abs(value))), 6);
    return value.toLocaleString("en", { maximumFractionDigits: digits }).replaceAll(",", "\u202f");
  };

  const element = (tag, className, text) => {
    const node = document.createElement(tag);
    if (className) node.className = className;
    if (text) node.textContent = text;
    return node;
  };

  // Round values for a logarithmic axis: 1, 2, 5 a decade, fewer where there are many decades.
  const roundValues = (_, axis, min, max) => {
    const decades = Math.log10(max / min);
    const steps = decades < 2 ? [1, 2, 5] : decades < 3.2 ? [1, 3] : [1];
    const values = [];
    for (let power = Math.floor(Math.log10(min)); power <= Math.ceil(Math.log10(max)); power++)
      for (const step of steps) values.push(Number(`${step}e${power}`));
    return values.filter((value) => value >= min && value <= max);
  };

  // Light behind the curves: each part of the drive in its colour, named where there is room.
  const shade = (named) => (u) => {
    const { left, top, width, height } = u.bbox;
    const at = (pair) => Math.min(Math.max(u.valToPos(pair, "x", true), left), left + width);
    const band = (first, last, fill) => {
      const start = at(first - 0.5);
      const across = Math.max(at(last + 0.5) - start, 0);
      u.ctx.fillStyle = fill;
      u.ctx.fillRect(start, top, across, height);
      return { middle: start + across / 2, across };
    };
    u.ctx.save();
    u.ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
    u.ctx.textAlign = "center";
    u.ctx.textBaseline = "top";
    for (const part of series.segments) {
      const { middle, across } = band(part.first, part.last,
        part.kind === "static" ? "transparent" : colour(`--${part.kind}`));
      if (!named || u.ctx.measureText(part.kind).width + 6 * devicePixelRatio > across) continue;
      u.ctx.fillStyle = colour("--soft");
      u.ctx.fillText(part.kind, middle, top + 3 * devicePixelRatio);
    }
    band(whole.min, series.warm_up - 1, colour("--shade"));
    u.ctx.fillStyle = colour("--faint");
    for (const pair of series.incomplete) {
      const x = u.valToPos(pair, "x", true);
      if (x >= left && x <= left + width) u.ctx.fillRect(x - 1, top, 2, height);
    }
    u.ctx.restore();
  };

  const threshold = (limit) => (u) => {
    const { left, top, width, height } = u.bbox;
    const y = u.valToPos(limit, "y", true);
    if (y < top || y > top + height) return;
    u.ctx.save();
    u.ctx.strokeStyle = colour("--faint");
    u.ctx.lineWidth = devicePixelRatio;
    u.ctx.setLineDash([4 * devicePixelRatio, 4 * devicePixelRatio]);
    u.ctx.beginPath();
    u.ctx.moveTo(left, y);
    u.ctx.lineTo(left + width, y);
    u.ctx.stroke();
    u.ctx.restore();
  };

  const readout = (chart, caption) => (u) => {
    const i = u.cursor.idx;
    caption.replaceChildren();
    const hovering = i !== null && i !== undefined && u.cursor.left >= 0;
    if (hovering) {
      cursorPair = series.pair[i];
      const time = series.time_s[i] === null ? "" : ` · ${series.time_s[i].toFixed(2)} s`;
      caption.append(element("span", "at", `pair ${series.pair[i]}${time}`));
    }
    for (const curve of chart.curves) {
      const value = hovering ? ` ${number(curve.values[i])}` : "";
      const entry = element("span");
      entry.append(element("span", `key ${curve.side}`), `${curve.name}${value}`);
      caption.append(entry);
    }
  };

  const build = (chart, first, last) => {
    const figure = element("figure", "chart");
    const host = document.getElementById(chart.host);
    const caption = element("figcaption");
    const title = element("b", "", chart.title);
    if (chart.unit) title.append(element("span", "unit", ` (${chart.unit})`));
    const live = element("span", "live");
    live.style.display = "contents";
    caption.append(title, live);
    figure.append(caption);
    host.append(figure);
    const axis = { stroke: colour("--soft"), grid: { stroke: colour("--rule"), width: 1 },
      ticks: { show: false }, font: "11.5px system-ui, sans-serif" };
    const draw = [];
    if (chart.threshold !== null) draw.push(threshold(chart.threshold));
    const show = readout(chart, live);
    const u = new uPlot({
      width: figure.clientWidth,
      height: chart.tall ? 230 : 150,
      legend: { show: false },
      padding: [8, 8, 0, 0],
      cursor: { sync: { key: "drive" }, drag: { x: true, y: false },
        points: { size: 7 }, focus: { prox: 24 } },
      scales: { x: { time: false, range: (_, min, max) => [min, max] },
        y: chart.log ? { distr: 3, range: (_, min, max) => [min / 1.25, max * 1.25] } : { range: { min: { pad: 0.05, soft: 0, mode: 1 },
          max: { pad: 0.08, soft: 1, mode: 2 } } } },
      axes: [
        { ...axis, size: 24, label: last ? "pair" : undefined, labelSize: 14,
          labelGap: 0, labelFont: "11.5px system-ui, sans-serif", gap: 4 },
        { ...axis, size: 52, gap: 6, space: chart.tall ? 36 : 26,
          ...(chart.log ? { splits: roundValues, filter: (_, splits) => splits } : {}),
          values: (_, splits) => splits.map((v) => (v === null ? "" : number(v))) },
      ],
      series: [{}, ...chart.curves.map((curve) => ({
        label: curve.name, stroke: colour(`--${curve.side}`), width: 1.6, spanGaps: false,
        points: { size: 4 } }))],
      hooks: { drawClear: [shade(first)], draw, setCursor: [show] },
    }, [series.pair, ...chart.curves.map((curve) => curve.values)], figure);
    show(u);
    touch(u);
    return { u, figure };
  };

  const touch = (u) => {
    const move = (event) => {
      const box = u.over.getBoundingClientRect();
      const finger = event.touches[0];
      u.setCursor({ left: finger.clientX - box.left, top: finger.clientY - box.top }, true, true);
    };
    u.over.addEventListener("touchstart", move, { passive: true });
    u.over.addEventListener("touchmove", move, { passive: true });
  };

  const look = (min, max) => plots.forEach(({ u }) => u.setScale("x", { min, max }));

  const zoomIn = () => {
    if (plots.length === 0) return;
    const { min, max } = plots[0].u.scales.x;
    const centre = cursorPair === null ? (min + max) / 2 : cursorPair;
    const half = Math.max((max - min) / 4, 2);
    look(Math.max(centre - half, whole.min), Math.min(centre + half, whole.max));
  };

  const drawAll = () => {
    plots.forEach(({ u }) => u.destroy());
    const hosts = series.charts.map((chart) => chart.host);
    new Set(hosts).forEach((name) => document.getElementById(name).replaceChildren());
    plots = series.charts.map((chart, i) =>
      build(chart, i === 0, hosts[i + 1] !== chart.host));
  };

  const fit = () => plots.forEach(({ u, figure }) => {
    if (figure.clientWidth !== u.width) u.setSize({ width: figure.clientWidth, height: u.height });
  });

  if (series.pair.length === 0) return;
  drawAll();
  new ResizeObserver(fit).observe(drive);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
  document.getElementById("zoom-in").addEventListener("click", zoomIn);
  document.getElementById("zoom-out").addEventListener("click", () => look(whole.min, whole.max));
})();
