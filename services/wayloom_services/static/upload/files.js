// Files of what was dropped or chosen, as drives: each folder or file at the top is one, its files below log/ as `wayloom upload` has them.

const JUNK = /(^|\/)(\.DS_Store|Thumbs\.db|desktop\.ini|__MACOSX|\.git)(\/|$)/;

const readBatch = (reader) => new Promise((resolve, reject) => reader.readEntries(resolve, reject));
const fileOf = (entry) => new Promise((resolve, reject) => entry.file(resolve, reject));

// Every file below an entry: [path from the entry on, File, how to have it as it is by then].
async function filesBelow(entry, path) {
  if (entry.isFile) return [[path, await fileOf(entry), () => fileOf(entry)]];
  const reader = entry.createReader();
  const found = [];
  for (let batch = await readBatch(reader); batch.length; batch = await readBatch(reader)) {
    for (const one of batch) found.push(...(await filesBelow(one, `${path}/${one.name}`)));
  }
  return found;
}

// [path, File, renew] of all that was dropped. The entries are taken at once: the browser forgets them after the event.
export async function dropped(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  return (await Promise.all(entries.map((entry) => filesBelow(entry, entry.name)))).flat();
}

export const chosen = (list) => [...list].map((file) => [file.webkitRelativePath || file.name, file]);

// Files of a GNSS log that is kept beside a drive, a file or a folder of them: { gnss, files } of its manifest, null of none.
export function gnssOf(pairs) {
  const found = pairs.filter(([path]) => !JUNK.test(path));
  if (!found.length) return null;
  const isPart = found[0][0].startsWith("oxts/"); // readers look for `oxts` below what they are given
  const part = found.filter(([path]) => path.split("/")[1] === "oxts");
  const files = (part.length ? part : found).map(([path, file]) => ({ path: isPart ? `gnss/log/${path}` : `gnss/${path}`, file }));
  return { gnss: files[0].path.split("/", 2).join("/"), files };
}

const bytesOf = (files) => files.reduce((sum, { file }) => sum + file.size, 0);
export const withGnss = (drive, beside) =>
  beside ? { ...drive, gnss: beside.gnss, files: [...drive.files, ...beside.files], bytes: bytesOf([...drive.files, ...beside.files]) } : drive;

// Drives of the files: { name, log, files: [{ path, file, renew }], bytes }.
export function drivesOf(pairs) {
  const tops = new Map();
  for (const [path, file, renew] of pairs) {
    if (JUNK.test(path)) continue;
    const top = path.split("/")[0];
    if (!tops.has(top)) tops.set(top, []);
    tops.get(top).push([path, file, renew]);
  }
  return [...tops].map(([name, found]) => {
    const isFolder = found.some(([path]) => path.includes("/"));
    const files = found
      .map(([path, file, renew]) => ({ path: `log/${isFolder ? path.slice(name.length + 1) : path}`, file, renew }))
      .sort((a, b) => (a.path < b.path ? -1 : 1));
    return {
      name: isFolder ? name : name.replace(/\.[^.]+$/, ""), log: isFolder ? "log" : `log/${name}`, files,
      bytes: bytesOf(files),
    };
  });
}

const OF_LOGS = /(^|\/)(times\.txt|timestamps\.txt|data\.csv)$|\.mcap$/;
const RAW = /^(.*\/)image_0[0-3]\/timestamps\.txt$/;
const CALIBRATION = /(^|\/)(calib_cam_to_cam|perspective)\.txt$/; // of KITTI's raw layout, of KITTI-360

// What speaks against a drive by the names of its files alone: { words, calibrationAt }, the latter where KITTI's calibration of the day, which
// is kept beside the drives of it, belongs.
export function doubtOf({ files }) {
  const paths = files.map(({ path }) => path);
  if (!paths.some((path) => OF_LOGS.test(path))) return { words: "No file of it is called as those of a drive log are (KITTI, EuRoC, MCAP): the service will hardly take it.", calibrationAt: null };
  const raw = paths.map((path) => RAW.exec(path)).find(Boolean);
  if (!raw || paths.some((path) => CALIBRATION.test(path))) return { words: "", calibrationAt: null };
  return { words: "KITTI keeps the calibration of a day beside its drives: give calib_cam_to_cam.txt and the others of that day, too.", calibrationAt: raw[1] };
}

export const withFiles = (drive, folder, found) => {
  const files = [...drive.files, ...found.map((file) => ({ path: `${folder}${file.name}`, file }))].sort((a, b) => (a.path < b.path ? -1 : 1));
  return { ...drive, files, bytes: bytesOf(files) };
};
