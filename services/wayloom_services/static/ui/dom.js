// Small helpers that every page builds its elements with.

export const at = (id) => document.getElementById(id);

export const element = (tag, className, text) => {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  return made;
};

export const svg = (tag, attributes = {}, text) => {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (text !== undefined) made.textContent = text;
  return made;
};

// A button that is disabled while what it does is under way.
export const button = (text, className, work) => {
  const made = element("button", className, text);
  made.type = "button";
  made.addEventListener("click", async (event) => {
    made.disabled = true;
    try {
      await work(event);
    } finally {
      made.disabled = false;
      if (document.activeElement === document.body) made.focus(); // a dialog cannot give it back to a button that is disabled
    }
  });
  return made;
};

export const link = (text, className, address) => {
  const made = element("a", className, text);
  made.href = address;
  return made;
};

// Sets a text only where it differs, so that what a screen reader or a selection holds stays as it is.
export const say = (node, text) => {
  if (node.textContent !== text) node.textContent = text;
  node.hidden = text === "";
};

// A table of rows of texts or nodes; the first cell of a row is its header where heads is not given.
export function table(rows, heads) {
  const made = element("table");
  if (heads) {
    const line = made.createTHead().insertRow();
    for (const head of heads) {
      const cell = element("th", "", head);
      cell.scope = "col";
      line.append(cell);
    }
  }
  const body = made.createTBody();
  for (const row of rows) {
    const line = body.insertRow();
    row.forEach((content, column) => {
      const cell = element(!heads && column === 0 ? "th" : "td");
      if (cell.tagName === "TH") cell.scope = "row";
      cell.append(content ?? "");
      line.append(cell);
    });
  }
  return made;
}
