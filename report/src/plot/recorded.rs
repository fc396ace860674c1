//! The channels and force plates of a recording for plots, as those of imported files: their samples have times of their
//! own. A signal of any length is a curve of a bounded number of points.

use std::ops::Range;

use mocapd_take::{
    TakeError,
    foreign::{analog::AnalogSamples, force_plates::ForcePlate},
    interchange::{SampledKind, SampledTable},
    motion::MotionInfo,
};

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

/// Points on a curve for a signal of more samples: two for every pixel of the widest panel.
const STEPS: u64 = 1200;

/// Time between two samples, in periods, from which on the curve has a gap.
const PERIODS_APART: f64 = 3.0;

/// A signal that is read sample by sample. If it has more than [`STEPS`] samples, the smallest and the largest of each
/// step are kept, so that no peak is lost.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Trace {
    start_s: f64,
    rate_hz: f64,
    samples_per_step: u64,
    n_read: u64,
    /// Time of the last sample.
    last_s: f64,
    /// The smallest and the largest sample of the current step.
    extremes: Option<[(f64, f64); 2]>,
    /// The curve between missing samples: times in seconds and values.
    runs: Vec<Vec<(f64, f64)>>,
    is_open: bool,
}

impl Trace {
    /// A signal of `n_samples` samples; the first is at `start_s`.
    pub(super) fn new(start_s: f64, rate_hz: f64, n_samples: u64) -> Self {
        let samples_per_step = n_samples.div_ceil(STEPS).max(1);
        let rate_hz = rate_hz.max(f64::MIN_POSITIVE);
        Self { start_s, rate_hz, samples_per_step, ..Self::default() }
    }

    /// Adds the next sample, a period after the one before; one that is not finite is missing.
    pub(super) fn push(&mut self, value: f64) {
        self.push_at(self.start_s + self.n_read as f64 / self.rate_hz, value);
    }

    /// Adds the next sample at its own time.
    pub(super) fn push_at(&mut self, time_s: f64, value: f64) {
        let at = (time_s, value);
        if self.n_read == 0 {
            self.start_s = time_s;
        } else if time_s - self.last_s > PERIODS_APART / self.rate_hz {
            self.end_step();
            self.is_open = false;
        }
        self.last_s = time_s;
        self.n_read += 1;
        if value.is_finite() {
            let [low, high] = self.extremes.get_or_insert([at; 2]);
            if value < low.1 {
                *low = at;
            }
            if value > high.1 {
                *high = at;
            }
        } else {
            self.end_step();
            self.is_open = false;
        }
        if self.n_read.is_multiple_of(self.samples_per_step) {
            self.end_step();
        }
    }

    fn end_step(&mut self) {
        let Some([low, high]) = self.extremes.take() else { return };
        if !self.is_open {
            self.runs.push(Vec::new());
            self.is_open = true;
        }
        let Some(run) = self.runs.last_mut() else { return };
        let (first, last) = if low.0 <= high.0 { (low, high) } else { (high, low) };
        run.push(first);
        run.extend((last != first).then_some(last));
    }

    /// Ends the signal.
    pub(super) fn end(&mut self) {
        self.end_step();
    }

    /// The curve between missing samples.
    pub(super) fn runs(&self) -> impl Iterator<Item = Vec<(f64, f64)>> + '_ {
        self.runs.iter().cloned()
    }

    /// The values on the curve.
    pub(super) fn values(&self) -> impl Iterator<Item = f64> + '_ {
        self.runs.iter().flatten().map(|&(_, value)| value)
    }

    /// From the first sample to the last, in seconds.
    pub(super) fn span_s(&self) -> Range<f64> {
        let is_span = self.n_read > 1 && self.last_s > self.start_s;
        self.start_s..if is_span { self.last_s } else { self.start_s + 1.0 / self.rate_hz }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trace(values: impl ExactSizeIterator<Item = f64>) -> Trace {
        let mut trace = Trace::new(2.0, 10.0, values.len() as u64);
        values.for_each(|value| trace.push(value));
        trace.end();
        trace
    }

    #[test]
    fn short_signals_keep_every_sample_and_break_where_one_is_missing() {
        let found = trace([1.0, 3.0, f64::NAN, -2.0].into_iter());
        let runs: Vec<_> = found.runs().collect();
        assert_eq!(runs, [vec![(2.0, 1.0), (2.1, 3.0)], vec![(2.3, -2.0)]]);
        assert_eq!(found.span_s(), 2.0..2.3);
    }

    #[test]
    fn long_signals_keep_their_peaks_in_bounded_memory() {
        let n = 1_000_003;
        let peaks = [123_456, 777_777];
        let value = |i: usize| match peaks.iter().position(|&peak| peak == i) {
            Some(0) => 50.0,
            Some(_) => -50.0,
            None => (i % 7) as f64 / 7.0,
        };
        let found = trace((0..n).map(value));
        let points: Vec<_> = found.runs().flatten().collect();
        assert!(points.len() as u64 <= 2 * STEPS + 2, "{}", points.len());
        assert!(points.is_sorted_by(|a, b| a.0 < b.0));
        for (peak, value) in [(peaks[0], 50.0), (peaks[1], -50.0)] {
            assert!(points.contains(&(2.0 + peak as f64 / 10.0, value)), "{value}");
        }
    }
}
