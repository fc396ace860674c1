// The clients that what is recorded is published to, and what each of them missed.

import { byId, h, setHidden, setText } from "./dom.js";
import { plural } from "./format.js";

/** What is known of a client, as one line. Pure. */
export function clientText({ address, version, transport, stream, is_streaming: isStreaming, is_in_control: isInControl, frames_sent: sent, frames_missed: missed, batches_missed: batches }) {
  const known = [`${address} by ${transport.toUpperCase()}`];
  if (version) known.push(`version ${version}`);
  if (stream) known.push(stream);
  known.push(isStreaming ? `${plural(sent, "frame")} sent` : "requests no frames");
  if (missed > 0) known.push(`${plural(missed, "frame")} missed`);
  if (batches > 0) known.push(`${plural(batches, "batch", "batches")} of samples missed`);
  if (isInControl) known.push("in control");
  return known.join(" · ");
}

/** What is known of a server, as one line. Pure. */
export function publishText({ protocol, listen, clients, clients_max: max, frames_missed: missed, batches_missed: batchesMissed, poses_left_out: poses, batches_left_out: batches }) {
  let total = missed > 0 ? `, ${plural(missed, "frame")} missed in all` : "";
  if (batchesMissed > 0) total += `, ${plural(batchesMissed, "batch", "batches")} of samples missed in all`;
  if (poses > 0) total += `, poses of ${plural(poses, "frame")} left out`;
  if (batches > 0) total += `, ${plural(batches, "batch", "batches")} of samples left out`;
  return `${protocol.toUpperCase()} at ${listen}: ${clients.length} of ${max}${total}`;
}

/** The lines of the list: each server, and its clients. Pure. */
export function publishedLines(publish) {
  return publish.flatMap((server) => [publishText(server), ...server.clients.map(clientText)]);
}

/** Shows the list, if anything is published. */
export function showPublished(status) {
  const publish = status.publish ?? [];
  setHidden(byId("published"), publish.length === 0);
  if (publish.length === 0) return;
  setText(byId("published-count"), plural(publish.reduce((sum, { clients }) => sum + clients.length, 0), "client"));
  const list = byId("published-clients");
  const lines = publishedLines(publish);
  while (list.children.length > lines.length) list.lastElementChild.remove();
  while (list.children.length < lines.length) list.append(h("li", {}));
  lines.forEach((line, index) => setText(list.children[index], line));
}
