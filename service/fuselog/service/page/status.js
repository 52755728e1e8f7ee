/** Statuses: how bad they are, and a badge that says so by word, shape and colour. */

import { h, s, say, set } from "./dom.js";

// Worst first; the look is a colour in page.css and a shape in index.html.
const LOOKS = {
  diverged: "diverged",
  stale: "stale",
  degraded: "degraded",
  unknown: "unknown",
  initializing: "waiting",
  waiting: "waiting",
  healthy: "healthy",
  ok: "healthy",
  disabled: "disabled",
};
const ORDER = Object.keys(LOOKS);
const WELL = new Set(["healthy", "ok", "disabled"]);

/** Its place among all, 0 the worst; a word that this page does not know is in the middle. */
export const severity = (status) => ORDER.indexOf(Object.hasOwn(LOOKS, status) ? status : "unknown");

/** Whether nobody has to look at it. */
export const isWell = (status) => WELL.has(status);

/** A shape in the status's colour. */
export function shape() {
  const use = s("use");
  const node = s("svg", { class: "shape", "aria-hidden": "true" }, use);
  const update = (status) => {
    const look = LOOKS[status] ?? "unknown";
    set(use, "href", `#shape-${look}`);
    set(node, "data-look", look);
  };
  return { node, update };
}

/** Shape and word. */
export function badge() {
  const picture = shape();
  const word = h("span");
  const node = h("span", { class: "badge" }, picture.node, word);
  const update = (status) => {
    const text = status ?? "unknown";
    picture.update(text);
    set(node, "data-look", LOOKS[text] ?? "unknown");
    say(word, text);
  };
  return { node, update };
}
