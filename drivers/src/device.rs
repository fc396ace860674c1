//! The interface between drivers and the recorder: [`Protocol`], its events, and its commands.
//!
//! Every device family translates its own wire format into these types.

use crate::{transport::Transport, uri::Location};

/// Identity and capabilities of a device. Sent first, and again on [`Command::Identify`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Hello {
    /// Model name: `DVMC-8820`, `mocapd-sim`...
    pub model: String,
    /// Serial number: the identity that survives a replug.
    pub serial: String,
    /// Firmware version, as the device reports it.
    pub firmware: String,
    /// Current frame rate, in millihertz: an integer that holds 59.94 Hz.
    pub rate_millihertz: u32,
    /// Lowest rate that the device supports, in millihertz.
    pub rate_min_millihertz: u32,
    /// Highest rate that the device supports, in millihertz.
    pub rate_max_millihertz: u32,
    /// Ticks of the device clock per second.
    pub tick_hz: u64,
    /// The axis that points up: 0 unknown, 1 x, 2 y, 3 z.
    pub up_axis: u8,
    /// Maximum number of markers that the device can announce, temporary ids included.
    pub markers_max: u16,
    /// Number of frames in a replay (a simulator knows it); 0 when the device runs until stopped.
    pub n_frames: u64,
}

/// A marker that the device tracks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MarkerInfo {
    /// The marker's id in frames.
    pub id: u16,
    /// Label; empty when the marker has none.
    pub label: String,
    /// `true` when the device knows which physical marker this is, `false` for a temporary id.
    pub labelled: bool,
}

/// One marker in one frame. A marker that is absent from a frame, or occluded in it, has no sample there.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MarkerSample {
    /// An id that a [`MarkerInfo`] announced, or a new temporary id.
    pub id: u16,
    /// Whether the device lists the marker without a position.
    pub occluded: bool,
    /// The device's residual in units of 10 micrometres: 255 = 2.55 mm or more, 0 = not reported.
    pub residual_10um: u8,
    /// x, y, z in millimetres, in the device's axes.
    pub position_mm: [f32; 3],
}

/// A residual as [`MarkerSample::residual_10um`]. 0 stands for none, so that smaller ones than its unit are 1; what is no
/// residual, such as a negative one and NaN, is none.
pub(crate) fn residual_10um(residual_mm: f64) -> u8 {
    if residual_mm > 0.0 { (residual_mm * 100.0).round().clamp(1.0, 255.0) as u8 } else { 0 }
}

/// One frame of marker samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame<'a> {
    /// The device's frame counter, which wraps.
    pub seq: u32,
    /// Device clock at exposure, in ticks.
    pub device_ticks: u64,
    /// SMPTE timecode as hh, mm, ss, ff, from devices that have one.
    pub timecode: Option<[u8; 4]>,
    /// Samples of the markers in this frame.
    pub markers: &'a [MarkerSample],
}

/// How a device sends the samples of its channels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SampleForm {
    /// Counts of 16 bits.
    #[default]
    Int16,
    /// Counts of 32 bits, of a magnitude of at most 2^24.
    Int32,
    /// Float32, any bits.
    Float32,
}

/// A sampled channel: a component of a force plate, an electrode, an axis of an inertial sensor.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SampledChannelInfo {
    /// Its name.
    pub name: String,
    /// The unit of its values; may be empty.
    pub unit: String,
    /// Units per count: a value is (sample - offset) * scale.
    pub scale: f64,
    /// The sample whose value is 0.
    pub offset: f64,
}

impl SampledChannelInfo {
    /// The value of a sample, in the channel's unit.
    #[must_use]
    pub fn value(&self, sample: f32) -> f64 {
        (f64::from(sample) - self.offset) * self.scale
    }
}

/// Channels that are sampled together, at a rate of their own.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SampledGroupInfo {
    /// Its number, by which batches refer to it.
    pub id: u8,
    /// The form of its samples.
    pub form: SampleForm,
    /// Samples of a channel per second, in thousandths.
    pub rate_millihertz: u32,
    /// The channels, 1 to 64.
    pub channels: Vec<SampledChannelInfo>,
}

/// What the channels of a force plate hold; the code of the C3D format's types.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PlateOutput {
    /// Six channels: the force, the centre of pressure x and y, the free moment.
    ForceAndCentre,
    /// Six channels: the force, and its moment about the origin of the sensors.
    #[default]
    ForceAndMoment,
    /// Eight channels: fx12, fx34, fy14, fy23, fz1 to fz4, forces at four sensors.
    FourSensors,
}

