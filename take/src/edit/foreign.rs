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

/// What a part of a take, with the frame numbers `frames`, has of a foreign part; `None` if that is unknown. `input` is
/// the file of the take.
pub(super) fn cut(
    part: &ForeignPart,
    input: &mut (impl Read + Seek),
    frames: &Range<u64>,
    context: &EditContext<'_>,
) -> Result<Option<Foreign>, TakeError> {
    let Some(relation) = relation_of(&part.kind) else { return Ok(None) };
    let whole = read(part, input, &mut Spool::new(context.new_scratch))?;
    Ok(match relation {
        FrameRelation::None | FrameRelation::Numbered => Some(whole),
        FrameRelation::Samples => sample_parts::cut(&whole, frames, &mut store(context))?,
    })
}

/// Reads a part of a take in which nothing is damaged.
fn read(
    part: &ForeignPart,
    input: &mut (impl Read + Seek),
    spool: &mut Spool<impl Fn() -> io::Result<Arc<dyn ScratchFile>>>,
) -> Result<Foreign, TakeError> {
    let (whole, undecodable) = part.read(input, spool)?;
    match undecodable.first() {
        Some(lost) => Err(damaged(&Problem::of_samples(&part.kind, lost))),
        None => Ok(whole),
    }
}

/// Holds the contents of new parts.
fn store<'a>(context: &EditContext<'a>) -> PartStore<'a> {
    PartStore::new(true, context.new_scratch)
}

/// The foreign parts of joined takes, and the kinds that cannot be joined.
#[derive(Debug, Default)]
pub(super) struct JoinedParts {
    pub(super) parts: Vec<Foreign>,
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
    for part in sources.iter().flat_map(|source| &source.map().foreign) {
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
) -> Result<Option<Foreign>, TakeError> {
    let mut spool = Spool::new(context.new_scratch);
    let mut parts = Vec::new();
    for (i, part) in found.iter().enumerate() {
        parts.push(read(part, &mut open(i)?, &mut spool)?);
    }
    let are_equal = parts.array_windows().all(|[a, b]| a == b);
    let first = parts.first().cloned().filter(|_| are_equal);
    Ok(match relation_of(found.first().map_or("", |part| part.kind.as_str())) {
        Some(FrameRelation::None) => first,
        Some(FrameRelation::Numbered) => first.filter(|_| frames_continue),
        Some(FrameRelation::Samples) => {
            let frames = sources.iter().map(|source| source.map().n_rows);
            sample_parts::join(&parts.iter().zip(frames).collect::<Vec<_>>(), &mut store(context))?
        }
        None => None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A new kind needs a decision.
    #[test]
    fn every_documented_kind_has_a_relation_to_frames() {
        let document = include_str!("../../../docs/foreign.md");
        let (_, table) = document.split_once("| kind | content | restored |").unwrap();
        let rows = table.lines().skip(2).map_while(|line| line.strip_prefix("| `"));
        let kinds: Vec<&str> = rows.filter_map(|row| row.split('`').next()).collect();
        assert_eq!(kinds, KINDS.map(|(kind, _)| kind));
    }
}
