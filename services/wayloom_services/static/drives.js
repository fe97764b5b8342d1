// Helpers of the list of drives under the address at which the map's modules ask for them.

export { element } from "/static/ui/dom.js";
export { gradeBadge } from "/static/list/card.js";
