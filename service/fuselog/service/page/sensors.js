/** The sensors of a filter: rates, ages, consistency, and what is wrong with each. */

import { figure, h, keyed, s, say, set, unseen } from "./dom.js";
import { badge } from "./status.js";
import { known, number, seconds, share } from "./words.js";

const WIDTH = 105;
const HEIGHT = 14;
const MOST = 3; // times what is expected: the right end of the bar
const FIGURES = ["rate", "expected", "age", "delay", "slowest", "gated", "late", "invalid"];

/** The rows of the table. */
export function showSensors(table, sensors) {
  keyed(table, Object.entries(sensors), ([name]) => name, ([name]) => sensorRow(name));
}

function sensorRow(name) {
  const topic = h("span", { class: "soft" });
  const mark = badge();
  const nis = nisBar();
  const figures = Object.fromEntries(FIGURES.map((key) => [key, h("span")]));
  const why = h("ul", { class: "reasons" });
  const whyRow = h("tr", { role: "row", class: "reasons" }, h("td", { role: "cell", colspan: 9 }, why));
  const node = h(
    "tbody",
    { role: "rowgroup" },
    h(
      "tr",
      { role: "row" },
      h("th", { role: "rowheader", scope: "row" }, h("span", { class: "name" }, name), topic),
      cell("Status", {}, mark.node),
      cell("Rate / expected, Hz", { class: "n" }, figures.rate, second(figures.expected)),
      cell("Age", { class: "n" }, figures.age),
      cell("Delay / p99", { class: "n" }, figures.delay, second(figures.slowest)),
      cell("NIS mean / expected", {}, nis.node),
      cell("Gated", { class: "n" }, figures.gated),
      cell("Late", { class: "n" }, figures.late),
      cell("Invalid", { class: "n" }, figures.invalid),
    ),
    whyRow,
  );
  const update = ([, sensor]) => {
    const { account = {}, rate, timing, not_examined: unlooked = {} } = sensor;
    say(topic, sensor.topic ?? "");
    mark.update(sensor.status);
    figure(figures.rate, number(rate?.hz), unlooked.rate);
    figure(figures.expected, number(rate?.expected_hz), unlooked.rate);
    figure(figures.age, seconds(sensor.idle_s ?? sensor.age_s));
    figure(figures.delay, seconds(timing?.median_s), unlooked.timing);
    figure(figures.slowest, seconds(timing?.p99_s), unlooked.timing);
    figure(figures.gated, share(account.gated, account.received));
    figure(figures.late, share(account.late, account.received));
    figure(figures.invalid, share(sum(account.invalid), account.received));
    nis.update(sensor.nis, unlooked.nis);
    showReasons(why, sensor);
    whyRow.hidden = !why.childElementCount;
  };
  return { node, update };
}

/** What is wrong, then what is worth knowing. */
export function showReasons(list, { reasons = [], notes = [] }) {
  const lines = [...reasons.map((text) => ["reason", text]), ...notes.map((text) => ["note", `Note: ${text}`])];
  keyed(list, [...lines.entries()], ([place]) => place, () => {
    const node = h("li");
    const update = ([, [kind, text]]) => {
      set(node, "class", kind);
      say(node, text);
    };
    return { node, update };
  });
}

/** The sum of counts by kind; NaN when there are none. */
export const sum = (counts) => Object.values(counts ?? { none: NaN }).reduce((a, b) => a + b, 0);

function cell(label, attributes, ...children) {
  return h("td", { role: "cell", "data-label": label, ...attributes }, ...children);
}

/** What a figure goes by; a line of its own where there is room. */
const second = (node) => h("span", { class: "second" }, " / ", node);

/**
 * The mean NIS on a scale of what is expected of it, its degrees of freedom: a line at 1, the band in which the mean is
 * accepted when there is one, and a mark: a disc, a triangle outside of the band, an arrow beyond the end of the scale.
 */
function nisBar() {
  const accepted = s("rect", { class: "band", y: 2, height: HEIGHT - 4 });
  const mark = s("path", { class: "mark" });
  const svg = s(
    "svg",
    { class: "nis", width: WIDTH, height: HEIGHT, viewBox: `0 0 ${WIDTH} ${HEIGHT}`, "aria-hidden": "true" },
    s("path", { class: "axis", d: `M0 ${HEIGHT / 2}H${WIDTH}` }),
    accepted,
    s("path", { class: "one", d: `M${WIDTH / MOST} 0V${HEIGHT}` }),
    mark,
  );
  const mean = h("span");
  const expected = h("span");
  const verdict = unseen("");
  const node = h("span", { class: "nis" }, svg, h("span", {}, mean, " / ", expected, verdict));
  const update = (nis, why) => {
    const { mean: value, dof, band: [low, high] = [] } = nis ?? {};
    const place = (figure) => (WIDTH * Math.max(0, Math.min(figure / dof, MOST))) / MOST;
    const drawn = known(value) && known(dof) && dof > 0;
    const banded = drawn && known(low) && known(high);
    const inside = banded ? value >= low && value <= high : null;
    set(svg, "class", drawn ? "nis" : "nis blank");
    set(accepted, "visibility", banded ? "visible" : "hidden");
    if (banded) set(accepted, "x", place(low));
    if (banded) set(accepted, "width", Math.max(1, place(high) - place(low)));
    if (drawn) set(mark, "d", markAt(place(value), inside));
    set(mark, "visibility", drawn ? "visible" : "hidden");
    set(mark, "data-inside", inside === null ? null : String(inside));
    set(svg.parentNode, "title", banded ? `accepted from ${number(low)} to ${number(high)}` : null);
    say(verdict, banded ? `, ${inside ? "inside" : "outside"} ${number(low)} to ${number(high)}` : "");
    figure(mean, number(value), why);
    figure(expected, number(dof), why);
  };
  return { node, update };
}

function markAt(place, inside) {
  if (place >= WIDTH) return `M${WIDTH - 9} 2l9 5l-9 5z`;
  const x = Math.max(5, Math.min(place, WIDTH - 5));
  return inside === false ? `M${x - 5} 12h10l-5 -11z` : `M${x - 4} 7a4 4 0 1 0 8 0a4 4 0 1 0 -8 0z`;
}