impl PlateOutput {
    /// All kinds of output.
    pub const ALL: [Self; 3] = [Self::ForceAndCentre, Self::ForceAndMoment, Self::FourSensors];

    /// The type that the C3D format calls it, 1 to 3.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::ForceAndCentre => 1,
            Self::ForceAndMoment => 2,
            Self::FourSensors => 3,
        }
    }

    /// Number of channels.
    #[must_use]
    pub const fn n_channels(self) -> usize {
        match self {
            Self::ForceAndCentre | Self::ForceAndMoment => 6,
            Self::FourSensors => 8,
        }
    }
}

/// A force plate: where it stands, and which sampled channels are its own.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ForcePlateInfo {
    /// Its number, from 1.
    pub number: u8,
    /// What its channels hold.
    pub output: PlateOutput,
    /// The number of the group that has its channels.
    pub group: u8,
    /// The indices of its channels in the group, in the order of its output.
    pub channels: Vec<u8>,
    /// The corners of its surface in the device's axes, in millimetres: those of the quadrants (+x +y), (-x +y), (-x -y),
    /// (+x -y) of the plate's own axes, in which its channels are.
    pub corners_mm: [[f32; 3]; 4],
    /// In the plate's own axes, in millimetres: from the origin of the sensors to the centre of the surface, so that z is
    /// positive in a plate whose z axis points up, and negative in one whose z axis points down; of four sensors half
    /// their distances along x and y, and the height of their origin above the surface, which is not positive.
    pub origin_mm: [f32; 3],
}

/// Consecutive samples of all channels of a group.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SampleBatch<'a> {
    /// The number of the group.
    pub group: u8,
    /// Number of the batch: counts the batches of the group that left the device, and wraps.
    pub number: u32,
    /// Number of its first sample: counts the samples that the device took since power-up, sent or not.
    pub first: u64,
    /// Device clock at its first sample, in ticks; without samples, at the next one.
    pub device_ticks: u64,
    /// The form in which it was sent.
    pub form: SampleForm,
    /// Number of channels.
    pub n_channels: u8,
    /// The samples, one after another; of each, all channels in order.
    pub samples: &'a [f32],
}

impl SampleBatch<'_> {
    /// Samples of each channel.
    #[must_use]
    pub fn n_samples(&self) -> usize {
        self.samples.len() / usize::from(self.n_channels).max(1)
    }
}

/// Counters and temperature that a device reports while it runs, and once more at the end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Status {
    /// Frames produced since Start, dropped ones included.
    pub frames_produced: u64,
    /// Frames of those that never left the device: its own queue was full, or the host polled too late and
    /// the next frame replaced them.
    pub frames_dropped: u64,
    /// Temperature in hundredths of a degree Celsius; `i16::MIN` when not measured.
    pub temperature_c_100: i16,
}

/// An edge on a trigger or sync input.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Trigger {
    /// Device clock at the edge, in ticks.
    pub device_ticks: u64,
    /// Number of the input.
    pub input: u8,
    /// Kind of edge: 0 trigger, 1 sync pulse.
    pub kind: u8,
}

/// A moment that the device reports with a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mark<'a> {
    /// Device clock at that moment, in ticks.
    pub device_ticks: u64,
    /// One line of text.
    pub text: &'a str,
}

/// Reply to a ping. Together with its arrival time it relates the device clock to the host clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pong {
    /// Host time that the ping carried, in nanoseconds.
    pub host_ns: u64,
    /// Device clock when the ping arrived, in ticks.
    pub device_ticks: u64,
}

/// Bandwidth that the frames need, and bandwidth that the line has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinkBudget {
    /// Bytes per second that the frames need at the chosen rate, worst case.
    pub needed_bytes_per_s: u64,
    /// Bytes per second that the line carries; `u64::MAX` when nothing limits it (a bare pty, USB).
    pub available_bytes_per_s: u64,
    /// Highest frame rate that fits the line, in millihertz.
    pub rate_fits_millihertz: u32,
}

impl LinkBudget {
    /// Whether the line has the bandwidth that the frames need.
    #[must_use]
    pub fn fits(&self) -> bool {
        self.needed_bytes_per_s <= self.available_bytes_per_s
    }
}

