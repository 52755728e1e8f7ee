/** The states of a filter: value, two standard deviations, and how both went while the page was open. */

import { figure, h, keyed, s, set } from "./dom.js";
import { number } from "./words.js";

const WIDTH = 160;
const HEIGHT = 28;

/** A row for each state. */
export function showStates(table, { states, state, rows }) {
  const unknown = new Set(state.not_measured_yet ?? []);
  const items = states.map((name, i) => ({ name, i, rows, value: unknown.has(name) ? null : state.state?.[name] }));
  keyed(table.tBodies[0], items, ({ name }) => name, stateRow);
}

function stateRow({ name }) {
  const [value, spread] = [h("td", { class: "n" }), h("td", { class: "n" })];
  const band = s("path", { class: "band" });
  const line = s("path", { class: "line" });
  const box = { width: WIDTH, height: HEIGHT, viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: "none" };
  const svg = s("svg", { class: "spark", ...box, "aria-hidden": "true" }, band, line);
  const node = h("tr", {}, h("th", { scope: "row" }, name), value, spread, h("td", {}, svg));
  const update = ({ i, rows, value: now }) => {
    figure(value, number(now, 5));
    figure(spread, now === null ? null : number(2 * (rows.at(-1)?.sds[i] ?? NaN)));
    const drawn = sparkline(rows.map(({ t, values, sds }) => [t, values[i], 2 * sds[i]]));
    set(band, "d", drawn.band);
    set(line, "d", drawn.line);
  };
  return { node, update };
}

/** Paths of (t, value, half width of its band) over time; times without a number are left out. */
export function sparkline(points) {
  const good = points
    .filter(([, value]) => Number.isFinite(value))
    .map(([t, value, half]) => [t, value, Number.isFinite(half) ? half : 0]);
  if (good.length < 2) return { band: "", line: "" };
  const [t0, t1] = [good[0][0], good.at(-1)[0]];
  const low = Math.min(...good.map(([, value, half]) => value - half));
  const high = Math.max(...good.map(([, value, half]) => value + half));
  const x = (t) => (((t - t0) / (t1 - t0)) * WIDTH).toFixed(1);
  const y = (value) => (HEIGHT - 1 - ((value - low) / (high - low || 1)) * (HEIGHT - 2)).toFixed(1);
  const path = (all) => `M${all.map(([t, value]) => `${x(t)} ${y(value)}`).join("L")}`;
  const above = good.map(([t, value, half]) => [t, value + half]);
  const below = good.map(([t, value, half]) => [t, value - half]).reverse();
  return { band: `${path([...above, ...below])}Z`, line: path(good) };
}
