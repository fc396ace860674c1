// Requests to the service. Every command carries a request id: a command whose response was lost is sent again and is
// executed only once.

/** The service answered with an error: HTTP status, kind and message. */
export class ServiceError extends Error {
  constructor(status, problem) {
    super(problem.message ?? `the service answered ${status}`);
    this.status = status;
    this.kind = problem.kind ?? "internal";
  }
}

/** No complete response: it is unknown whether the request was executed. */
export class ConnectionError extends Error {}

/** Called when the service requires a token; resolves after the login. */
let logIn = () => Promise.reject(new ConnectionError("a token is needed"));

export function onUnauthorized(handler) {
  logIn = handler;
}

/** A token that every request carries; without one the cookie of a login must do. */
let token = null;

export function setToken(text) {
  token = text;
}

/** A token that was refused is dropped, since it would win over the cookie of a login. */
async function authorize() {
  if (token === null) return logIn();
  setToken(null);
}

const RESPONSE_TIMEOUT_MS = 2500;
/** The service itself gives up after 60 s and reports it. */
const COMMAND_TIMEOUT_MS = 65_000;
const COMMAND_TRIES = 6;

async function send(path, { signal: given = null, ...options }, timeoutMs) {
  const timeout = AbortSignal.timeout(timeoutMs);
  const signal = given ? AbortSignal.any([timeout, given]) : timeout;
  const headers = { ...options.headers, ...(token ? { Authorization: `Bearer ${token}` } : {}) };
  let response;
  try {
    response = await fetch(path, { ...options, headers, signal, cache: "no-store" });
  } catch {
    throw new ConnectionError(timeout.aborted ? `no reply within ${timeoutMs / 1000} s` : "the service cannot be reached");
  }
  return checkStatus(response);
}

async function checkStatus(response) {
  if (response.ok) return response;
  let problem = {};
  try {
    problem = await response.json();
  } catch {
    // The body is not a JSON problem: the HTTP status must do.
  }
  throw new ServiceError(response.status, problem);
}

/** The JSON document at a path. The request ends early, with an error, if `signal` says so. */
export const get = (path, timeoutMs = RESPONSE_TIMEOUT_MS, signal = null) => read(path, timeoutMs, (response) => response.json(), signal);

/** The bytes at a path, likewise. */
export const getBytes = (path, timeoutMs, signal = null) => read(path, timeoutMs, (response) => response.arrayBuffer(), signal);

async function read(path, timeoutMs, body, signal = null) {
  for (;;) {
    try {
      return await body(await send(path, { signal }, timeoutMs));
    } catch (error) {
      if (error.status === 401) await authorize();
      else if (error instanceof ServiceError || error instanceof ConnectionError) throw error;
      else throw new ConnectionError("the reply is incomplete");
    }
  }
}

/** Opens a response that does not end. */
export async function openStream(path, signal, headers = {}) {
  for (;;) {
    try {
      return await checkStatus(await fetch(path, { signal, headers, cache: "no-store" }));
    } catch (error) {
      if (error.status !== 401) throw error;
      await logIn();
    }
  }
}

/** Sends a command and waits for its result. `onRetry` is called before it is sent again with the same request id. */
export async function sendCommand(path, body = {}, { onRetry = () => {}, tries = COMMAND_TRIES, timeoutMs = COMMAND_TIMEOUT_MS } = {}) {
  const options = {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ ...body, request_id: requestId() }),
  };
  for (let attempt = 1; ; attempt += 1) {
    try {
      const response = await send(path, options, timeoutMs);
      const text = await response.text();
      return text ? JSON.parse(text) : {};
    } catch (error) {
      if (error.status === 401) {
        await authorize();
      } else if ((error instanceof ServiceError && error.kind !== "unavailable") || attempt >= tries) {
        throw error;
      } else {
        // Not reachable, too busy, or still executing the first attempt.
        onRetry();
        await new Promise((resolve) => setTimeout(resolve, 500 * attempt));
      }
    }
  }
}

/** Random, 32 hexadecimal digits: `crypto.randomUUID` does not exist on plain HTTP from another machine. */
function requestId() {
  return Array.from(crypto.getRandomValues(new Uint8Array(16)), (b) => b.toString(16).padStart(2, "0")).join("");
}

/** Sends the token to the service, which answers with a session cookie. */
export async function login(token) {
  const options = { method: "POST", body: new URLSearchParams({ token }), redirect: "manual" };
  let response;
  try {
    response = await fetch("/login", options);
  } catch {
    throw new ConnectionError("the service cannot be reached");
  }
  // After a login the service redirects to this page.
  if (response.type !== "opaqueredirect") await checkStatus(response);
}