/// The reply to `SetRate` of a system whose rate is a setting of its own, which its driver reads but never changes.
pub(crate) fn rate_reply(asked_millihertz: u32, own_millihertz: u32) -> DeviceEvent<'static> {
    if asked_millihertz == own_millihertz {
        return DeviceEvent::RateSet(asked_millihertz);
    }
    DeviceEvent::Refused(LinkBudget {
        needed_bytes_per_s: 0,
        available_bytes_per_s: u64::MAX,
        rate_fits_millihertz: own_millihertz,
    })
}

/// A decoded message from a device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DeviceEvent<'a> {
    /// Identity and capabilities.
    Hello(&'a Hello),
    /// Markers to add to the table: all of them after Hello, later ones as they appear.
    Markers(&'a [MarkerInfo]),
    /// One frame.
    Frame(Frame<'a>),
    /// A group of sampled channels: all of them after the markers that follow Hello.
    SampledGroup(&'a SampledGroupInfo),
    /// A force plate: all of them after the groups.
    ForcePlate(&'a ForcePlateInfo),
    /// Samples of such a group.
    Samples(SampleBatch<'a>),
    /// The rigid bodies: the whole table, after the markers that follow Hello, and again when it changes.
    Bodies(&'a [BodyInfo]),
    /// Their poses in a frame, before or after that frame.
    Poses(PoseFrame<'a>),
    /// No poses follow until the next Start.
    EndOfPoses(EndOfPoses),
    /// A trigger edge.
    Trigger(Trigger),
    /// A moment with a text.
    Mark(Mark<'a>),
    /// Counters and temperature.
    Status(Status),
    /// One line of text for the operator about the device or its line. Sent rarely: at most once per Start
    /// for each subject.
    Note(&'a str),
    /// Reply to [`Command::Ping`].
    Pong(Pong),
    /// [`Command::Start`] was accepted; frames follow.
    Started(LinkBudget),
    /// [`Command::Start`] or [`Command::SetRate`] was refused: the line is too slow, or the rate out of range.
    Refused(LinkBudget),
    /// [`Command::SetRate`] was accepted: the rate from the next Start on, in millihertz.
    RateSet(u32),
    /// The stream ended: no frame follows. Carries the final counters.
    EndOfStream(Status),
}

/// A command from the host to a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// Send Hello and Markers, possibly again.
    Identify,
    /// Start to send frames.
    Start {
        /// Bandwidth of the line as the host knows it, in bytes per second; 0 when unknown or unlimited.
        line_bytes_per_s: u64,
    },
    /// Stop sending frames. The device replies with [`DeviceEvent::EndOfStream`].
    Stop,
    /// Change the frame rate, in millihertz. Valid while the device is stopped.
    SetRate(u32),
    /// Reply with a [`Pong`].
    Ping {
        /// The host's monotonic time in nanoseconds, which the device returns unchanged.
        host_ns: u64,
    },
}

/// Counters of a protocol since its creation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LinkCounters {
    /// Bytes received.
    pub bytes: u64,
    /// Bytes that belonged to no valid message, counted once the end of the damage has arrived. A lone 0x00
    /// between messages is framing and is not counted.
    pub bytes_skipped: u64,
    /// Messages decoded.
    pub messages: u64,
    /// Messages with a wrong checksum or layout.
    pub messages_damaged: u64,
    /// Messages of a type or version that this build does not know; they are skipped whole.
    pub messages_unknown: u64,
    /// Marker positions that were infinite or NaN; they are reported as occluded.
    pub samples_not_finite: u64,
}

/// The protocol of a device family, sans-io: received bytes become events, commands become bytes.
///
/// Decoding a frame must not allocate. Rare messages (a marker table, a Hello) may.
pub trait Protocol: Send + std::fmt::Debug {
    /// Takes the transport after every open and reopen, and returns the one to read from.
    ///
    /// Returns `line` unchanged for devices that send on their own. A protocol that must poll wraps it in a
    /// [`PolledTransport`](crate::transport::polled::PolledTransport). The state of the device is unknown from
    /// then on: a protocol that keeps any resets it here.
    fn attach(&mut self, line: Box<dyn Transport>) -> Box<dyn Transport> {
        line
    }

    /// Decodes received bytes, split at arbitrary points, and calls `on_event` for every event they complete.
    ///
    /// The reader calls it after every read, empty ones included, so that a polling protocol can detect
    /// time-outs.
    fn push(&mut self, bytes: &[u8], on_event: &mut dyn FnMut(DeviceEvent<'_>));

    /// Appends the encoded `command` to `out`.
    fn command(&mut self, command: Command, out: &mut Vec<u8>);

    /// Whether the protocol itself checks a connection on which nothing arrives, and reports its loss. Otherwise the
    /// reader asks a silent device to identify itself, which stops and restarts it.
    fn checks_silence(&self) -> bool {
        false
    }

    /// The counters so far.
    fn counters(&self) -> LinkCounters;
}

/// Devices that speak one protocol.
#[derive(Debug)]
pub struct Family {
    /// The family's name in `?driver=NAME`: lower-case ASCII letters and digits.
    pub name: &'static str,
    /// Rates a device by what is visible without opening it: location, USB ids and strings.
    pub claims: fn(&Candidate) -> Claim,
    /// Creates the protocol for a newly opened device at a location.
    pub protocol: fn(&Location) -> Box<dyn Protocol>,
}

/// How confident a family is that a device is one of its own. Ordered: a higher claim wins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Claim {
    /// Not a device of this family.
    No,
    /// Could be one; nothing rules it out (a bare serial port).
    Possible,
    /// The device's USB strings identify it.
    Certain,
}

/// A device as the operating system describes it, without opening it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Candidate {
    /// The serial port or USB address.
    pub location: Location,
    /// USB vendor and product ids; `None` for a serial port that is not on USB.
    pub usb_ids: Option<(u16, u16)>,
    /// Serial number from the USB descriptor.
    pub serial: Option<String>,
    /// Manufacturer string from the USB descriptor.
    pub manufacturer: Option<String>,
    /// Product string from the USB descriptor.
    pub product: Option<String>,
}

impl Candidate {
    /// A device known by its location only.
    #[must_use]
    pub fn at(location: Location) -> Self {
        Self { location, usb_ids: None, serial: None, manufacturer: None, product: None }
    }

    /// Whether `is_name` accepts the product or the manufacturer string, in lower case.
    pub(crate) fn name_matches(&self, is_name: impl Fn(&str) -> bool) -> bool {
        let strings = [&self.product, &self.manufacturer].into_iter().flatten();
        strings.map(|text| text.to_ascii_lowercase()).any(|text| is_name(&text))
    }

    pub(crate) fn is_serial(&self) -> bool {
        matches!(self.location, Location::Serial { .. })
    }
}

/// Maximum number of rigid bodies of a device: twice the most tools and props that a volume holds. It bounds the memory
/// that their poses need.
pub const BODIES_MAX: usize = 128;

/// A rigid body that the device tracks.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct BodyInfo {
    /// The number by which poses refer to it. No two bodies have the same.
    pub id: u16,
    /// Its name; may be empty.
    pub name: String,
}

/// Whether a device has the pose of a body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PoseStatus {
    /// It has.
    #[default]
    Tracked,
    /// It does not see enough of the body.
    Lost,
    /// It does not vouch for the pose: the body is outside its volume, or its markers do not fit well.
    Rejected,
    /// A code of a later version of the link protocol, 3 to 127: it has none.
    Other(u8),
}

impl PoseStatus {
    /// All that have a name, by their codes.
    pub const ALL: [Self; 3] = [Self::Tracked, Self::Lost, Self::Rejected];

    /// Its number on the wire and in takes, which have numbers of their own from 128 on.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Tracked => 0,
            Self::Lost => 1,
            Self::Rejected => 2,
            Self::Other(code) => code,
        }
    }

    /// That of a number on the wire; `None` from 128 on.
    #[must_use]
    pub const fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Tracked),
            1 => Some(Self::Lost),
            2 => Some(Self::Rejected),
            3..128 => Some(Self::Other(code)),
            128.. => None,
        }
    }
}

