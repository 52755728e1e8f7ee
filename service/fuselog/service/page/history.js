/** What the page remembers of estimates while it is open: bounded, older ones more thinly. */

const MOST = 600;

/** Estimates of one filter: `{t, values, sds}`, t in s, values and standard deviations in the order of the states. */
export class History {
  #rows = [];

  /** Remember an estimate; time that goes back is another run, which begins anew. */
  push(row) {
    const last = this.#rows.at(-1);
    if (last && row.t < last.t) this.#rows = [];
    if (last && row.t === last.t) return;
    this.#rows.push(row);
    if (this.#rows.length > MOST) this.#rows = this.#rows.filter((_, i) => i >= MOST / 2 || i % 2 === 0);
  }

  get rows() {
    return this.#rows;
  }
}

/** A filter's estimate as a row; null while there is none. Numbers that are not finite are NaN. */
export function rowOf({ state, states = Object.keys(state?.state ?? {}) }) {
  if (typeof state?.t_ns !== "number") return null;
  const values = states.map((name) => state.state?.[name] ?? NaN);
  const sds = states.map((_, i) => Math.sqrt(state.covariance?.[i]?.[i] ?? NaN));
  return { t: state.t_ns / 1e9, values, sds };
}
