//! Compares a repacked take with the old one.

use std::io::{Read, Seek};

use super::{REPACK, RepackSettings};
use crate::{
    TakeError, TakeFrames,
    compare::{ContentDifference, compare_recorded, compare_times},
    damage::Problem,
    edit::{EditContext, SourceTake},
    motion::{FrameSource, GAP, Position, is_gap},
    sampled::SampledPart,
};

/// What other settings change of the header, and of its settings.
const ENCODING_FIELDS: [&str; 5] = ["take_id", "resampler", "tolerance_mm", "effort", REPACK];

/// Compares a take with the one that it was repacked from: every sample, gap, lost row, time, event and part, the header
/// with the channel table, the subject, the observations of the clocks, the last ledger, and the stated errors. Returns
/// the first difference. `source` is what was read of the old take. With `settings`, those fields may differ that say how
/// it is encoded; with a lossy resampler, samples may differ within its tolerance.
///
/// # Errors
/// Those of [`TakeFrames::open_with`], and `Io`.
pub fn check_repacked(
    source: &SourceTake,
    mut old: impl Read + Seek,
    mut new: impl Read + Seek,
    settings: Option<&RepackSettings>,
    context: &EditContext<'_>,
) -> Result<Option<String>, TakeError> {
    let found = SourceTake::scan(&mut new)?;
    if let Some(problem) = found.map.problems.first() {
        return Ok(Some(problem.to_string()));
    }
    if let Some(why) = content_difference(source, &found, settings) {
        return Ok(Some(why));
    }
    if let Some(why) = frames_difference((&mut old, &mut new), settings, context)? {
        return Ok(Some(why));
    }
    let recorded = compare_recorded((source.map(), &mut old), (found.map(), &mut new))?;
    if let Some(difference) = recorded.first() {
        return Ok(Some(format!("the {} differ", difference.field)));
    }
    // A joined take may have other runs of samples, and other segments of the clock; a repacked one has the same.
    let pairs = source.map().sample_groups().zip(found.map().sample_groups());
    if pairs.into_iter().any(|(a, b)| a.anchors() != b.anchors()) {
        return Ok(Some("the times of sampled channels differ".to_owned()));
    }
    // Times are compared where both takes have them.
    if source.has_time_lines != found.has_time_lines {
        return Ok(Some("the times differ".to_owned()));
    }
    if !source.has_time_lines {
        return Ok(None);
    }
    let times = compare_times((old, source.map()), (new, found.map()))?;
    Ok((!times.is_none()).then(|| "the times differ".to_owned()))
}

/// The first difference of what two takes state besides their samples and times.
fn content_difference(
    one: &SourceTake,
    other: &SourceTake,
    settings: Option<&RepackSettings>,
) -> Option<String> {
    let is_encoded_anew = settings.is_some() && one.why_stretches_stay().is_none();
    let may_differ = |field: &str| match field {
        "keys" => settings.is_some_and(|settings| settings.keys.is_some()),
        "codec_version" | "stretch_rows" => is_encoded_anew,
        _ => settings.is_some() && ENCODING_FIELDS.contains(&field),
    };
    let (map, other_map) = (one.map(), other.map());
    let content = ContentDifference::between((map, &[]), (other_map, &[]));
    let fields = [&content.header, &content.settings, &content.subject, &content.ledger];
    if let Some(found) = fields.into_iter().flatten().find(|found| !may_differ(&found.field)) {
        return Some(format!("`{}` differs", found.field));
    }
    let parts = |take: &SourceTake| -> Vec<_> {
        let parts = take.map().foreign.iter();
        parts
            .map(|part| {
                let lost = part.sampled().map(SampledPart::lost);
                (part.kind.clone(), part.bounds(), lost)
            })
            .collect()
    };
    let differing = [
        ("an event", !content.events.is_empty()),
        ("the channel table", map.channels != other_map.channels),
        ("a lost frame", (map.n_rows, &map.damage) != (other_map.n_rows, &other_map.damage)),
        ("an observation of the clocks", one.clocks != other.clocks),
        ("the bound or the lost samples of a part", parts(one) != parts(other)),
    ];
    let (what, _) = differing.into_iter().find(|(_, differs)| *differs)?;
    Some(format!("{what} differs"))
}

/// The first difference of the samples of two takes, and of their parts.
fn frames_difference(
    (old, new): (&mut (impl Read + Seek), &mut (impl Read + Seek)),
    settings: Option<&RepackSettings>,
    context: &EditContext<'_>,
) -> Result<Option<String>, TakeError> {
    let mut one = TakeFrames::open_with(old, |_| true, context.new_scratch)?;
    let mut other = TakeFrames::open_with(new, |_| true, context.new_scratch)?;
    if one.info().foreign != other.info().foreign {
        return Ok(Some("a part of the imported file differs".to_owned()));
    }
    let lossy = settings.filter(|settings| !settings.codec.kind.is_lossless());
    let tolerance_mm = lossy.map(|settings| settings.codec.tolerance.mm());
    if let Some(why) = rows_difference(&mut one, &mut other, tolerance_mm)? {
        return Ok(Some(why));
    }
    // The old take may state lost samples, and the new one must state the same.
    let is_stated = |problem: &&Problem| matches!(problem, Problem::SamplesLost { .. });
    if let Some(problem) = one.problems().iter().find(|problem| !is_stated(problem)) {
        return Err(TakeError::InvalidArgument(format!("the take cannot be compared: {problem}")));
    }
    let mut added = other.problems().iter().filter(|problem| !one.problems().contains(problem));
    Ok(added.next().map(ToString::to_string))
}

/// The first difference between the samples of two takes, and what they state of them; or, with a tolerance, the first
/// sample that is further away.
fn rows_difference(
    one: &mut dyn FrameSource,
    other: &mut dyn FrameSource,
    tolerance_mm: Option<f64>,
) -> Result<Option<String>, TakeError> {
    let n_markers = one.info().markers.len();
    let (mut a, mut b) = (vec![GAP; n_markers], vec![GAP; n_markers]);
    for row in 0_u64.. {
        let more = [one.next_frame(&mut a)?, other.next_frame(&mut b)?];
        if more == [false; 2] {
            break;
        }
        let is_equal = |column: usize, (a, b): (&Position, &Position)| match tolerance_mm {
            _ if is_gap(*a) || is_gap(*b) => is_gap(*a) && is_gap(*b),
            None => {
                a.map(f32::to_bits) == b.map(f32::to_bits)
                    && one.stated_error_mm(column) == other.stated_error_mm(column)
            }
            Some(tolerance_mm) => {
                let apart = (0..3).map(|axis| f64::from(a[axis]) - f64::from(b[axis]));
                apart.map(|apart| apart * apart).sum::<f64>().sqrt() <= tolerance_mm
            }
        };
        let rows = a.iter().zip(&b).enumerate();
        let differing = rows.into_iter().find(|&(column, pair)| !is_equal(column, pair));
        if more[0] != more[1] || differing.is_some() {
            return Ok(Some(format!("frame {row} (from 0) differs")));
        }
    }
    Ok(None)
}
