// Questions and orders to the service. Every order carries an id, so that one whose answer was lost can be given again
// without being carried out twice.

/** The service said no, and why. */
export class Refused extends Error {
  constructor(status, problem) {
    super(problem.message ?? `the service answered ${status}`);
    this.status = status;
    this.kind = problem.kind ?? "internal";
  }
}

/** Nothing came back: nobody knows whether it was done. */
export class Unreachable extends Error {}

/** Told when a token is needed: a function that resolves when there is one. */
let logIn = () => Promise.reject(new Unreachable("a token is needed"));

export function onUnauthorized(handler) {
  logIn = handler;
}

const ANSWER_MS = 2500;
/** The service itself gives up after 60 s and says so. */
const ORDER_MS = 65_000;
const ORDER_TRIES = 6;

async function send(path, options, limitMs) {
  const limit = AbortSignal.timeout(limitMs);
  let response;
  try {
    response = await fetch(path, { ...options, signal: limit, cache: "no-store" });
  } catch {
    throw new Unreachable(limit.aborted ? `no answer within ${limitMs / 1000} s` : "the service cannot be reached");
  }
  return checked(response);
}

async function checked(response) {
  if (response.ok) return response;
  let problem = {};
  try {
    problem = await response.json();
  } catch {
    // No problem in JSON: the status has to do.
  }
  throw new Refused(response.status, problem);
}

/** What stands at a path, as JSON. */
export async function get(path) {
  for (;;) {
    try {
      const response = await send(path, {}, ANSWER_MS);
      return await response.json();
    } catch (error) {
      if (error.status === 401) await logIn();
      else if (error instanceof Refused || error instanceof Unreachable) throw error;
      else throw new Unreachable("the answer was cut off");
    }
  }
}

/** A response that does not end. */
export async function open(path, signal, headers = {}) {
  for (;;) {
    try {
      return await checked(await fetch(path, { signal, headers, cache: "no-store" }));
    } catch (error) {
      if (error.status !== 401) throw error;
      await logIn();
    }
  }
}

/** Gives an order and waits for what came of it. `onRetry` hears that it is given again, with the same id. */
export async function order(path, body = {}, { onRetry = () => {}, tries = ORDER_TRIES, limitMs = ORDER_MS } = {}) {
  const options = {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ ...body, request_id: requestId() }),
  };
  for (let tried = 1; ; tried += 1) {
    try {
      const response = await send(path, options, limitMs);
      const text = await response.text();
      return text ? JSON.parse(text) : {};
    } catch (error) {
      if (error.status === 401) {
        await logIn();
      } else if ((error instanceof Refused && error.kind !== "unavailable") || tried >= tries) {
        throw error;
      } else {
        // Not reached, too busy, or still at it with the first try.
        onRetry();
        await new Promise((resolve) => setTimeout(resolve, 500 * tried));
      }
    }
  }
}

/** Random, 32 hexadecimal digits. `crypto.randomUUID` is not there on plain HTTP from another machine. */
function requestId() {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), (b) => b.toString(16).padStart(2, "0")).join("");
}

/** Gives the token to the service, which answers with a cookie. */
export async function login(token) {
  const options = { method: "POST", body: new URLSearchParams({ token }), redirect: "manual" };
  let response;
  try {
    response = await fetch("/login", options);
  } catch {
    throw new Unreachable("the service cannot be reached");
  }
  // Logged in, it sends the browser to the page that we are.
  if (response.type !== "opaqueredirect") await checked(response);
}
