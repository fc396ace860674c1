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
    record::{Event, EventKind, GroupLedger, SampleLedger, SampledGroup},
    sampled::{
        GroupSamples, RECORDED, RecoveredSamples, SampleContent, SampleSpan, is_recorded, part_name,
    },
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
    /// The ledger of the samples that are kept, of a recording.
    pub(super) ledger: Option<SampleLedger>,
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
        let mut kept = Self { has_later_groups: take.later_samples.groups, ..Self::default() };
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
                let recovered = group.recovered(&undecodable);
                if is_recorded(&group.group.kind) {
                    let ledger = kept.ledger.get_or_insert_default();
                    ledger.groups.push(group_ledger(take, group, &recovered));
                }
                kept.add_group(take, group, recovered);
            }
        }
        kept.close_ledger(take.sample_ledger.as_ref());
        if take.later_samples.ledger && take.finished && kept.kinds.is_empty() {
            // The ledger of a later version is copied, and states more than a new one could.
            kept.ledger = None;
        }
        Ok(kept)
    }

    /// Completes the ledger with what only the last one of the file states: batches that were refused, and groups whose
    /// description is lost, and with it all their samples. Those of later versions keep their samples and their counts.
    fn close_ledger(&mut self, stated: Option<&SampleLedger>) {
        if stated.is_none() && self.ledger.is_none() {
            return;
        }
        let ledger = self.ledger.get_or_insert_default();
        ledger.finished = true;
        if let Some(stated) = stated {
            ledger.batches_refused = stated.batches_refused;
            let is_kept =
                |group: &GroupLedger| ledger.groups.iter().any(|g| g.group == group.group);
            let lost: Vec<&GroupLedger> =
                stated.groups.iter().filter(|group| !is_kept(group)).collect();
            for group in lost {
                if self.has_later_groups {
                    ledger.groups.push(*group);
                    continue;
                }
                ledger.groups.push(group.without_samples());
                if !self.kinds.iter().any(|known| known == part_name(RECORDED)) {
                    self.kinds.push(part_name(RECORDED).to_owned());
                }
            }
        }
        ledger.groups.sort_by_key(|group| group.group);
    }

    fn add_kind(&mut self, kind: &str) {
        if !self.kinds.iter().any(|known| known == kind) {
            self.kinds.push(kind.to_owned());
        }
    }

    fn add_group(&mut self, take: &TakeMap, group: &GroupSamples, samples: Vec<RecoveredSamples>) {
        let of_group = std::iter::once(group.offset).chain(group.times_offsets());
        self.chunks.extend(of_group.map(|offset| (offset, Vec::new())));
        let mut lost = Vec::new();
        for samples in samples {
            match samples {
                RecoveredSamples::Chunk { offset } => {
                    self.chunks.insert(offset, std::mem::take(&mut lost));
                }
                RecoveredSamples::Lost { first, n } => {
                    self.add_kind(part_name(&group.group.kind));
                    lost.push(lost_samples(take, &group.group, first, n));
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

/// The ledger of a group whose chunks are kept: the counts of the samples that it has, and those that no chunk shows.
fn group_ledger(
    take: &TakeMap,
    group: &GroupSamples,
    recovered: &[RecoveredSamples],
) -> GroupLedger {
    let number = group.group.number;
    let stated = take.sample_ledger.iter().flat_map(|ledger| &ledger.groups);
    let stated = stated.copied().find(|stated| stated.group == number).unwrap_or_default();
    let kept: HashSet<u64> = recovered
        .iter()
        .filter_map(|samples| match samples {
            RecoveredSamples::Chunk { offset } => Some(*offset),
            RecoveredSamples::Lost { .. } => None,
        })
        .collect();
    let mut ledger = group.ledger(|offset| kept.contains(&offset));
    let damaged = recovered.iter().map(|samples| match samples {
        RecoveredSamples::Lost { n, .. } => *n,
        RecoveredSamples::Chunk { .. } => 0,
    });
    ledger.lost_other = damaged.fold(ledger.lost_other, u64::saturating_add);
    ledger.taken = ledger.stored.saturating_add(ledger.lost());
    GroupLedger { duplicates: stated.duplicates, jumps: stated.jumps, ..ledger }
}

fn lost_samples(take: &TakeMap, group: &SampledGroup, first: u64, n: u64) -> OutputChunk {
    let content = SampleContent::Lost(LossCauses::DAMAGED);
    let span = SampleSpan { group: group.number, first, n, content };
    let channel = u64::from(group.first_channel);
    let text = format!(
        "samples {first} to {} of {}, channels {} to {}, were damaged in the file that this take was recovered from",
        span.end() - 1,
        part_name(&group.kind),
        channel + 1,
        channel + group.channels.len() as u64
    );
    let row = match group.samples_per_frame {
        // By the rates, which is as near as an event needs to be.
        0 => (first as f64 * take.header.rate_hz / group.rate_hz) as u64,
        ratio => first / u64::from(ratio),
    };
    let row = row.min(take.n_rows.saturating_sub(1));
    OutputChunk::LostSamples { span, event: Event { row, ..Event::new(EventKind::Host, 0, text) } }
}
