//! The log of what a device sent: the ground truth for checking recordings; and, for a system on the network, how it is
//! served, and the file with the fate of each of its frames.

use std::{
    fmt,
    io::{self, Write},
};

use crate::faults::{KINDS, Kind, Kinds};

/// Frame and sample counters of a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SentCounters {
    /// Frames produced.
    pub frames_produced: u64,
    /// Produced frames that never left the device: its queue was full, or it is polled and produced the next frame
    /// before a request fetched this one.
    pub frames_dropped: u64,
    /// Frames that a polled device produced after the last request of a run. No host can know of them, so they do not
    /// count as dropped.
    pub frames_unasked: u64,
    /// Marker samples in the frames that left the device.
    pub samples: u64,
    /// Markers that these frames listed as occluded, or omitted because they were not visible.
    pub samples_occluded: u64,
}

/// What a device has done since it was made.
///
/// Over all runs, without faults, `frames_produced` is the sum of `frames_sent`, `frames_waiting`, `frames_discarded`,
/// `frames_dropped` and `frames_unasked`.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SentLog {
    /// Counters since the last Start.
    pub run: SentCounters,
    /// Counters since the device was made.
    pub total: SentCounters,
    /// Starts accepted.
    pub starts: u64,
    /// Start and `SetRate` commands refused.
    pub refused: u64,
    /// Ends of stream queued.
    pub ends: u64,
    /// Answers and reports dropped because the host did not read and the queue was full.
    pub answers_dropped: u64,
    /// Frames that the line took whole, over all runs.
    pub frames_sent: u64,
    /// Frames still in the device's queue; for a polled device, those that a request may still fetch or miss.
    pub frames_waiting: u64,
    /// Frames discarded from the queue because a host sent Identify: they belonged to an earlier session.
    pub frames_discarded: u64,
    /// Bytes that the line took.
    pub bytes_sent: u64,
    /// Totals by fate, on a line with faults.
    pub faults: Option<FaultTotals>,
    /// Samples of each channel taken, over all groups.
    pub samples_taken: u64,
    /// Batches of samples queued.
    pub batches_produced: u64,
    /// Batches that never left the device: its queue was full.
    pub batches_dropped: u64,
    /// Batches discarded from the queue because a host sent Identify.
    pub batches_discarded: u64,
    /// Totals of batches by fate, on a line with faults.
    pub batch_faults: Option<FaultTotals>,
    /// One entry per batch, if the frame log is on; emptied by [`Device::take_batches`](super::Device::take_batches).
    pub batches: Vec<SentBatch>,
    /// One entry per frame, if the frame log is on; emptied by [`take_frames`](super::LineDevice::take_frames).
    pub frames: Vec<SentFrame>,
}

/// One frame that the device produced.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SentFrame {
    /// Number of the run (of the Start before it), from 1.
    pub run: u64,
    /// Frame counter on the wire; it continues from run to run, modulo 2^32.
    pub seq: u32,
    /// The device's clock, in ticks.
    pub device_ticks: u64,
    /// Number of markers with a position.
    pub present: u32,
    /// Whether it never left the device: see [`SentCounters::frames_dropped`].
    pub dropped: bool,
    /// Whether it was produced after the last request: see [`SentCounters::frames_unasked`].
    pub unasked: bool,
    /// The caller's clock when the frame was due, nanoseconds; on a line, the host's monotonic clock.
    pub host_ns: u64,
}

impl SentFrame {
    /// The header of a log file.
    pub const CSV_HEADER: &'static str = "run,seq,device_ticks,present,dropped,host_ns,unasked";

    /// One row of a log file, without a line end.
    #[must_use]
    pub fn to_csv(self) -> String {
        let Self { run, seq, device_ticks, present, dropped, unasked, host_ns } = self;
        let (dropped, unasked) = (u8::from(dropped), u8::from(unasked));
        format!("{run},{seq},{device_ticks},{present},{dropped},{host_ns},{unasked}")
    }
}

/// One batch of samples that the device produced, or the poses of a frame. Without samples, it states how many there were.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SentBatch {
    /// Number of the run (of the Start before it), from 1.
    pub run: u64,
    /// Number of the group; [`POSES_GROUP`](super::POSES_GROUP) for poses, each of which is one sample.
    pub group: u8,
    /// Number of the batch, on the wire; a dropped one has the number of the next.
    pub number: u32,
    /// Number of its first sample, on the wire.
    pub first: u64,
    /// The same, counted from the start of the run.
    pub first_in_run: u64,
    /// Samples of each channel.
    pub n: u64,
    /// The device's clock at its first sample, in ticks.
    pub device_ticks: u64,
    /// Whether it never left the device.
    pub dropped: bool,
    /// The caller's clock at its first sample, nanoseconds.
    pub host_ns: u64,
}

