/** Elements made and kept up to date without touching what has not changed, so that selections and focus stay. */

const SVG = "http://www.w3.org/2000/svg";

/** An HTML element with attributes and children; attributes that are null or false are left out. */
export function h(tag, attributes = {}, ...children) {
  return filled(document.createElement(tag), attributes, children);
}

/** The same in SVG. */
export function s(tag, attributes = {}, ...children) {
  return filled(document.createElementNS(SVG, tag), attributes, children);
}

function filled(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) set(node, name, value);
  node.append(...children);
  return node;
}

/** Give an attribute a value; null and false take it away. */
export function set(node, name, value) {
  if (value === null || value === false) node.removeAttribute(name);
  else if (node.getAttribute(name) !== String(value)) node.setAttribute(name, value);
}

/** Give an element a text. */
export function say(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/** Give an element a figure; null, what nobody has examined, is a dash that says so, and why when that is known. */
export function figure(node, text, why = "") {
  if (text !== null) return say(node, text);
  const words = why ? `not examined: ${why}` : "not examined";
  if (node.textContent === `–${words}`) return;
  node.replaceChildren(h("span", { "aria-hidden": "true", title: words }, "–"), unseen(words));
}

/** A text for those who do not see the picture beside it. */
export function unseen(text) {
  return h("span", { class: "unseen" }, text);
}

const rowsOf = new WeakMap(); // parent: rows by key

/** One child for each item, in their order: `make(item)` gives `{node, update}`, kept while the item's key is there. */
export function keyed(parent, items, keyOf, make) {
  if (!rowsOf.has(parent)) rowsOf.set(parent, new Map());
  const rows = rowsOf.get(parent);
  const wanted = new Map(items.map((item) => [String(keyOf(item)), item]));
  for (const [key, row] of rows) {
    if (wanted.has(key)) continue;
    row.node.remove();
    rows.delete(key);
  }
  let next = parent.querySelector(":scope > [data-keyed]");
  for (const [key, item] of wanted) {
    const row = rows.get(key) ?? make(item);
    rows.set(key, row);
    set(row.node, "data-keyed", "");
    row.update(item);
    if (next === row.node) next = next.nextElementSibling;
    else parent.insertBefore(row.node, next);
  }
}
