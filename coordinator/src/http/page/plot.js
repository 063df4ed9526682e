// Error against time, both by their logarithms: the error of N samples is O(N^-1/2), a straight line of slope -1/2.

import { duration, percent } from "./tables.js";

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name);
// `light-dark()` is resolved where a colour is used.
const colour = (name) => {
  const probe = document.createElement("i");
  probe.style.color = css(name);
  document.body.append(probe);
  const value = getComputedStyle(probe).color;
  probe.remove();
  return value;
};

// One unit a time, to fit below the plot.
function brief(s) {
  if (s < 1000) return `${+s.toPrecision(1)} s`;
  return s < 36000 ? `${Math.round(s / 60)} min` : `${Math.round(s / 3600)} h`;
}

export class Plot {
  constructor(place) {
    this.place = place;
    this.clear();
    new ResizeObserver(() => this.plot?.setSize(this.size())).observe(place);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.rebuild());
  }

  clear() {
    this.rounds = [];
    this.live = [];
    this.goal = null;
    this.end = null;
    this.rebuild();
  }

  size() {
    return { width: Math.max(200, this.place.clientWidth), height: 280 };
  }

  // What the coordinator measured after each round: seconds, samples, [error, low, high].
  setRounds(rounds) {
    this.rounds = rounds;
    this.update();
  }

  // What the picture here says now.
  add(seconds, error) {
    const last = this.live.at(-1);
    if (!(seconds > 0) || !(error > 0) || (last && seconds < last[0] * 1.01)) return;
    this.live.push([seconds, error]);
    // Each point is 1 % later than the one before: some hundreds an hour.
    this.update();
  }

  // The error that is aimed at or expected, and when.
  aim(error, seconds) {
    this.goal = error;
    this.end = seconds;
    this.update();
  }

  data() {
    const rows = new Map();
    const put = (x, column, y) => {
      if (!(x > 0) || !(y > 0)) return;
      if (!rows.has(x)) rows.set(x, [null, null, null, null, null]);
      rows.get(x)[column] = y;
    };
    this.rounds.forEach(([x, , [value, low, high]]) => [value, low, high].forEach((y, i) => put(x, i, y)));
    this.live.forEach(([x, y]) => put(x, 3, y));
    const xs = [...rows.keys()].sort((a, b) => a - b);
    if (this.goal > 0 && xs.length > 0) {
      const end = Math.max(this.end ?? 0, xs.at(-1) * 1.001);
      put(xs[0], 4, this.goal);
      put(end, 4, this.goal);
    }
    const sorted = [...rows].sort((a, b) => a[0] - b[0]);
    return [sorted.map(([x]) => x), ...[0, 1, 2, 3, 4].map((i) => sorted.map(([, row]) => row[i]))];
  }

  update() {
    const data = this.data();
    this.place.classList.toggle("none", data[0].length === 0);
    this.plot?.setData(data);
  }

  rebuild() {
    this.plot?.destroy();
    const ink = colour("--soft"), grid = { stroke: colour("--line"), width: 1 }, accent = colour("--accent"), warm = colour("--warm");
    const shown = (format) => (_, value) => (value == null ? "–" : format(value));
    const line = (label, stroke, more = {}) => ({ label, stroke, spanGaps: true, points: { show: false }, value: shown(percent), ...more });
    // Whole decades would leave most of a small plot empty.
    const range = (_, low, high) => (low > 0 ? [low / 1.25, Math.max(high, low) * 1.25] : [0.1, 10]);
    const ticks = (_, splits) => splits.map((v) => (/^[125]\.0/.test(v.toExponential(1)) ? v : null));
    const axis = (format) => ({
      stroke: ink, grid, ticks: grid, size: 52, filter: ticks,
      values: (_, splits) => splits.map((v) => (v == null ? "" : format(v))),
    });
    this.plot = new uPlot({
      ...this.size(),
      legend: { live: true },
      cursor: { y: false },
      scales: { x: { time: false, distr: 3, range }, y: { distr: 3, range } },
      axes: [{ ...axis(brief), size: 32 }, axis((v) => percent(v, 2))],
      series: [
        { label: "Time", value: shown(duration) },
        line("Error", accent, { width: 0, paths: () => null, points: { show: true, size: 7, fill: accent } }),
        line("Low", accent, { width: 1, dash: [2, 3] }),
        line("High", accent, { width: 1, dash: [2, 3] }),
        line("Now", accent, { width: 2 }),
        line("Goal", warm, { width: 2, dash: [6, 4] }),
      ],
    }, this.data(), this.place);
  }
}