impl SentBatch {
    /// The header of a log file of batches.
    pub const CSV_HEADER: &'static str =
        "run,group,number,first,first_in_run,n,device_ticks,dropped,host_ns";

    /// One row of a log file, without a line end.
    #[must_use]
    pub fn to_csv(self) -> String {
        let Self { run, group, number, first, first_in_run, n, device_ticks, dropped, host_ns } =
            self;
        let dropped = u8::from(dropped);
        format!(
            "{run},{group},{number},{first},{first_in_run},{n},{device_ticks},{dropped},{host_ns}"
        )
    }
}

/// What a device sends and a log has a row of.
pub trait Sent: Copy {
    /// Number of its run.
    fn run(&self) -> u64;
    /// Whether it never left the device.
    fn is_dropped(&self) -> bool;
    /// The caller's clock when it was due, nanoseconds.
    fn host_ns(&self) -> u64;
    /// The series in which it has its place: one that comes after a later one of its series is late.
    fn series(&self) -> u8 {
        0
    }
}

impl Sent for SentFrame {
    fn run(&self) -> u64 {
        self.run
    }

    fn is_dropped(&self) -> bool {
        self.dropped
    }

    fn host_ns(&self) -> u64 {
        self.host_ns
    }
}

impl Sent for SentBatch {
    fn run(&self) -> u64 {
        self.run
    }

    fn is_dropped(&self) -> bool {
        self.dropped
    }

    fn host_ns(&self) -> u64 {
        self.host_ns
    }

    fn series(&self) -> u8 {
        self.group
    }
}

/// What became of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// Arrived whole and in order.
    Whole,
    /// Arrived whole, but after a later frame.
    Late,
    /// Arrived whole, after the cable was plugged in again and before a host asked for frames.
    Unasked,
    /// Arrived changed; `faults` tells by what.
    Damaged,
    /// Did not arrive.
    Lost,
    /// Dropped by the device because its queue was full.
    Dropped,
    /// Discarded from the queue by a host's Identify or a loss of power.
    Discarded,
    /// Still queued at the end.
    Waiting,
}

impl Fate {
    /// Its name in log files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Whole => "whole",
            Self::Late => "late",
            Self::Unasked => "unasked",
            Self::Damaged => "damaged",
            Self::Lost => "lost",
            Self::Dropped => "dropped",
            Self::Discarded => "discarded",
            Self::Waiting => "waiting",
        }
    }
}

/// A frame and its fate.
pub type FrameFate = SentFate<SentFrame>;

/// A batch of samples and its fate.
pub type BatchFate = SentFate<SentBatch>;

/// A frame or batch, and its fate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SentFate<T> {
    /// What the device sent; its number is the one on the wire, true or not.
    pub frame: T,
    /// How many consecutive ones this describes, starting with `frame`: 1, except in long series of dropped ones.
    pub frames: u64,
    /// What became of it.
    pub fate: Fate,
    /// How many more whole copies arrived after the first.
    pub again: u32,
    /// The kinds of faults that touched its bytes.
    pub faults: Kinds,
}

impl FrameFate {
    /// The header of a log file.
    pub const CSV_HEADER: &'static str =
        "run,seq,device_ticks,present,dropped,host_ns,unasked,fate,again,faults,frames";

    /// One row of a log file, without a line end.
    #[must_use]
    pub fn to_csv(self) -> String {
        let Self { frame, frames, fate, again, faults } = self;
        format!("{},{},{again},{},{frames}", frame.to_csv(), fate.name(), faults.names())
    }
}

impl BatchFate {
    /// The header of a log file of batches.
    pub const CSV_HEADER: &'static str = "run,group,number,first,first_in_run,n,device_ticks,dropped,host_ns,fate,again,faults,batches";

    /// One row of a log file, without a line end.
    #[must_use]
    pub fn to_csv(self) -> String {
        let Self { frame, frames, fate, again, faults } = self;
        format!("{},{},{again},{},{frames}", frame.to_csv(), fate.name(), faults.names())
    }
}

/// Frames by fate and faults by kind, since the device was made.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FaultTotals {
    /// Frames, indexed by [`Fate`].
    fates: [u64; Fate::Waiting as usize + 1],
    /// Extra copies of whole frames.
    pub again: u64,
    /// Damaged and lost frames that each kind touched, indexed by [`Kind`]. A frame that two kinds touched counts for
    /// both.
    pub by_kind: [u64; KINDS.len()],
    /// Effects of each kind, regardless of the frames' fates.
    pub counts: FaultCounts,
}

impl FaultTotals {
    /// The number of frames with this fate.
    #[must_use]
    pub fn of(&self, fate: Fate) -> u64 {
        self.fates[fate as usize]
    }

