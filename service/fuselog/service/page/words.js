/** Numbers as people read them; what is missing or not finite is null: nobody has examined it. */

export const known = (value) => typeof value === "number" && Number.isFinite(value);

/** A number with `digits` significant ones, null when there is none. */
export function number(value, digits = 3) {
  if (!known(value)) return null;
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e6 || size < 1e-3) return value.toExponential(digits - 1).replace("e+", "e").replace("-", "−");
  const decimals = Math.max(0, digits - 1 - Math.floor(Math.log10(size)));
  return value.toFixed(decimals).replace("-", "−");
}

/** A count with thin spaces between thousands. */
export const count = (value) => (known(value) ? String(value).replace(/\B(?=(\d{3})+$)/g, "\u202f") : null);

/** A number with its unit. */
export function quantity(value, unit, digits = 3) {
  const text = number(value, digits);
  return text === null ? null : `${text} ${unit}`;
}

/** A duration, in the unit that suits it. */
export function seconds(value) {
  if (!known(value)) return null;
  const size = Math.abs(value);
  if (size < 1) return `${number(value * 1000, size < 0.1 ? 2 : 3)} ms`;
  if (size < 120) return `${value.toFixed(size < 10 ? 1 : 0)} s`;
  if (size < 7200) return `${(value / 60).toFixed(0)} min`;
  return `${(value / 3600).toFixed(1)} h`;
}

/** `part` of `whole` in percent; null while there is nothing of which it could be a part. */
export function share(part, whole) {
  if (!known(part) || !known(whole) || whole <= 0) return null;
  const percent = (100 * part) / whole;
  if (part > 0 && percent < 0.1) return "< 0.1 %";
  return `${percent > 0 && percent < 10 ? percent.toFixed(1) : percent.toFixed(0)} %`;
}

/** Bytes with a decimal prefix. */
export function bytes(value) {
  if (!known(value)) return null;
  const power = value < 1000 ? 0 : Math.min(4, Math.floor(Math.log10(value) / 3));
  return `${number(value / 1000 ** power)} ${["B", "kB", "MB", "GB", "TB"][power]}`;
}

/** A stamp of the data, ns: a time of day (UTC) when it can be one, else seconds. */
export function stamp(t_ns) {
  if (!known(t_ns)) return null;
  const seconds = t_ns / 1e9;
  if (seconds < 1e8 || seconds > 1e11) return `${seconds.toFixed(3)} s`;
  return new Date(seconds * 1000).toISOString().replace("T", " ").replace("Z", " UTC");
}
