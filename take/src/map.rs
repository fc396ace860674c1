//! The map of a take: everything but the samples, and the positions from which decoding can start.

mod open;

use std::{
    io::{Read, Seek},
    ops::Range,
};

pub use self::open::TakeTail;

use crate::{
    ChannelOrder, TakeError, TakeEvent,
    chunk::types,
    damage::{LostRows, Problem, push_problem},
    foreign::ForeignPart,
    index::IndexEntry,
    record::{
        Channel, ClockLine, Event, Header, Ledger, RecordedPlate, SampleLedger, Subject, TakeEnding,
    },
    sampled::{GroupSamples, SampledPart, is_recorded},
    statistics::TakeStatistics,
};

/// Maximum number of groups of sampled channels that a reader remembers of a take. A C3D file with as many points and
/// channels as 16 bits can count has 6144.
const GROUPS_MAX: usize = 1 << 13;

/// Maximum number of bytes of the names and units of all these channels. Deflated they take hardly any space, so a file of a
/// few megabytes could state gigabytes. The labels of a C3D file have at most 130 kB, each of which names up to four channels; with
/// suffixes and units of 20 bytes the outputs that 16 bits can count have 6 MB.
const GROUP_TEXT_BYTES_MAX: usize = 1 << 25;

/// Which chunks of sampled channels are of a later version. They are skipped, and nothing is wrong with a take in which
/// what they state is missing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LaterSamples {
    /// `SAMPLED_GROUP`.
    pub groups: bool,
    /// `SAMPLE_TIMES`.
    pub times: bool,
    /// `SAMPLE_LEDGER`.
    pub ledger: bool,
}

impl LaterSamples {
    /// A chunk of this type was skipped.
    pub(crate) fn skip(&mut self, kind: u8) {
        match kind {
            types::SAMPLED_GROUP => self.groups = true,
            types::SAMPLE_TIMES => self.times = true,
            types::SAMPLE_LEDGER => self.ledger = true,
            _ => {}
        }
    }
}

/// Everything in a take but its samples.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TakeMap {
    /// The header.
    pub header: Header,
    /// The complete channel table, in column order: that of the source.
    pub channels: Vec<Channel>,
    /// How the take's own table, which is that of the header, is ordered in the source.
    pub order: ChannelOrder,
    /// Number of rows, including lost ones.
    pub n_rows: u64,
    /// Rows in stretches that were found and have samples; `None` if the stretches were not read. All other rows were
    /// lost or have no marker.
    pub n_sampled_rows: Option<u64>,
    /// Rows of the longest stretch, which is what a decoder buffers of each marker; `None` if the stretches were not
    /// read.
    pub longest_stretch: Option<u64>,
    /// The key stretches, from which decoding can start, in order of rows.
    pub keys: Vec<IndexEntry>,
    /// The captured subject, if stated.
    pub subject: Option<Subject>,
    /// The events, in file order.
    pub events: Vec<Event>,
    /// The last ledger.
    pub ledger: Option<Ledger>,
    /// The last ledger of the samples of sampled channels; only in recordings that have some.
    pub sample_ledger: Option<SampleLedger>,
    /// How the take ended; `None` in takes of earlier versions, in imports, and in takes that were cut off.
    pub ending: Option<TakeEnding>,
    /// The statistics that the take states, in column order; `None` in takes of earlier versions, and in those that were cut off.
    pub statistics: Option<TakeStatistics>,
    /// The last fitted clock line of each segment of the device's clock that has one.
    pub clock_lines: Vec<(u32, ClockLine)>,
    /// The parts that an importer kept, and the sampled channels of a recording; empty if the stretches were not read.
    pub foreign: Vec<ForeignPart>,
    /// Chunks of sampled channels that belong to no group, because the chunk that describes it is damaged or of a later
    /// version.
    pub samples_orphaned: u64,
    /// Bytes of the names and units of all sampled channels.
    pub group_text_bytes: usize,
    /// Which chunks of sampled channels were skipped because of their version; of groups and times only if the stretches
    /// were read.
    pub later_samples: LaterSamples,
    /// Whether the take was closed; a take without a footer was cut off.
    pub finished: bool,
    /// Whether anything damaged or missing was found.
    pub damaged: bool,
    /// Rows lost to damage, in this file or before it was recovered, in the stretches that were read.
    pub damage: Vec<LostRows>,
    /// Everything that is wrong with the take; the cut-off comes last.
    pub problems: Vec<Problem>,
}

impl TakeMap {
    /// The groups of scalar channels of a recording.
    pub fn recorded_groups(&self) -> impl Iterator<Item = &GroupSamples> {
        self.sample_groups().filter(|group| !group.group.has_poses())
    }

    /// The force plates of a recording that can be used, and why others cannot, one sentence each.
    #[must_use]
    pub fn force_plates(&self) -> (Vec<RecordedPlate>, Vec<String>) {
        let (plates, mut warnings) = self.header.force_plates();
        let has_channels = |plate: &RecordedPlate| {
            let group = self.recorded_groups().find(|of| of.group.number == plate.group);
            let n_channels = group.map_or(0, |of| of.group.channels.len());
            plate.channels.iter().all(|&channel| channel < n_channels)
        };
        let (plates, others): (Vec<_>, Vec<_>) = plates.into_iter().partition(has_channels);
        warnings.extend(others.iter().map(|plate| {
            format!("Force plate {} has channels that the take does not have.", plate.number)
        }));
        (plates, warnings)
    }

