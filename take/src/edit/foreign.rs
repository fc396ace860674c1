//! The foreign parts of edited takes: docs/foreign.md lists them.

use std::{
    io::{self, Read, Seek},
    ops::Range,
    sync::Arc,
};

use super::{EditContext, SourceTake, damaged};
use crate::{
    TakeError,
    damage::Problem,
    foreign::{
        Foreign, ForeignPart,
        content::{PartStore, ScratchFile, Spool},
    },
    interchange::c3d::sample_parts,
    sampled::{LostSamples, SampledPart, is_recorded},
};

/// How the content of a part relates to frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FrameRelation {
    /// It describes the whole file.
    None,
    /// It gives the numbers of the frames that it belongs to, so that the part of a take finds its own.
    Numbered,
    /// It holds samples of every frame.
    Samples,
}

/// The kinds that importers keep. How others relate to frames is unknown.
const KINDS: [(&str, FrameRelation); 8] = [
    ("c3d/parameters", FrameRelation::None),
    ("c3d/analog", FrameRelation::Samples),
    ("c3d/residuals", FrameRelation::Samples),
    ("c3d/model-outputs", FrameRelation::Samples),
    ("c3d/gap-coordinates", FrameRelation::Numbered),
    ("trc/header", FrameRelation::None),
    ("tsv/header", FrameRelation::None),
    ("csv/header", FrameRelation::None),
];

fn relation_of(kind: &str) -> Option<FrameRelation> {
    KINDS.iter().find(|(known, _)| *known == kind).map(|(_, relation)| *relation)
}

/// A foreign part of an edited take, and the samples of it that are lost.
#[derive(Debug)]
pub(super) struct EditedPart {
    pub(super) part: Foreign,
    pub(super) lost: Vec<LostSamples>,
}

/// Cuts a foreign part to the frame numbers `frames`; `None` if its relation to frames is unknown. `input` is the file
/// of the take.
pub(super) fn cut(
    part: &ForeignPart,
    input: &mut (impl Read + Seek),
    frames: &Range<u64>,
    context: &EditContext<'_>,
) -> Result<Option<EditedPart>, TakeError> {
    let Some(relation) = relation_of(&part.kind) else { return Ok(None) };
    let whole = read(part, input, &mut Spool::new(context.new_scratch))?;
    if relation != FrameRelation::Samples {
        return Ok(Some(whole));
    }
    let found = sample_parts::cut(&whole.part, frames, &mut store(context))?;
    Ok(found.map(|(part, samples)| {
        let of_range = |lost: LostSamples| {
            let first = lost.first.max(samples.start);
            let n = lost.first.saturating_add(lost.n).min(samples.end).checked_sub(first)?;
            (n > 0).then(|| LostSamples { first: first - samples.start, n, ..lost })
        };
        EditedPart { part, lost: whole.lost.into_iter().filter_map(of_range).collect() }
    }))
}

/// Reads a part whole, to write it again.
pub(super) fn read_whole(
    part: &ForeignPart,
    input: &mut (impl Read + Seek),
    context: &EditContext<'_>,
) -> Result<EditedPart, TakeError> {
    if relation_of(&part.kind).is_none() {
        return Err(TakeError::InvalidArgument(format!(
            "it has the part `{}`, which this version cannot keep: use a newer mocapd",
            part.kind
        )));
    }
    read(part, input, &mut Spool::new(context.new_scratch))
}

/// Reads a foreign part; damage is an error.
fn read(
    part: &ForeignPart,
    input: &mut (impl Read + Seek),
    spool: &mut Spool<impl Fn() -> io::Result<Arc<dyn ScratchFile>>>,
) -> Result<EditedPart, TakeError> {
    let (whole, lost, undecodable) = part.read_for_edit(input, spool)?;
    match undecodable.first() {
        Some(found) => Err(damaged(&Problem::of_samples(&part.kind, found))),
        None => Ok(EditedPart { part: whole, lost }),
    }
}

/// Holds the contents of new parts.
fn store<'a>(context: &EditContext<'a>) -> PartStore<'a> {
    PartStore::new(true, context.new_scratch)
}

/// The foreign parts of joined takes, and the kinds that cannot be joined.
#[derive(Debug, Default)]
pub(super) struct JoinedParts {
    pub(super) parts: Vec<EditedPart>,
    pub(super) left_out: Vec<String>,
}

