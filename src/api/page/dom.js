// Making elements, and changing only what differs, so that focus and half-typed text stay.

export const byId = (id) => document.getElementById(id);

/** An element with a class and children: texts or elements. */
export function make(name, className, ...children) {
  const made = document.createElement(name);
  if (className) made.className = className;
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

export function button(text, onClick, className) {
  const made = make("button", className, text);
  made.type = "button";
  made.addEventListener("click", onClick);
  return made;
}

/** Sets a text if it is another one. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Puts these children there in this order, and leaves alone those that are in place. */
export function arrange(parent, children) {
  const wanted = new Set(children);
  for (const child of [...parent.children]) if (!wanted.has(child)) child.remove();
  children.forEach((child, k) => {
    if (parent.children[k] !== child) parent.insertBefore(child, parent.children[k] ?? null);
  });
}

/** A list of names and values; a value is a text or an element. */
export function facts(rows) {
  const list = make("dl", "facts");
  for (const [name, value] of rows) if (value !== null && value !== undefined && value !== "") list.append(make("dt", "", name), make("dd", "", value));
  return list;
}

/** A table with a caption that only readers of the screen hear. */
export function table(caption, head, rows) {
  const made = make("table", "", make("caption", "unseen", caption));
  made.createTHead().append(make("tr", "", ...head.map((text) => Object.assign(make("th", "", text), { scope: "col" }))));
  const body = made.createTBody();
  for (const row of rows) body.append(make("tr", "", ...row.map((cell) => make("td", "", cell ?? "–"))));
  return make("div", "scroll", made);
}

/** A dialog that answers with what its button stands for, or null. */
export function ask(title, content, buttons) {
  return new Promise((resolve) => {
    const dialog = document.createElement("dialog");
    const heading = make("h2", "", title);
    heading.id = "dialog-title";
    dialog.setAttribute("aria-labelledby", heading.id);
    const row = make("div", "row");
    let answer = null;
    for (const [text, value, className] of buttons) row.append(button(text, () => { answer = value; dialog.close(); }, className));
    dialog.append(heading, ...content, row);
    dialog.addEventListener("close", () => { dialog.remove(); resolve(answer); });
    document.body.append(dialog);
    dialog.showModal();
    (dialog.querySelector("[autofocus]") ?? row.lastElementChild).focus();
  });
}
