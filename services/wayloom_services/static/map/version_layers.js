// The layers of one version on a map: pictures and vector tiles, with classes switched off where they are.

import { namesWithin } from "/static/map/overlay_classes.js";
import { addressWithout, overlayAddress } from "/static/map/shown_classes.js";
import { classPaint, FEATURES, HIDDEN, KIND_OF_CLASS } from "/static/map/style.js";

const PHOTO = "ortho";
const CLASS_PICTURES = new Set(["semantic"]);
export const CLASS_LIST = "class-list";
const LISTED_UP_TO = 14;

export class VersionLayers {
  // before: the id of the layer under which pictures lie. above: of that under which features lie. overlays: names of pictures over the classes.
  constructor(map, overlays, before, above) {
    Object.assign(this, { map, overlays, before, above, version: null, hidden: new Set(), off: new Set([...overlays, ...HIDDEN]) });
  }

  get names() {
    return [PHOTO, "semantic", ...this.overlays, ...Object.keys(FEATURES)];
  }

  ids(name) {
    return name in FEATURES ? Object.keys(FEATURES[name]) : [name];
  }

  show(version) {
    this.version = version;
    this.#showClassList();
    for (const name of [PHOTO, "semantic", ...this.overlays]) this.#showPictures(name);
    for (const name of Object.keys(FEATURES)) this.#showFeatures(name);
  }

  visible(name, on) {
    if (on) this.off.delete(name);
    else this.off.add(name);
    for (const id of this.ids(name)) if (this.map.getLayer(id)) this.map.setLayoutProperty(id, "visibility", on ? "visible" : "none");
  }

  // classes: [{ id, name }] that are not drawn.
  hide(classes) {
    this.hidden = new Set(classes.map(({ id }) => id));
    this.kinds = classes.map(({ name }) => KIND_OF_CLASS[name]).filter(Boolean);
    if (!this.version) return;
    for (const name of CLASS_PICTURES) this.map.getSource(name)?.setTiles([this.#address(name)]);
    for (const id of ["areas", "objects"]) if (this.map.getLayer(id)) this.map.setFilter(id, this.#filter());
  }

  #filter() {
    return this.kinds?.length ? ["!", ["in", ["get", "kind"], ["literal", this.kinds]]] : null;
  }

  #base(name) {
    return `${location.origin}/v1/maps/${this.version.map_id}/versions/${this.version.version}/tiles/${name}`;
  }

  #address(name) {
    const suffix = name in FEATURES || name === "features" ? "mvt" : name === PHOTO ? "webp" : "png";
    const plain = `${this.#base(name)}/{z}/{x}/{y}.${suffix}`;
    if (this.overlays.includes(name)) return overlayAddress(plain);
    return CLASS_PICTURES.has(name) ? addressWithout(plain, this.hidden) : plain;
  }

  #take(name, ids) {
    for (const id of ids) if (this.map.getLayer(id)) this.map.removeLayer(id);
    if (this.map.getSource(name)) this.map.removeSource(name);
  }

  #common(layer) {
    const { bounds } = this.version;
    return { minzoom: layer.min_zoom, maxzoom: layer.max_zoom, ...(bounds && bounds[0] <= bounds[2] ? { bounds } : {}) };
  }

  // In the place of those of the version before.
  #showPictures(name) {
    const layer = this.version.layers[name];
    this.#take(name, [name]);
    if (!layer) return;
    const photo = name === PHOTO;
    this.map.addSource(name, { type: "raster", tiles: [this.#address(name)], tileSize: photo ? 512 : 256, ...this.#common(layer) });
    const layout = { visibility: this.off.has(name) ? "none" : "visible" };
    const paint = { "raster-resampling": photo ? "linear" : "nearest" };
    this.map.addLayer({ id: name, type: "raster", source: name, layout, paint }, this.before);
  }

  // For the page's light or dark scheme.
  recolour() {
    for (const name of ["semantic", ...this.overlays]) this.map.getSource(name)?.setTiles([this.#address(name)]);
    for (const id of ["areas", "objects"]) {
      if (this.map.getLayer(id)) for (const [property, value] of Object.entries(classPaint(id))) this.map.setPaintProperty(id, property, value);
    }
  }

  #showFeatures(name) {
    const layer = this.version.layers[name];
    this.#take(name, this.ids(name));
    if (!layer) return;
    this.map.addSource(name, { type: "vector", tiles: [this.#address(name)], ...this.#common(layer) });
    for (const [id, drawn] of Object.entries(FEATURES[name])) {
      const layout = { ...drawn.layout, visibility: this.off.has(name) ? "none" : "visible" };
      const filter = ["areas", "objects"].includes(id) && this.#filter() ? { filter: this.#filter() } : {};
      this.map.addLayer({ ...drawn, ...filter, paint: { ...drawn.paint, ...classPaint(id) }, id, source: name, "source-layer": id, layout }, this.above);
    }
  }

  // Coarse cells that nobody sees: they tell which classes there are.
  #showClassList() {
    const layer = this.version.layers.features;
    this.#take(CLASS_LIST, [CLASS_LIST]);
    if (!layer) return;
    const about = { ...this.#common(layer), maxzoom: Math.min(layer.max_zoom, LISTED_UP_TO) };
    this.map.addSource(CLASS_LIST, { type: "vector", tiles: [this.#address("features")], ...about });
    this.map.addLayer({ id: CLASS_LIST, type: "fill", source: CLASS_LIST, "source-layer": "semantic", paint: { "fill-opacity": 0 } }, this.before);
  }

  // Names of the classes of which the tiles in sight have voxels; null where they do not tell.
  classesHere() {
    if (!this.map.getSource(CLASS_LIST)) return null;
    const found = new Set();
    for (const { properties } of this.map.querySourceFeatures(CLASS_LIST, { sourceLayer: "semantic" })) {
      for (const name of Object.keys(properties)) if (name.startsWith("n_")) found.add(name.slice(2).replaceAll("_", " "));
    }
    return found.size ? found : null;
  }

  // Names of the classes in the pictures of an overlay that are in sight; none where it is not shown.
  classesOf(name) {
    const isShown = !this.off.has(name) && this.map.getLayer(name) && Math.round(this.map.getZoom() + 1) >= this.version.layers[name].min_zoom;
    return isShown ? namesWithin(this.#base(name), this.map.getBounds()) : new Set();
  }
}
