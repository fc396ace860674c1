//! Settings that change during a stream: labels and bodies are requested again, and the frames that come meanwhile wait.

use std::collections::VecDeque;

use super::{
    host::{EventSink, MS, QtmHost},
    packet::{Packet, PacketKind, printable},
    settings::Settings,
    stream_run::FrameParts,
};
use crate::device::DeviceEvent;

/// Least time between two requests for the same settings, if frames keep having other numbers than QTM states.
const INTERVAL_NS: u64 = 1_000 * MS;

/// Frames that wait for settings: a sixteenth of a second at 1000 Hz, and many times what a request takes on a local
/// network.
const HELD_MAX: usize = 64;

/// How long they wait, at low rates.
const HELD_NS: u64 = 1_000 * MS;

/// Settings that name what frames have in their order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Named {
    Markers,
    Bodies,
}

/// The requests of a connection.
#[derive(Debug, Default)]
pub(super) struct Renewal {
    /// Those without a reply. QTM answers in order.
    awaited: VecDeque<Named>,
    /// When each was requested last.
    requested_ns: [Option<u64>; 2],
    /// Frames that wait for the replies, and since when.
    held: Vec<Vec<u8>>,
    held_since_ns: u64,
}

impl Renewal {
    /// Whether a reply is awaited.
    pub(super) fn is_awaited(&self) -> bool {
        !self.awaited.is_empty()
    }

    /// Forgets one request, whose reply is of no use any more. Returns whether there was one.
    pub(super) fn forget_one(&mut self) -> bool {
        self.awaited.pop_front().is_some()
    }
}

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
        if !self.renewal.is_awaited() {
            return false;
        }
        if self.renewal.held.is_empty() {
            self.renewal.held_since_ns = self.line.now_ns();
        }
        self.renewal.held.push(body.to_vec());
        true
    }

    /// Decodes the frames that wait when there are too many, or for too long: the replies are late, and may never come.
    pub(super) fn release_excess(&mut self, on_event: EventSink<'_>) {
        let Renewal { held, held_since_ns, .. } = &self.renewal;
        let is_overdue =
            !held.is_empty() && self.line.now_ns().saturating_sub(*held_since_ns) > HELD_NS;
        if is_overdue || held.len() >= HELD_MAX {
            self.renewal.awaited.clear();
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
        if self.run.has_bodies {
            self.renew(Named::Bodies, true);
        }
    }

    /// Requests settings again: at once if they are known to have changed, and else not for every frame.
    fn renew(&mut self, settings: Named, is_certain: bool) {
        let now_ns = self.line.now_ns();
        let last_ns = &mut self.renewal.requested_ns[settings as usize];
        let is_due = last_ns.is_none_or(|last_ns| now_ns.saturating_sub(last_ns) > INTERVAL_NS);
        if self.renewal.awaited.contains(&settings) || !(is_due || is_certain) {
            return;
        }
        *last_ns = Some(now_ns);
        self.renewal.awaited.push_back(settings);
        self.send(match settings {
            Named::Markers => "GetParameters 3D",
            Named::Bodies => "GetParameters 6D",
        });
    }

    /// The reply to the oldest request: settings, or an error.
    pub(super) fn on_renewed(&mut self, packet: &Packet<'_>, on_event: EventSink<'_>) {
        let Some(requested) = self.renewal.awaited.pop_front() else { return };
        self.flush_frame(on_event);
        let is_refused = packet.kind == Some(PacketKind::Error);
        let settings = match is_refused {
            // There are none any more.
            true if requested == Named::Bodies => Ok(Settings::default()),
            true => Err(printable(&packet.text())),
            false => Settings::parse(&packet.text()),
        };
        match (settings, requested) {
            (Ok(settings), Named::Bodies) => self.use_bodies(&settings, on_event),
            (Ok(Settings { labels: Some(labels), .. }), _) => self.use_labels(&labels, on_event),
            (Ok(_), _) => {}
            (Err(problem), _) if is_refused => self.note_refusal(&problem, on_event),
            (Err(problem), _) => {
                let problem = printable(&problem);
                self.note(&format!("QTM's new settings cannot be read: {problem}"), on_event);
            }
        }
        if !self.renewal.is_awaited() {
            self.release_held(on_event);
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

    fn use_bodies(&mut self, settings: &Settings, on_event: EventSink<'_>) {
        let before = self.bodies.infos();
        self.bodies.update(settings.bodies.as_deref().unwrap_or_default());
        let now = self.bodies.infos();
        if now != before {
            on_event(DeviceEvent::Bodies(&now));
            let n = now.len();
            self.note(&format!("QTM's list of rigid bodies changed: {n} bodies"), on_event);
        }
    }
}
