//! The truth about what was sent, for whoever checks a recording against it.

/// What became of frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SentCounters {
    /// Frames whose time came.
    pub frames_produced: u64,
    /// Of these, dropped because the device's own queue was full.
    pub frames_dropped: u64,
    /// Marker samples in the frames that were not dropped.
    pub samples: u64,
    /// Markers that these frames listed as occluded, or left out because they were not seen.
    pub samples_occluded: u64,
}

/// What a device did since it was made.
///
/// Over all runs, `frames_produced = frames_sent + frames_waiting + frames_discarded + frames_dropped`.
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
    /// Frames still in the device's queue.
    pub frames_waiting: u64,
    /// Frames that waited when a host said Identify: they were not its own, and did not leave.
    pub frames_discarded: u64,
    /// Bytes that the line took.
    pub bytes_sent: u64,
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
    /// The queue was full: it never left the device.
    pub dropped: bool,
    /// The caller's clock when its time came: of a device on a line the host's monotonic one, in nanoseconds.
    pub host_ns: u64,
}

impl SentFrame {
    /// The first line of a log file.
    pub const CSV_HEADER: &'static str = "run,seq,device_ticks,present,dropped,host_ns";

    /// One line of a log file, without its end.
    #[must_use]
    pub fn to_csv(self) -> String {
        let Self { run, seq, device_ticks, present, dropped, host_ns } = self;
        format!("{run},{seq},{device_ticks},{present},{},{host_ns}", u8::from(dropped))
    }
}
