//! The truth about what was sent, for whoever checks a recording against it.

use crate::faults::{KINDS, Kind, Kinds};

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

/// What became of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// It went over the line whole, and in order.
    Whole,
    /// Whole, but after a later one.
    Late,
    /// Whole, after the line was plugged in again and before a host asked for frames.
    Unasked,
    /// Not as it was: the faults that touched it say why.
    Damaged,
    /// Left out altogether.
    Lost,
    /// Dropped by the device's own queue.
    Dropped,
    /// It waited when a host said Identify, or the device lost its power.
    Discarded,
    /// The line did not take it until the end.
    Waiting,
}

impl Fate {
    /// As the log writes it.
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
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameFate {
    /// What the device made of it: its number is the one on the wire, true or not.
    pub frame: SentFrame,
    /// How many in a row this is told of, of which `frame` is the first: 1, but for very many that were dropped.
    pub frames: u64,
    /// What became of it.
    pub fate: Fate,
    /// How often it went whole after the first time.
    pub again: u32,
    /// The faults that touched its bytes.
    pub faults: Kinds,
}

impl FrameFate {
    /// The first line of a log file.
    pub const CSV_HEADER: &'static str =
        "run,seq,device_ticks,present,dropped,host_ns,unasked,fate,again,faults,frames";

    /// One line of a log file, without its end.
    #[must_use]
    pub fn to_csv(self) -> String {
        let Self { frame, frames, fate, again, faults } = self;
        format!("{},{},{again},{},{frames}", frame.to_csv(), fate.name(), faults.names())
    }
}

/// Frames by their fates, since the device was made.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FaultTotals {
    /// By [`Fate`].
    fates: [u64; Fate::Waiting as usize + 1],
    /// Further copies of whole frames.
    pub again: u64,
    /// Of the damaged and lost ones, those that each kind touched, by [`Kind`]. One that two kinds touched is with
    /// both.
    pub by_kind: [u64; KINDS.len()],
    /// What each kind did at all, whatever became of the frames.
    pub parts: Parts,
}

impl FaultTotals {
    /// Frames of one fate.
    #[must_use]
    pub fn of(&self, fate: Fate) -> u64 {
        self.fates[fate as usize]
    }

    pub(crate) fn add(&mut self, fate: &FrameFate) {
        self.fates[fate.fate as usize] += fate.frames;
        for kind in fate.faults.iter().filter(|kind| !kind.is_of_a_moment()) {
            self.parts.add(kind, fate.frames);
        }
        self.again += u64::from(fate.again);
        if matches!(fate.fate, Fate::Damaged | Fate::Lost) {
            for kind in fate.faults.iter() {
                self.by_kind[kind as usize] += 1;
            }
        }
    }

    /// In words: what went whole, and what did not, by kind.
    #[must_use]
    pub fn words(&self) -> String {
        let kinds = KINDS.iter().zip(self.by_kind).filter(|(_, n)| *n > 0);
        let kinds: Vec<String> = kinds.map(|(keys, n)| format!("{n} by {}", keys.name)).collect();
        let by = if kinds.is_empty() { String::new() } else { format!(" ({})", kinds.join(", ")) };
        let mut words = format!(
            "faults: {} frames sent whole, {} damaged and {} lost{by}",
            self.of(Fate::Whole),
            self.of(Fate::Damaged),
            self.of(Fate::Lost)
        );
        for (n, what) in [
            (self.of(Fate::Late), "late"),
            (self.again, "sent again"),
            (self.of(Fate::Unasked), "sent unasked"),
            (self.of(Fate::Dropped), "dropped by the full queue"),
            (self.of(Fate::Discarded), "discarded"),
            (self.of(Fate::Waiting), "never taken"),
        ] {
            if n > 0 {
                words.push_str(&format!(", {n} {what}"));
            }
        }
        words + &self.parts.words()
    }
}

/// For each kind the frames that it changed or hit, or how often it happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Parts([u64; KINDS.len()]);

impl Parts {
    pub(crate) fn add(&mut self, kind: Kind, n: u64) {
        if let Some(part) = self.0.get_mut(kind as usize) {
            *part += n;
        }
    }

    /// These and those.
    pub(crate) fn join(mut self, others: Self) -> Self {
        self.0.iter_mut().zip(others.0).for_each(|(part, other)| *part += other);
        self
    }

    /// Of one kind: frames, or times.
    #[must_use]
    pub fn of(&self, kind: Kind) -> u64 {
        self.0.get(kind as usize).copied().unwrap_or(0)
    }

    /// Behind the fates; empty when nothing happened.
    fn words(self) -> String {
        let told = KINDS.iter().zip(self.0).filter(|(_, n)| *n > 0).map(|(keys, n)| {
            let name = keys.name;
            match (keys.kind.is_of_a_moment(), n) {
                (true, 1) => format!("{name} once"),
                (true, _) => format!("{name} {n} times"),
                (false, 1) => format!("{name} in 1 frame"),
                (false, _) => format!("{name} in {n} frames"),
            }
        });
        let told: Vec<String> = told.collect();
        if told.is_empty() {
            String::new()
        } else {
            format!("; what happened: {}", told.join(", "))
        }
    }
}
