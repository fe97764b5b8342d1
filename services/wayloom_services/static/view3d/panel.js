// The panel of the 3D page: what is chosen there goes to `act`, what is the case comes from `show`, `classes`, `drive` and so on.

import { onGround } from "/static/ui/tones.js";
import { element } from "/static/ui/dom.js";
import { CIVIDIS, endsOf, VIRIDIS } from "/static/view3d/colours.js";

export class Panel {
  // act: { change(more, step), fly(), goTo(share), speed(m_s), save(), fit(), site(number), north() }.
  constructor(at, info, act) {
    Object.assign(this, { at, info, act, listed: "" });
    const heard = (id, event, work) => at(id).addEventListener(event, () => work(at(id)));
    heard("colour", "change", ({ value }) => act.change({ colour: value }));
    heard("size", "input", ({ value }) => act.change({ size: Number(value) }, false));
    heard("detail", "input", ({ value }) => act.change({ detail: Number(value) }, false));
    heard("drive", "change", ({ value }) => act.change({ drive: value }));
    heard("along", "input", ({ value }) => act.goTo(value / 1000));
    heard("speed", "input", ({ value }) => (act.speed(Number(value)), (at("pace").textContent = `${value} m/s`)));
    heard("site", "change", ({ value }) => act.site(Number(value)));
    heard("play", "click", act.fly);
    heard("shot", "click", act.save);
    heard("fit", "click", () => act.fit());
    heard("north", "click", act.north);
    if (matchMedia("(max-width: 800px)").matches) at("panel").open = false;
  }

  show(state) {
    for (const name of ["colour", "size", "detail"]) this.at(name).value = state[name];
    for (const box of this.at("panel").querySelectorAll("#classes input")) box.checked = !state.hidden.has(box.value);
    if ([...this.at("drive").options].some(({ value }) => value === state.drive)) this.at("drive").value = state.drive;
    this.#mayFly(state);
  }

  // Boxes for the classes that are there, in the catalogue's order.
  classes(ids, state) {
    const here = this.info.classes.filter(({ id }) => ids.has(id));
    const names = here.map(({ name }) => name).join(",");
    if (names === this.listed) return;
    this.listed = names;
    this.at("classes").replaceChildren(...here.map(({ name, colour }) => this.#classBox(name, colour, state)));
  }

  #classBox(name, colour, state) {
    const [item, label, box, square] = [element("li"), element("label"), element("input"), element("i")];
    Object.assign(box, { type: "checkbox", value: name, checked: !state.hidden.has(name) });
    box.addEventListener("change", () => {
      const hidden = new Set(state.hidden);
      if (box.checked) hidden.delete(name);
      else hidden.add(name);
      this.act.change({ hidden });
    });
    square.style.background = onGround(colour);
    label.append(box, square, name);
    item.append(label);
    return item;
  }

  // Overlays that the version has.
  layers(names, state) {
    const group = this.at("layers");
    group.hidden = names.length === 0;
    group.replaceChildren(element("legend", "", "Also show"));
    for (const name of names) {
      const [label, box] = [element("label"), element("input")];
      Object.assign(box, { type: "checkbox", value: name, checked: state.layers.has(name) });
      box.addEventListener("change", () => {
        const layers = new Set(state.layers);
        if (box.checked) layers.add(name);
        else layers.delete(name);
        this.act.change({ layers });
      });
      label.append(box, ` ${name}`);
      group.append(label);
    }
  }

  ramp(mode, range, baseM) {
    this.at("ramp").hidden = mode === "class";
    if (mode === "class") return;
    const pen = this.at("ramp-bar").getContext("2d");
    (mode === "age" ? [...CIVIDIS].reverse() : VIRIDIS).forEach((colour, step) => {
      pen.fillStyle = colour;
      pen.fillRect(step, 0, 1, 1);
    });
    [this.at("ramp-low").textContent, this.at("ramp-high").textContent] = endsOf(mode, range, baseM);
  }

  drive({ id, name }, state) {
    const choice = this.at("drive");
    if ([...choice.options].some(({ value }) => value === id)) return;
    const option = element("option", "", name);
    option.value = id;
    choice.append(option);
    if (id === state.drive) choice.value = id;
    this.at("fly").hidden = false;
    this.#mayFly(state);
  }

  forget(id) {
    [...this.at("drive").options].find(({ value }) => value === id)?.remove();
  }

  #mayFly({ drive }) {
    for (const id of ["play", "along"]) this.at(id).disabled = !drive;
  }

  flown(share, flying) {
    this.at("along").value = Math.round(1000 * share);
    this.at("play").textContent = flying ? "Stop" : "Fly";
    for (const id of ["play", "along"]) this.at(id).disabled = !this.at("drive").value;
  }

  sites(sites) {
    this.at("site-row").hidden = sites.length < 2;
    this.at("site").replaceChildren(...sites.map((_, number) => Object.assign(element("option", "", `Site ${number + 1}`), { value: number })));
  }
}
