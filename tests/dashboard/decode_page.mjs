// Decodes the motion of a shared page with the page's own decoder, and writes it to standard output, block by block: for each
// frame three f32 per marker, and behind them for each frame the nine f32 of the pose of each rigid body, little endian.
//
//     node tests/dashboard/decode_page.mjs PAGE.html

import { readFileSync, writeSync } from "node:fs";
import { fileURLToPath } from "node:url";

// Browsers load the modules of web/ as modules; Node needs to be told.
const decoder = readFileSync(fileURLToPath(new URL("../../web/motion_decoder.js", import.meta.url)), "utf8");
const { decodeBlock, split } = await import(`data:text/javascript;base64,${Buffer.from(decoder).toString("base64")}`);

const page = readFileSync(process.argv[2], "utf8");
const part = (from) => page.split(from)[1].split("</script>")[0];
const { markers, frames, page: coded } = JSON.parse(part('<script id="take" type="application/json">'));
// An empty line is a block, too: all its bits are 0.
const blocks = part('<script id="motion" type="text/plain">').split("\n").slice(1, -1);
const bodies = coded.bodies.length;
blocks.forEach((line, index) => {
  const held = Math.min(coded.block_frames, frames - index * coded.block_frames);
  const block = decodeBlock(Buffer.from(line, "base64"), markers + 2 * bodies, held, coded.step_mm);
  const { positions, poses } = split(block, markers, bodies, coded.step_mm);
  for (const values of poses === null ? [positions] : [positions, poses]) {
    const bytes = Buffer.from(values.buffer);
    for (let at = 0; at < bytes.length; ) at += writeSync(1, bytes, at);
  }
});
