//! The two ends of a link: [`DeviceLink`] for simulators, [`HostLink`] for the recorder.

use super::{
    COMMAND_WIRE_BYTES_MAX, DecodeOutcome, Deframer, ENVELOPE_BYTES, EncodeError, FrameForm,
    Framer, MARKERS_MAX, MARKERS_MESSAGE_BYTES_MAX, SAMPLE_VALUES_MAX, WIRE_BYTES_MAX,
    frame::{get_frame, put_frame},
    messages::{self, get_hello, get_markers, kind},
};
use crate::{
    bytes::WireValue,
    device::{
        BODIES_MAX, BodyInfo, Command, DeviceEvent, EndOfPoses, ForcePlateInfo, Frame, Hello,
        LinkBudget, LinkCounters, MarkerInfo, MarkerSample, Pong, Pose, PoseFrame, Protocol,
        SampleBatch, SampledGroupInfo, Status, Trigger,
    },
};

/// The device's end of a link, sans-io. Its methods append each message to `out`.
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
    /// Makes a link with empty buffers and zeroed counters.
    #[must_use]
    pub fn new() -> Self {
        Self { deframer: Deframer::new(COMMAND_WIRE_BYTES_MAX), framer: Framer::default() }
    }

    /// Decodes received bytes, split at arbitrary points, and calls `on_command` for every command they complete.
    pub fn push(&mut self, bytes: &[u8], on_command: &mut dyn FnMut(Command)) {
        self.deframer.push(bytes, |kind, payload| match messages::get_command(kind, payload) {
            Some(command) => command.map(&mut *on_command).into(),
            None => DecodeOutcome::Unknown,
        });
    }

    /// Counters of the received bytes and messages.
    #[must_use]
    pub fn counters(&self) -> LinkCounters {
        self.deframer.counters
    }

    /// Encodes a Hello. A 0x00 precedes it and ends whatever another device left on the line.
    ///
    /// # Errors
    /// `Text` and `Hello` for values that the message cannot hold.
    pub fn hello(&mut self, hello: &Hello, out: &mut Vec<u8>) -> Result<(), EncodeError> {
        messages::put_hello(hello, self.framer.open(kind::HELLO))?;
        out.push(0);
        self.framer.close(out);
        Ok(())
    }

    /// Encodes markers for the host's table, in as many messages as needed; an empty table takes one.
    ///
    /// # Errors
    /// `TooManyMarkers`, and `Text` for a label that the message cannot hold; nothing is appended then.
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
            let (now, later) = rest.split_at(n_fitting(rest));
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

    /// Encodes a frame, whose markers must be sorted by ascending id.
    ///
    /// `form` is a preference: a frame that it cannot represent, or only in more bytes than another form, is
    /// sent in the other. A marker whose position is not finite is sent as occluded.
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

    /// Encodes the description of a group of sampled channels.
    ///
    /// # Errors
    /// `SampledGroup`, and `Text` for a name or unit that the message cannot hold; nothing is appended then.
    pub fn sampled_group(
        &mut self,
        group: &SampledGroupInfo,
        out: &mut Vec<u8>,
    ) -> Result<(), EncodeError> {
        messages::put_group(group, self.framer.open(kind::SAMPLED_GROUP))?;
        self.framer.close(out);
        Ok(())
    }

    /// Encodes the description of a force plate.
    ///
    /// # Errors
    /// `ForcePlate` for one that the message cannot hold; nothing is appended then.
    pub fn force_plate(
        &mut self,
        plate: &ForcePlateInfo,
        out: &mut Vec<u8>,
    ) -> Result<(), EncodeError> {
        messages::put_plate(plate, self.framer.open(kind::FORCE_PLATE))?;
        self.framer.close(out);
        Ok(())
    }

    /// Encodes a batch of samples.
    ///
    /// # Errors
    /// `Samples` for a batch that the message cannot hold; nothing is appended then.
    pub fn samples(
        &mut self,
        batch: &SampleBatch<'_>,
        out: &mut Vec<u8>,
    ) -> Result<(), EncodeError> {
        messages::put_batch(&mut self.framer, batch, out)
    }

    /// Encodes the table of rigid bodies, which must be sorted by ascending id.
    ///
    /// # Errors
    /// `Bodies`, and `Text` for a name that the message cannot hold; nothing is appended then.
    pub fn bodies(&mut self, bodies: &[BodyInfo], out: &mut Vec<u8>) -> Result<(), EncodeError> {
        messages::put_bodies(bodies, self.framer.open(kind::BODIES))?;
        self.framer.close(out);
        Ok(())
    }

    /// Encodes the poses of a frame, which must be sorted by ascending body.
    ///
    /// # Errors
    /// `Poses` for poses that the message cannot hold; nothing is appended then.
    pub fn poses(&mut self, frame: &PoseFrame<'_>, out: &mut Vec<u8>) -> Result<(), EncodeError> {
        messages::put_poses(&mut self.framer, frame, out)
    }

    /// Encodes the end of the poses of a run.
    pub fn end_of_poses(&mut self, end: EndOfPoses, out: &mut Vec<u8>) {
        messages::put_end(&mut self.framer, end, out);
    }

    /// Encodes a trigger edge.
    pub fn trigger(&mut self, trigger: Trigger, out: &mut Vec<u8>) {
        self.framer.write(kind::TRIGGER, trigger, out);
    }

    /// Encodes the counters and temperature of the device.
    pub fn status(&mut self, status: Status, out: &mut Vec<u8>) {
        self.framer.write(kind::STATUS, status, out);
    }

    /// Encodes the end of the stream with the final counters. No frames follow until the next Start.
    pub fn end_of_stream(&mut self, status: Status, out: &mut Vec<u8>) {
        self.framer.write(kind::END_OF_STREAM, status, out);
    }

    /// Encodes the reply to Ping.
    pub fn pong(&mut self, pong: Pong, out: &mut Vec<u8>) {
        self.framer.write(kind::PONG, pong, out);
    }

    /// Encodes the acceptance of Start. Frames follow.
    pub fn started(&mut self, budget: LinkBudget, out: &mut Vec<u8>) {
        self.framer.write(kind::STARTED, budget, out);
    }

    /// Encodes the refusal of Start or `SetRate`: the line is too slow, or the rate out of range.
    pub fn refused(&mut self, budget: LinkBudget, out: &mut Vec<u8>) {
        self.framer.write(kind::REFUSED, budget, out);
    }

    /// Encodes the acceptance of `SetRate`: the rate from the next Start on, in millihertz.
    pub fn rate_set(&mut self, rate_millihertz: u32, out: &mut Vec<u8>) {
        self.framer.write(kind::RATE_SET, rate_millihertz, out);
    }
}

