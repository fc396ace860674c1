// Reads a QTM RT server with Qualisys's client for Node.js, npm's qualisys-rt, for check_qtm.py.
//
//     node qtm_client.cjs FOLDER_OF_NODE_MODULES PORT
//
// PORT is the server's little-endian port on this machine. One line of JSON for everything that arrives, until its standard input is
// closed.
"use strict";

const { createRequire } = require("node:module");
const path = require("node:path");

const [folder, port] = process.argv.slice(2);
const load = createRequire(path.join(path.resolve(folder), "package.json"));
const { Api } = load("qualisys-rt");

const print = (value) => process.stdout.write(`${JSON.stringify(value)}\n`);
// Once what was printed has been read.
const end = (code) => process.stdout.write(`${JSON.stringify({ kind: "closed" })}\n`, () => process.exit(code));
const COMPONENTS = ["3D", "3DRes", "3DNoLabels", "3DNoLabelsRes"];
const NAME_OF = { "3d": "3D", "3dRes": "3DRes", "3dNoLabels": "3DNoLabels", "3dNoLabelsRes": "3DNoLabelsRes" };
const values = ({ id, x, y, z, residual }) => [id, x, y, z, residual].filter((value) => value !== undefined);

const fail = (error) => {
  print({ kind: "error", error: String((error && (error.data || error.stack)) || error) });
  end(1);
};

const client = new Api();
client.on("event", (event) => print({ kind: "other", packet: event.name }));
client.on("frame", ({ frame, components }) => {
  const found = Object.entries(components).map(([name, { markers }]) => [NAME_OF[name] || name, markers.map(values)]);
  print({ kind: "frame", number: frame, components: Object.fromEntries(found) });
});

const read = async () => {
  await client.connect(Number(port), "127.0.0.1");
  const { localAddress, localPort } = client.client;
  print({ kind: "address", address: `${localAddress}:${localPort}` });
  print({ kind: "state", state: await client.getState() });
  print({ kind: "settings", settings: await client.getParameters("3D") });
  await client.streamFrames({ frequency: "AllFrames", components: COMPONENTS });
};

process.stdin.on("data", () => {});
process.stdin.on("end", () => end(0));
read().catch(fail);
