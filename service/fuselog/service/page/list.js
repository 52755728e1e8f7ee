/** The list of filters: worst first, found by words, one of them chosen; and how many there are of each status. */

import { h, keyed, say, set } from "./dom.js";
import { badge, severity, shape } from "./status.js";

const byName = new Intl.Collator("en", { numeric: true }).compare;
const statusOf = ([, filter]) => filter.health?.status ?? "unknown";

export class FilterList {
  #filters = [];
  #shown = []; // ids from top to bottom
  #only = null; // a status
  #chosen = null;

  /** `choose(id)` is called when another filter is chosen, `enter()` when the reader wants to go on to it. */
  constructor({ list, search, counts, empty }, { choose, enter }) {
    Object.assign(this, { list, search, counts, empty, choose });
    search.addEventListener("input", () => this.#show());
    search.addEventListener("keydown", (event) => {
      if (event.key === "ArrowDown" || event.key === "Enter") {
        event.preventDefault();
        list.focus();
        if (!this.#shown.includes(this.#chosen)) this.#go(0);
      }
    });
    list.addEventListener("click", (event) => {
      const option = event.target.closest("[role=option]");
      if (option) this.select(option.dataset.id);
    });
    list.addEventListener("keydown", (event) => {
      const at = this.#shown.indexOf(this.#chosen);
      const page = 10;
      const to = { ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: Infinity, PageDown: at + page, PageUp: at - page };
      if (event.key === "Enter") enter();
      else if (event.key in to) this.#go(to[event.key]);
      else return;
      event.preventDefault();
    });
  }

  get chosen() {
    return this.#chosen;
  }

  /** Choose a filter. */
  select(id) {
    this.#take(id);
    this.list.querySelector("[aria-selected=true]")?.scrollIntoView({ block: "nearest" });
  }

  #take(id) {
    this.#chosen = id;
    this.#show();
    this.choose(id);
  }

  /** Show these filters, by id; the worst is chosen when none is. */
  update(filters) {
    this.#filters = Object.entries(filters).sort(
      (a, b) => severity(statusOf(a)) - severity(statusOf(b)) || byName(a[0], b[0]),
    );
    this.#count();
    this.#show();
    // It is at the top; and what is scrolled to is where the Tab key goes on from.
    if (this.#chosen === null && this.#filters.length) this.#take(this.#filters[0][0]);
  }

  #go(index) {
    if (this.#shown.length) this.select(this.#shown[Math.max(0, Math.min(index, this.#shown.length - 1))]);
  }

  #count() {
    const counts = new Map();
    for (const filter of this.#filters) counts.set(statusOf(filter), (counts.get(statusOf(filter)) ?? 0) + 1);
    if (!counts.has(this.#only)) this.#only = null; // nothing could take the choice back
    keyed(this.counts, [...counts], ([status]) => status, ([status]) => {
      const number = h("b");
      const mark = badge();
      const node = h("button", { type: "button" }, number, mark.node);
      node.addEventListener("click", () => {
        this.#only = this.#only === status ? null : status;
        this.#count();
        this.#show();
      });
      const update = ([, n]) => {
        say(number, String(n));
        mark.update(status);
        set(node, "aria-pressed", String(this.#only === status));
      };
      return { node, update };
    });
  }

  #show() {
    const words = this.search.value.toLowerCase().split(/\s+/).filter(Boolean);
    const shown = this.#filters.filter((entry) => {
      const wanted = this.#only === null || statusOf(entry) === this.#only;
      return wanted && words.every((word) => text(entry).includes(word));
    });
    this.#shown = shown.map(([id]) => id);
    keyed(this.list, shown, ([id]) => id, ([id]) => option(id, this.list));
    for (const node of this.list.children) set(node, "aria-selected", String(node.dataset.id === this.#chosen));
    const active = this.list.querySelector("[aria-selected=true]");
    set(this.list, "aria-activedescendant", active?.id ?? null);
    this.empty.hidden = shown.length > 0;
    say(this.empty, this.#filters.length ? "None is like this." : "No filters yet.");
  }
}

function text([id, filter]) {
  const health = filter.health ?? {};
  return [id, filter.model, health.status, ...(health.reasons ?? [])].join(" ").toLowerCase();
}

function option(id, list) {
  const picture = shape();
  const word = h("span", { class: "word" });
  const why = h("span", { class: "why" });
  const node = h(
    "li",
    { role: "option", "data-id": id, id: `${list.id}-${id}` },
    picture.node,
    h("span", { class: "id" }, id),
    word,
    why,
  );
  const update = ([, filter]) => {
    const [reason = filter.model ?? "", ...more] = filter.health?.reasons ?? [];
    picture.update(filter.health?.status ?? "unknown");
    set(word, "data-look", picture.node.dataset.look);
    say(word, filter.health?.status ?? "unknown");
    say(why, more.length ? `${reason} (and ${more.length} more)` : reason);
  };
  return { node, update };
}
