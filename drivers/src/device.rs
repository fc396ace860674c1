//! What a device says and is told, whatever its wire: the vocabulary between a driver and the daemon.

use crate::transport::Transport;

/// Who the device is. Sent first, and again when asked.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Hello {
    /// `DVMC-8820`, `mocapd-sim`...
    pub model: String,
    /// Serial number, the stable identity across replugs.
    pub serial: String,
    /// Firmware version, as the device writes it.
    pub firmware: String,
    /// Frame rate now, in millihertz (so that 59.94 Hz is exact enough and integers stay integers).
    pub rate_mhz: u32,
    /// Lowest and highest rate it can run at, in millihertz.
    pub rate_min_mhz: u32,
    /// See `rate_min_mhz`.
    pub rate_max_mhz: u32,
    /// Device clock ticks a second.
    pub tick_hz: u64,
    /// Which way is up: 0 unknown, 1 x, 2 y, 3 z.
    pub up_axis: u8,
    /// How many markers it may announce at most, temporary ids included.
    pub markers_max: u16,
    /// Frames in the replay when the device knows it (a simulator does); 0 when it runs until stopped.
    pub n_frames: u64,
}

/// One marker the device tracks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MarkerInfo {
    /// Its id in frames.
    pub id: u16,
    /// Its name; empty when unlabelled.
    pub label: String,
    /// Whether the device knows which physical marker this is (false: a temporary id).
    pub labelled: bool,
}

/// One marker in one frame. A marker that is not listed, or is listed as occluded, has no sample.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MarkerSample {
    /// The id announced by [`MarkerInfo`], or a new temporary one.
    pub id: u16,
    /// Seen by the device but without a position.
    pub occluded: bool,
    /// The device's own residual in units of 10 micrometres; 255 = 2.55 mm or more, 0 = not given.
    pub residual_10um: u8,
    /// x y z in millimetres.
    pub position_mm: [f32; 3],
}

/// One frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame<'a> {
    /// The device's frame counter; wraps.
    pub seq: u32,
    /// The device's clock at exposure, in ticks.
    pub device_ticks: u64,
    /// SMPTE timecode packed as hh mm ss ff, when the device has one.
    pub timecode: Option<[u8; 4]>,
    /// The markers.
    pub markers: &'a [MarkerSample],
}

/// What a device reports about itself while it runs, and once more at the end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Status {
    /// Frames produced since Start: the value the counter reached, dropped ones included.
    pub frames_produced: u64,
    /// Of these, the ones that never left the device: its own queue was full, or it is polled and nobody
    /// fetched them before the next one.
    pub frames_dropped: u64,
    /// Temperature in hundredths of a degree Celsius; `i16::MIN` when not measured.
    pub temperature_c_100: i16,
}

/// A trigger input or sync pulse.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Trigger {
    /// The device's clock at the edge, in ticks.
    pub device_ticks: u64,
    /// Which input.
    pub input: u8,
    /// 0 trigger, 1 sync pulse.
    pub kind: u8,
}

/// Answer to a ping: with the time at which it arrives, what ties the two clocks together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pong {
    /// The host time the ping carried, in nanoseconds.
    pub host_ns: u64,
    /// Device ticks when the ping arrived.
    pub device_ticks: u64,
}

/// What the line must carry and can carry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinkBudget {
    /// Bytes a second the frames need at the rate, worst case.
    pub needed_bytes_per_s: u64,
    /// Bytes a second the line carries; `u64::MAX` when not limited (a bare pty, USB).
    pub available_bytes_per_s: u64,
    /// The highest rate that fits, in millihertz.
    pub rate_fits_mhz: u32,
}

impl LinkBudget {
    /// Whether the line carries what is needed.
    #[must_use]
    pub fn fits(&self) -> bool {
        self.needed_bytes_per_s <= self.available_bytes_per_s
    }
}

/// One thing a device said.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DeviceEvent<'a> {
    /// Who it is.
    Hello(&'a Hello),
    /// Markers added to the table (all of them after Hello; later ones as they appear).
    Markers(&'a [MarkerInfo]),
    /// A frame of markers.
    Frame(Frame<'a>),
    /// A trigger edge.
    Trigger(Trigger),
    /// A report.
    Status(Status),
    /// What people should know about this device or its line, in one line of words. Said rarely: once a
    /// Start for each thing.
    Note(&'a str),
    /// Answer to [`Command::Ping`].
    Pong(Pong),
    /// Start accepted.
    Started(LinkBudget),
    /// Start or `SetRate` refused: the line is too slow, or the rate out of range.
    Refused(LinkBudget),
    /// `SetRate` accepted: the rate from the next Start on, in millihertz.
    RateSet(u32),
    /// The device will send no more frames, and the last report.
    EndOfStream(Status),
}

/// What the host can ask.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// Say Hello and Markers (again).
    Identify,
    /// Send frames. The line's speed as the host knows it, in bytes a second; 0 = unknown.
    Start {
        /// See the variant.
        line_bytes_per_s: u64,
    },
    /// Stop sending frames; the device answers with `EndOfStream`.
    Stop,
    /// Change the rate while stopped, in millihertz.
    SetRate(u32),
    /// Answer with a [`Pong`].
    Ping {
        /// The host's monotonic time, in nanoseconds, sent back as it came.
        host_ns: u64,
    },
}

/// What a protocol counted since it was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LinkCounters {
    /// Bytes pushed in.
    pub bytes: u64,
    /// Bytes that belonged to no valid message, once the end of the damage is seen.
    /// A lone 0x00 between messages is framing and counts nowhere.
    pub bytes_skipped: u64,
    /// Messages decoded.
    pub messages: u64,
    /// Messages whose checksum or layout was wrong.
    pub messages_damaged: u64,
    /// Messages of a type this build does not know: skipped whole.
    pub messages_unknown: u64,
    /// Marker positions that were no numbers (infinite, NaN), given as occluded.
    pub samples_not_finite: u64,
}

/// A device family's wire, sans-io: bytes are pushed in, events come out; commands go in, bytes come out.
///
/// Frames are decoded without allocating; what is rare (a table, a Hello) may allocate.
pub trait Protocol: Send + std::fmt::Debug {
    /// Takes the line that it is spoken on, at first and again after the device went away, and gives
    /// the transport to read instead.
    ///
    /// A protocol of devices that speak unasked gives the line back as it is. One of devices that
    /// only answer puts a [`TurnTransport`](crate::transport::turns::TurnTransport) around it, and
    /// knows nothing of the device from then on.
    fn attach(&mut self, line: Box<dyn Transport>) -> Box<dyn Transport> {
        line
    }

    /// Takes bytes as they arrived, in pieces of any size, and gives every event they complete.
    ///
    /// It is called after every read, also one that brought nothing: a protocol that waits for
    /// answers sees then that time has passed.
    fn push(&mut self, bytes: &[u8], on_event: &mut dyn FnMut(DeviceEvent<'_>));

    /// Appends the bytes that say `command`.
    fn command(&mut self, command: Command, out: &mut Vec<u8>);

    /// What was counted so far.
    fn counters(&self) -> LinkCounters;
}