/// Joins the foreign parts of takes, kind by kind. `frames_continue`: every take begins with the frame number after the
/// last of the one before.
pub(super) fn join<R: Read + Seek>(
    sources: &[SourceTake],
    open: &mut impl FnMut(usize) -> io::Result<R>,
    frames_continue: bool,
    context: &EditContext<'_>,
) -> Result<JoinedParts, TakeError> {
    let mut kinds: Vec<&str> = Vec::new();
    let parts = sources.iter().flat_map(|source| &source.map().foreign);
    for part in parts.filter(|part| !is_recorded(&part.kind)) {
        if !kinds.contains(&part.kind.as_str()) {
            kinds.push(&part.kind);
        }
    }
    let mut joined = JoinedParts::default();
    // Samples mean nothing without the parameters that they were stored with.
    let mut parameters_differ = false;
    for kind in kinds {
        let found: Option<Vec<_>> = sources.iter().map(|source| part_of(source, kind)).collect();
        let part = match found.filter(|_| !parameters_differ) {
            Some(found) => join_kind(sources, open, &found, frames_continue, context)?,
            None => None,
        };
        if part.is_none() {
            joined.left_out.push(kind.to_owned());
            parameters_differ |= relation_of(kind) == Some(FrameRelation::None);
        }
        joined.parts.extend(part);
    }
    Ok(joined)
}

/// The only part of a kind.
fn part_of<'a>(source: &'a SourceTake, kind: &str) -> Option<&'a ForeignPart> {
    let mut parts = source.map().foreign.iter().filter(|part| part.kind == kind);
    parts.next().filter(|_| parts.next().is_none())
}

/// Joins the parts of one kind, one of each take; `None` if they cannot be.
fn join_kind<R: Read + Seek>(
    sources: &[SourceTake],
    open: &mut impl FnMut(usize) -> io::Result<R>,
    found: &[&ForeignPart],
    frames_continue: bool,
    context: &EditContext<'_>,
) -> Result<Option<EditedPart>, TakeError> {
    let mut spool = Spool::new(context.new_scratch);
    let mut read_parts = Vec::new();
    for (i, part) in found.iter().enumerate() {
        read_parts.push(read(part, &mut open(i)?, &mut spool)?);
    }
    let parts: Vec<&Foreign> = read_parts.iter().map(|read| &read.part).collect();
    let relation = relation_of(found.first().map_or("", |part| part.kind.as_str()));
    if relation == Some(FrameRelation::Samples) {
        let frames = sources.iter().map(|source| source.map().n_rows);
        let sized: Vec<_> = parts.iter().copied().zip(frames.clone()).collect();
        let joined = sample_parts::join(&sized, &mut store(context))?;
        let (mut lost, mut before) = (Vec::new(), 0_u64);
        // Parts of different ratios are not joined.
        let ratio = found.iter().find_map(|part| part.sampled());
        let ratio = ratio.map_or(1, SampledPart::samples_per_frame);
        for (read, n_frames) in read_parts.iter().zip(frames) {
            lost.extend(
                read.lost
                    .iter()
                    .map(|lost| LostSamples { first: lost.first.saturating_add(before), ..*lost }),
            );
            before = before.saturating_add(n_frames.saturating_mul(ratio));
        }
        return Ok(joined.map(|part| EditedPart { part, lost }));
    }
    let are_equal = parts.array_windows().all(|[a, b]| a == b);
    let is_joined = match relation {
        Some(FrameRelation::Numbered) => frames_continue,
        relation => relation.is_some(),
    };
    Ok(read_parts.into_iter().next().filter(|_| are_equal && is_joined))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails for a new kind until [`KINDS`] has its relation.
    #[test]
    fn every_documented_kind_has_a_relation_to_frames() {
        let document = include_str!("../../../docs/foreign.md");
        let (_, table) = document.split_once("| kind | content | restored |").unwrap();
        let rows = table.lines().skip(2).map_while(|line| line.strip_prefix("| `"));
        let kinds: Vec<&str> = rows.filter_map(|row| row.split('`').next()).collect();
        assert_eq!(kinds, KINDS.map(|(kind, _)| kind));
    }
}
