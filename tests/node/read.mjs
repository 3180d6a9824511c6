// Reads a recording with Foxglove's own packages and prints what they see as one JSON object.
import { open, readFile } from "node:fs/promises";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";
import { parse } from "@foxglove/rosmsg";
import common from "@foxglove/rosmsg-msgs-common";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import published from "@foxglove/schemas/internal.js";

const path = process.argv[2];

function readable(handle) {
  return {
    size: async () => BigInt((await handle.stat()).size),
    read: async (offset, length) => {
      const buffer = new Uint8Array(Number(length));
      await handle.read(buffer, 0, Number(length), Number(offset));
      return buffer;
    },
  };
}

function sameAsPublished(name, definitions) {
  const ours = definitions.find((each) => each.name === name);
  const theirs = common.ros2jazzy[name.replace("/msg/", "/")] ?? common.ros2jazzy[name];
  if (theirs === undefined) {
    return undefined;
  }
  const fields = (definition) =>
    definition.definitions
      .filter((field) => field.isConstant !== true)
      .map((field) => [field.name, field.type.replace("/msg/", "/"), field.isArray === true]);
  const entry = ours ?? definitions[0];
  return JSON.stringify(fields(entry)) === JSON.stringify(fields(theirs));
}

// A published schema is met when each of its fields has a value of its kind.
function meets(schemaName, value) {
  const kinds = { uint32: "number", float64: "number", string: "string", bytes: "object" };
  return published.foxgloveMessageSchemas[schemaName].fields.every((field) => {
    const given = value[field.name];
    if (field.type.type === "primitive" && field.type.name in kinds) {
      return field.array ? given.length >= 0 : typeof given === kinds[field.type.name];
    }
    return given !== undefined;
  });
}

function asFoxglove(topic, message) {
  const { stamp: timestamp, frame_id } = message.header ?? {};
  if (topic.endsWith("image_raw")) {
    return ["RawImage", { ...message, timestamp, frame_id }];
  }
  if (topic.endsWith("camera_info")) {
    const { d: D, k: K, r: R, p: P } = message;
    return ["CameraCalibration", { ...message, timestamp, frame_id, D, K, R, P }];
  }
  return topic.endsWith("pose")
    ? ["PoseInFrame", { timestamp, frame_id, pose: message.pose }]
    : undefined;
}

const handle = await open(path);
const reader = await McapIndexedReader.Initialize({ readable: readable(handle) });
const readers = new Map();
const result = { profile: reader.header.profile, indexed: {}, published: {}, foxglove: {} };
for (const [id, schema] of reader.schemasById) {
  const text = new TextDecoder().decode(schema.data);
  const definitions = parse(text, { ros2: true });
  readers.set(id, new MessageReader(definitions));
  const same = sameAsPublished(schema.name, definitions.map((each, index) =>
    index === 0 || each.name === undefined ? { ...each, name: schema.name } : each));
  if (same !== undefined) {
    result.published[schema.name] = same;
  }
}
result.first = {};
for await (const message of reader.readMessages()) {
  const channel = reader.channelsById.get(message.channelId);
  const decoded = readers.get(channel.schemaId).readMessage(message.data);
  result.indexed[channel.topic] = (result.indexed[channel.topic] ?? 0) + 1;
  const foxglove = asFoxglove(channel.topic, decoded);
  if (foxglove !== undefined) {
    const met = meets(...foxglove);
    result.foxglove[foxglove[0]] = (result.foxglove[foxglove[0]] ?? true) && met;
  }
  if (!(channel.topic in result.first)) {
    const plain = decoded.data instanceof Uint8Array
      ? { ...decoded, data: Buffer.from(decoded.data).toString("base64") } : decoded;
    result.first[channel.topic] = plain;
  }
}
await handle.close();

const stream = new McapStreamReader({ validateCrcs: true });
stream.append(new Uint8Array(await readFile(path)));
result.streamed = 0;
for (let record; (record = stream.nextRecord()); ) {
  result.streamed += record.type === "Message" ? 1 : 0;
}
result.done = stream.done();
const image = published.foxgloveMessageSchemas.RawImage.fields.find((each) => each.name === "data");
result.bayer = image.description.includes("`bayer_rggb8`");
process.stdout.write(
  JSON.stringify(result, (_, value) => (typeof value === "bigint" ? value.toString() : value)));
