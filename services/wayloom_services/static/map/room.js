// Where the map is free of what lies over it: tools, the legend, versions, plans of sites, what is told.

const OVER = "#tools, #legend, #versions, #insets, #map-list, #told, .maplibregl-ctrl, .plain-buttons, .plain-note";
const EDGE = 24;
const LEAST = 96; // less room than that is worse than what lies under a panel

const isOver = (one, other) => one.left < other.right && one.right > other.left && one.top < other.bottom && one.bottom > other.top;
const scaleOf = ({ left, top, right, bottom }, shape) => Math.min((right - left) / shape, bottom - top);

// Of the rectangles within `free` that no panel touches, the one in which a box of a shape (width over height) gets largest.
export function roomBeside(free, panels, shape) {
  const over = panels.find((panel) => isOver(panel, free));
  if (!over) return free;
  const cuts = [{ ...free, left: over.right }, { ...free, right: over.left }, { ...free, top: over.bottom }, { ...free, bottom: over.top }];
  return cuts.map((cut) => roomBeside(cut, panels, shape)).reduce((best, one) => (scaleOf(one, shape) > scaleOf(best, shape) ? one : best));
}

// The room in pixels from the map's own corner: { left, top, right, bottom }. container: the map's element. shape: of what shall be shown there.
export function roomOn(container, shape) {
  const map = container.getBoundingClientRect();
  const whole = { left: EDGE, top: EDGE, right: Math.max(map.width - EDGE, EDGE + 1), bottom: Math.max(map.height - EDGE, EDGE + 1) };
  const boxes = [...document.querySelectorAll(OVER)].map((panel) => panel.getBoundingClientRect()).filter((box) => box.width && box.height);
  const panels = boxes.map(({ left, top, right, bottom }) => ({
    left: left - map.left - EDGE, top: top - map.top - EDGE, right: right - map.left + EDGE, bottom: bottom - map.top + EDGE,
  }));
  const room = roomBeside(whole, panels, Math.min(Math.max(shape, 0.01), 100));
  return room.right - room.left < LEAST || room.bottom - room.top < LEAST ? whole : room;
}
