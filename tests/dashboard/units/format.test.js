import { bytes, count, micros, nextName, percent, percentile, plural, running, short, span, zone } from "/format.js";
import { equal, isTrue, test } from "./harness.js";

test("counts have groups of three", () => {
  equal([0, 999, 1000, 1234567].map((n) => count(n).replace(/\u202f/g, "_")), ["0", "999", "1_000", "1_234_567"]);
  equal([plural(1, "frame"), plural(2, "frame")], ["1 frame", "2 frames"]);
});

test("short numbers have three digits that say something", () => {
  equal([0, 1.234, 12.34, 99.96, 123.4].map(short), ["0", "1.23", "12.3", "100", "123"]);
});

test("bytes, microseconds and spans choose their unit", () => {
  equal([0, 999, 1000, 61_234, 999_600, 4.12e11].map((n) => bytes(n).join(" ")),
    ["0 B", "999 B", "1.00 kB", "61.2 kB", "1.00 MB", "412 GB"]);
  equal([46, 999, 1500, 2_000_000].map((n) => micros(n).join(" ")), ["46 µs", "999 µs", "1.50 ms", "2.00 s"]);
  equal([8, 99, 600, 7200, 40_000, 400_000, 1e9].map((n) => span(n).join(" ")),
    ["8.00 s", "99.0 s", "10 min", "2 h", "11 h", "4 days", "> 999 days"]);
});

test("a running time is never ahead", () => {
  equal([0, 9.99, 59.95, 60, 3599.99, 3723.4].map(running), ["0:00.0", "0:09.9", "0:59.9", "1:00.0", "59:59.9", "1:02:03.4"]);
});

test("what is not all is not said to be all, and what is something not nothing", () => {
  equal([0, 1e-9, 0.0005, 0.0182, 0.5, 0.9995, 0.99999, 1].map(percent),
    ["0", "< 0.01", "0.05", "1.8", "50.0", "> 99.9", "> 99.9", "100"]);
});

test("the next name counts on and keeps its zeros", () => {
  equal(["jump-009", "jump-099", "jump", "7", "a1b", "x-999"].map(nextName), ["jump-010", "jump-100", "jump", "8", "a1b", "x-1000"]);
});

test("percentiles are values that were there", () => {
  const values = Array.from({ length: 100 }, (_, i) => 100 - i);
  equal([percentile(values, 0.95), percentile(values, 1), percentile([7], 0.5)], [95, 100, 7]);
  isTrue(Number.isNaN(percentile([], 0.5)), "nothing has no percentile");
});

test("the time zone has its offset, and its name where that is known", () => {
  equal(zone(0, "UTC"), "Times of day are this browser's: UTC");
  equal(zone(60, "Europe/Berlin"), "Times of day are this browser's: UTC+01:00 (Europe/Berlin)");
  equal(zone(-210, undefined), "Times of day are this browser's: UTC−03:30");
});
