//! Settings that change during a stream: labels and bodies are requested again, and the frames that come meanwhile wait.

use super::{
    body_settings::BodySettings,
    host::{EventSink, MS, QtmHost},
    packet::{PACKET_BYTES_MAX, Packet, PacketKind, printable},
    settings::Settings,
    stream_run::{FrameParts, Named, Renewal},
};
use crate::device::DeviceEvent;

/// Least time between two requests for the same settings, if frames keep having other numbers than QTM states.
const INTERVAL_NS: u64 = 1_000 * MS;

/// Frames that wait for settings, and their bytes: a sixteenth of a second at 1000 Hz, and the largest packet.
const HELD_MAX: usize = 64;
const HELD_BYTES_MAX: usize = PACKET_BYTES_MAX;

/// How long they wait, at low rates.
const HELD_NS: u64 = 1_000 * MS;

impl QtmHost {
    /// Holds a frame back if it has other numbers of markers or bodies than the lists that are known, or the lists may have
    /// changed. Returns whether it is held.
    pub(super) fn holds(&mut self, body: &[u8], parts: FrameParts) -> bool {
        if parts.n_labelled.is_some_and(|n| n != self.labels.n_labels()) {
            self.renew(Named::Markers, false);
        }
        if parts.n_bodies.is_some_and(|n| n != self.bodies.n_bodies()) {
            self.renew(Named::Bodies, false);
        }
        let now_ns = self.line.now_ns();
        let renewal = &mut self.renewal;
        if !renewal.is_awaited() || renewal.is_late {
            return false;
        }
        if renewal.held.is_empty() {
            (renewal.held_since_ns, renewal.held_bytes) = (now_ns, 0);
        }
        renewal.held_bytes += body.len();
        renewal.held.push(body.to_vec());
        true
    }

    /// Decodes the frames that wait when there are too many, or for too long. Later ones do not wait: the replies are used when
    /// they come.
    pub(super) fn release_excess(&mut self, on_event: EventSink<'_>) {
        let Renewal { held, held_bytes, held_since_ns, .. } = &self.renewal;
        let waited_ns = self.line.now_ns().saturating_sub(*held_since_ns);
        let is_too_much = held.len() >= HELD_MAX || *held_bytes > HELD_BYTES_MAX;
        if !held.is_empty() && (is_too_much || waited_ns > HELD_NS) {
            self.renewal.is_late = true;
            self.release_held(on_event);
        }
    }

    /// Decodes the frames that wait.
    pub(super) fn release_held(&mut self, on_event: EventSink<'_>) {
        for body in std::mem::take(&mut self.renewal.held) {
            self.decode(&body, on_event);
        }
    }

    /// QTM states that its settings changed.
    pub(super) fn renew_all(&mut self) {
        self.renew(Named::Markers, true);
        self.renew(Named::Bodies, true);
    }

    /// Requests settings again: at once if they are known to have changed, and else not for every frame.
    fn renew(&mut self, settings: Named, is_certain: bool) {
        let now_ns = self.line.now_ns();
        let last_ns = &mut self.renewal.requested_ns[settings as usize];
        let is_due = last_ns.is_none_or(|last_ns| now_ns.saturating_sub(last_ns) > INTERVAL_NS);
        let is_asked = self.renewal.awaited.contains(&settings) && !is_certain;
        // An event while one is asked may be behind what its reply states.
        let n_asked = self.renewal.awaited.iter().filter(|of| **of == settings).count();
        if is_asked || n_asked >= 2 || !(is_due || is_certain) {
            return;
        }
        *last_ns = Some(now_ns);
        self.renewal.awaited.push_back(settings);
        self.send(match settings {
            Named::Markers => "GetParameters 3D",
            Named::Bodies => "GetParameters 6D",
        });
    }

    /// Settings that were requested, or an error in their place.
    pub(super) fn on_renewed(&mut self, packet: &Packet<'_>, on_event: EventSink<'_>) {
        self.pass_all(on_event);
        if packet.kind == Some(PacketKind::Error) {
            match self.renewal.awaited.pop_front() {
                // There are none any more.
                Some(Named::Bodies) => self.use_bodies(&[], on_event),
                _ => self.note_refusal(&printable(&packet.text()), on_event),
            }
        } else {
            match Settings::parse(&packet.text()) {
                Ok(Settings { labels: Some(labels), .. }) => {
                    self.forget(Named::Markers);
                    self.use_labels(&labels, on_event);
                }
                // What the document has counts, and not the order of the requests.
                Ok(Settings { bodies: Some(bodies), .. }) => {
                    self.forget(Named::Bodies);
                    self.use_bodies(&bodies, on_event);
                }
                Ok(_) => drop(self.renewal.forget_one()),
                Err(problem) => {
                    self.renewal.forget_one();
                    let problem = printable(&problem);
                    self.note(&format!("QTM's new settings cannot be read: {problem}"), on_event);
                }
            }
        }
        if !self.renewal.is_awaited() {
            self.renewal.is_late = false;
            self.release_held(on_event);
        }
    }

    fn forget(&mut self, settings: Named) {
        let awaited = &mut self.renewal.awaited;
        if let Some(at) = awaited.iter().position(|of| *of == settings) {
            awaited.remove(at);
        }
    }

    fn use_labels(&mut self, labels: &[String], on_event: EventSink<'_>) {
        let before = self.labels.markers();
        self.labels.update(labels);
        let now = self.labels.markers();
        if now != before {
            on_event(DeviceEvent::Markers(&now));
            let n = labels.len();
            self.note(&format!("QTM's list of labels changed: {n} labels"), on_event);
        }
    }

    fn use_bodies(&mut self, bodies: &[BodySettings], on_event: EventSink<'_>) {
        let before = self.bodies.infos();
        let n_excess = self.bodies.update(bodies);
        let now = self.bodies.infos();
        if now == before {
            return;
        }
        if !self.run.has_bodies {
            self.note("QTM has rigid bodies now: record again to have them in the take", on_event);
            return;
        }
        on_event(DeviceEvent::Bodies(&now));
        let n_new = now.iter().filter(|info| !before.contains(info)).count();
        let mut text = format!("QTM's list of rigid bodies changed: {} bodies", now.len());
        if n_new + n_excess > 0 {
            let n = n_new + n_excess;
            text += &format!(", of which {n} are recorded only when you record again");
        }
        self.note(&text, on_event);
    }
}
