//! The host's end: device messages in, commands out.

use super::{
    envelope::{Deframer, Framer, Verdict},
    frame::get_frame,
    kind,
    limits::{MARKERS_MAX, WIRE_BYTES_MAX},
    records,
};
use crate::device::{
    Command, DeviceEvent, Hello, LinkCounters, MarkerInfo, MarkerSample, Protocol,
};

/// The host's end of a link, sans-io.
#[derive(Debug)]
pub struct HostLink {
    deframer: Deframer,
    framer: Framer,
    inbox: Inbox,
}

/// Where messages are decoded to; its memory is used again for the next one.
#[derive(Debug, Default)]
struct Inbox {
    samples: Vec<MarkerSample>,
    markers: Vec<MarkerInfo>,
    hello: Hello,
    samples_not_finite: u64,
}

impl HostLink {
    /// A link on which nothing was said yet.
    #[must_use]
    pub fn new() -> Self {
        Self {
            deframer: Deframer::new(WIRE_BYTES_MAX),
            framer: Framer::default(),
            inbox: Inbox { samples: Vec::with_capacity(MARKERS_MAX), ..Inbox::default() },
        }
    }
}

impl Default for HostLink {
    fn default() -> Self {
        Self::new()
    }
}

impl Protocol for HostLink {
    fn push(&mut self, bytes: &[u8], on_event: &mut dyn FnMut(DeviceEvent<'_>)) {
        let inbox = &mut self.inbox;
        self.deframer.push(bytes, |kind, payload| inbox.decode(kind, payload, on_event));
    }

    fn command(&mut self, command: Command, out: &mut Vec<u8>) {
        match command {
            Command::Identify => {
                // Closes whatever reached the device before us, so that it cannot spoil this.
                out.push(0);
                self.framer.write(kind::IDENTIFY, &[], out);
            }
            Command::Start { line_bytes_per_s } => {
                self.framer.write(kind::START, &[&line_bytes_per_s.to_le_bytes()], out);
            }
            Command::Stop => self.framer.write(kind::STOP, &[], out),
            Command::SetRate(rate_mhz) => {
                self.framer.write(kind::SET_RATE, &[&rate_mhz.to_le_bytes()], out);
            }
            Command::Ping { host_ns } => {
                self.framer.write(kind::PING, &[&host_ns.to_le_bytes()], out);
            }
        }
    }

    fn counters(&self) -> LinkCounters {
        LinkCounters { samples_not_finite: self.inbox.samples_not_finite, ..self.deframer.counters }
    }
}

impl Inbox {
    fn decode(
        &mut self,
        kind: u8,
        payload: &[u8],
        on_event: &mut dyn FnMut(DeviceEvent<'_>),
    ) -> Verdict {
        let event = match kind {
            kind::FRAME_FLOAT | kind::FRAME_MICROMETRES | kind::FRAME_COMPACT => {
                get_frame(kind, payload, &mut self.samples, &mut self.samples_not_finite)
                    .map(DeviceEvent::Frame)
            }
            kind::HELLO => records::get_hello(payload, &mut self.hello)
                .map(|()| DeviceEvent::Hello(&self.hello)),
            kind::MARKERS => records::get_markers(payload, &mut self.markers)
                .and_then(|n| self.markers.get(..n))
                .map(DeviceEvent::Markers),
            kind::TRIGGER => records::get_trigger(payload).map(DeviceEvent::Trigger),
            kind::STATUS => records::get_status(payload).map(DeviceEvent::Status),
            kind::END_OF_STREAM => records::get_status(payload).map(DeviceEvent::EndOfStream),
            kind::PONG => records::get_pong(payload).map(DeviceEvent::Pong),
            kind::STARTED => records::get_budget(payload).map(DeviceEvent::Started),
            kind::REFUSED => records::get_budget(payload).map(DeviceEvent::Refused),
            kind::RATE_SET => records::get_rate(payload).map(DeviceEvent::RateSet),
            _ => return Verdict::Unknown,
        };
        match event {
            Some(event) => {
                on_event(event);
                Verdict::Decoded
            }
            None => Verdict::Damaged,
        }
    }
}
