/** The estimate on a map: where it came along, its 95 % ellipse, its heading, and how long a metre is. */

import { s } from "./dom.js";
import { number } from "./words.js";

const CHI2_95 = 5.991; // quantile of two degrees of freedom
const MARGIN = 24; // px
const LEAST_M = 0.5; // that the map shows
const ARROW = "M26 0l-9 -4.5v9zM0 0H18";

/** Draw into an SVG; returns what it shows in words, null when there is no position. */
export function drawMap(svg, { states, state, rows }) {
  const [ix, iy, iyaw] = ["x", "y", "yaw"].map((name) => states.indexOf(name));
  const unknown = state.not_measured_yet ?? [];
  const at = [state.state?.x, state.state?.y];
  if (ix < 0 || iy < 0 || !at.every(Number.isFinite) || unknown.includes("x") || unknown.includes("y")) return null;
  const covariance = [ix, iy].map((i) => [ix, iy].map((j) => state.covariance?.[i]?.[j]));
  const ellipse = ellipseOf(covariance);
  const trail = rows.map(({ values }) => [values[ix], values[iy]]).filter((p) => p.every(Number.isFinite));
  const size = [svg.clientWidth || 360, svg.clientHeight || 300];
  const view = viewOf([...trail, at], at, ellipse, size);
  const [cx, cy] = view.place(at);
  svg.setAttribute("viewBox", `0 0 ${size.join(" ")}`);
  svg.replaceChildren(
    ...grid(view, size),
    s("polyline", { class: "trail", points: trail.map((p) => view.place(p).map(round).join(",")).join(" ") }),
    ...(ellipse ? [drawnEllipse(ellipse, view, cx, cy)] : []),
    ...arrow(iyaw >= 0 && !unknown.includes("yaw") ? state.state?.yaw : null, cx, cy),
    s("circle", { class: "here", cx: round(cx), cy: round(cy), r: 3.5 }),
    ...scaleBar(view, size),
  );
  const words = [`x ${number(at[0], 4)} m, y ${number(at[1], 4)} m`];
  if (ellipse) words.push(`95 % ellipse ${number(ellipse.a)} m by ${number(ellipse.b)} m (half axes)`);
  return words.join("; ");
}

/** Half axes (m) and direction (rad) of the ellipse that holds 95 %; null for what is no covariance. */
export function ellipseOf([[xx, xy], [yx, yy]]) {
  if (![xx, xy, yx, yy].every(Number.isFinite) || xx < 0 || yy < 0) return null;
  const mean = (xx + yy) / 2;
  const spread = Math.hypot((xx - yy) / 2, (xy + yx) / 2);
  const axis = (variance) => Math.sqrt(CHI2_95 * Math.max(0, variance));
  return { a: axis(mean + spread), b: axis(mean - spread), angle: Math.atan2(xy + yx, xx - yy) / 2 };
}

/** The part of the plane that is shown. Its scale goes in steps, so that it does not tremble. */
function viewOf(points, at, ellipse, [width, height]) {
  const reach = ellipse?.a ?? 0;
  const all = [...points, [at[0] - reach, at[1] - reach], [at[0] + reach, at[1] + reach]];
  const ranges = [0, 1].map((axis) => {
    const numbers = all.map((p) => p[axis]);
    return [Math.min(...numbers), Math.max(...numbers)];
  });
  const spans = ranges.map(([low, high]) => high - low);
  const need = Math.max(spans[0] / (width - 2 * MARGIN), spans[1] / (height - 2 * MARGIN), LEAST_M / height);
  const metresPerPx = 2 ** (Math.ceil(2 * Math.log2(need)) / 2);
  const middle = ranges.map(([low, high]) => (low + high) / 2);
  const place = ([x, y]) => [width / 2 + (x - middle[0]) / metresPerPx, height / 2 - (y - middle[1]) / metresPerPx];
  return { metresPerPx, middle, place, step: roundLength(70 * metresPerPx) };
}

/** The longest of 1, 2, 5 times a power of ten that is not longer. */
export function roundLength(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return [5, 2, 1].find((n) => n * power <= most * (1 + 1e-9)) * power;
}

function grid({ metresPerPx, middle, place, step }, [width, height]) {
  const lines = [];
  const first = [middle[0] - (width / 2) * metresPerPx, middle[1] - (height / 2) * metresPerPx];
  for (let n = Math.ceil(first[0] / step); n * step < middle[0] + (width / 2) * metresPerPx; n += 1)
    lines.push(`M${round(place([n * step, 0])[0])} 0V${height}`);
  for (let n = Math.ceil(first[1] / step); n * step < middle[1] + (height / 2) * metresPerPx; n += 1)
    lines.push(`M0 ${round(place([0, n * step])[1])}H${width}`);
  return [s("path", { class: "grid", d: lines.join("") })];
}

function drawnEllipse({ a, b, angle }, { metresPerPx }, cx, cy) {
  const axes = { rx: round(Math.max(a / metresPerPx, 1)), ry: round(Math.max(b / metresPerPx, 1)) };
  const turn = `rotate(${round((-angle * 180) / Math.PI)} ${round(cx)} ${round(cy)})`;
  return s("ellipse", { class: "ellipse", cx: round(cx), cy: round(cy), ...axes, transform: turn });
}

function arrow(yaw, cx, cy) {
  if (!Number.isFinite(yaw)) return [];
  const turn = `translate(${round(cx)} ${round(cy)}) rotate(${round((-yaw * 180) / Math.PI)})`;
  return [s("path", { class: "heading", d: ARROW, transform: turn })];
}

function scaleBar({ metresPerPx, step }, [, height]) {
  const [left, bottom, length] = [12, height - 12, round(step / metresPerPx)];
  const text = step >= 1000 ? `${step / 1000} km` : `${Number(step.toPrecision(1))} m`;
  return [
    s("path", { class: "scale", d: `M${left} ${bottom - 4}v4h${length}v-4` }),
    s("text", { class: "scale", x: left + 4, y: bottom - 6 }, text),
  ];
}

const round = (value) => Math.round(value * 10) / 10;
