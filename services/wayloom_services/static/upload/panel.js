// Sending drives from the page: a folder is dropped anywhere or chosen by a button, looked at, named, and sent; its progress stands over the list.

import { chosen, doubtOf, drivesOf, dropped, gnssOf, withFiles, withGnss } from "/static/upload/files.js";
import { Sender } from "/static/upload/sender.js";
import { dialog } from "/static/ui/dialogs.js";
import { at, button, element, say } from "/static/ui/dom.js";
import { announce } from "/static/ui/frame.js";
import { many, size } from "/static/ui/words.js";

const WORDS = { hashing: "reading", announcing: "announcing", sending: "sending", paused: "paused", stopped: "stopped", sent: "sent" };

class UploadCard {
  constructor(drive) {
    this.root = element("section", "upload");
    this.root.ariaLabel = `Upload of ${drive.name}`;
    this.words = element("p", "words");
    this.bar = element("progress");
    this.bar.max = 1;
    this.bar.ariaLabel = `Progress of ${drive.name}`;
    this.error = element("p", "error");
    this.error.setAttribute("role", "alert");
    this.hold = button("Pause", "", () => this.sender.pause());
    this.go = button("Go on", "primary", async () => void this.sender.resume());
    this.drop = button("Cancel", "", () => this.sender.cancel());
    const row = element("div", "row");
    row.append(this.hold, this.go, this.drop);
    const name = element("p", "name", drive.name);
    this.root.append(name, this.bar, this.words, this.error, row);
    this.sender = new Sender(drive, () => this.#fill());
    this.#fill();
    this.sender.run();
  }

  #fill() {
    const { state, drive, read, sent, total, filesDone, error } = this.sender;
    if (state === "cancelled") return this.root.remove();
    const done = state === "hashing" ? read : sent;
    this.root.dataset.state = state;
    this.bar.value = total ? done / total : 1;
    const files = state === "hashing" ? many(drive.files.length, "file") : `${filesDone.toLocaleString("en")} of ${many(drive.files.length, "file")}`;
    say(this.words, `${WORDS[state]} · ${size(done)} of ${size(total)} · ${files}`);
    say(this.error, error);
    this.hold.hidden = state !== "sending";
    this.go.hidden = !["paused", "stopped"].includes(state);
    say(this.drop, state === "sent" ? "Close" : "Cancel");
    if (state !== "sent" || this.told) return;
    this.told = true;
    announce(`${drive.name} is sent`);
    setTimeout(() => this.root.remove(), 8000);
  }
}

// Asks for name and vehicle of each drive, and begins.
async function offer(pairs) {
  for (const drive of drivesOf(pairs)) {
    const doubt = doubtOf(drive);
    const wanted = await dialog({
      title: "Send a drive", action: "Send", text: `${many(drive.files.length, "file")}, ${size(drive.bytes)}. Nothing is sent before you say so. ${doubt.words}`.trim(),
      fields: [
        ...(doubt.calibrationAt === null ? [] : [{ name: "calibration", label: "Calibration of that day, its files", kind: "files", required: true }]),
        { name: "name", label: "Name", value: drive.name, required: true },
        { name: "vehicle", label: "Vehicle", hint: "empty: as the log says" },
        { name: "gnss", label: "GNSS log that is kept beside it, a file", kind: "file" },
        { name: "gnssFolder", label: "or a folder of one", kind: "folder" },
      ],
      check: ({ name, gnss, gnssFolder, calibration }) => (calibration?.length === 0 ? "no calibration" : !name.trim() ? "no name" : gnss.length && gnssFolder.length ? "a file or a folder" : ""),
    });
    if (!wanted) continue;
    const beside = gnssOf(chosen([...wanted.gnss, ...wanted.gnssFolder]));
    const whole = withFiles(drive, doubt.calibrationAt, wanted.calibration ?? []);
    at("uploads").append(new UploadCard({ ...withGnss(whole, beside), name: wanted.name.trim(), vehicle: wanted.vehicle.trim() }).root);
  }
}

function picker() {
  const input = element("input");
  input.type = "file";
  input.id = "choose-folder";
  input.webkitdirectory = true;
  input.hidden = true;
  input.ariaLabel = "Folder of a drive";
  input.addEventListener("change", async () => {
    const pairs = chosen(input.files);
    input.value = "";
    await offer(pairs);
  });
  return input;
}

export function mountUpload() {
  const input = picker();
  at("send").append(button("Send a drive…", "", async () => input.click()), input);
  at("send").hidden = false;
  const hint = element("div", "drop-hint");
  hint.append(element("p", "", "Drop the folder of a drive to send it"));
  hint.hidden = true;
  document.body.append(hint);
  const isFiles = (event) => event.dataTransfer?.types.includes("Files");
  let depth = 0;
  addEventListener("dragenter", (event) => {
    if (!isFiles(event)) return;
    depth += 1;
    hint.hidden = false;
  });
  addEventListener("dragleave", (event) => {
    if (isFiles(event) && --depth <= 0) hint.hidden = true;
  });
  addEventListener("dragover", (event) => isFiles(event) && event.preventDefault());
  addEventListener("drop", async (event) => {
    if (!isFiles(event)) return;
    event.preventDefault();
    depth = 0;
    hint.hidden = true;
    await offer(await dropped(event.dataTransfer));
  });
  addEventListener("beforeunload", (event) => {
    const busy = [...at("uploads").children].some((one) => ["hashing", "announcing", "sending"].includes(one.dataset.state));
    if (busy) event.preventDefault();
  });
}
