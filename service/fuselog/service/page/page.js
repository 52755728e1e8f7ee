/** The status page: follows the service's stream and shows the filters as they are. */

import { Changes } from "./changes.js";
import { Detail } from "./detail.js";
import { say } from "./dom.js";
import { History, rowOf } from "./history.js";
import { FilterList } from "./list.js";
import { isWell, shape } from "./status.js";
import { Stream } from "./stream.js";
import { themeButton } from "./theme.js";
import { Token } from "./token.js";

const STREAM = "api/v1/stream?rate=2";
const STALE_MS = 3000; // without data, at two a second
const parts = Object.fromEntries([...document.querySelectorAll("[id]")].map((node) => [node.id, node]));

const histories = new Map(); // by id
let filters = {};
let link = { kind: "connecting", reason: "", until: 0 };
let heard = null; // when data came last, ms
let due = false; // whether it is to be drawn
let addressing; // timer
let told = "waiting"; // status of the connection that was announced last

const list = new FilterList(
  { list: parts.list, search: parts.search, counts: parts.counts, empty: parts.empty },
  { choose: remember, enter: () => parts.detail.focus() },
);
const detail = new Detail(parts);
const changes = new Changes(
  { list: parts.changes, none: parts["no-changes"], announce: parts.announce },
  (id) => list.select(id),
);
const linkShape = shape();

const token = new Token(
  { form: parts.token, input: parts["token-input"], why: parts["token-why"], forget: parts.forget },
  () => stream.restart(),
);
const stream = new Stream(STREAM, "health", { token: () => token.value, onData: take, onState: tell });

/** Take what the service says; it is drawn when the browser is ready to. */
function take(data) {
  filters = data.filters ?? {};
  heard = performance.now();
  for (const id of histories.keys()) if (!Object.hasOwn(filters, id)) histories.delete(id);
  for (const [id, filter] of Object.entries(filters)) {
    const row = rowOf(filter);
    if (!histories.has(id)) histories.set(id, new History());
    if (row) histories.get(id).push(row);
  }
  changes.update(filters);
  soon();
}

function tell(kind, reason = "", pause = 0) {
  link = { kind, reason, until: performance.now() + 1000 * pause };
  if (kind === "unauthorised") token.ask(reason);
  showLink();
}

function soon() {
  if (due) return;
  due = true;
  requestAnimationFrame(() => {
    due = false;
    list.update(filters);
    showChosen();
    showLink();
    const unwell = Object.values(filters).filter((filter) => !isWell(filter.health?.status)).length;
    document.title = unwell ? `(${unwell}) fuselog` : "fuselog";
  });
}

function showChosen() {
  const id = list.chosen;
  const filter = id === null || !Object.hasOwn(filters, id) ? undefined : filters[id];
  detail.show(id, filter, histories.get(id)?.rows ?? []);
}

/** Whether what the page shows is of now, and what it waits for if not. */
function showLink() {
  const silent = heard === null ? null : performance.now() - heard;
  const late = silent !== null && silent > STALE_MS;
  const since = late ? `stale since ${Math.floor(silent / 1000)} s` : "";
  const seconds = Math.max(0, Math.ceil((link.until - performance.now()) / 1000));
  const [status, text] = {
    open: late ? ["stale", since] : heard === null ? ["waiting", "connected, no data yet"] : ["healthy", "live"],
    connecting: heard === null ? ["waiting", "connecting"] : ["stale", `${since || "stale"}, reconnecting`],
    waiting: ["stale", `${since ? `${since}, ` : ""}reconnecting in ${seconds} s: ${link.reason}`],
    unauthorised: ["disabled", "not authorised"],
  }[link.kind];
  if (status !== told) say(parts.announce, `Connection: ${status === "healthy" ? "live" : text}`);
  told = status;
  linkShape.update(status);
  say(parts.connection.lastElementChild, text);
  document.body.classList.toggle("stale", status !== "healthy" && heard !== null);
}

/** Show the choice, and keep it in the address, so that it can be reloaded or sent. */
function remember(id) {
  showChosen();
  clearTimeout(addressing); // browsers refuse an address that changes with every press of a key
  addressing = setTimeout(() => history.replaceState(null, "", `#${new URLSearchParams({ filter: id })}`), 300);
}

function chooseFromAddress() {
  const id = new URLSearchParams(location.hash.slice(1)).get("filter");
  if (id) list.select(id);
}

parts.connection.replaceChild(linkShape.node, parts.connection.firstElementChild);
parts.all.addEventListener("toggle", showChosen);
document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault(); // the address is for the choice
  parts.detail.focus();
});
addEventListener("online", () => stream.retry());
addEventListener("resize", showChosen);
setInterval(showLink, 1000);
themeButton(parts.theme);
addEventListener("hashchange", chooseFromAddress);
chooseFromAddress();
stream.run();
