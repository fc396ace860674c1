//! Both ends of a link: the device's, for simulators, and the host's.

use super::{
    COMMAND_WIRE_BYTES_MAX, ENVELOPE_BYTES, EncodeError, FrameForm, MARKERS_MAX,
    MARKERS_MESSAGE_BYTES_MAX, WIRE_BYTES_MAX,
    envelope::{Deframer, Framer, Verdict},
    frame::{get_frame, put_frame},
    messages::{self, kind},
};
use crate::{
    bytes::Wire,
    device::{
        Command, DeviceEvent, Frame, Hello, LinkBudget, LinkCounters, MarkerInfo, MarkerSample,
        Pong, Protocol, Status, Trigger,
    },
};

/// The device's end of a link, sans-io. Every message is appended to the caller's `out`.
#[derive(Debug)]
pub struct DeviceLink {
    deframer: Deframer,
    framer: Framer,
}

impl Default for DeviceLink {
    fn default() -> Self {
        Self::new()
    }
}

impl DeviceLink {
    /// A link on which nothing was said yet.
    #[must_use]
    pub fn new() -> Self {
        Self { deframer: Deframer::new(COMMAND_WIRE_BYTES_MAX), framer: Framer::default() }
    }

    /// Takes bytes as they arrived, in pieces of any size, and gives every command they complete.
    pub fn push(&mut self, bytes: &[u8], on_command: &mut dyn FnMut(Command)) {
        self.deframer.push(bytes, |kind, payload| match messages::get_command(kind, payload) {
            Some(Some(command)) => {
                on_command(command);
                Verdict::Decoded
            }
            Some(None) => Verdict::Damaged,
            None => Verdict::Unknown,
        });
    }

    /// What was counted of the bytes pushed in.
    #[must_use]
    pub fn counters(&self) -> LinkCounters {
        self.deframer.counters
    }

    /// Who the device is. A 0x00 goes before it, which closes whatever a former device left.
    ///
    /// # Errors
    /// `Text` and `Hello` when the values cannot be sent.
    pub fn hello(&mut self, hello: &Hello, out: &mut Vec<u8>) -> Result<(), EncodeError> {
        messages::put_hello(hello, self.framer.open(kind::HELLO))?;
        out.push(0);
        self.framer.close(out);
        Ok(())
    }

    /// Adds markers to the host's table, in as many messages as they need: one even for none.
    ///
    /// # Errors
    /// `TooManyMarkers`, and `Text` when a label cannot be sent; nothing was appended then.
    pub fn markers(
        &mut self,
        markers: &[MarkerInfo],
        out: &mut Vec<u8>,
    ) -> Result<(), EncodeError> {
        if markers.len() > MARKERS_MAX {
            return Err(EncodeError::TooManyMarkers { found: markers.len(), max: MARKERS_MAX });
        }
        let start = out.len();
        let mut rest = markers;
        loop {
            let (now, later) = rest.split_at(fitting(rest));
            let message = self.framer.open(kind::MARKERS);
            message.extend_from_slice(&(now.len() as u16).to_le_bytes());
            for marker in now {
                if let Err(error) = messages::put_marker_info(marker, message) {
                    out.truncate(start);
                    return Err(error);
                }
            }
            self.framer.close(out);
            if later.is_empty() {
                return Ok(());
            }
            rest = later;
        }
    }

    /// One frame, its markers in ascending order of their ids.
    ///
    /// `form` is a wish: a frame that it cannot say, or says in more bytes than another, is sent in
    /// the one that can. A marker whose position is not finite travels as occluded.
    ///
    /// # Errors
    /// `TooManyMarkers` and `IdsNotAscending`.
    pub fn frame(
        &mut self,
        form: FrameForm,
        frame: &Frame<'_>,
        out: &mut Vec<u8>,
    ) -> Result<(), EncodeError> {
        put_frame(&mut self.framer, form, frame, out)
    }

    /// A trigger edge.
    pub fn trigger(&mut self, trigger: Trigger, out: &mut Vec<u8>) {
        self.framer.write(kind::TRIGGER, trigger, out);
    }

    /// A report.
    pub fn status(&mut self, status: Status, out: &mut Vec<u8>) {
        self.framer.write(kind::STATUS, status, out);
    }

    /// The last report: no frames follow until the next Start.
    pub fn end_of_stream(&mut self, status: Status, out: &mut Vec<u8>) {
        self.framer.write(kind::END_OF_STREAM, status, out);
    }

    /// Answers Ping.
    pub fn pong(&mut self, pong: Pong, out: &mut Vec<u8>) {
        self.framer.write(kind::PONG, pong, out);
    }

    /// Answers Start: frames follow.
    pub fn started(&mut self, budget: LinkBudget, out: &mut Vec<u8>) {
        self.framer.write(kind::STARTED, budget, out);
    }

    /// Answers Start or `SetRate`: the line is too slow, or the rate out of range.
    pub fn refused(&mut self, budget: LinkBudget, out: &mut Vec<u8>) {
        self.framer.write(kind::REFUSED, budget, out);
    }

    /// Answers `SetRate`: the rate from the next Start on, in millihertz.
    pub fn rate_set(&mut self, rate_mhz: u32, out: &mut Vec<u8>) {
        self.framer.write(kind::RATE_SET, rate_mhz, out);
    }
}

/// How many of the markers fit into one message: at least one, when there is any.
fn fitting(markers: &[MarkerInfo]) -> usize {
    let mut bytes = ENVELOPE_BYTES + 2;
    markers
        .iter()
        .take_while(|marker| {
            bytes += messages::marker_info_bytes(marker);
            bytes <= MARKERS_MESSAGE_BYTES_MAX
        })
        .count()
        .max(usize::from(!markers.is_empty()))
}

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
        let framer = &mut self.framer;
        match command {
            Command::Identify => {
                // Closes whatever reached the device before us, so that it cannot spoil this.
                out.push(0);
                framer.write(kind::IDENTIFY, (), out);
            }
            Command::Start { line_bytes_per_s } => {
                framer.write(kind::START, line_bytes_per_s, out);
            }
            Command::Stop => framer.write(kind::STOP, (), out),
            Command::SetRate(rate_mhz) => framer.write(kind::SET_RATE, rate_mhz, out),
            Command::Ping { host_ns } => framer.write(kind::PING, host_ns, out),
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
            kind::HELLO => messages::get_hello(payload, &mut self.hello)
                .map(|()| DeviceEvent::Hello(&self.hello)),
            kind::MARKERS => {
                messages::get_markers(payload, &mut self.markers).map(DeviceEvent::Markers)
            }
            kind::TRIGGER => Wire::whole(payload).map(DeviceEvent::Trigger),
            kind::STATUS => Wire::whole(payload).map(DeviceEvent::Status),
            kind::END_OF_STREAM => Wire::whole(payload).map(DeviceEvent::EndOfStream),
            kind::PONG => Wire::whole(payload).map(DeviceEvent::Pong),
            kind::STARTED => Wire::whole(payload).map(DeviceEvent::Started),
            kind::REFUSED => Wire::whole(payload).map(DeviceEvent::Refused),
            kind::RATE_SET => Wire::whole(payload).map(DeviceEvent::RateSet),
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
