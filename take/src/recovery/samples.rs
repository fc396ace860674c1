//! The samples of sampled channels that a recovery keeps, and those that it records as lost.

use std::{
    collections::{HashMap, HashSet},
    io::{Read, Seek},
};

use super::OutputChunk;
use crate::{
    TakeError, TakeMap,
    damage::{Problem, push_problem},
    foreign::ForeignPart,
    record::{Event, EventKind, SampledGroup},
    sampled::{GroupSamples, RecoveredSamples, SampleContent, SampleSpan},
    timeline::LossCauses,
};

/// Which chunks of sampled channels a recovery copies.
#[derive(Debug, Default)]
pub(super) struct KeptSamples {
    /// The chunks that are copied by their file offsets, with the records of lost samples before them.
    chunks: HashMap<u64, Vec<OutputChunk>>,
    /// Records of lost samples after the last chunk of a group.
    pub(super) lost_at_end: Vec<OutputChunk>,
    /// The kinds of the foreign parts that lost samples.
    pub(super) kinds: Vec<String>,
    /// Samples whose blocks cannot be decoded.
    pub(super) undecodable: Vec<Problem>,
    /// The chunks of known groups that are not copied, unless they are among `chunks`.
    known: HashSet<u64>,
    /// Whether some groups are of a later version; chunks that belong to no known group are theirs.
    has_later_groups: bool,
}

impl KeptSamples {
    /// Decodes all samples of a take. Those of a part that lacks the description of a channel are not kept: the part
    /// cannot be read.
    pub(super) fn find(take: &TakeMap, input: &mut (impl Read + Seek)) -> Result<Self, TakeError> {
        let is_orphan = |problem: &Problem| matches!(problem, Problem::SamplesOrphaned { .. });
        let mut kept = Self {
            has_later_groups: take.samples_orphaned > 0 && !take.problems.iter().any(is_orphan),
            ..Self::default()
        };
        for part in take.foreign.iter().filter_map(ForeignPart::sampled) {
            for group in part.groups() {
                kept.known.insert(group.offset);
                kept.known.extend(group.chunk_offsets());
            }
            if part.missing_channels().is_some() {
                kept.add_kind(part.kind());
                continue;
            }
            for group in part.groups() {
                let undecodable = group.decode(input, |_, _| Ok(()))?;
                for lost in &undecodable {
                    let problem = Problem::of_samples(part.kind(), lost);
                    push_problem(&mut kept.undecodable, problem);
                }
                kept.add_group(group, group.recovered(&undecodable));
            }
        }
        Ok(kept)
    }

    fn add_kind(&mut self, kind: &str) {
        if !self.kinds.iter().any(|known| known == kind) {
            self.kinds.push(kind.to_owned());
        }
    }

    fn add_group(&mut self, group: &GroupSamples, samples: Vec<RecoveredSamples>) {
        self.chunks.insert(group.offset, Vec::new());
        let mut lost = Vec::new();
        for samples in samples {
            match samples {
                RecoveredSamples::Chunk { offset } => {
                    self.chunks.insert(offset, std::mem::take(&mut lost));
                }
                RecoveredSamples::Lost { first, n } => {
                    self.add_kind(&group.group.kind);
                    lost.push(lost_samples(&group.group, first, n));
                }
            }
        }
        self.lost_at_end.append(&mut lost);
    }

    /// Whether the chunk at this file offset is copied.
    pub(super) fn keeps(&self, offset: u64) -> bool {
        let is_of_later = self.has_later_groups && !self.known.contains(&offset);
        is_of_later || self.chunks.contains_key(&offset)
    }

    /// The records of lost samples before the chunk at this file offset.
    pub(super) fn lost_at(&self, offset: u64) -> Vec<OutputChunk> {
        self.chunks.get(&offset).cloned().unwrap_or_default()
    }
}

fn lost_samples(group: &SampledGroup, first: u64, n: u64) -> OutputChunk {
    let content = SampleContent::Lost(LossCauses::DAMAGED);
    let span = SampleSpan { group: group.number, first, n, content };
    let channel = u64::from(group.first_channel);
    let text = format!(
        "samples {first} to {} of {}, channels {} to {}, were damaged in the file that this take was recovered from",
        span.end() - 1,
        group.kind,
        channel + 1,
        channel + group.channels.len() as u64
    );
    let row = first / u64::from(group.samples_per_frame.max(1));
    OutputChunk::LostSamples { span, event: Event { row, ..Event::new(EventKind::Host, 0, text) } }
}
