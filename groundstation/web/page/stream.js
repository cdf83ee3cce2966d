// The stream of the ground station, opened again whenever it ends, and the clock that says how old the last word is.

const STALE_MS = 2000; // without any message the page says that it is old
const FIRST_WAIT_MS = 250;
const LONGEST_WAIT_MS = 4000;
const LOOK_EVERY_MS = 250;
const NOT_ALLOWED = 1008; // the ground station's code for somebody whom it does not know

/** Keeps a WebSocket open; tells of messages, of what the connection is, and of not being let in any more. */
export class Stream {
  constructor(path, { onMessage, onState, onShutOut }) {
    this.path = path;
    this.onMessage = onMessage;
    this.onState = onState;
    this.onShutOut = onShutOut;
    this.lastMs = performance.now();
    this.waitMs = FIRST_WAIT_MS;
    this.quietAllowed = false;
    this.socket = null;
    this.told = "";
    setInterval(() => this.look(), LOOK_EVERY_MS);
    this.open();
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    this.socket = new WebSocket(`${scheme}//${location.host}${this.path}`);
    this.socket.addEventListener("message", (event) => this.heard(event.data));
    this.socket.addEventListener("close", (event) => this.again(event.code));
  }

  heard(text) {
    this.lastMs = performance.now();
    this.waitMs = FIRST_WAIT_MS;
    this.onMessage(JSON.parse(text));
    this.look();
  }

  again(code) {
    this.socket = null;
    if (code === NOT_ALLOWED) this.onShutOut();
    else setTimeout(() => this.open(), this.waitMs);
    this.waitMs = Math.min(2 * this.waitMs, LONGEST_WAIT_MS);
    this.look();
  }

  /** Seconds since the last message. */
  ageS() {
    return (performance.now() - this.lastMs) / 1000;
  }

  look() {
    const open = this.socket !== null && this.socket.readyState === WebSocket.OPEN;
    const late = performance.now() - this.lastMs > STALE_MS && !(this.quietAllowed && open);
    this.onState(late ? "stale" : "live", this.ageS());
  }
}