/// The pose of a body in a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// The number of the body.
    pub body: u16,
    /// The other fields have a meaning only if it is tracked.
    pub status: PoseStatus,
    /// Position of the body's origin in millimetres, in the device's axes.
    pub position_mm: [f32; 3],
    /// Rotation from the body's axes to the device's, as a unit quaternion w, x, y, z. Its negative is the same rotation.
    pub quaternion: [f32; 4],
    /// How well the body's markers fit, in millimetres; NaN if the device does not report it.
    pub residual_mm: f32,
}

/// Largest deviation of the length of a quaternion from 1. Quaternions and matrices of float32 stay within 1e-6, and those
/// with three decimals within 1e-3; beyond this it is no rotation.
const LENGTH_ERROR_MAX: f64 = 0.01;

impl Pose {
    /// A body without a pose.
    #[must_use]
    pub const fn without(body: u16, status: PoseStatus) -> Self {
        Self {
            body,
            status,
            position_mm: [f32::NAN; 3],
            quaternion: [f32::NAN; 4],
            residual_mm: f32::NAN,
        }
    }

    /// The pose, or none with the status [`Rejected`](PoseStatus::Rejected) if a number is not finite or the quaternion
    /// is no rotation. Nothing but the status remains of a body that is not tracked.
    #[must_use]
    pub fn checked(self) -> Self {
        let status = match self.status {
            PoseStatus::Tracked if !self.is_rotation() => PoseStatus::Rejected,
            status => status,
        };
        if status == PoseStatus::Tracked { self } else { Self::without(self.body, status) }
    }

