//! The device's end, for simulators: commands in, messages out.

use super::{
    EncodeError,
    envelope::{Deframer, Framer, Verdict},
    frame::{FrameForm, put_frame},
    kind,
    limits::{COMMAND_WIRE_BYTES_MAX, ENVELOPE_BYTES, MARKERS_MAX, MARKERS_MESSAGE_BYTES_MAX},
    records,
};
use crate::device::{
    Command, Frame, Hello, LinkBudget, LinkCounters, MarkerInfo, Pong, Status, Trigger,
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
        self.deframer.push(bytes, |kind, payload| match records::get_command(kind, payload) {
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
        records::put_hello(hello, self.framer.open(kind::HELLO))?;
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
                if let Err(error) = records::put_marker_info(marker, message) {
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
        let Trigger { device_ticks, input, kind } = trigger;
        self.framer.write(kind::TRIGGER, &[&device_ticks.to_le_bytes(), &[input, kind]], out);
    }

    /// A report.
    pub fn status(&mut self, status: Status, out: &mut Vec<u8>) {
        self.framer.write(kind::STATUS, &[&records::status_bytes(status)], out);
    }

    /// The last report: no frames follow until the next Start.
    pub fn end_of_stream(&mut self, status: Status, out: &mut Vec<u8>) {
        self.framer.write(kind::END_OF_STREAM, &[&records::status_bytes(status)], out);
    }

    /// Answers Ping.
    pub fn pong(&mut self, pong: Pong, out: &mut Vec<u8>) {
        let Pong { host_ns, device_ticks } = pong;
        self.framer.write(kind::PONG, &[&host_ns.to_le_bytes(), &device_ticks.to_le_bytes()], out);
    }

    /// Answers Start: frames follow.
    pub fn started(&mut self, budget: LinkBudget, out: &mut Vec<u8>) {
        self.framer.write(kind::STARTED, &[&records::budget_bytes(budget)], out);
    }

    /// Answers Start or `SetRate`: the line is too slow, or the rate out of range.
    pub fn refused(&mut self, budget: LinkBudget, out: &mut Vec<u8>) {
        self.framer.write(kind::REFUSED, &[&records::budget_bytes(budget)], out);
    }

    /// Answers `SetRate`: the rate from the next Start on, in millihertz.
    pub fn rate_set(&mut self, rate_mhz: u32, out: &mut Vec<u8>) {
        self.framer.write(kind::RATE_SET, &[&rate_mhz.to_le_bytes()], out);
    }
}

/// How many of the markers fit into one message: at least one, when there is any.
fn fitting(markers: &[MarkerInfo]) -> usize {
    let mut bytes = ENVELOPE_BYTES + 2;
    markers
        .iter()
        .take_while(|marker| {
            bytes += records::marker_info_bytes(marker);
            bytes <= MARKERS_MESSAGE_BYTES_MAX
        })
        .count()
        .max(usize::from(!markers.is_empty()))
}
