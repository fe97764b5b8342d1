// Files of what was dropped or chosen, as drives: each folder or file at the top is one, its files below log/ as `wayloom upload` has them.

const JUNK = /(^|\/)(\.DS_Store|Thumbs\.db|desktop\.ini|__MACOSX|\.git)(\/|$)/;

const readBatch = (reader) => new Promise((resolve, reject) => reader.readEntries(resolve, reject));
const fileOf = (entry) => new Promise((resolve, reject) => entry.file(resolve, reject));

// Every file below an entry: [path from the entry on, File].
async function filesBelow(entry, path) {
  if (entry.isFile) return [[path, await fileOf(entry)]];
  const reader = entry.createReader();
  const found = [];
  for (let batch = await readBatch(reader); batch.length; batch = await readBatch(reader)) {
    for (const one of batch) found.push(...(await filesBelow(one, `${path}/${one.name}`)));
  }
  return found;
}

// [path, File] of all that was dropped. The entries are taken at once: the browser forgets them after the event.
export async function dropped(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  return (await Promise.all(entries.map((entry) => filesBelow(entry, entry.name)))).flat();
}

export const chosen = (list) => [...list].map((file) => [file.webkitRelativePath || file.name, file]);

// Drives of the files: { name, log, files: [{ path, file }], bytes }.
export function drivesOf(pairs) {
  const tops = new Map();
  for (const [path, file] of pairs) {
    if (JUNK.test(path)) continue;
    const top = path.split("/")[0];
    if (!tops.has(top)) tops.set(top, []);
    tops.get(top).push([path, file]);
  }
  return [...tops].map(([name, found]) => {
    const isFolder = found.some(([path]) => path.includes("/"));
    const files = found
      .map(([path, file]) => ({ path: `log/${isFolder ? path.slice(name.length + 1) : path}`, file }))
      .sort((a, b) => (a.path < b.path ? -1 : 1));
    return {
      name: isFolder ? name : name.replace(/\.[^.]+$/, ""), log: isFolder ? "log" : `log/${name}`, files,
      bytes: files.reduce((sum, { file }) => sum + file.size, 0),
    };
  });
}
