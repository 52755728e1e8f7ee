/** Follows server-sent events by fetch, for EventSource cannot send a token; connects again by itself. */

const SILENT_MS = 10_000; // without a byte, after which a connection is given up
const FIRST_PAUSE_MS = 500;
const LONGEST_PAUSE_MS = 10_000;

/** Why no stream came: an answer of the service other than the stream. */
class Refused extends Error {
  constructor(status, reason) {
    super(reason);
    this.status = status;
  }
}

/**
 * A stream of events of one type, from `run` on for ever.
 *
 * `token()` is asked before each attempt. `onData(data)` gets each event's JSON. `onState(kind, reason, seconds)` hears
 * how the connection is: connecting, open, unauthorised (until `retry` is called), or waiting some seconds for the next
 * attempt.
 */
export class Stream {
  #wake = () => {};
  #attempt = new AbortController();
  #failures = 0;

  constructor(url, type, { token, onData, onState }) {
    Object.assign(this, { url, type, token, onData, onState });
  }

  /** Follow. */
  async run() {
    for (;;) {
      this.onState("connecting");
      try {
        await this.#follow();
        this.#failures += 1;
        await this.#pause("the service ended the stream");
      } catch (error) {
        if (error.status === 401 || error.status === 403) {
          this.onState("unauthorised", error.message);
          await new Promise((wake) => (this.#wake = wake));
          continue;
        }
        this.#failures += 1;
        await this.#pause(error.message);
      }
    }
  }

  /** Connect at once: there is a token, or the network is back. */
  retry() {
    this.#failures = 0;
    this.#wake();
  }

  /** Give up the connection and connect anew. */
  restart() {
    this.#attempt.abort(new Error("connecting anew"));
    this.retry();
  }

  async #follow() {
    const attempt = (this.#attempt = new AbortController());
    const { signal } = attempt;
    const giveUp = () => attempt.abort(new Error(`nothing came for ${SILENT_MS / 1000} s`));
    let watch = setTimeout(giveUp, SILENT_MS);
    const token = this.token();
    const headers = { Accept: "text/event-stream", ...(token && { Authorization: `Bearer ${token}` }) };
    try {
      const response = await fetch(this.url, { headers, signal, cache: "no-store" });
      if (!response.ok) throw new Refused(response.status, await reasonOf(response));
      this.onState("open");
      for await (const event of events(response.body, () => {
        clearTimeout(watch);
        watch = setTimeout(giveUp, SILENT_MS);
      })) {
        if (event.type !== this.type) continue;
        this.onData(JSON.parse(event.data));
        this.#failures = 0;
      }
    } catch (error) {
      throw signal.aborted ? signal.reason : error;
    } finally {
      clearTimeout(watch);
      attempt.abort(); // leaves no connection behind when an event could not be read
    }
  }

  async #pause(reason) {
    const longest = Math.min(LONGEST_PAUSE_MS, FIRST_PAUSE_MS * 2 ** (this.#failures - 1));
    const pause = longest * (0.5 + Math.random() / 2); // so that many pages do not come back at once
    this.onState("waiting", reason, pause / 1000);
    await new Promise((wake) => {
      this.#wake = wake;
      setTimeout(wake, pause);
    });
  }
}

/** What an answer says is wrong: the detail of a problem (RFC 9457), or its status. */
async function reasonOf(response) {
  const problem = await response.json().catch(() => null);
  return problem?.detail ?? `the service answers ${response.status}`;
}

/** The events in a body (WHATWG HTML, server-sent events); `heard` is called for every piece that comes. */
export async function* events(body, heard = () => {}) {
  const reader = body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  let type = "message";
  let data = [];
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    heard();
    rest += value;
    if (!value.includes("\n")) continue;
    const lines = rest.split("\n");
    rest = lines.pop();
    for (const line of lines.map((each) => each.replace(/\r$/, ""))) {
      const [, name, text] = /^([^:]*)(?:: ?(.*))?$/s.exec(line);
      if (line === "") {
        if (data.length) yield { type, data: data.join("\n") };
        type = "message";
        data = [];
      } else if (name === "event") type = text ?? "";
      else if (name === "data") data.push(text ?? "");
    }
  }
}
