// Reads the stream of a Foxglove WebSocket server with Foxglove's own client, npm's @foxglove/ws-protocol, for check_foxglove.py.
//
//     node foxglove_client.cjs FOLDER_OF_NODE_MODULES URL TOPIC...
//
// One line of JSON for everything that arrives, until its standard input is closed. Topics that are announced later are subscribed
// to then.
"use strict";

const { createRequire } = require("node:module");
const path = require("node:path");

const [folder, url, ...topics] = process.argv.slice(2);
const load = createRequire(path.join(path.resolve(folder), "package.json"));
const { FoxgloveClient } = load("@foxglove/ws-protocol");
const { WebSocket } = load("ws");

const print = (value) => process.stdout.write(`${JSON.stringify(value)}\n`);
const client = new FoxgloveClient({ ws: new WebSocket(url, [FoxgloveClient.SUPPORTED_SUBPROTOCOL]) });
const topicOf = new Map();
const subscriptionOf = new Map();

client.on("serverInfo", (info) => print({ kind: "info", info }));
client.on("status", (status) => print({ kind: "status", status }));
client.on("error", (error) => print({ kind: "error", error: String(error) }));
client.on("advertise", (channels) => {
  for (const { id, topic, encoding, schemaName, schema, schemaEncoding } of channels) {
    print({ kind: "channel", topic, encoding, schemaName, schema, schemaEncoding });
    if (topics.includes(topic)) {
      const subscription = client.subscribe(id);
      topicOf.set(subscription, topic);
      subscriptionOf.set(id, subscription);
    }
  }
});
client.on("unadvertise", (ids) => {
  for (const id of ids) {
    topicOf.delete(subscriptionOf.get(id));
    print({ kind: "end" });
  }
});
client.on("time", ({ timestamp }) => print({ kind: "time", time: String(timestamp) }));
client.on("message", ({ subscriptionId, timestamp, data }) => {
  const bytes = Buffer.from(data.buffer, data.byteOffset, data.byteLength).toString("base64");
  print({ kind: "message", topic: topicOf.get(subscriptionId), time: String(timestamp), bytes });
});
client.on("close", () => {
  print({ kind: "closed" });
  process.exitCode = 0;
});
process.stdin.on("data", () => {});
process.stdin.on("end", () => client.close());