/// Number of markers that fit into one message: at least one unless there are none.
fn n_fitting(markers: &[MarkerInfo]) -> usize {
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

/// The host's end of a link, sans-io: the [`Protocol`] of the DVMC family.
#[derive(Debug)]
pub struct HostLink {
    deframer: Deframer,
    framer: Framer,
    scratch: Scratch,
}

/// Memory that messages are decoded into, reused from one to the next.
#[derive(Debug, Default)]
struct Scratch {
    positions: Vec<MarkerSample>,
    markers: Vec<MarkerInfo>,
    hello: Hello,
    group: SampledGroupInfo,
    plate: ForcePlateInfo,
    samples: Vec<f32>,
    bodies: Vec<BodyInfo>,
    poses: Vec<Pose>,
    samples_not_finite: u64,
}

impl HostLink {
    /// Makes a link with empty buffers and zeroed counters.
    #[must_use]
    pub fn new() -> Self {
        Self {
            deframer: Deframer::new(WIRE_BYTES_MAX),
            framer: Framer::default(),
            scratch: Scratch {
                positions: Vec::with_capacity(MARKERS_MAX),
                samples: Vec::with_capacity(SAMPLE_VALUES_MAX),
                poses: Vec::with_capacity(BODIES_MAX),
                ..Scratch::default()
            },
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
        let scratch = &mut self.scratch;
        self.deframer.push(bytes, |kind, payload| scratch.decode(kind, payload, on_event));
    }

    fn command(&mut self, command: Command, out: &mut Vec<u8>) {
        let framer = &mut self.framer;
        match command {
            Command::Identify => {
                // Ends whatever the device received before, so that it cannot damage this command.
                out.push(0);
                framer.write(kind::IDENTIFY, (), out);
            }
            Command::Start { line_bytes_per_s: n } => framer.write(kind::START, n, out),
            Command::Stop => framer.write(kind::STOP, (), out),
            Command::SetRate(rate_millihertz) => framer.write(kind::SET_RATE, rate_millihertz, out),
            Command::Ping { host_ns } => framer.write(kind::PING, host_ns, out),
        }
    }

    fn counters(&self) -> LinkCounters {
        let samples_not_finite = self.scratch.samples_not_finite;
        LinkCounters { samples_not_finite, ..self.deframer.counters }
    }
}

impl Scratch {
    fn decode(
        &mut self,
        kind: u8,
        payload: &[u8],
        on_event: &mut dyn FnMut(DeviceEvent<'_>),
    ) -> DecodeOutcome {
        let Self {
            positions,
            markers,
            hello,
            group,
            plate,
            samples,
            bodies,
            poses,
            samples_not_finite,
        } = self;
        let event = match kind {
            kind::FRAME_FLOAT | kind::FRAME_MICROMETRES | kind::FRAME_COMPACT => {
                get_frame(kind, payload, positions, samples_not_finite).map(DeviceEvent::Frame)
            }
            kind::HELLO => get_hello(payload, hello).map(|()| DeviceEvent::Hello(hello)),
            kind::MARKERS => get_markers(payload, markers).map(DeviceEvent::Markers),
            kind::SAMPLED_GROUP => {
                messages::get_group(payload, group).map(|()| DeviceEvent::SampledGroup(group))
            }
            kind::FORCE_PLATE => {
                messages::get_plate(payload, plate).map(|()| DeviceEvent::ForcePlate(plate))
            }
            kind::SAMPLES => messages::get_batch(payload, samples).map(DeviceEvent::Samples),
            kind::BODIES => {
                messages::get_bodies(payload, bodies).map(|()| DeviceEvent::Bodies(bodies))
            }
            kind::POSES => messages::get_poses(payload, poses),
            kind::TRIGGER => WireValue::decode(payload).map(DeviceEvent::Trigger),
            kind::STATUS => WireValue::decode(payload).map(DeviceEvent::Status),
            kind::END_OF_STREAM => WireValue::decode(payload).map(DeviceEvent::EndOfStream),
            kind::PONG => WireValue::decode(payload).map(DeviceEvent::Pong),
            kind::STARTED => WireValue::decode(payload).map(DeviceEvent::Started),
            kind::REFUSED => WireValue::decode(payload).map(DeviceEvent::Refused),
            kind::RATE_SET => WireValue::decode(payload).map(DeviceEvent::RateSet),
            _ => return DecodeOutcome::Unknown,
        };
        event.map(on_event).into()
    }
}
