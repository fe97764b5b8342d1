// A drive's card: built once and then changed in place, so that the focus stays where it is while its drive goes on.

import { actionsFor } from "/static/ui/actions.js";
import { button, element, link, say } from "/static/ui/dom.js";
import { driveWords, duration, errorOf, STATES } from "/static/ui/words.js";

const MOST_WARNINGS = 2;

// A drive's grade as a badge; nothing before it is judged.
export function gradeBadge(quality) {
  if (!quality) return "";
  const badge = element("span", `grade ${quality.gate}`, quality.grade ?? "–");
  badge.title = [quality.grade ? `Grade ${quality.grade}` : "No place on Earth", ...quality.reasons].join("\n");
  return badge;
}

export class Card {
  // about: { caller, models, choose(id), tell(text), acted() }
  constructor(about) {
    this.about = about;
    this.drive = null;
    this.shownActions = "";
    this.root = element("li", "drive");
    this.name = link("", "name", "#");
    this.vehicle = element("span", "vehicle quiet");
    this.badge = element("span");
    this.state = element("span", "state");
    this.stages = element("div", "stages");
    this.stages.setAttribute("role", "img");
    this.words = element("p", "words");
    this.reasons = element("p", "reasons");
    this.warnings = element("ul", "warnings");
    this.error = element("p", "error");
    this.foot = element("div", "foot");
    this.show = button("On the map", "show", () => about.choose(this.drive.id));
    this.page = link("Details", "report", "#");
    this.menu = element("div", "acts");
    const top = element("div", "top");
    top.append(this.name, this.vehicle, this.badge, this.state);
    this.foot.append(this.show, this.page, this.menu);
    this.root.append(top, this.stages, this.words, this.reasons, this.warnings, this.error, this.foot);
    this.root.addEventListener("click", (event) => {
      if (!event.target.closest("a, button, details")) about.choose(this.drive.id);
    });
  }

  set chosen(on) {
    this.root.classList.toggle("chosen", on);
    this.show.setAttribute("aria-pressed", String(on));
  }

  fill(drive) {
    this.drive = drive;
    const { root, quality = drive.quality } = this;
    root.dataset.id = drive.id;
    root.dataset.state = drive.state;
    say(this.name, drive.name);
    this.name.title = drive.id;
    this.name.href = this.page.href = `/drives/${drive.id}`;
    this.page.ariaLabel = `Details of ${drive.name}`;
    this.show.ariaLabel = `Show ${drive.name} on the map`;
    this.show.hidden = drive.placed !== true;
    say(this.vehicle, drive.vehicle_id && drive.vehicle_id !== drive.name ? drive.vehicle_id : "");
    const badge = `${quality?.gate}${quality?.grade}${quality?.reasons}`;
    if (this.badge.dataset.key !== badge) {
      this.badge.replaceChildren(gradeBadge(quality));
      this.badge.dataset.key = badge;
    }
    say(this.state, STATES[drive.state]);
    this.state.className = `state ${drive.state}`;
    this.#fillStages(drive);
    say(this.words, driveWords(drive));
    say(this.reasons, quality && ["D", "E"].includes(quality.grade) && !driveWords(drive).includes(quality.reasons[0]) ? quality.reasons.join("; ") : "");
    this.#fillWarnings(drive.warnings);
    say(this.error, errorOf(drive));
    this.#fillActions(drive);
  }

  #fillStages(drive) {
    if (this.stages.children.length !== drive.stages.length) {
      this.stages.replaceChildren(...drive.stages.map(() => element("span")));
      for (const bar of this.stages.children) bar.append(element("b"));
    }
    drive.stages.forEach((stage, k) => {
      const bar = this.stages.children[k];
      bar.className = stage.state;
      const took = stage.seconds === null ? "" : `, ${duration(stage.seconds)}`;
      bar.title = `${stage.stage}: ${stage.state}${took}${stage.error ? `\n${stage.error}` : ""}`;
      bar.firstChild.style.width = `${100 * stage.progress}%`;
    });
    const done = drive.stages.filter(({ state }) => state === "done").length;
    this.stages.ariaLabel = `${done} of ${drive.stages.length} stages are done, ${Math.round(100 * drive.progress)} %`;
  }

  #fillWarnings(warnings) {
    const key = warnings.join("\n");
    this.warnings.hidden = !warnings.length;
    if (this.warnings.dataset.key === key) return;
    this.warnings.dataset.key = key;
    const shown = warnings.slice(0, MOST_WARNINGS).map((text) => element("li", "", text));
    if (warnings.length > MOST_WARNINGS) shown.push(element("li", "", `and ${warnings.length - MOST_WARNINGS} more`));
    this.warnings.replaceChildren(...shown);
  }

  #fillActions(drive) {
    const actions = actionsFor(drive, this.about);
    const key = actions.map(({ id }) => id).join();
    if (key === this.shownActions) return;
    this.shownActions = key;
    const had = this.menu.contains(document.activeElement) ? document.activeElement.dataset.action : null;
    const made = actions.map(({ id, label, danger }) => {
      const one = button(label, danger ? "danger" : "", () => this.#act(id));
      one.dataset.action = id;
      one.ariaLabel = `${label.replace("…", "")}: ${drive.name}`;
      return one;
    });
    const first = made.filter((one) => ["retry", "cancel"].includes(one.dataset.action));
    const rest = made.filter((one) => !first.includes(one));
    const more = element("details", "more");
    const head = element("summary", "", "More");
    head.ariaLabel = `More actions: ${drive.name}`;
    const list = element("div", "menu");
    list.append(...rest);
    more.append(head, list);
    this.menu.replaceChildren(...first, ...(rest.length ? [more] : []));
    if (had) (made.find((one) => one.dataset.action === had) ?? head).focus();
  }

  // By the drive as it is now, not as it was when the button was made.
  async #act(id) {
    const found = actionsFor(this.drive, this.about).find((one) => one.id === id);
    const open = this.menu.querySelector("details[open]");
    if (open) open.open = false;
    try {
      await found?.run();
    } catch (error) {
      return this.about.tell(`${this.drive.name}: ${error.message}`);
    }
    await this.about.acted();
  }
}
