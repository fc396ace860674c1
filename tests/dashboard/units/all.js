import "./stream.test.js";
import "./camera.test.js";
import "./motion.test.js";
import "./format.test.js";
import "./figures.test.js";
import "./words.test.js";
import { run } from "./harness.js";

window.unitResults = run();
