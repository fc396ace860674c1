// The clients that what is recorded is published to, and what each of them missed.

import { byId, h, setHidden, setText } from "./dom.js";
import { plural } from "./format.js";

/** What is known of a client, as one line. Pure. */
export function clientText({ address, version, transport, is_streaming: isStreaming, is_in_control: isInControl, frames_sent: sent, frames_missed: missed }) {
  const known = [`${address} by ${transport.toUpperCase()}`];
  if (version) known.push(`version ${version}`);
  known.push(isStreaming ? `${plural(sent, "frame")} sent` : "requests no frames");
  if (missed > 0) known.push(`${plural(missed, "frame")} missed`);
  if (isInControl) known.push("in control");
  return known.join(" · ");
}

/** The line above the list. Pure. */
export function publishText({ protocol, listen, clients, clients_max: max, frames_missed: missed }) {
  const total = missed > 0 ? `, ${plural(missed, "frame")} missed in all` : "";
  return `${protocol.toUpperCase()} at ${listen}: ${clients.length} of ${max}${total}`;
}

/** Shows the list, if anything is published. */
export function showPublished({ publish }) {
  setHidden(byId("published"), !publish);
  if (!publish) return;
  setText(byId("published-count"), publishText(publish));
  const list = byId("published-clients");
  const lines = publish.clients.map(clientText);
  while (list.children.length > lines.length) list.lastElementChild.remove();
  while (list.children.length < lines.length) list.append(h("li", {}));
  lines.forEach((line, index) => setText(list.children[index], line));
}
