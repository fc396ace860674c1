//! What became of every frame on a damaged line: the truth that recordings are held against.
//!
//! A frame is whole when the bytes between two 0x00 on the line are its own, whatever happened around it.

use std::collections::VecDeque;
use std::hash::{DefaultHasher, Hash, Hasher};

use mocapd_drivers::link::WIRE_BYTES_MAX;

use super::kinds::{KINDS, Kind, Kinds};
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
        "run,seq,device_ticks,present,dropped,host_ns,fate,again,faults";

    /// One line of a log file, without its end.
    #[must_use]
    pub fn to_csv(self) -> String {
        let Self { frame, fate, again, faults } = self;
        format!("{},{},{again},{}", frame.to_csv(), fate.name(), faults.names())
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
        };
        let name = cell()?;
        let fate = *FATES.iter().find(|fate| fate.name() == name)?;
        let again = cell()?.parse().ok()?;
        let mut faults = Kinds::default();
        for name in cell()?.split('+').filter(|name| !name.is_empty()) {
            faults.add(Kinds::of(KINDS.iter().find(|keys| keys.name == name)?.kind));
        }
        Some(Self { frame, fate, again, faults })
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
    /// Of the damaged and lost ones, those that each kind touched, by [`Kind`]. One that two kinds touched is with
    /// both.
    pub by_kind: [u64; KINDS.len()],
}

impl FaultTotals {
    fn add(&mut self, fate: &FrameFate) {
        *match fate.fate {
            Fate::Whole => &mut self.whole,
            Fate::Late => &mut self.late,
            Fate::Unasked => &mut self.unasked,
            Fate::Damaged => &mut self.damaged,
            Fate::Lost => &mut self.lost,
            Fate::Dropped => &mut self.dropped,
            Fate::Discarded => &mut self.discarded,
            Fate::Waiting => &mut self.waiting,
        } += 1;
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
        words
    }
}

#[derive(Debug)]
struct Entry {
    frame: SentFrame,
    fate: Option<Fate>,
    again: u32,
    faults: Kinds,
    /// Of what is between its 0x00 and the one before.
    content: u64,
    /// Up to which byte of the line its fate is open; `u64::MAX` before it was put there.
    open_until: u64,
}

/// Frames whose fate is open, and the bytes since the last 0x00.
#[derive(Debug, Default)]
pub(super) struct Account {
    entries: VecDeque<Entry>,
    /// The number of the first entry.
    first: u64,
    /// The number of the next frame that the device hands over.
    next: u64,
    /// The last one that went whole.
    last_whole: Option<u64>,
    segment: Vec<u8>,
    put_bytes: u64,
    taken_bytes: u64,
    /// What was taken up to the last 0x00: no more bytes join what stands before it.
    decided_bytes: u64,
    unasked: bool,
    closed: Vec<FrameFate>,
    keeps_frames: bool,
    totals: FaultTotals,
}

impl Account {
    pub(super) fn keep_frames(&mut self) {
        self.keeps_frames = true;
    }

    pub(super) fn take_frames(&mut self) -> Vec<FrameFate> {
        std::mem::take(&mut self.closed)
    }

    pub(super) fn totals(&self) -> FaultTotals {
        self.totals.clone()
    }

    /// The device made a frame.
    pub(super) fn produced(&mut self, frame: SentFrame) {
        let fate = frame.dropped.then_some(Fate::Dropped);
        let open_until = if frame.dropped { 0 } else { u64::MAX };
        let (again, faults, content) = (0, Kinds::default(), 0);
        self.entries.push_back(Entry { frame, fate, again, faults, content, open_until });
    }

    /// The device hands over the next frame that it did not drop: its number here, and itself.
    pub(super) fn handed_over(&mut self, message: &[u8]) -> Option<(u64, SentFrame)> {
        loop {
            let number = self.next;
            let entry = self.entry(number)?;
            let frame = entry.frame;
            let dropped = entry.fate.is_some();
            entry.content = hash(message.strip_suffix(&[0]).unwrap_or(message));
            self.next += 1;
            if !dropped {
                return Some((number, frame));
            }
        }
    }

