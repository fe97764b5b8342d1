// The map's place on the page: the WebGL map where it can be had, else a plain one, and the tools beside it. The page does not wait for it.

import { ask } from "/static/api.js";

const hasWebGL2 = () => document.createElement("canvas").getContext("webgl2") !== null;

function styled(address) {
  const link = document.createElement("link");
  link.rel = "stylesheet";
  link.href = address;
  return new Promise((resolve, reject) => {
    link.addEventListener("load", resolve);
    link.addEventListener("error", () => reject(new Error(`${address} does not load`)));
    document.head.append(link);
  });
}

async function glMap(container, about) {
  if (!hasWebGL2()) throw new Error("this browser has no WebGL 2");
  const [{ mountMap }] = await Promise.all([import("/static/map.js"), styled("/static/vendor/maplibre-gl/maplibre-gl.css")]);
  return mountMap(container, about);
}

async function anyMap(container, about) {
  try {
    return await glMap(container, about);
  } catch (error) {
    const { mountMap } = await import("/static/plain_map.js");
    container.replaceChildren();
    return mountMap(container, { ...about, why: error.message });
  }
}

// The one interface of every map: show(version), track(drive), forget(id), choose(id, fits), fit(), visible(name, on), hear(what, work).
// Calls may come before the map is there: they wait for it, in their order. Where no map loads at all they do nothing.
export class MapHost {
  // container: an element; info: the answer of /v1/info; at: finds an element of the page by its id; chosen(id): a drive has been chosen.
  constructor(container, info, at, chosen) {
    this.mounted = anyMap(container, { info, ask }).catch((error) => {
      container.textContent = `No map: ${error.message}`;
      return null;
    });
    this.mounted.then((city) => {
      city?.hear("chosen", chosen);
      if (city) this.#mountTools(city, info, at);
    });
  }

  // Measuring, 3D and whatever else draws on the map; the page does without where they do not load.
  async #mountTools(city, info, at) {
    try {
      const { mountTools } = await import("/static/map_tools.js");
      await mountTools(city, { info, ask, at });
    } catch (error) {
      console.warn(`map tools: ${error.message}`);
    }
  }

  async #call(name, ...rest) {
    const city = await this.mounted;
    return city?.[name](...rest);
  }

  show(version) {
    return this.#call("show", version);
  }

  track(drive) {
    return this.#call("track", drive);
  }

  forget(id) {
    return this.#call("forget", id);
  }

  choose(id, fits = true) {
    return this.#call("choose", id, fits);
  }

  fit() {
    return this.#call("fit");
  }

  visible(name, on) {
    return this.#call("visible", name, on);
  }
}
