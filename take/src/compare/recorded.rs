//! Compares the sampled channels of two recordings.

use std::io::{Read, Seek};

use super::content::FieldDifference;
use crate::{TakeError, TakeMap, sampled::GroupSamples};

/// Compares the groups of sampled channels of two recordings: descriptions, samples bit for bit, lost samples, and times
/// to within a tick. Each difference has the number of a group.
///
/// # Errors
/// `Io`.
pub fn compare_recorded(
    (one, a): (&TakeMap, &mut (impl Read + Seek)),
    (other, b): (&TakeMap, &mut (impl Read + Seek)),
) -> Result<Vec<FieldDifference>, TakeError> {
    let numbers = |map: &TakeMap| map.recorded_groups().map(|g| g.group.number).collect::<Vec<_>>();
    let mut all = [numbers(one), numbers(other)].concat();
    all.sort_unstable();
    all.dedup();
    let mut differences = Vec::new();
    for number in all {
        let of = |map: &TakeMap| map.recorded_groups().find(|g| g.group.number == number).cloned();
        let (left, right) = (of(one), of(other));
        let text = |group: &Option<GroupSamples>| group.as_ref().map(describe);
        let mut found = (text(&left), text(&right));
        if let (Some(left), Some(right)) = (&left, &right)
            && let Some(what) = difference((left, one, &mut *a), (right, other, &mut *b))?
        {
            found.1 = found.1.map(|text| format!("{text}, {what}"));
        }
        if found.0 != found.1 {
            let field = format!("sampled channels of group {number}");
            differences.push(FieldDifference { field, a: found.0, b: found.1 });
        }
    }
    Ok(differences)
}

/// A group in a few words, which are equal for equal descriptions.
fn describe(group: &GroupSamples) -> String {
    let info = &group.group;
    let channels = info.channels.iter().map(|channel| {
        format!("{} ({}, {}, {})", channel.name, channel.unit, channel.scale, channel.offset)
    });
    let channels: Vec<String> = channels.collect();
    format!(
        "{} samples at {} Hz, {}: {}",
        group.n_samples(),
        info.rate_hz,
        info.form.name(),
        channels.join(", ")
    )
}

type Side<'a, R> = (&'a GroupSamples, &'a TakeMap, &'a mut R);

/// How the samples or times of two groups differ.
fn difference<A: Read + Seek, B: Read + Seek>(
    (left, one, a): Side<'_, A>,
    (right, other, b): Side<'_, B>,
) -> Result<Option<String>, TakeError> {
    if left.lost() != right.lost() {
        return Ok(Some("others of them lost".to_owned()));
    }
    if left.n_samples() != right.n_samples()
        || left.group.channels.len() != right.group.channels.len()
    {
        return Ok(None);
    }
    // Blocks may be divided otherwise, so one side is held: those samples that are there, which both have alike.
    let n_channels = left.group.channels.len();
    let mut columns: Vec<Vec<u32>> = vec![Vec::new(); n_channels];
    let undecodable = left.read(a, |_, n, decoded| {
        let found = decoded.into_iter().flat_map(|samples| samples.chunks_exact(n as usize));
        for (column, samples) in columns.iter_mut().zip(found) {
            column.extend(samples.iter().map(|sample| sample.to_bits()));
        }
        Ok(())
    })?;
    let (mut at, mut n_differing) = (0, 0_u64);
    let undecodable_too = right.read(b, |_, n, decoded| {
        let Some(samples) = decoded else { return Ok(()) };
        for (column, samples) in columns.iter().zip(samples.chunks_exact(n as usize)) {
            let theirs = column.get(at..).unwrap_or_default();
            let differing = theirs.iter().zip(samples).filter(|(a, b)| **a != b.to_bits());
            n_differing += differing.count() as u64;
        }
        at += n as usize;
        Ok(())
    })?;
    if undecodable != undecodable_too {
        return Ok(Some("others of them damaged".to_owned()));
    }
    if n_differing > 0 {
        return Ok(Some(format!("{n_differing} of them different")));
    }
    Ok(times_differ((left, one), (right, other)).then(|| "at other times".to_owned()))
}

/// Whether the times of any sample differ by more than a tick: those of all stated ones are compared, and of the ends.
fn times_differ(
    (left, one): (&GroupSamples, &TakeMap),
    (right, other): (&GroupSamples, &TakeMap),
) -> bool {
    let tick_hz = |map: &TakeMap| map.header.device.as_ref().map_or(1, |device| device.tick_hz);
    let (a, b) = (left.clock(tick_hz(one)), right.clock(tick_hz(other)));
    let stated = left.anchors().iter().chain(right.anchors()).map(|anchor| anchor.number);
    let ends = [0, left.n_samples().saturating_sub(1)];
    let mut numbers = stated.chain(ends).filter(|number| *number < left.n_samples());
    numbers.any(|number| match (a.at(number), b.at(number)) {
        (Some(a), Some(b)) => {
            let ticks = a.device_ticks.wrapping_sub(b.device_ticks).cast_signed() as f64;
            (ticks + a.fraction - b.fraction).abs() > 1.0
        }
        (a, b) => a.is_some() != b.is_some(),
    })
}
