// The player's page of the service: which take is played, the list of takes, and what the service does meanwhile.

import { get, setToken } from "./api.js";
import { byId, h, setAttribute, setHidden, setText } from "./dom.js";
import { downloadMenu } from "./downloads.js";
import { installTheme } from "./keys.js";
import { installLogin } from "./login.js";
import { Overlays } from "./overlays.js";
import { Player } from "./player.js";
import { ServiceSource } from "./service_source.js";

const TAKES_MAX = 1000;
const STATUS_MS = 2000;
const TOKEN_KEY = "mocapd-token";

/** `mocapd view` serves this page alone, as its first; there is no dashboard. */
const isViewer = location.pathname === "/";

installTheme();
installLogin(isViewer ? "Open the address that mocapd view printed: it contains the token. Or enter the token here." : undefined);
if (isViewer) takeTokenFromAddress();
const player = new Player(new Overlays());
// For the browser's console and the tests.
window.mocapdPlayer = player;

/** The token of `mocapd view`, from the part of the address that browsers send to nobody. It stays in this tab. */
function takeTokenFromAddress() {
  const { hash, pathname, search } = location;
  const found = new URLSearchParams(hash.slice(1)).get("token");
  try {
    if (found) sessionStorage.setItem(TOKEN_KEY, found);
    setToken(sessionStorage.getItem(TOKEN_KEY));
  } catch {
    // The browser stores nothing: the token lasts until the page is loaded again.
    setToken(found);
  }
  if (found) history.replaceState(null, "", pathname + search);
}

/** Opens a take; `against` is the name of the take that it is compared with, or empty. */
function open(name, against = "") {
  const query = new URLSearchParams(against ? { take: name, against } : { take: name });
  history.replaceState(null, "", `${location.pathname}?${query}`);
  byId("take-select").value = name;
  byId("against-select").value = against;
  byId("downloads").replaceChildren(downloadMenu(name, isViewer));
  player.open(new ServiceSource(name), against ? new ServiceSource(against) : null);
}

async function showTakes() {
  const all = await get(`/v1/takes?limit=${TAKES_MAX}`);
  const takes = all.filter((take) => !take.is_open && take.health !== "unreadable");
  const [asked, against] = ["take", "against"].map((key) => new URLSearchParams(location.search).get(key));
  for (const name of [against, asked]) {
    if (name && !takes.some((take) => take.name === name)) takes.unshift({ name });
  }
  setText(byId("take-note"), all.length === TAKES_MAX ? `the last ${TAKES_MAX}` : "");
  const options = () => takes.map(({ name }) => h("option", { value: name }, name));
  byId("take-select").replaceChildren(...options());
  byId("against-select").replaceChildren(h("option", { value: "" }, "no other take"), ...options());
  setHidden(byId("take-choice"), takes.length === 0);
  for (const id of ["take-field", "against-field"]) setHidden(byId(id), takes.length < 2);
  return [asked ?? takes[0]?.name ?? null, against ?? ""];
}

/** The state of the recording, which this page must not hide. */
async function showStatus() {
  const text = byId("service");
  try {
    const { state, take, device, failure } = await get("/v1/status");
    const isGone = ["armed", "recording"].includes(state) && device.presence !== "streaming";
    const words = { idle: "Idle", armed: "Armed", recording: `● Recording ${take?.name ?? ""}`, failed: `✕ Failed: ${failure ?? ""}` };
    setText(text, isGone ? `✕ ${take ? `Recording ${take.name}: ` : ""}no frames from the device` : words[state] ?? state);
    setAttribute(text, "data-level", isGone || state === "failed" ? "bad" : state);
  } catch (error) {
    setText(text, `✕ ${error.message}`);
    setAttribute(text, "data-level", "bad");
  }
}

async function watchStatus() {
  for (;;) {
    await showStatus();
    await new Promise((resolve) => setTimeout(resolve, STATUS_MS));
  }
}

for (const id of ["take-select", "against-select"]) {
  byId(id).addEventListener("change", (event) => {
    open(byId("take-select").value, byId("against-select").value);
    // The keys of the player work again.
    event.target.blur();
  });
}
// Another address of a viewer, opened in this tab.
if (isViewer) addEventListener("hashchange", () => location.reload());
setHidden(byId("home"), isViewer);
setHidden(byId("brand"), !isViewer);
if (!isViewer) watchStatus();
try {
  const [name, against] = await showTakes();
  if (name !== null) open(name, against);
  else setText(byId("view-message"), "No finished take yet");
} catch (error) {
  setText(byId("view-message"), error.message);
}
