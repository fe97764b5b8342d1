// Lists over the map that a button opens: sites, changes. One at a time, by mouse and keyboard.

import { element } from "/static/ui/dom.js";

export class Lists {
  // into: the map's container. tools: where the buttons stand.
  constructor(into, tools) {
    Object.assign(this, { tools, buttons: new Map(), rows: new Map(), open: null });
    this.panel = Object.assign(element("section", "map-card"), { id: "map-list", hidden: true });
    into.append(this.panel);
    this.panel.addEventListener("keydown", (event) => event.key === "Escape" && this.show(null));
  }

  // rows: [{ title, words, mark, work }]; without any there is no button.
  fill(name, title, rows) {
    this.rows.set(name, { title, rows });
    if (!this.buttons.has(name)) {
      const made = Object.assign(element("button"), { type: "button", id: `list-${name}`, ariaExpanded: "false" });
      made.setAttribute("aria-controls", "map-list");
      made.addEventListener("click", () => this.show(this.open === name ? null : name));
      this.buttons.set(name, made);
      this.tools.append(made);
    }
    const button = this.buttons.get(name);
    button.textContent = `${title} ${rows.length}`;
    button.hidden = rows.length === 0;
    if (this.open === name) this.show(rows.length ? name : null);
  }

  show(name) {
    const before = this.open;
    this.open = name;
    for (const [key, button] of this.buttons) button.ariaExpanded = String(key === name);
    this.panel.hidden = name === null;
    if (name === null) return void this.buttons.get(before)?.focus();
    const { title, rows } = this.rows.get(name);
    this.panel.ariaLabel = title;
    const list = element("ol");
    list.append(...rows.map((row) => this.#row(row)));
    this.panel.replaceChildren(element("h2", "", title), list);
  }

  #row({ title, words, mark, work }) {
    const [item, button] = [element("li"), element("button")];
    button.type = "button";
    if (mark) button.append(element("i", mark));
    button.append(element("b", "", title), element("span", "quiet", words));
    button.addEventListener("click", work);
    item.append(button);
    return item;
  }
}
