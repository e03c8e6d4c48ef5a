// Making elements, and changing only what differs, so that focus and half-typed text stay.

/** @typedef {Node | string | null | undefined} Child */

/**
 * The element with that id, which index.html has.
 * @param {string} id
 * @returns {HTMLElement}
 */
export function byId(id) {
  const found = document.getElementById(id);
  if (!found) throw new Error("no element " + id);
  return found;
}

/**
 * An element with a class and children: texts or elements.
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} name
 * @param {string} [className]
 * @param {...Child} children
 * @returns {HTMLElementTagNameMap[K]}
 */
export function make(name, className, ...children) {
  const made = document.createElement(name);
  if (className) made.className = className;
  for (const child of children) if (child !== null && child !== undefined) made.append(child);
  return made;
}

/**
 * @param {string} text
 * @param {(event: MouseEvent) => void} onClick
 * @param {string} [className]
 */
export function button(text, onClick, className) {
  const made = make("button", className, text);
  made.type = "button";
  made.addEventListener("click", onClick);
  return made;
}

/**
 * A button whose text is a sign, with the name that is read aloud.
 * @param {string} sign
 * @param {string} name
 * @param {() => void} onClick
 */
export function iconButton(sign, name, onClick) {
  const made = button(sign, onClick, "icon");
  made.setAttribute("aria-label", name);
  made.title = name;
  return made;
}

/**
 * @param {Child} text
 * @param {string} href
 * @param {string} [className]
 */
export function link(text, href, className) {
  const made = make("a", className, text);
  made.href = href;
  return made;
}

/**
 * A select with a name that is read aloud; options are pairs of a value and its text.
 * @param {string} name
 * @param {Iterable<readonly [string, string]>} options
 * @param {(value: string) => void} onChange
 */
export function choice(name, options, onChange) {
  const select = make("select");
  select.setAttribute("aria-label", name);
  for (const [value, text] of options) select.append(new Option(text, value));
  select.addEventListener("change", () => onChange(select.value));
  return select;
}

/**
 * A checkbox within its label.
 * @param {string} text
 * @param {(checked: boolean) => void} onChange
 */
export function check(text, onChange) {
  const box = make("input");
  box.type = "checkbox";
  box.addEventListener("change", () => onChange(box.checked));
  return { box, label: make("label", "check", box, text) };
}

/**
 * A labelled text field of some lines.
 * @param {string} label
 * @param {string} value
 */
export function noteField(label, value) {
  const area = make("textarea");
  area.maxLength = 2000;
  area.rows = 2;
  area.value = value;
  return { area, field: make("label", "field", label, area) };
}

/**
 * Sets a text if it is another one.
 * @param {HTMLElement} element
 * @param {string} text
 */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/**
 * Sets an attribute, or removes it for null.
 * @param {Element} element
 * @param {string} name
 * @param {string | null} value
 */
export function mark(element, name, value) {
  if (value === null) element.removeAttribute(name);
  else if (element.getAttribute(name) !== value) element.setAttribute(name, value);
}

/**
 * Puts these children there in this order, and leaves alone those that are in place.
 * @param {Element} parent
 * @param {Element[]} children
 */
export function arrange(parent, children) {
  const wanted = new Set(children);
  for (const child of [...parent.children]) if (!wanted.has(child)) child.remove();
  children.forEach((child, k) => {
    if (parent.children[k] !== child) parent.insertBefore(child, parent.children[k] ?? null);
  });
}

/**
 * A list of names and values; a value is a text or an element.
 * @param {[string, Child][]} rows
 */
export function facts(rows) {
  const list = make("dl", "facts");
  for (const [name, value] of rows) if (value !== null && value !== undefined && value !== "") list.append(make("dt", "", name), make("dd", "", value));
  return list;
}

/**
 * A table with a caption for screen readers; it scrolls sideways by itself.
 * @param {string} caption
 * @param {string[]} head
 * @param {Child[][]} rows
 */
export function table(caption, head, rows) {
  const made = make("table", "", make("caption", "unseen", caption));
  const cells = head.map((text) => Object.assign(make("th", "", text), { scope: "col" }));
  made.createTHead().append(make("tr", "", ...cells));
  const body = made.createTBody();
  for (const row of rows) body.append(make("tr", "", ...row.map((cell) => make("td", "", cell ?? "–"))));
  const scroll = make("div", "scroll", made);
  scroll.tabIndex = 0;
  scroll.setAttribute("role", "region");
  scroll.setAttribute("aria-label", caption);
  return scroll;
}
