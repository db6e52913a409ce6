// The websocket connection: JSON both ways, images from the server; reconnects when lost.

const FIRST_WAIT = 500;
const LONGEST_WAIT = 10000;

export class Connection {
  /**
   * Handlers: open(), text(message), image(header, bytes), lost(seconds until the next attempt,
   * reason).
   */
  constructor(address, handlers) {
    this.address = address;
    this.handlers = handlers;
    this.wait = FIRST_WAIT;
    this.reason = "";
    this.timer = null;
    this.connect();
    addEventListener("online", () => this.retry());
  }

  get isOpen() {
    return this.socket.readyState === WebSocket.OPEN;
  }

  /** Send a message; false if not connected. */
  send(message) {
    if (!this.isOpen) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  /** Reconnect now, if disconnected. */
  retry() {
    if (this.timer === null) return;
    clearTimeout(this.timer);
    this.timer = null;
    this.connect();
  }

  connect() {
    const socket = new WebSocket(this.address);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => this.handlers.open();
    socket.onmessage = event => this.receive(event.data);
    socket.onclose = event => {
      const reason = event.reason || this.reason;
      this.reason = "";
      const wait = this.wait * (1 + Math.random() / 4);
      this.wait = Math.min(this.wait * 2, LONGEST_WAIT);
      this.timer = setTimeout(() => this.retry(), wait);
      this.handlers.lost(wait / 1000, reason);
    };
  }

  receive(content) {
    if (typeof content === "string") {
      const message = JSON.parse(content);
      if (message.type === "hello") this.wait = FIRST_WAIT;
      if (message.type === "closing") this.reason = message.reason;
      this.handlers.text(message);
      return;
    }
    const size = new DataView(content).getUint32(0, true);
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(content, 4, size)));
    this.handlers.image(header, new Uint8Array(content, 4 + size));
  }
}
