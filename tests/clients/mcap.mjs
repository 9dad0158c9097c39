// Decodes every message of a recording as Lichtblick does: node mcap.mjs RUN.MCAP prints what it found as JSON.
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { FileHandleReadable } from "@mcap/nodejs";
import { decompress } from "fzstd";
import { open } from "node:fs/promises";
import protobuf from "protobufjs";
import descriptor from "protobufjs/ext/descriptor/index.js";

/** The decoder of a channel, as parseChannel of Lichtblick chooses it; an encoding that it does not know throws. */
function decoder(channel, schema) {
  if (channel.messageEncoding === "json") return (data) => JSON.parse(new TextDecoder().decode(data));
  if (channel.messageEncoding === "protobuf" && schema.encoding === "protobuf") {
    const set = descriptor.FileDescriptorSet.decode(schema.data);
    const type = protobuf.Root.fromDescriptor(set).lookupType(schema.name);
    return (data) => type.decode(data);
  }
  if (channel.messageEncoding === "cdr" && schema.encoding === "ros2msg") {
    const reader = new MessageReader(parse(new TextDecoder().decode(schema.data), { ros2: true }));
    return (data) => reader.readMessage(data);
  }
  throw new Error(`Unsupported encoding ${channel.messageEncoding}`);
}

const reader = await McapIndexedReader.Initialize({
  readable: new FileHandleReadable(await open(process.argv[2])),
  decompressHandlers: { zstd: (data, size) => decompress(data, new Uint8Array(Number(size))) },
});
const errors = [];
const decoders = new Map();
for (const channel of reader.channelsById.values()) {
  try {
    decoders.set(channel.id, decoder(channel, reader.schemasById.get(channel.schemaId)));
  } catch (error) {
    errors.push(`${channel.topic}: ${error.message}`);
  }
}
let messages = 0;
let registered = [];
for await (const { channelId, data } of reader.readMessages()) {
  const { topic } = reader.channelsById.get(channelId);
  try {
    const message = decoders.get(channelId)?.(data);
    messages += 1;
    if (topic === "/run/registered") {
      const bytes = new DataView(message.data.buffer, message.data.byteOffset, message.data.byteLength);
      const stride = message.point_stride ?? message.pointStride;
      registered = [];
      for (let at = 0; at < bytes.byteLength; at += stride) registered.push(...[0, 4, 8].map((k) => bytes.getFloat32(at + k, true)));
    }
    if (topic.startsWith("/exact/") && new TextDecoder().decode(message.view.slice(0, 8)) !== "OSTEOVW1") errors.push(`${topic}: no item`);
  } catch (error) {
    errors.push(`${topic}: ${error.message}`);
  }
}
const start = Number(reader.chunkIndexes.map((chunk) => chunk.messageStartTime).reduce((a, b) => (a < b ? a : b)));
console.log(JSON.stringify({ messages, channels: decoders.size, errors, start, registered }));
