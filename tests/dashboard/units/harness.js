// A minimal test framework.

const tests = [];

export function test(name, body) {
  tests.push([name, body]);
}

export function equal(found, expected, what = "") {
  const [a, b] = [found, expected].map((value) => JSON.stringify(value));
  if (a !== b) throw new Error(`${what} found ${a}, expected ${b}`);
}

export function near(found, expected, within = 1e-6, what = "") {
  if (!(Math.abs(found - expected) <= within)) throw new Error(`${what} found ${found}, expected ${expected} ± ${within}`);
}

export function isTrue(found, what) {
  if (found !== true) throw new Error(`${what}: ${found}`);
}

export function throws(body, text) {
  try {
    body();
  } catch (error) {
    if (!error.message.includes(text)) throw new Error(`'${error.message}' does not contain '${text}'`);
    return;
  }
  throw new Error(`nothing was thrown; expected '${text}'`);
}

/** Runs the tests one after another; a test may be asynchronous. */
export async function run() {
  const failed = [];
  for (const [name, body] of tests) {
    try {
      await body();
    } catch (error) {
      failed.push(`${name}: ${error.message}`);
    }
  }
  return { passed: tests.length - failed.length, failed };
}
