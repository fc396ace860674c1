//! The channels and force plates of a recording for plots, as those of imported files: their samples have times of their
//! own.

use mocapd_take::{
    TakeError,
    foreign::{analog::AnalogSamples, force_plates::ForcePlate},
    interchange::{SampledKind, SampledTable},
    motion::MotionInfo,
};

use super::trace::Trace;
use crate::ReportError;

/// A channel that a plot can show.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlotChannel {
    /// Its name.
    pub name: String,
    /// Its unit; may be empty.
    pub unit: String,
}

/// The channels of a take, in order: the analog channels of an imported file, or those of a recording, group by group.
///
/// # Errors
/// Those of reading the take.
pub fn plot_channels(info: &MotionInfo) -> Result<Vec<PlotChannel>, ReportError> {
    if let Some(recording) = &info.recording {
        let channels = recording.groups().iter().flat_map(|found| &found.group.channels);
        let channel = |(name, unit): (&String, &String)| PlotChannel {
            name: name.clone(),
            unit: unit.clone(),
        };
        return Ok(channels.map(|found| channel((&found.name, &found.unit))).collect());
    }
    let samples = AnalogSamples::open(info)?;
    let channels = samples.as_ref().map_or(&[][..], AnalogSamples::channels).iter();
    let channel = |found: &mocapd_take::foreign::analog::AnalogChannel| PlotChannel {
        name: found.name.clone(),
        unit: found.unit.clone(),
    };
    Ok(channels.map(channel).collect())
}

/// The curves of some channels in a part of a take that begins at `start_s`, and their rates.
pub(super) fn channel_traces(
    part: &MotionInfo,
    start_s: f64,
    channels: &[usize],
) -> Result<Vec<(Trace, f64)>, ReportError> {
    if part.recording.is_none() {
        return imported_traces(part, start_s, channels);
    }
    let empty = || (Trace::new(start_s, part.rate_hz, 0), part.rate_hz);
    let mut found: Vec<(Trace, f64)> = channels.iter().map(|_| empty()).collect();
    let mut before = 0;
    let tables = SampledTable::all(part).map_err(TakeError::from)?;
    for mut table in
        tables.into_iter().filter(|table| matches!(table.kind(), SampledKind::Group(_)))
    {
        let width = table.columns().len();
        let (own, rate_hz, n_rows) = (before..before + width, table.rate_hz(), table.n_rows());
        before += width;
        let wanted = channels.iter().enumerate().filter(|(_, channel)| own.contains(channel));
        let wanted: Vec<(usize, usize)> =
            wanted.map(|(at, channel)| (at, channel - own.start)).collect();
        for &(at, _) in &wanted {
            if let Some(place) = found.get_mut(at) {
                *place = (Trace::new(start_s, rate_hz, n_rows), rate_hz);
            }
        }
        if wanted.is_empty() {
            continue;
        }
        while let Some((rows, times)) = table.next_any().map_err(TakeError::from)? {
            for (row, time) in rows.chunks_exact(width.max(1)).zip(times) {
                for &(at, channel) in &wanted {
                    if let (Some((trace, _)), Some(&value)) = (found.get_mut(at), row.get(channel))
                    {
                        trace.push_at(start_s + time.time_s, value.into());
                    }
                }
            }
        }
    }
    found.iter_mut().for_each(|(trace, _)| trace.end());
    Ok(found)
}

fn imported_traces(
    part: &MotionInfo,
    start_s: f64,
    channels: &[usize],
) -> Result<Vec<(Trace, f64)>, ReportError> {
    let Some(mut samples) = AnalogSamples::open(part)? else { return Ok(Vec::new()) };
    let n = part.n_frames.saturating_mul(samples.samples_per_frame() as u64);
    let (n_channels, rate_hz) = (samples.channels().len(), samples.rate_hz());
    let mut traces: Vec<Trace> = channels.iter().map(|_| Trace::new(start_s, rate_hz, n)).collect();
    let mut block = Vec::new();
    while samples.next_block(&mut block).map_err(TakeError::from)? > 0 {
        for row in block.chunks_exact(n_channels.max(1)) {
            for (trace, &channel) in traces.iter_mut().zip(channels) {
                trace.push(row.get(channel).copied().unwrap_or(f64::NAN));
            }
        }
    }
    traces.iter_mut().for_each(Trace::end);
    Ok(traces.into_iter().map(|trace| (trace, rate_hz)).collect())
}

/// A load at a time: force and centre of pressure.
pub(super) type LoadAt = (f64, [f64; 3], [f64; 3]);

/// The force plates of a recording, of all groups, with the rate of each and its number of loads.
pub(super) fn plates(part: &MotionInfo) -> Result<Vec<(ForcePlate, f64, u64)>, ReportError> {
    let mut all = Vec::new();
    for table in SampledTable::all(part).map_err(TakeError::from)? {
        let (rate_hz, n) = (table.rate_hz(), table.n_rows());
        let is_recorded = table.is_recorded() && table.kind().is_of_plates();
        let plates = table.plates().iter().filter(|_| is_recorded);
        all.extend(plates.map(|plate| (plate.clone(), rate_hz, n)));
    }
    Ok(all)
}

/// Calls `each` with the loads of every plate in the order of [`plates`], plate after plate of a sample.
pub(super) fn for_each_load(
    part: &MotionInfo,
    mut each: impl FnMut(usize, LoadAt),
) -> Result<(), ReportError> {
    let mut before = 0;
    for mut table in SampledTable::all(part).map_err(TakeError::from)? {
        if !(table.is_recorded() && table.kind().is_of_plates()) {
            continue;
        }
        let n_plates = table.plates().len();
        while let Some((rows, times)) = table.next_any().map_err(TakeError::from)? {
            let loads = rows.as_chunks::<3>().0.as_chunks::<4>().0;
            for (row, time) in loads.chunks_exact(n_plates.max(1)).zip(times) {
                for (place, [force, _, cop, _]) in row.iter().enumerate() {
                    let vectors = [force, cop].map(|vector| vector.map(f64::from));
                    each(before + place, (time.time_s, vectors[0], vectors[1]));
                }
            }
        }
        before += n_plates;
    }
    Ok(())
}