    /// So many frames waited in the device, and will not leave it.
    pub(super) fn discarded(&mut self, n: u64) {
        for _ in 0..n {
            if let Some((number, _)) = self.handed_over(&[])
                && let Some(entry) = self.entry(number)
            {
                (entry.fate, entry.open_until) = (Some(Fate::Discarded), 0);
            }
        }
        self.close_decided();
    }

    /// A fault touched a frame.
    pub(super) fn touch(&mut self, number: u64, faults: Kinds) {
        if let Some(entry) = self.entry(number) {
            entry.faults.add(faults);
        }
    }

    /// A frame is left out.
    pub(super) fn lost(&mut self, number: u64, kind: Kind) {
        if let Some(entry) = self.entry(number) {
            (entry.fate, entry.open_until) = (Some(Fate::Lost), 0);
            entry.faults.add(Kinds::of(kind));
        }
    }

    /// So many bytes go to the line, for this frame where it is one.
    pub(super) fn put(&mut self, bytes: usize, number: Option<u64>) {
        self.put_bytes += bytes as u64;
        let until = self.put_bytes;
        if let Some(entry) = number.and_then(|number| self.entry(number)) {
            entry.open_until = until;
        }
    }

    /// The line took these.
    pub(super) fn taken(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.taken_bytes += 1;
            if byte != 0 {
                // What is longer than a message is none.
                if self.segment.len() <= WIRE_BYTES_MAX {
                    self.segment.push(byte);
                }
                continue;
            }
            self.decided_bytes = self.taken_bytes;
            if !self.segment.is_empty() {
                let content = hash(&self.segment);
                self.segment.clear();
                self.arrived(content);
            }
        }
        self.close_decided();
    }

    fn arrived(&mut self, content: u64) {
        let handed_over = self.next.saturating_sub(self.first) as usize;
        let mut entries = (self.first..).zip(self.entries.iter_mut().take(handed_over));
        let Some((number, entry)) = entries.find(|(_, entry)| {
            entry.content == content
                && !matches!(entry.fate, Some(Fate::Dropped | Fate::Discarded | Fate::Lost))
        }) else {
            return;
        };
        if entry.fate.is_some() {
            entry.again += 1;
            return;
        }
        let late = self.last_whole.is_some_and(|last| last > number);
        entry.fate = Some(match (self.unasked, late) {
            (true, _) => Fate::Unasked,
            (_, true) => Fate::Late,
            _ => Fate::Whole,
        });
        self.last_whole = self.last_whole.max(Some(number));
    }

    /// What is on its way to the line does not get there: it is pulled out, or the device is dead.
    pub(super) fn cut(&mut self, kind: Kind) {
        for entry in self.entries.iter_mut().take(self.next.saturating_sub(self.first) as usize) {
            if entry.fate.is_none() {
                entry.faults.add(Kinds::of(kind));
                entry.open_until = 0;
            }
        }
        self.segment.clear();
        self.put_bytes = self.taken_bytes;
        self.decided_bytes = self.taken_bytes;
        self.close_decided();
    }

    /// Frames that arrive from now on were asked for by nobody, or were again.
    pub(super) fn set_unasked(&mut self, unasked: bool) {
        self.unasked = unasked;
    }

    /// Nothing goes over the line any more.
    pub(super) fn close(&mut self) {
        for entry in &mut self.entries {
            if entry.open_until > self.taken_bytes {
                entry.fate = entry.fate.or(Some(Fate::Waiting));
            }
            entry.open_until = 0;
        }
        self.close_decided();
    }

    fn entry(&mut self, number: u64) -> Option<&mut Entry> {
        self.entries.get_mut(usize::try_from(number.checked_sub(self.first)?).ok()?)
    }

    fn close_decided(&mut self) {
        while let Some(entry) = self.entries.front().filter(|e| e.open_until <= self.decided_bytes)
        {
            let Entry { frame, fate, again, faults, .. } = *entry;
            let fate = FrameFate { frame, fate: fate.unwrap_or(Fate::Damaged), again, faults };
            self.totals.add(&fate);
            if self.keeps_frames {
                self.closed.push(fate);
            }
            self.entries.pop_front();
            self.first += 1;
            self.next = self.next.max(self.first);
        }
    }
}

fn hash(bytes: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    bytes.hash(&mut hasher);
    hasher.finish()
}