    fn is_rotation(&self) -> bool {
        let length: f64 = self.quaternion.iter().map(|x| f64::from(*x) * f64::from(*x)).sum();
        (length.sqrt() - 1.0).abs() <= LENGTH_ERROR_MAX
            && self.position_mm.iter().all(|x| x.is_finite())
    }
}

/// The poses of the bodies in one frame. A device that has bodies sends one for each of its frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseFrame<'a> {
    /// Number of the frame: that of [`Frame::seq`](Frame::seq), which wraps.
    pub seq: u32,
    /// Counts the pose frames that left the device, and wraps: where frames are missing between two that follow each other
    /// by this number, the device dropped them. A device that does not count them repeats `seq`, and then all missing
    /// ones count as lost on the link.
    pub number: u32,
    /// Device clock at exposure, in ticks.
    pub device_ticks: u64,
    /// The poses; of bodies that are not listed, nothing is known.
    pub poses: &'a [Pose],
}

/// The end of the poses of a run, sent before [`EndOfStream`](DeviceEvent::EndOfStream), so that a loss at the end
/// is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EndOfPoses {
    /// Number of the frame that would come next.
    pub seq: u32,
    /// Number of the next message, as [`PoseFrame::number`].
    pub number: u32,
    /// Device clock, in ticks.
    pub device_ticks: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_residual_is_not_none_and_a_large_one_is_the_largest() {
        let found =
            [0.001, 0.004, 0.005, 0.014, 0.12, 2.55, 40.0, f64::INFINITY].map(residual_10um);
        assert_eq!(found, [1, 1, 1, 1, 12, 255, 255, 255]);
        assert_eq!([0.0, -0.0, -1.0, f64::NAN].map(residual_10um), [0; 4]);
    }

    #[test]
    fn what_is_no_pose_is_rejected_and_leaves_only_its_status() {
        let good = Pose {
            body: 3,
            status: PoseStatus::Tracked,
            position_mm: [1.0, -2.0, 3.0],
            quaternion: [0.6, 0.0, -0.8, 0.0],
            residual_mm: f32::NAN,
        };
        assert_eq!(good.checked().position_mm, good.position_mm);
        assert_eq!(good.checked().status, PoseStatus::Tracked);
        let rotations = [[0.8001, 0.6, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [1.009, 0.0, 0.0, 0.0]];
        for quaternion in rotations {
            assert_eq!(Pose { quaternion, ..good }.checked().status, PoseStatus::Tracked);
        }
        for bad in [
            Pose { quaternion: [0.0; 4], ..good },
            Pose { quaternion: [1.0, 0.2, 0.0, 0.0], ..good },
            Pose { quaternion: [f32::NAN, 0.0, 0.0, 1.0], ..good },
            Pose { quaternion: [f32::INFINITY, 0.0, 0.0, 1.0], ..good },
            Pose { position_mm: [0.0, f32::NEG_INFINITY, 0.0], ..good },
        ] {
            let found = bad.checked();
            assert_eq!((found.body, found.status), (3, PoseStatus::Rejected), "{bad:?}");
            assert!(found.quaternion.iter().chain(&found.position_mm).all(|x| x.is_nan()));
        }
        let lost = Pose { status: PoseStatus::Lost, ..good }.checked();
        assert!(lost.status == PoseStatus::Lost && lost.residual_mm.is_nan());
    }
}
