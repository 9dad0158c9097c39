// A viewer's hands by the client library of the protocol's authors: node ws.mjs STREAM play|steer|live prints what happened as JSON.
// That library (0.8.0) has no playback control, whose bytes are sent beside it over its socket.
import FoxgloveClientModule from "@foxglove/ws-protocol";
import protobuf from "protobufjs";
import descriptor from "protobufjs/ext/descriptor/index.js";
import WebSocket from "ws";

const FoxgloveClient = FoxgloveClientModule.FoxgloveClient ?? FoxgloveClientModule.default ?? FoxgloveClientModule;
const [address, what] = process.argv.slice(2);
const socket = new WebSocket(address, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]);
socket.binaryType = "arraybuffer";
const client = new FoxgloveClient({ ws: socket });
const out = { errors: [] };
const later = (/** @type {number} */ ms) => new Promise((go) => setTimeout(go, ms));
const limit = setTimeout(() => end("nothing more came in 60 s"), 60000);

function end(error) {
  clearTimeout(limit);
  if (error) out.errors.push(String(error));
  process.stdout.write(JSON.stringify(out) + "\n", () => process.exit(0));
}

// Once the playback was asked for, its state is sent, which this library does not know.
let controls = false;
client.on("error", (error) => {
  const message = error.message ?? String(error);
  if (!(controls && /opcode.*: 5$/.test(message))) end(message);
});
client.on("status", ({ level, message }) => { if (level > 0) out.errors.push(message); });
const info = new Promise((go) => client.on("serverInfo", go));
const channels = new Map();
const waits = [];
const services = new Map();
client.on("advertiseServices", (all) => all.forEach((service) => services.set(service.name, service)));
client.on("advertise", (all) => {
  all.forEach((channel) => channels.set(channel.topic, channel));
  waits.splice(0).forEach((go) => go());
});
const channel = async (topic) => {
  while (!channels.has(topic)) await new Promise((go) => waits.push(go));
  return channels.get(topic);
};
let heard = [];
client.on("message", ({ subscriptionId, timestamp, data }) => heard.push({ subscriptionId, ns: timestamp, data }));

/** The player's request: play or pause, speed, time or null. */
function control(plays, speed, seekNs) {
  controls = true;
  const id = new TextEncoder().encode("hands");
  const view = new DataView(new ArrayBuffer(19 + id.length));
  view.setUint8(0, 3);
  view.setUint8(1, plays ? 0 : 1);
  view.setFloat32(2, speed, true);
  view.setUint8(6, seekNs === null ? 0 : 1);
  view.setBigUint64(7, seekNs ?? 0n, true);
  view.setUint32(15, id.length, true);
  new Uint8Array(view.buffer, 19).set(id);
  socket.send(view.buffer);
}

try {
  const server = await info;
  out.capabilities = server.capabilities;
  if (what === "play") {
    const markers = await channel("/view/recording.bone_marker");
    const id = client.subscribe(markers.id);
    await later(800);
    const first = heard.at(-1).ns;
    out.stopped = heard.length;
    const start = BigInt(server.dataStartTime.sec) * 1000000000n + BigInt(server.dataStartTime.nsec);
    heard = [];
    control(true, 4, start + 35000000000n);
    await later(2500);
    control(false, 4, null);
    await later(400);
    const times = heard.filter((message) => message.subscriptionId === id).map((message) => Number(message.ns - start) / 1e9);
    out.seek_s = times.find((time) => time >= 34.5);
    out.last_s = times.at(-1);
    out.played = times.length;
    heard = [];
    await later(1000);
    out.paused = heard.length;
    out.end_s = Number(first - start) / 1e9;
    control(false, 1, start + 40000000000n);
    await later(800);
    out.sought_s = Number(heard.at(-1).ns - start) / 1e9;
  } else if (what === "steer") {
    const replies = [];
    client.on("parameterValues", (event) => replies.push(event));
    client.getParameters(["icp.max_iterations"], "before");
    const reply = async (id) => {
      for (;;) {
        const found = replies.find((event) => event.id === id);
        if (found) return found.parameters;
        await later(50);
      }
    };
    out.before = (await reply("before"))[0].value;
    client.setParameters([{ name: "icp.max_iterations", value: 77 }], "set");
    out.after = (await reply("set")).find(({ name }) => name === "icp.max_iterations").value;
    const named = [...services.values()].find(({ name }) => /revert/.test(name));
    out.services = [...services.keys()];
    if (named) {
      const answered = new Promise((go) => client.on("serviceCallResponse", go));
      client.on("serviceCallFailure", ({ message }) => out.errors.push(message));
      const data = new DataView(new TextEncoder().encode("{}").buffer);
      (client.sendServiceCallRequest ?? client.sendCallServiceRequest).call(client, { serviceId: named.id, callId: 1, encoding: "json", data });
      const { data: said } = await answered;
      out.reverted = new TextDecoder().decode(said);
      client.getParameters(["icp.max_iterations"], "again");
      out.again = (await reply("again"))[0].value;
    }
  } else {
    const registered = await channel("/run/registered");
    const subscription = client.subscribe(registered.id);
    const state = client.subscribe((await channel("/viewer/state")).id);
    const type = protobuf.Root.fromDescriptor(descriptor.FileDescriptorSet.decode(Buffer.from(registered.schema, "base64"))).lookupType(registered.schemaName);
    for (;;) {
      const last = heard.filter((message) => message.subscriptionId === state).at(-1);
      if (last && JSON.parse(new TextDecoder().decode(last.data)).state !== "running" && heard.some((message) => message.subscriptionId === subscription)) break;
      await later(100);
    }
    const { data } = heard.filter((message) => message.subscriptionId === subscription).at(-1);
    const message = type.decode(new Uint8Array(data.buffer, data.byteOffset, data.byteLength));
    const bytes = new DataView(message.data.buffer, message.data.byteOffset, message.data.byteLength);
    const stride = message.point_stride ?? message.pointStride;
    out.registered = [];
    for (let at = 0; at < bytes.byteLength; at += stride) out.registered.push(...[0, 4, 8].map((k) => bytes.getFloat32(at + k, true)));
  }
  end();
} catch (error) {
  end(error.stack ?? error);
}
