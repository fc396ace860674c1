// Formats numbers, sizes and times. Pure: no page, no clock.

/** A whole number, its digits in groups of three with narrow no-break spaces. */
export function count(n) {
  return String(Math.round(n)).replace(/\B(?=(\d{3})+$)/g, "\u202f");
}

/** Three significant digits, no decimals from 100 on. */
export function rounded(value) {
  const size = Math.abs(value);
  return value.toFixed(size >= 99.95 || size === 0 ? 0 : size >= 9.995 ? 1 : 2);
}

/** A bound with so many significant digits: never rounded down, since it would be wrong then. */
export function roundedUp(value, significant = 3) {
  if (!(value > 0)) return "0";
  const digits = significant - 1 - Math.floor(Math.log10(value));
  const scale = 10 ** digits;
  // A bound that is computed from decimal numbers is not meant to be above them by the last bit.
  return String(Number((Math.ceil(value * scale - 1e-9) / scale).toFixed(Math.max(0, digits))));
}

/** Bytes as [number, unit], with decimal prefixes. */
export function bytes(n) {
  const units = ["B", "kB", "MB", "GB", "TB", "PB"];
  let power = 0;
  let value = n;
  while (value >= 999.5 && power < units.length - 1) {
    value /= 1000;
    power += 1;
  }
  return [power === 0 ? count(value) : rounded(value), units[power]];
}

/** Microseconds as [number, unit]. */
export function microseconds(us) {
  if (us < 1000) return [String(Math.round(us)), "µs"];
  return us < 999_500 ? [rounded(us / 1000), "ms"] : [rounded(us / 1e6), "s"];
}

/** A rounded duration as [number, unit]. */
export function duration(seconds) {
  if (seconds < 100) return [rounded(seconds), "s"];
  if (seconds < 100 * 60) return [String(Math.floor(seconds / 60)), "min"];
  if (seconds < 100 * 3600) return [String(Math.floor(seconds / 3600)), "h"];
  const days = Math.floor(seconds / 86400);
  return days < 1000 ? [String(days), "days"] : ["> 999", "days"];
}

/** An elapsed time: `0:42.7`, `1:02:03.4`. Rounded down, as clocks do. */
export function elapsed(seconds) {
  const tenths = Math.floor(Math.max(0, seconds) * 10 + 1e-6);
  const s = Math.floor(tenths / 10);
  const two = (n) => String(n).padStart(2, "0");
  const [h, min] = [Math.floor(s / 3600), Math.floor(s / 60) % 60];
  return `${h ? `${h}:${two(min)}` : min}:${two(s % 60)}.${tenths % 10}`;
}

/** A time in a take, with milliseconds: `0:42.700`, `1:02:03.450`. Rounded down, as clocks do. */
export function takeTime(seconds) {
  const ms = Math.floor(Math.max(0, seconds) * 1000 + 1e-3);
  return `${elapsed(Math.floor(ms / 1000)).slice(0, -2)}.${String(ms % 1000).padStart(3, "0")}`;
}

/** A time beside others that are `step` seconds apart, without digits that do not differ: `0:42`, `0:42.5`, `0:42.05`. Pure. */
export function axisTime(seconds, step) {
  const text = takeTime(seconds + 1e-6);
  return step >= 1 ? text.slice(0, -4) : step >= 0.1 ? text.slice(0, -2) : text.slice(0, -1);
}

/** A fraction from 0 to 1 in percent. Only 1 is shown as 100, and only 0 as 0. */
export function percent(share) {
  if (share >= 1) return "100";
  if (share <= 0) return "0";
  const p = share * 100;
  if (p > 99.9) return "> 99.9";
  return p < 0.01 ? "< 0.01" : p < 0.1 ? p.toFixed(2) : p.toFixed(1);
}

/** Time of day in this browser's time zone. */
export function timeOfDay(unixMs) {
  return new Date(unixMs).toLocaleTimeString([], { hour12: false });
}

/** The time zone of the page: its offset from UTC in minutes, and its name where the browser knows it. */
export function timeZone(offsetMin, name) {
  const two = (n) => String(n).padStart(2, "0");
  const size = Math.abs(offsetMin);
  const offset = offsetMin === 0 ? "UTC" : `UTC${offsetMin < 0 ? "−" : "+"}${two(Math.floor(size / 60))}:${two(size % 60)}`;
  return `Times are in this browser's time zone: ${offset}${name && name !== "UTC" ? ` (${name})` : ""}`;
}

/** Day and time; today only the time. */
export function dateTime(unixMs, nowMs) {
  const time = timeOfDay(unixMs).slice(0, 5);
  const day = new Date(unixMs);
  const isToday = day.toDateString() === new Date(nowMs).toDateString();
  return isToday ? time : `${day.toLocaleDateString([], { day: "numeric", month: "short" })} ${time}`;
}

/** A count with its noun in the singular or plural. */
export function plural(n, one, many = `${one}s`) {
  return `${count(n)} ${n === 1 ? one : many}`;
}

/** The name for the next take: `jump-010` after `jump-009`; a name without a number stays. */
export function nextName(name) {
  const [, head, digits] = /^(.*?)(\d{1,12})$/.exec(name) ?? [];
  return digits === undefined ? name : head + String(Number(digits) + 1).padStart(digits.length, "0");
}

/** A percentile by the nearest-rank method: `percentile(values, 0.95)`; NaN without values. */
export function percentile(values, share) {
  if (values.length === 0) return NaN;
  const sorted = Float64Array.from(values).sort();
  return sorted[Math.max(0, Math.ceil(share * sorted.length) - 1)];
}

/** The longest beginning of a text that has at most so many bytes in UTF-8, cut between characters. */
export function cutToBytes(text, bytesMax) {
  return text.slice(0, new TextEncoder().encodeInto(text, new Uint8Array(bytesMax)).read);
}
