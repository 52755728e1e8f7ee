/** Everything about the chosen filter. */

import { figure, h, keyed, say } from "./dom.js";
import { showLedger } from "./ledger.js";
import { drawMap } from "./map.js";
import { showReasons, showSensors, sum } from "./sensors.js";
import { showStates } from "./states.js";
import { badge } from "./status.js";
import { bytes, count, known, number, quantity, seconds, stamp } from "./words.js";

export class Detail {
  #mark = badge();

  /** `parts`: the elements of index.html by id. */
  constructor(parts) {
    this.parts = parts;
    parts.status.append(this.#mark.node);
  }

  /** Show a filter with the rows of its history, or that there is none of this id. */
  show(id, filter, rows) {
    const { parts } = this;
    parts.chosen.hidden = filter === undefined;
    parts.nothing.hidden = filter !== undefined;
    say(parts.nothing, id === null ? "Choose a filter." : `The service has no filter ${id} now.`);
    if (filter === undefined) return;
    const health = filter.health ?? {};
    const sensors = health.sensors ?? {};
    const states = filter.states ?? Object.keys(filter.state?.state ?? {});
    const began = known(filter.state?.t_ns); // before, the state is what the configuration begins with
    const estimate = { states, state: began ? filter.state : { not_measured_yet: states }, rows };
    say(parts.name, id);
    say(parts.model, filter.model ?? "");
    this.#mark.update(health.status);
    showReasons(parts.reasons, health);
    showPairs(parts.figures, figuresOf(health));
    showSensors(parts.sensors, sensors);
    parts["map-figure"].hidden = false; // its size is to be known
    const words = drawMap(parts.map, estimate);
    parts["map-figure"].hidden = words === null;
    parts.map.setAttribute("aria-label", `Map: ${words}`);
    say(parts["map-words"], words ?? "");
    showStates(parts.states, estimate);
    showLedger(parts.ledger, sensors);
    parts["recording-none"].hidden = Boolean(health.recording);
    showPairs(parts.recording, health.recording ? recordingOf(health.recording) : []);
    if (parts.all.open) showPairs(parts.all.querySelector("dl"), leaves(health));
  }
}

/** Names and figures in a list; a figure that is null was not examined. */
function showPairs(list, pairs) {
  keyed(list, pairs, ([name]) => name, ([name]) => {
    const value = h("dd");
    const node = h("div", {}, h("dt", {}, name), value);
    return { node, update: ([, text]) => figure(value, text) };
  });
}

function figuresOf(health) {
  const covariance = health.finite === false ? "not finite" : health.positive === false ? "not positive" : "sound";
  return [
    ["Estimate at", stamp(health.t_ns)],
    ["Last sample came", known(health.idle_s) ? `${seconds(health.idle_s)} ago` : null],
    ["Position, 1 sigma", quantity(health.position_sd_m, "m")],
    ["Heading, 1 sigma", known(health.heading_sd_rad) ? quantity((health.heading_sd_rad * 180) / Math.PI, "°") : null],
    ["Since an absolute fix", seconds(health.fix_age_s)],
    ["Covariance", typeof health.finite === "boolean" ? covariance : null],
    ["Its condition", number(health.condition)],
    ["Variance over optimal", number(health.optimality_ratio)],
    ["Results not published", count(health.unpublished)],
  ];
}

function recordingOf(recording) {
  return [
    ["State", recording.reason ? `${recording.state}: ${recording.reason}` : (recording.state ?? null)],
    ["Newest file", recording.file ?? null],
    ["Files", count(recording.files)],
    ["Size", bytes(recording.bytes)],
    ["On the disk until", stamp(recording.durable_until)],
    ["Messages received", count(recording.received)],
    ["Written", count(recording.written)],
    ["Waiting", count(recording.waiting)],
    ["Expired", count(recording.expired)],
    ["Dropped", count(sum(recording.dropped))],
    ["Missed", count(recording.missed)],
  ];
}

/** Every figure below, by its path; whatever the service adds one day is here. */
function leaves(value, path = "") {
  if (value === null || value === undefined) return [[path, null]];
  if (Array.isArray(value) && value.every((each) => typeof each !== "object"))
    return [[path, value.join("; ") || "none"]];
  if (typeof value !== "object") return [[path, String(value)]];
  return Object.entries(value).flatMap(([key, each]) => leaves(each, path ? `${path}.${key}` : key));
}
