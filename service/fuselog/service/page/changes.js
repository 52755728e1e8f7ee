/** The log of health changes, newest first and bounded, and their announcement to those who cannot see them. */

import { h, keyed, say } from "./dom.js";
import { badge } from "./status.js";
import { stamp } from "./words.js";

const MOST = 200;

export class Changes {
  #log = [];
  #told = new Map(); // by id: keys of the changes that were told last
  #before = null; // status by id, null before the first data

  constructor({ list, none, announce }, choose) {
    Object.assign(this, { list, none, announce, choose });
  }

  /** Take what the service tells of its filters; a change may be told more than once. */
  update(filters) {
    const fresh = Object.entries(filters).flatMap(([id, filter]) => this.#fresh(id, filter.changes ?? []));
    for (const [id, from] of Object.entries(this.#before ?? {})) {
      if (Object.hasOwn(filters, id)) continue;
      this.#told.delete(id);
      fresh.push({ id, t_ns: Date.now() * 1e6, from, to: "gone", reason: "no longer served" });
    }
    const first = this.#before === null;
    this.#before = Object.fromEntries(Object.entries(filters).map(([id, filter]) => [id, filter.health?.status]));
    if (!fresh.length) return;
    this.#log = [...fresh.sort((a, b) => b.t_ns - a.t_ns), ...this.#log].slice(0, MOST);
    keyed(this.list, this.#log, keyOf, (change) => this.#row(change));
    this.none.hidden = true;
    if (!first) say(this.announce, words(fresh));
  }

  /** Those that were not told before. */
  #fresh(id, changes) {
    const before = this.#told.get(id);
    const all = changes.map((change) => read(id, change));
    if (all.length) this.#told.set(id, new Set(all.map(keyOf)));
    return all.filter((change) => !before?.has(keyOf(change)));
  }

  #row(change) {
    const [from, to] = [badge(), badge()];
    const name = h("button", { type: "button", class: "link" }, change.id);
    name.addEventListener("click", () => this.choose(change.id));
    const time = h("time", { class: "soft" }, stamp(change.t_ns) ?? "at no time");
    const way = h("span", { class: "way" }, ...(change.from === change.to ? [] : [from.node, " to "]), to.node);
    const node = h("li", {}, time, name, way, h("span", { class: "why" }, change.reason));
    from.update(change.from);
    to.update(change.to);
    return { node, update: () => {} };
  }
}

/** A change of status, and the reason that began or ended with it. */
function read(id, { t_ns, from, before = from, to, after = to, began = true, sensor = "", text = "", reason = text }) {
  const words = [sensor && `${sensor}: `, reason, began ? "" : " (over)"].join("");
  return { id, t_ns, from: before, to: after, reason: words };
}

const keyOf = ({ id, t_ns, from, to, reason }) => JSON.stringify([id, t_ns, from, to, reason]);

function words(changes) {
  if (changes.length > 3) return `${changes.length} health changes`;
  return changes.map(({ id, to, reason }) => `${id} is ${to}${reason ? `: ${reason}` : ""}`).join(". ");
}
