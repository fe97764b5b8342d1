// Dialogs in which an operator says what shall be done: one element <dialog>, closed by Escape, its first field in focus.

import { element } from "/static/ui/dom.js";

// Asks. about: { title, text, fields, action, danger, check(values) -> why not | "" }. A field: { name, label, kind, value, options, hint }.
// The values by name, of kinds file, files and folder lists of files, or null where the dialog is closed without an answer. work(values) runs while the dialog is open, and an error of it is
// told there, so that what was typed is not lost.
export function dialog({ title, text, fields = [], action, danger = false, check = () => "", work }) {
  return new Promise((resolve) => {
    const box = element("dialog", "ask");
    const form = element("form");
    form.method = "dialog";
    const heading = element("h2", "", title);
    heading.id = "dialog-title";
    box.setAttribute("aria-labelledby", heading.id);
    const problem = element("p", "error");
    problem.setAttribute("role", "alert");
    problem.hidden = true;
    const inputs = fields.map(inputOf);
    const yes = element("button", danger ? "danger" : "primary", action);
    const no = element("button", "", "Close");
    no.type = "button";
    const row = element("div", "row end");
    row.append(no, yes);
    form.append(heading, ...(text ? [element("p", "", text)] : []), ...inputs.map(({ label }) => label), problem, row);
    box.append(form);
    document.body.append(box);
    const values = () => Object.fromEntries(inputs.map(({ name, input }) => [name, input.type === "file" ? [...input.files] : input.value]));
    const look = () => (yes.disabled = check(values()) !== "");
    form.addEventListener("input", look);
    look();
    let answer = null;
    no.addEventListener("click", () => box.close());
    box.addEventListener("close", () => {
      box.remove();
      resolve(answer);
    });
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      const wanted = values();
      yes.disabled = true;
      try {
        if (work) await work(wanted);
        answer = wanted;
        box.close();
      } catch (error) {
        problem.hidden = false;
        problem.textContent = error.message;
        yes.disabled = false;
      }
    });
    box.showModal();
  });
}

function inputOf({ name, label, kind = "text", value = "", options = [], hint = "", required = false }) {
  const wrap = element("label", "", label);
  const input = element(kind === "select" ? "select" : kind === "long" ? "textarea" : "input");
  if (kind === "select") input.append(...options.map(([key, words]) => new Option(words, key)));
  else if (kind !== "long") input.type = ["folder", "files"].includes(kind) ? "file" : kind;
  input.multiple = kind === "files";
  input.name = name;
  if (kind === "folder") input.webkitdirectory = true;
  if (input.type !== "file") input.value = value;
  input.required = required;
  if (kind === "text") input.autocomplete = "off";
  wrap.append(input);
  if (hint) wrap.append(element("small", "quiet", hint));
  return { name, label: wrap, input };
}
