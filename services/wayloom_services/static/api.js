// Requests to the service, with its key where it wants one, and its stream of events with polling where that breaks.

const KEY = "wayloom-key";
const SIGN_IN = "/sign-in";

export const headers = () => {
  const key = sessionStorage.getItem(KEY);
  // What a page of another origin cannot send: with a cookie, the server wants it of every change.
  return { "X-Requested-With": "wayloom", ...(key ? { Authorization: `Bearer ${key}` } : {}) };
};

export const keepKey = (key) => (key === null ? sessionStorage.removeItem(KEY) : sessionStorage.setItem(KEY, key));

export class Refused extends Error {
  constructor(status, detail) {
    super(detail);
    this.status = status;
  }
}

// To the sign-in, which leads back to what is seen now.
export function toSignIn() {
  location.replace(`${SIGN_IN}?next=${encodeURIComponent(location.pathname + location.search + location.hash)}`);
}

let asked = new AbortController();
const KEPT = { signal: null };

// Gives up what is asked for now, all but the changes of `listen`. What waits for it fails with an AbortError.
export function giveUp() {
  asked.abort();
  asked = new AbortController();
}

// The answer to a request, whatever its status; but where the session is over the page goes to the sign-in, and there is none.
export async function send(path, options = {}) {
  const answer = await fetch(path, { signal: asked.signal, ...options, headers: { ...headers(), ...options.headers } });
  if (answer.status !== 401 || location.pathname === SIGN_IN) return answer;
  toSignIn();
  return new Promise(() => {});
}

async function accepted(answer) {
  if (answer.ok) return answer;
  const body = await answer.json().catch(() => ({}));
  throw new Refused(answer.status, body.detail ?? answer.statusText);
}

export async function ask(path, options = {}) {
  const typed = options.body === undefined ? {} : { "Content-Type": "application/json" };
  const answer = await accepted(await send(path, { ...options, headers: typed }));
  return answer.status === 204 ? null : answer.json();
}

export const blobOf = async (path) => (await accepted(await send(path))).blob();

// Calls hear(event, data) for every change. Events come over one long answer; when it breaks, the lists are asked for until it is back.
export async function listen(hear, live) {
  for (let pause = 1000; ; pause = Math.min(2 * pause, 15000)) {
    try {
      const answer = await send("/v1/events", KEPT);
      if (!answer.ok || !answer.body) throw new Refused(answer.status, answer.statusText);
      live("live");
      pause = 1000;
      await readEvents(answer.body.getReader(), hear);
    } catch (error) {
      live(error instanceof Refused ? `refused: ${error.status}` : "offline");
    }
    await poll(hear, live);
    await new Promise((resolve) => setTimeout(resolve, pause));
  }
}

async function readEvents(reader, hear) {
  const decoder = new TextDecoder();
  for (let rest = ""; ; ) {
    const { value, done } = await reader.read();
    if (done) return;
    rest = (rest + decoder.decode(value, { stream: true })).replaceAll("\r\n", "\n");
    const blocks = rest.split("\n\n");
    rest = blocks.pop();
    for (const block of blocks) {
      const lines = block.split("\n").map((line) => [line.slice(0, line.indexOf(":")), line.slice(line.indexOf(":") + 1).trimStart()]);
      const event = lines.find(([name]) => name === "event")?.[1];
      const data = lines.filter(([name]) => name === "data").map(([, text]) => text).join("\n");
      if (event && data) hear(event, JSON.parse(data));
    }
  }
}

async function poll(hear, live) {
  try {
    const [{ drives }, { maps }] = await Promise.all([ask("/v1/drives?limit=200", KEPT), ask("/v1/maps", KEPT)]);
    drives.reverse().forEach((drive) => hear("drive", drive));
    maps.forEach((map) => hear("map", map));
    live("polling");
  } catch {
    live("offline");
  }
}
