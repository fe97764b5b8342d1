// The list of drives: a page of those that the filters ask for, kept current by events. However many drives there are, it holds one page.

import { ask } from "/static/api.js";
import { Card } from "/static/list/card.js";
import { announce } from "/static/ui/frame.js";
import { at, say } from "/static/ui/dom.js";
import { many, STATES } from "/static/ui/words.js";

const PAGE = 40;
const WAIT_MS = 400;
const RENEW_MS = 10_000;
const IN_WORK = ["queued", "running", "stitching"];

export class DriveList {
  // about: { caller, models, choose(id) }
  constructor(about) {
    this.about = { ...about, tell: (text) => this.tell(text), acted: () => this.load() };
    this.cards = new Map();
    this.states = new Map();
    this.offset = 0;
    this.chosen = null;
    this.waiting = null;
    this.asked = 0;
    this.#listen();
    setInterval(() => this.isAtWork && this.load(), RENEW_MS);
  }

  #listen() {
    at("filter-state").append(new Option("every state", ""), ...Object.entries(STATES).map(([state, words]) => new Option(words, state)));
    for (const id of ["filter-state", "filter-vehicle", "sort"]) at(id).addEventListener("change", () => this.#turnTo(0));
    let typed = null;
    at("search").addEventListener("input", () => {
      clearTimeout(typed);
      typed = setTimeout(() => this.#turnTo(0), 250);
    });
    at("filters").addEventListener("submit", (event) => event.preventDefault());
    at("earlier").addEventListener("click", () => this.#turnTo(this.offset + PAGE));
    at("later").addEventListener("click", () => this.#turnTo(Math.max(0, this.offset - PAGE)));
    at("filter-vehicle").addEventListener("focus", () => this.#fillVehicles(), { once: true });
  }

  async #fillVehicles() {
    const { vehicles } = await ask("/v1/fleet").catch(() => ({ vehicles: [] }));
    at("filter-vehicle").append(...vehicles.map(({ id }) => new Option(id, id)));
  }

  #turnTo(offset) {
    this.offset = offset;
    at("aside").scrollTop = 0;
    return this.load();
  }

  // Whether a drive of this page is: the stream tells of the newest drives alone.
  get isAtWork() {
    return [...this.cards.values()].some(({ drive }) => IN_WORK.includes(drive.state) || drive.reprocess);
  }

  drive(id) {
    return this.cards.get(id)?.drive;
  }

  get #wanted() {
    const wanted = { limit: PAGE, offset: this.offset, sort: at("sort").value };
    const filters = { state: at("filter-state").value, vehicle: at("filter-vehicle").value, search: at("search").value.trim() };
    return new URLSearchParams({ ...wanted, ...Object.fromEntries(Object.entries(filters).filter(([, value]) => value)) });
  }

  // Asks for the page and shows it.
  async load() {
    clearTimeout(this.waiting);
    this.waiting = null;
    const number = ++this.asked;
    let page;
    try {
      page = await ask(`/v1/drives?${this.#wanted}`);
    } catch (error) {
      return this.tell(error.message);
    }
    if (number !== this.asked) return;
    if (!page.drives.length && this.offset > 0) return this.#turnTo(Math.max(0, Math.min(this.offset - PAGE, PAGE * Math.floor((page.total - 1) / PAGE))));
    this.tell("");
    this.#show(page);
  }

  #show({ drives, total, states }) {
    const ids = new Set(drives.map(({ id }) => id));
    for (const [id, card] of this.cards) {
      if (ids.has(id)) continue;
      card.root.remove();
      this.cards.delete(id);
    }
    drives.forEach((drive, k) => {
      const { root } = this.#fill(drive);
      if (at("drives").children[k] !== root) at("drives").insertBefore(root, at("drives").children[k] ?? null);
    });
    const every = Object.values(states).reduce((sum, one) => sum + one, 0);
    const working = IN_WORK.reduce((sum, state) => sum + (states[state] ?? 0), 0);
    say(at("count"), every ? `${every.toLocaleString("en")}${working ? `, ${working} in work` : ""}` : "");
    at("empty").hidden = every > 0;
    at("filters").hidden = every === 0;
    at("none").hidden = every === 0 || total > 0;
    at("pages").hidden = total <= PAGE;
    say(at("shown"), total ? `${this.offset + 1}–${this.offset + drives.length} of ${many(total, "drive")}` : "");
    at("later").disabled = this.offset === 0;
    at("earlier").disabled = this.offset + drives.length >= total;
  }

  #fill(drive) {
    let card = this.cards.get(drive.id);
    if (!card) {
      card = new Card(this.about);
      card.chosen = drive.id === this.chosen;
      this.cards.set(drive.id, card);
    }
    card.fill(drive);
    return card;
  }

  #soon() {
    this.waiting ??= setTimeout(() => this.load(), WAIT_MS);
  }

  // A drive has changed: its card does at once, the page where the drive may come, go or move.
  hear(drive) {
    const before = this.states.get(drive.id);
    this.states.set(drive.id, drive.state);
    if (this.cards.has(drive.id)) this.#fill(drive);
    if (before !== drive.state) {
      this.#soon();
      if (before) announce(`${drive.name}: ${STATES[drive.state]}`);
    }
  }

  forget(id) {
    this.states.delete(id);
    this.cards.get(id)?.root.remove();
    this.cards.delete(id);
    this.#soon();
  }

  choose(id) {
    if (this.cards.has(this.chosen)) this.cards.get(this.chosen).chosen = false;
    if (this.cards.has(id)) this.cards.get(id).chosen = true;
    this.chosen = id;
  }

  tell(text) {
    say(at("problem"), text);
  }
}
