// The Foxglove WebSocket protocol, as a viewer speaks it.

const SUBPROTOCOL = "foxglove.sdk.v1";
const MESSAGE = 1;
const PLAYBACK_STATE = 5;
const PLAYBACK_CONTROL = 3;

/** @typedef {{id: number, topic: string, encoding: string, schemaName: string, origin?: string}} Channel */

/** @typedef {{status: "playing" | "paused" | "buffering" | "ended", atNs: bigint, speed: number, didSeek: boolean}} Playback */

/**
 * What the connection calls.
 * @typedef {object} Handlers
 * @property {(info: any) => void} info
 * @property {(channel: Channel) => boolean} wants
 * @property {(channel: Channel, logTimeNs: bigint, data: DataView) => void} message
 * @property {() => void} restart the channels of a run are gone: another begins
 * @property {(playback: Playback) => void} playback
 * @property {(text: string) => void} status
 * @property {(isOpen: boolean) => void} open
 */

export class Connection {
  /**
   * @param {string} address
   * @param {Handlers} handlers
   */
  constructor(address, handlers) {
    this.handlers = handlers;
    /** Channel of each subscription, by number. @type {Map<number, Channel>} */
    this.channels = new Map();
    this.requests = 0;
    this.socket = new WebSocket(address, [SUBPROTOCOL]);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => handlers.open(true);
    this.socket.onclose = () => handlers.open(false);
    this.socket.onmessage = (event) => {
      if (typeof event.data === "string") this.#text(JSON.parse(event.data));
      else this.#binary(new DataView(event.data));
    };
  }

  /** @param {any} message */
  #text(message) {
    switch (message.op) {
      case "serverInfo": this.handlers.info(message); break;
      case "advertise": {
        const wanted = message.channels.filter(this.handlers.wants);
        // A subscription has the number of its channel.
        for (const channel of wanted) this.channels.set(channel.id, channel);
        if (wanted.length === 0) break;
        const subscriptions = wanted.map((/** @type {{id: number}} */ { id }) => ({ id, channelId: id }));
        this.socket.send(JSON.stringify({ op: "subscribe", subscriptions }));
        break;
      }
      case "unadvertise": {
        for (const id of message.channelIds) this.channels.delete(id);
        this.handlers.restart();
        break;
      }
      case "status": this.handlers.status(message.message); break;
    }
  }

  /** @param {DataView} view */
  #binary(view) {
    switch (view.getUint8(0)) {
      case MESSAGE: {
        const channel = this.channels.get(view.getUint32(1, true));
        if (channel) this.handlers.message(channel, view.getBigUint64(5, true), new DataView(view.buffer, 13));
        break;
      }
      case PLAYBACK_STATE: {
        const status = /** @type {const} */ (["playing", "paused", "buffering", "ended"])[view.getUint8(1)];
        this.handlers.playback({ status, atNs: view.getBigUint64(2, true), speed: view.getFloat32(10, true), didSeek: view.getUint8(14) !== 0 });
        break;
      }
    }
  }

  /**
   * @param {boolean} plays
   * @param {number} speed
   * @param {bigint | null} seekNs
   */
  play(plays, speed, seekNs) {
    const id = new TextEncoder().encode(`page-${++this.requests}`);
    const view = new DataView(new ArrayBuffer(19 + id.length));
    view.setUint8(0, PLAYBACK_CONTROL);
    view.setUint8(1, plays ? 0 : 1);
    view.setFloat32(2, speed, true);
    view.setUint8(6, seekNs === null ? 0 : 1);
    view.setBigUint64(7, seekNs ?? 0n, true);
    view.setUint32(15, id.length, true);
    new Uint8Array(view.buffer, 19).set(id);
    this.socket.send(view.buffer);
  }
}