    /// All groups of sampled channels of a recording: scalar ones, and those of poses.
    pub fn sample_groups(&self) -> impl Iterator<Item = &GroupSamples> {
        let parts = self.foreign.iter().filter(|part| is_recorded(&part.kind));
        parts.filter_map(ForeignPart::sampled).flat_map(SampledPart::groups)
    }

    /// The groups of sampled channels that are the poses of rigid bodies.
    pub fn pose_groups(&self) -> impl Iterator<Item = &GroupSamples> {
        self.sample_groups().filter(|group| group.group.has_poses())
    }

    /// Decodes the samples of all sampled channels, and adds those that cannot be decoded to the problems. `input` is the
    /// file of the take.
    ///
    /// # Errors
    /// `Io`.
    pub fn check_samples(&mut self, input: &mut (impl Read + Seek)) -> Result<(), TakeError> {
        for part in self.foreign.iter().filter_map(ForeignPart::sampled) {
            for lost in part.check(input)? {
                push_problem(&mut self.problems, Problem::of_samples(part.kind(), &lost));
                self.damaged = true;
            }
        }
        Ok(())
    }

    /// The channel table as the take has it, in the order in which its channels are coded.
    #[must_use]
    pub(crate) fn table(&self) -> Vec<Channel> {
        let mut table = self.channels.clone();
        self.order.apply_to_table(&mut table);
        table
    }

    /// Puts the channel table and the statistics, read in the order of the take, into that of the source.
    pub(crate) fn restore_order(&mut self) {
        self.order.restore_table(&mut self.channels);
        if let Some(statistics) = &mut self.statistics {
            self.order.restore_statistics(statistics);
        }
    }

    /// Splits `rows` at key stretches into at most `n` consecutive ranges that can be decoded independently.
    #[must_use]
    pub fn pieces(&self, rows: &Range<u64>, n: usize) -> Vec<Range<u64>> {
        let inside = self.keys.iter().map(|key| key.first_row);
        let keys: Vec<u64> = inside.filter(|row| rows.start < *row && *row < rows.end).collect();
        let n = n.clamp(1, keys.len() + 1);
        let starts = (1..n).map(|i| keys[i * keys.len() / n]);
        let mut pieces = Vec::new();
        let mut at = rows.start;
        for row in starts.chain([rows.end]) {
            if row > at {
                pieces.push(at..row);
                at = row;
            }
        }
        pieces
    }

    /// Adds the content of an event whose chunk is at file offset `offset` and has `chunk_bytes`, except motion and channel
    /// table.
    pub(crate) fn add_content(&mut self, event: TakeEvent<'_>, offset: u64, chunk_bytes: u64) {
        match event {
            TakeEvent::Subject(subject) => self.subject = Some(*subject),
            TakeEvent::Event(event) => self.events.push(event),
            TakeEvent::Ledger(ledger) => self.ledger = Some(*ledger),
            TakeEvent::SampleLedger(ledger) => {
                let parts = self.foreign.iter_mut().filter_map(ForeignPart::sampled_mut);
                parts.for_each(|part| part.state(&ledger));
                self.sample_ledger = Some(*ledger);
            }
            TakeEvent::Clock(clock) => {
                if let Some(line) = clock.line {
                    self.clock_lines.pop_if(|last| last.0 == clock.segment);
                    self.clock_lines.push((clock.segment, line));
                }
            }
            TakeEvent::Foreign(part) => self.foreign.push(part),
            TakeEvent::SampledGroup(group) => {
                self.add_group(GroupSamples::new(*group, offset, chunk_bytes));
            }
            TakeEvent::Samples(chunk) => {
                // Those of an import belong to the last part.
                let mut parts = self.foreign.iter_mut().rev().filter_map(ForeignPart::sampled_mut);
                let is_known = parts.any(|part| part.push(chunk, chunk_bytes));
                self.samples_orphaned += u64::from(!is_known);
            }
            TakeEvent::SampleTimes(times) => {
                let mut parts = self.foreign.iter_mut().rev().filter_map(ForeignPart::sampled_mut);
                let is_known = parts.any(|part| part.push_times(&times, offset, chunk_bytes));
                self.samples_orphaned += u64::from(!is_known);
            }
            TakeEvent::Summary(summary) => {
                if let Some(ledger) = summary.sample_ledger {
                    // The last one again, whose chunk may be damaged.
                    self.add_content(
                        TakeEvent::SampleLedger(Box::new(ledger)),
                        offset,
                        chunk_bytes,
                    );
                }
                (self.ending, self.statistics) = (summary.ending, summary.statistics);
            }
            _ => {}
        }
    }

    fn add_group(&mut self, group: GroupSamples) {
        let texts = group.group.channels.iter().map(|of| of.name.len() + of.unit.len());
        let text_bytes = self.group_text_bytes.saturating_add(texts.sum());
        let mut known =
            self.foreign.iter().filter_map(ForeignPart::sampled).flat_map(SampledPart::groups);
        let is_too_much = known.clone().count() >= GROUPS_MAX || text_bytes > GROUP_TEXT_BYTES_MAX;
        if is_too_much || known.any(|known| known.group.number == group.group.number) {
            self.samples_orphaned += 1;
            return;
        }
        self.group_text_bytes = text_bytes;
        // Groups of one kind follow each other.
        let last = self.foreign.last_mut().and_then(ForeignPart::sampled_mut);
        let group = match last {
            Some(part) => match part.push_group(group) {
                Ok(()) => return,
                Err(group) => group,
            },
            None => group,
        };
        self.foreign.push(SampledPart::new(group).into());
    }
}
