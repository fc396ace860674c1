// Numbers as people read them. Pure: no page, no clock.

/** Whole numbers in groups of three, with a narrow space between them. */
export function count(n) {
  return String(Math.round(n)).replace(/\B(?=(\d{3})+$)/g, "\u202f");
}

/** At most three digits that say something, and none after the point from 100 on. */
export function short(value) {
  const size = Math.abs(value);
  return value.toFixed(size >= 99.95 || size === 0 ? 0 : size >= 9.995 ? 1 : 2);
}

/** Bytes as [number, unit], in thousands. */
export function bytes(n) {
  const units = ["B", "kB", "MB", "GB", "TB", "PB"];
  let power = 0;
  let value = n;
  while (value >= 999.5 && power < units.length - 1) {
    value /= 1000;
    power += 1;
  }
  return [power === 0 ? count(value) : short(value), units[power]];
}

/** Microseconds as [number, unit]. */
export function micros(us) {
  if (us < 1000) return [String(Math.round(us)), "µs"];
  return us < 999_500 ? [short(us / 1000), "ms"] : [short(us / 1e6), "s"];
}

/** How long something is, roughly, as [number, unit]. */
export function span(seconds) {
  if (seconds < 100) return [short(seconds), "s"];
  if (seconds < 100 * 60) return [String(Math.floor(seconds / 60)), "min"];
  if (seconds < 100 * 3600) return [String(Math.floor(seconds / 3600)), "h"];
  const days = Math.floor(seconds / 86400);
  return days < 1000 ? [String(days), "days"] : ["> 999", "days"];
}

/** A running time: `0:42.7`, `1:02:03.4`. Never rounded up, as no clock is. */
export function running(seconds) {
  const tenths = Math.floor(Math.max(0, seconds) * 10 + 1e-6);
  const s = Math.floor(tenths / 10);
  const two = (n) => String(n).padStart(2, "0");
  const [h, min] = [Math.floor(s / 3600), Math.floor(s / 60) % 60];
  return `${h ? `${h}:${two(min)}` : min}:${two(s % 60)}.${tenths % 10}`;
}

/** A share from 0 to 1 in percent. What is not all is never said to be 100, and what is something never 0. */
export function percent(share) {
  if (share >= 1) return "100";
  if (share <= 0) return "0";
  const p = share * 100;
  if (p > 99.9) return "> 99.9";
  return p < 0.01 ? "< 0.01" : p < 0.1 ? p.toFixed(2) : p.toFixed(1);
}

/** Time of day at this browser. */
export function clock(unixMs) {
  return new Date(unixMs).toLocaleTimeString([], { hour12: false });
}

/** What times of day are: the offset from UTC in minutes, and the zone's name, where the browser knows it. */
export function zone(offsetMin, name) {
  const two = (n) => String(n).padStart(2, "0");
  const size = Math.abs(offsetMin);
  const offset = offsetMin === 0 ? "UTC" : `UTC${offsetMin < 0 ? "−" : "+"}${two(Math.floor(size / 60))}:${two(size % 60)}`;
  return `Times of day are this browser's: ${offset}${name && name !== "UTC" ? ` (${name})` : ""}`;
}

/** Day and time, the day left out today. */
export function when(unixMs, nowMs) {
  const time = clock(unixMs).slice(0, 5);
  const day = new Date(unixMs);
  const isToday = day.toDateString() === new Date(nowMs).toDateString();
  return isToday ? time : `${day.toLocaleDateString([], { day: "numeric", month: "short" })} ${time}`;
}

/** One thing or several. */
export function plural(n, one, many = `${one}s`) {
  return `${count(n)} ${n === 1 ? one : many}`;
}

/** The name for the next take: `jump-009` after it `jump-010`; a name without a number stays. */
export function nextName(name) {
  const [, head, digits] = /^(.*?)(\d{1,12})$/.exec(name) ?? [];
  return digits === undefined ? name : head + String(Number(digits) + 1).padStart(digits.length, "0");
}

/** The value that a share of all are at most: `percentile(values, 0.95)`; NaN of nothing. */
export function percentile(values, share) {
  if (values.length === 0) return NaN;
  const sorted = Float64Array.from(values).sort();
  return sorted[Math.max(0, Math.ceil(share * sorted.length) - 1)];
}
