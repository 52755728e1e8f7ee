/** The ledger: every sample that was received, by what became of it, and what did not get as far as the filter. */

import { figure, h, keyed, say } from "./dom.js";
import { sum } from "./sensors.js";
import { count } from "./words.js";

const ENDS = ["fused", "gated", "late", "duplicate", "skipped", "disabled", "pending", "invalid"]; // of a received sample
const LOST = ["shed", "missed", "unknown"]; // before the filter
const COLUMNS = ["received", ...ENDS, ...LOST];

/** A row for each sensor, and the sum. */
export function showLedger(table, sensors) {
  keyed(table.tHead.rows[0], ["sensor", ...COLUMNS, "balance"], (name) => name, heading);
  const rows = Object.entries(sensors).map(([name, sensor]) => [name, countsOf(sensor), sensor.account?.invalid ?? {}]);
  const total = (column) => rows.reduce((sum, [, counts]) => sum + counts[column], 0);
  const all = ["all", Object.fromEntries(COLUMNS.map((column) => [column, total(column)])), null];
  keyed(table.tBodies[0], [...rows, all], ([name, , invalid]) => (invalid ? `sensor ${name}` : "all"), row);
}

function heading(name) {
  const title = LOST.includes(name) ? "not received" : null;
  const node = h("th", { scope: "col", class: name === "sensor" ? null : "n", title }, name);
  return { node, update: () => {} };
}

function countsOf({ account = {}, losses = {} }) {
  const counts = { ...account, ...losses, invalid: sum(account.invalid) };
  return Object.fromEntries(COLUMNS.map((name) => [name, counts[name] ?? NaN]));
}

function row([name]) {
  const cells = Object.fromEntries(COLUMNS.map((column) => [column, h("span")]));
  const kinds = h("span", { class: "kinds soft" });
  const balance = h("td", { class: "n" });
  const node = h(
    "tr",
    {},
    h("th", { scope: "row" }, name),
    ...COLUMNS.map((column) => h("td", { class: "n" }, cells[column], ...(column === "invalid" ? [kinds] : []))),
    balance,
  );
  const update = ([, counts, invalid]) => {
    for (const column of COLUMNS) figure(cells[column], count(counts[column]));
    const some = Object.entries(invalid ?? {}).filter(([, n]) => n > 0);
    say(kinds, some.map(([kind, n]) => `${kind} ${count(n)}`).join(", "));
    const rest = ENDS.reduce((left, end) => left - counts[end], counts.received);
    figure(balance, Number.isNaN(rest) ? null : rest === 0 ? "exact" : `${count(rest)} unaccounted`);
    balance.classList.toggle("bad", rest !== 0 && !Number.isNaN(rest));
  };
  return { node, update };
}
