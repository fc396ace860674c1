//! What can become of a frame, and how a log says it.

use super::keys::KINDS;
use super::kinds::Kinds;
use super::parts::Parts;
use crate::device::SentFrame;

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

/// Every fate.
const FATES: &[Fate] = &[
    Fate::Whole,
    Fate::Late,
    Fate::Unasked,
    Fate::Damaged,
    Fate::Lost,
    Fate::Dropped,
    Fate::Discarded,
    Fate::Waiting,
];

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

    /// Reads such a line; `None` for another.
    #[must_use]
    pub fn from_csv(line: &str) -> Option<Self> {
        let mut cells = line.split(',');
        let mut cell = || cells.next();
        let frame = SentFrame {
            run: cell()?.parse().ok()?,
            seq: cell()?.parse().ok()?,
            device_ticks: cell()?.parse().ok()?,
            present: cell()?.parse().ok()?,
            dropped: cell()? == "1",
            host_ns: cell()?.parse().ok()?,
            unasked: cell()? == "1",
        };
        let name = cell()?;
        let fate = *FATES.iter().find(|fate| fate.name() == name)?;
        let again = cell()?.parse().ok()?;
        let mut faults = Kinds::default();
        for name in cell()?.split('+').filter(|name| !name.is_empty()) {
            faults.add(Kinds::of(KINDS.iter().find(|keys| keys.name == name)?.kind));
        }
        let frames = cell()?.parse().ok()?;
        Some(Self { frame, frames, fate, again, faults })
    }
}

/// Frames by their fates, since the device was made.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FaultTotals {
    /// Whole and in order.
    pub whole: u64,
    /// Whole and late.
    pub late: u64,
    /// Whole, and nobody had asked for them.
    pub unasked: u64,
    /// Further copies of whole frames.
    pub again: u64,
    /// Damaged.
    pub damaged: u64,
    /// Lost.
    pub lost: u64,
    /// Dropped by the device's own queue.
    pub dropped: u64,
    /// Discarded.
    pub discarded: u64,
    /// Never taken.
    pub waiting: u64,
    /// Of the damaged and lost ones, those that each kind touched, by [`Kind`](super::Kind). One that two kinds touched is with
    /// both.
    pub by_kind: [u64; KINDS.len()],
    /// What each kind did at all, whatever became of the frames.
    pub parts: Parts,
}

impl FaultTotals {
    pub(super) fn add(&mut self, fate: &FrameFate) {
        *match fate.fate {
            Fate::Whole => &mut self.whole,
            Fate::Late => &mut self.late,
            Fate::Unasked => &mut self.unasked,
            Fate::Damaged => &mut self.damaged,
            Fate::Lost => &mut self.lost,
            Fate::Dropped => &mut self.dropped,
            Fate::Discarded => &mut self.discarded,
            Fate::Waiting => &mut self.waiting,
        } += fate.frames;
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
            self.whole, self.damaged, self.lost
        );
        for (n, what) in [
            (self.late, "late"),
            (self.again, "sent again"),
            (self.unasked, "sent unasked"),
            (self.dropped, "dropped by the full queue"),
            (self.discarded, "discarded"),
            (self.waiting, "never taken"),
        ] {
            if n > 0 {
                words.push_str(&format!(", {n} {what}"));
            }
        }
        words + &self.parts.words()
    }
}
