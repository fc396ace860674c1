import "./stream.test.js";
import "./camera.test.js";
import "./motion.test.js";
import "./format.test.js";
import "./metrics.test.js";
import "./messages.test.js";
import "./playback.test.js";
import "./finished.test.js";
import "./overlays.test.js";
import "./source.test.js";
import { run } from "./harness.js";

window.unitResults = await run();
