//! The sampled channels, force plates and poses of a recording.

use std::ops::Range;

use mocapd_take::{
    TakeMap,
    interchange::recorded_plates,
    record::SampledChannel,
    sampled::{RecordedSamples, Recording, SampleBlock},
};
use pyo3::{
    prelude::*,
    types::{PyDict, PyList},
};

use crate::{
    errors::{Failure, Result},
    foreign::{LOAD_VALUES, values},
    records,
    source::Source,
};

/// Finds the sampled channels of a take; `None` if it has none, as an import.
pub(crate) fn open(source: &Source) -> Result<Option<Recording>> {
    let map = TakeMap::scan(&mut source.reader())?;
    let recording = Recording::open(&map, source.reader())?;
    for recording in recording.iter() {
        // Here, where the interpreter is not held: later calls find it.
        for index in 0..recording.groups().len() {
            recording.numbers(index, &(0..recording.n_rows()))?;
        }
    }
    Ok(recording)
}

/// The times of a group's samples, in seconds from the first frame.
pub(crate) fn times(recording: &Recording, group: usize) -> Result<Vec<f64>> {
    let samples = recording.samples(group, &(0..recording.n_rows()))?;
    Ok(samples.positions().map(|at| recording.time_s(at, 0)).collect())
}

/// Calls `each` with the stored values of every sample of `indices`.
fn for_each(
    recording: &Recording,
    source: &Source,
    (group, indices): (usize, &Range<u64>),
    mut each: impl FnMut(&[SampledChannel], &[f32]),
) -> Result<()> {
    let mut samples: RecordedSamples<'_> = recording.samples_at(group, indices)?;
    let channels = samples.channels();
    let mut block = SampleBlock::default();
    while samples.next_block(&mut block)? {
        source.check()?;
        block.stored.chunks_exact(channels.len().max(1)).for_each(|row| each(channels, row));
    }
    Ok(())
}

/// Fills `out`, which has a row for each of `indices` and a column for each of `wanted`, with the values of channels; NaN
/// for samples that are lost.
pub(crate) fn read(
    recording: &Recording,
    source: &Source,
    place: (usize, &Range<u64>),
    wanted: &[usize],
    out: &mut [f32],
) -> Result<()> {
    let mut rows = out.chunks_exact_mut(wanted.len().max(1));
    for_each(recording, source, place, |channels, stored| {
        let Some(out) = rows.next() else { return };
        for (out, &channel) in out.iter_mut().zip(wanted) {
            let value = channels.get(channel).zip(stored.get(channel));
            *out = value.map_or(f32::NAN, |(channel, &stored)| channel.value(stored) as f32);
        }
    })
}

/// Fills `out`, which has a row for each of `indices` and [`LOAD_VALUES`] columns for each of `wanted`, with the loads of
/// the group's force plates.
pub(crate) fn read_loads(
    recording: &Recording,
    source: &Source,
    place: (usize, &Range<u64>),
    wanted: &[usize],
    out: &mut [f64],
) -> Result<()> {
    let plates = recorded_plates(recording, place.0);
    let mut rows = out.chunks_exact_mut((wanted.len() * LOAD_VALUES).max(1));
    for_each(recording, source, place, |channels, stored| {
        let Some(out) = rows.next() else { return };
        for (out, &plate) in out.as_chunks_mut::<LOAD_VALUES>().0.iter_mut().zip(wanted) {
            let Some(plate) = plates.get(plate) else { continue };
            let value = |&channel: &usize| {
                let found = channels.get(channel).zip(stored.get(channel));
                found.map_or(f64::NAN, |(channel, &stored)| channel.value(stored))
            };
            *out = values(&plate.load(&plate.channels.iter().map(value).collect::<Vec<_>>()));
        }
    })
}

/// Numbers of a pose in an array: position, quaternion and residual.
pub(crate) const POSE_VALUES: usize = 8;

/// Fills `out`, which has [`POSE_VALUES`] numbers for each of `wanted` in each of `rows`, with the poses of these bodies, and
/// `states` with the numbers of their states.
pub(crate) fn read_poses(
    recording: &Recording,
    source: &Source,
    rows: &Range<u64>,
    wanted: &[usize],
    (out, states): (&mut [f32], &mut [u8]),
) -> Result<()> {
    let n_bodies = recording.bodies().len().max(1);
    let mut poses = recording.poses(rows.clone());
    let mut block = Vec::new();
    let mut places = out.as_chunks_mut::<POSE_VALUES>().0.iter_mut().zip(states);
    while poses.next(&mut block)?.is_some() {
        source.check()?;
        for of_row in block.chunks_exact(n_bodies) {
            for pose in wanted.iter().filter_map(|&body| of_row.get(body)) {
                let Some((numbers, state)) = places.next() else { return Ok(()) };
                let ([x, y, z], [qw, qx, qy, qz]) = (pose.position_mm, pose.quaternion);
                *numbers = [x, y, z, qw, qx, qy, qz, pose.residual_mm];
                *state = pose.state.code();
            }
        }
    }
    Ok(())
}

/// The groups, each as a dict, and what is wrong with them.
pub(crate) fn describe<'py>(
    py: Python<'py>,
    recording: Option<&Recording>,
) -> PyResult<(Bound<'py, PyList>, Vec<String>)> {
    let (out, mut warnings) = (PyList::empty(py), Vec::new());
    let Some(recording) = recording else { return Ok((out, warnings)) };
    warnings.extend_from_slice(recording.warnings());
    for (index, found) in recording.groups().iter().enumerate() {
        let group = &found.group;
        let placed = recording.numbers(index, &(0..recording.n_rows())).map_err(Failure::from)?;
        let n_samples: u64 = placed.iter().map(|range| range.end - range.start).sum();
        let without_time = recording.n_without_time(index).map_err(Failure::from)?;
        if without_time > 0 {
            warnings.push(format!(
                "{without_time} samples of group {} are left out: the take does not say when they were taken",
                group.number
            ));
        }
        let channels = PyList::empty(py);
        for channel in &group.channels {
            let dict = PyDict::new(py);
            dict.set_item("name", &channel.name)?;
            dict.set_item("unit", &channel.unit)?;
            dict.set_item("description", "")?;
            dict.set_item("scale", channel.scale)?;
            dict.set_item("offset", channel.offset)?;
            channels.append(dict)?;
        }
        let dict = PyDict::new(py);
        dict.set_item("channels", channels)?;
        dict.set_item("samples_per_frame", 0)?;
        dict.set_item("n_samples", n_samples)?;
        dict.set_item("rate_hz", group.rate_hz)?;
        dict.set_item("number", group.number)?;
        let plates = PyList::empty(py);
        for plate in recorded_plates(recording, index) {
            plates.append(records::force_plate(py, &plate)?)?;
        }
        dict.set_item("plates", plates)?;
        out.append(dict)?;
    }
    Ok((out, warnings))
}
