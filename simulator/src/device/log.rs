//! The truth about what was sent, for whoever checks a recording against it.

use crate::faults::FaultTotals;

/// What became of frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SentCounters {
    /// Frames whose time came.
    pub frames_produced: u64,
    /// Of these, the ones that never left the device: its own queue was full, or it is polled and the
    /// next frame came before a request fetched them.
    pub frames_dropped: u64,
    /// Frames of a polled device for which nobody asked any more: no request came in their run after
    /// them, so no host can know that they were made. They are not among those dropped.
    pub frames_unasked: u64,
    /// Marker samples in the frames that left it.
    pub samples: u64,
    /// Markers that these frames listed as occluded, or left out because they were not seen.
    pub samples_occluded: u64,
}

/// What a device did since it was made.
///
/// Over all runs, without faults, `frames_produced` is the sum of `frames_sent`, `frames_waiting`, `frames_discarded`,
/// `frames_dropped` and `frames_unasked`.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SentLog {
    /// Since the last Start.
    pub run: SentCounters,
    /// Since the device was made.
    pub total: SentCounters,
    /// Starts that were accepted.
    pub starts: u64,
    /// Start and `SetRate` commands that were refused.
    pub refused: u64,
    /// Ends of stream that were queued.
    pub ends: u64,
    /// Answers and reports that found no room, because the host does not read what it asks for.
    pub answers_dropped: u64,
    /// Frames that the line took whole, over all runs.
    pub frames_sent: u64,
    /// Frames still in the device's queue; of a polled device those that a request may still fetch, or
    /// miss.
    pub frames_waiting: u64,
    /// Frames that waited when a host said Identify: they were not its own, and did not leave.
    pub frames_discarded: u64,
    /// Bytes that the line took.
    pub bytes_sent: u64,
    /// What became of the frames on a line with faults.
    pub faults: Option<FaultTotals>,
    /// One entry a frame, when asked for and not taken away by then.
    pub frames: Vec<SentFrame>,
}

/// One frame whose time came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SentFrame {
    /// Which Start it followed, from 1.
    pub run: u64,
    /// Its number on the wire: it counts on from run to run, and wraps.
    pub seq: u32,
    /// The device's clock, in ticks.
    pub device_ticks: u64,
    /// Markers with a position in it.
    pub present: u32,
    /// It never left the device: see [`SentCounters::frames_dropped`].
    pub dropped: bool,
    /// Nobody asked for it, nor for any after it: see [`SentCounters::frames_unasked`].
    pub unasked: bool,
    /// The caller's clock when its time came: of a device on a line the host's monotonic one, in nanoseconds.
    pub host_ns: u64,
}

impl SentFrame {
    /// The first line of a log file.
    pub const CSV_HEADER: &'static str = "run,seq,device_ticks,present,dropped,host_ns,unasked";

    /// One line of a log file, without its end.
    #[must_use]
    pub fn to_csv(self) -> String {
        let Self { run, seq, device_ticks, present, dropped, unasked, host_ns } = self;
        let (dropped, unasked) = (u8::from(dropped), u8::from(unasked));
        format!("{run},{seq},{device_ticks},{present},{dropped},{host_ns},{unasked}")
    }
}