    pub(crate) fn add<T>(&mut self, fate: &SentFate<T>) {
        self.fates[fate.fate as usize] += fate.frames;
        for kind in fate.faults.iter().filter(|kind| !kind.is_counted_by_occurrence()) {
            self.counts.add(kind, fate.frames);
        }
        self.again += u64::from(fate.again);
        if matches!(fate.fate, Fate::Damaged | Fate::Lost) {
            for kind in fate.faults.iter() {
                self.by_kind[kind as usize] += 1;
            }
        }
    }

    /// One line of text: frames by fate, and damaged or lost frames and effects by kind.
    #[must_use]
    pub fn summary(&self) -> String {
        let kinds = KINDS.iter().zip(self.by_kind).filter(|(_, n)| *n > 0);
        let kinds: Vec<String> = kinds.map(|(keys, n)| format!("{n} by {}", keys.name)).collect();
        let by = if kinds.is_empty() { String::new() } else { format!(" ({})", kinds.join(", ")) };
        let mut text = format!(
            "faults: {} frames sent whole, {} damaged and {} lost{by}",
            self.of(Fate::Whole),
            self.of(Fate::Damaged),
            self.of(Fate::Lost)
        );
        for (n, what) in [
            (self.of(Fate::Late), "late"),
            (self.again, "duplicated"),
            (self.of(Fate::Unasked), "sent before a host asked"),
            (self.of(Fate::Dropped), "dropped by the full queue"),
            (self.of(Fate::Discarded), "discarded"),
            (self.of(Fate::Waiting), "not sent"),
        ] {
            if n > 0 {
                text.push_str(&format!(", {n} {what}"));
            }
        }
        text + &self.counts.text()
    }
}

/// Effects of each kind of fault: frames that it affected, or occurrences.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct FaultCounts([u64; KINDS.len()]);

impl FaultCounts {
    pub(crate) fn add(&mut self, kind: Kind, n: u64) {
        if let Some(count) = self.0.get_mut(kind as usize) {
            *count += n;
        }
    }

    /// The sums by kind.
    pub(crate) fn merge(mut self, others: Self) -> Self {
        self.0.iter_mut().zip(others.0).for_each(|(count, other)| *count += other);
        self
    }

    /// The count of one kind: frames, or occurrences.
    #[must_use]
    pub fn of(&self, kind: Kind) -> u64 {
        self.0.get(kind as usize).copied().unwrap_or(0)
    }

    /// The end of a summary; empty when no fault had an effect.
    fn text(self) -> String {
        let effects = KINDS.iter().zip(self.0).filter(|(_, n)| *n > 0).map(|(keys, n)| {
            let name = keys.name;
            match (keys.kind.is_counted_by_occurrence(), n) {
                (true, 1) => format!("{name} once"),
                (true, _) => format!("{name} {n} times"),
                (false, 1) => format!("{name} in 1 frame"),
                (false, _) => format!("{name} in {n} frames"),
            }
        });
        let texts: Vec<String> = effects.collect();
        if texts.is_empty() { String::new() } else { format!("; effects: {}", texts.join(", ")) }
    }
}

/// How to serve a system on the network.
#[derive(Default)]
pub struct NetworkOptions {
    /// Return when the motion has ended and what can be delivered was.
    pub once: bool,
    /// Destination of the log: the fate of every frame, one CSV row each.
    pub log: Option<Box<dyn Write + Send>>,
}

impl fmt::Debug for NetworkOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let log = self.log.is_some();
        f.debug_struct("NetworkOptions").field("once", &self.once).field("log", &log).finish()
    }
}

/// The log, if one is kept.
pub(crate) struct FateLog(Option<Box<dyn Write + Send>>);

impl FateLog {
    /// Writes the names of the columns.
    ///
    /// # Errors
    /// The output's.
    pub(crate) fn begin(mut out: Option<Box<dyn Write + Send>>) -> io::Result<Self> {
        out.iter_mut().try_for_each(|out| writeln!(out, "{}", FrameFate::CSV_HEADER))?;
        Ok(Self(out))
    }

    pub(crate) fn is_kept(&self) -> bool {
        self.0.is_some()
    }

    /// Adds the fates of frames.
    ///
    /// # Errors
    /// The output's.
    pub(crate) fn add(&mut self, fates: impl IntoIterator<Item = FrameFate>) -> io::Result<()> {
        let Some(out) = &mut self.0 else { return Ok(()) };
        fates.into_iter().try_for_each(|fate| writeln!(out, "{}", fate.to_csv()))
    }

    /// Writes the rest out.
    ///
    /// # Errors
    /// The output's.
    pub(crate) fn finish(self) -> io::Result<()> {
        self.0.into_iter().try_for_each(|mut out| out.flush())
    }
}
