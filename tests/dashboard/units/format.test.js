import { bytes, count, cutToBytes, duration, elapsed, microseconds, nextName, percent, percentile, plural, rounded, timeZone } from "/format.js";
import { equal, isTrue, test } from "./harness.js";

test("counts have groups of three", () => {
  equal([0, 999, 1000, 1234567].map((n) => count(n).replace(/\u202f/g, "_")), ["0", "999", "1_000", "1_234_567"]);
  equal([plural(1, "frame"), plural(2, "frame")], ["1 frame", "2 frames"]);
});

test("rounded numbers have three significant digits", () => {
  equal([0, 1.234, 12.34, 99.96, 123.4].map(rounded), ["0", "1.23", "12.3", "100", "123"]);
});

test("bytes, microseconds and durations choose their unit", () => {
  equal([0, 999, 1000, 61_234, 999_600, 4.12e11].map((n) => bytes(n).join(" ")),
    ["0 B", "999 B", "1.00 kB", "61.2 kB", "1.00 MB", "412 GB"]);
  equal([46, 999, 1500, 2_000_000].map((n) => microseconds(n).join(" ")), ["46 µs", "999 µs", "1.50 ms", "2.00 s"]);
  equal([8, 99, 600, 7200, 40_000, 400_000, 1e9].map((n) => duration(n).join(" ")),
    ["8.00 s", "99.0 s", "10 min", "2 h", "11 h", "4 days", "> 999 days"]);
});

test("an elapsed time is rounded down", () => {
  equal([0, 9.99, 59.95, 60, 3599.99, 3723.4].map(elapsed), ["0:00.0", "0:09.9", "0:59.9", "1:00.0", "59:59.9", "1:02:03.4"]);
});

test("only all is 100 % and only nothing is 0 %", () => {
  equal([0, 1e-9, 0.0005, 0.0182, 0.5, 0.9995, 0.99999, 1].map(percent),
    ["0", "< 0.01", "0.05", "1.8", "50.0", "> 99.9", "> 99.9", "100"]);
});

test("the next name counts up and keeps leading zeros", () => {
  equal(["jump-009", "jump-099", "jump", "7", "a1b", "x-999"].map(nextName), ["jump-010", "jump-100", "jump", "8", "a1b", "x-1000"]);
});

test("percentiles are values of the list", () => {
  const values = Array.from({ length: 100 }, (_, i) => 100 - i);
  equal([percentile(values, 0.95), percentile(values, 1), percentile([7], 0.5)], [95, 100, 7]);
  isTrue(Number.isNaN(percentile([], 0.5)), "an empty list has no percentile");
});

test("the time zone has its offset, and its name if known", () => {
  equal(timeZone(0, "UTC"), "Times are in this browser's time zone: UTC");
  equal(timeZone(60, "Europe/Berlin"), "Times are in this browser's time zone: UTC+01:00 (Europe/Berlin)");
  equal(timeZone(-210, undefined), "Times are in this browser's time zone: UTC−03:30");
});

test("a text is cut to bytes, between characters", () => {
  equal(["jump", "jumps", "Müller", "歩く人", "😀😀"].map((text) => cutToBytes(text, 4)), ["jump", "jump", "Mül", "歩", "😀"]);
  equal(cutToBytes("", 4), "");
});
