//! Sampled channels of a simulated device: force plates under the generated jumps, and a stream like that of electrodes.
//!
//! Every sample is a function of its number in the run, so the ground truth of a recording can be computed again.

use std::f64::consts::TAU;
use std::fmt;
use std::ops::Range;
use std::str::FromStr;
use std::sync::Arc;

use mocapd_drivers::device::{
    ForcePlateInfo, PlateOutput, SampleForm, SampledChannelInfo, SampledGroupInfo,
};
use mocapd_drivers::link::{SAMPLE_VALUES_MAX, SAMPLED_CHANNELS_MAX};
use mocapd_take::quantity::rate_hz;

use crate::generator::{ForcePlates, PLATE_COMPONENTS, Rng, plate_corners_mm};

/// Newtons, and newton metres, of a count. An unloaded plate has exactly 0.
const NEWTONS_PER_COUNT: f64 = 0.25;
const NEWTON_METRES_PER_COUNT: f64 = 0.05;

/// Volts of a count of the electrodes: 10 V over 65 536 counts, and a gain of 1000.
const VOLTS_PER_COUNT: f64 = 1.525_878_906_25e-7;

/// A stream like that of electrodes, as written on a command line: `16@2kHz`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Electrodes {
    /// Number of channels.
    pub n_channels: usize,
    /// Samples of a channel in a second.
    pub rate_hz: f64,
}

impl FromStr for Electrodes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('@');
        let parsed = parts.and_then(|(n, rate)| Some((n.parse().ok()?, rate_hz(rate).ok()?)));
        let electrodes = parsed.map(|(n_channels, rate_hz)| Self { n_channels, rate_hz });
        electrodes.ok_or_else(|| {
            format!("'{text}' is not a number of channels and a rate: give one such as 16@2kHz")
        })
    }
}

impl fmt::Display for Electrodes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}Hz", self.n_channels, self.rate_hz)
    }
}

/// How much device time a batch covers.
pub(crate) const BATCH_MS: u64 = 10;

/// Where the samples come from.
#[derive(Debug, Clone)]
enum Signal {
    /// Two plates of six components each.
    Plates(Arc<ForcePlates>),
    /// Noise of a bandwidth like that of muscles, in bursts.
    Electrodes { seed: u64 },
    /// Those of a take.
    Recorded(Arc<RecordedSamples>),
}

/// The samples of a group of a take, from the first that is played on.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct RecordedSamples {
    /// Where samples follow each other: the numbers, and the place of the first in `values`. In ascending order.
    runs: Vec<(Range<u64>, usize)>,
    /// The samples of all runs one after another; of each, all channels in order.
    values: Vec<f32>,
    /// One past the last sample, stored or lost.
    end: u64,
}

impl RecordedSamples {
    /// Adds samples behind those that it has: `rows` of the channels' columns, of which the first is number `first`.
    pub(crate) fn add(&mut self, first: u64, rows: Range<usize>, columns: &[&[f32]]) {
        let end = first + rows.len() as u64;
        match self.runs.last_mut() {
            Some((run, _)) if run.end == first => run.end = end,
            _ => self.runs.push((first..end, self.values.len())),
        }
        for row in rows {
            self.values.extend(columns.iter().filter_map(|column| column.get(row)));
        }
        self.end = self.end.max(end);
    }

    /// Samples up to this number were taken, though the last ones may be lost.
    pub(crate) fn end_at(&mut self, end: u64) {
        self.end = self.end.max(end);
    }
}

/// A group of sampled channels and its samples.
#[derive(Debug, Clone)]
pub struct SampledSource {
    info: SampledGroupInfo,
    /// Those whose channels it has.
    plates: Vec<ForcePlateInfo>,
    signal: Signal,
}

impl PartialEq for SampledSource {
    fn eq(&self, other: &Self) -> bool {
        self.info == other.info
    }
}

/// Why a group cannot be made.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{n_channels} sampled channels at {rate_hz} Hz: expected 1 to 64 channels at 1 to 100000 Hz, and at most 4000000 samples a second"
)]
pub struct SampledError {
    n_channels: usize,
    rate_hz: String,
}

impl SampledSource {
    /// Two force plates: Fx, Fy, Fz in newtons and Mx, My, Mz in newton metres of each, as counts of 16 bits.
    ///
    /// # Errors
    /// When the rate is out of range.
    pub fn plates(id: u8, plates: Arc<ForcePlates>, rate_hz: f64) -> Result<Self, SampledError> {
        let channel = |plate: usize, name: &str| {
            let is_force = name.starts_with('F');
            SampledChannelInfo {
                name: format!("{name}{plate}"),
                unit: if is_force { "N" } else { "Nm" }.to_owned(),
                scale: if is_force { NEWTONS_PER_COUNT } else { NEWTON_METRES_PER_COUNT },
                offset: 0.0,
            }
        };
        let of_plate = |plate: usize| PLATE_COMPONENTS.map(|name| channel(plate, name));
        let channels = [1, 2].into_iter().flat_map(of_plate).collect();
        let source = Self::new(id, channels, rate_hz, Signal::Plates(plates))?;
        let plate = |(first, corners_mm)| ForcePlateInfo {
            number: first / 6 + 1,
            output: PlateOutput::ForceAndMoment,
            group: id,
            channels: (first..first + 6).collect(),
            corners_mm,
            // The moments are those about the centre of the surface.
            origin_mm: [0.0; 3],
        };
        let plates = [0, 6].into_iter().zip(plate_corners_mm()).map(plate).collect();
        Ok(Self { plates, ..source })
    }

    /// Electrodes, as counts of 16 bits.
    ///
    /// # Errors
    /// When a number is out of range.
    pub fn electrodes(
        id: u8,
        Electrodes { n_channels, rate_hz }: Electrodes,
        seed: u64,
    ) -> Result<Self, SampledError> {
        let channel = |i: usize| SampledChannelInfo {
            name: format!("EMG{}", i + 1),
            unit: "V".to_owned(),
            scale: VOLTS_PER_COUNT,
            offset: 0.0,
        };
        let channels = (0..n_channels.min(SAMPLED_CHANNELS_MAX + 1)).map(channel).collect();
        Self::new(id, channels, rate_hz, Signal::Electrodes { seed })
    }

    /// Samples of a take, in the form and with the description of its group.
    ///
    /// # Errors
    /// When a number is out of range.
    pub fn recorded(
        info: SampledGroupInfo,
        plates: Vec<ForcePlateInfo>,
        samples: RecordedSamples,
    ) -> Result<Self, SampledError> {
        let rate_hz = f64::from(info.rate_millihertz) / 1000.0;
        let signal = Signal::Recorded(Arc::new(samples));
        let source = Self::new(info.id, info.channels.clone(), rate_hz, signal)?;
        Ok(Self { info, plates, ..source })
    }

    /// The same without its force plates: its channels only.
    #[must_use]
    pub fn without_plates(self) -> Self {
        Self { plates: Vec::new(), ..self }
    }

    /// Whether samples are missing in it.
    #[must_use]
    pub fn has_losses(&self) -> bool {
        match &self.signal {
            Signal::Recorded(samples) => {
                let stored: u64 = samples.runs.iter().map(|(run, _)| run.end - run.start).sum();
                stored != samples.end
            }
            Signal::Plates(_) | Signal::Electrodes { .. } => false,
        }
    }

    /// Samples of the run from number `first` on, at most `n`: those that are left.
    pub(crate) fn n_left(&self, first: u64, n: u64) -> u64 {
        match &self.signal {
            Signal::Recorded(samples) => samples.end.saturating_sub(first).min(n),
            Signal::Plates(_) | Signal::Electrodes { .. } => n,
        }
    }

    /// `n` samples from number `first` on as parts one after another: how many samples each has, and whether they are there.
    pub(crate) fn parts(&self, first: u64, n: u64) -> Vec<(u64, bool)> {
        let Signal::Recorded(samples) = &self.signal else { return vec![(n, true)] };
        let (mut parts, mut at, end) = (Vec::new(), first, first + n);
        let from = samples.runs.partition_point(|(run, _)| run.end <= first);
        for (run, _) in samples.runs.get(from..).unwrap_or_default() {
            if run.start >= end {
                break;
            }
            if run.start > at {
                parts.push((run.start - at, false));
                at = run.start;
            }
            let stop = run.end.min(end);
            parts.push((stop - at, true));
            at = stop;
        }
        if at < end {
            parts.push((end - at, false));
        }
        parts
    }

    fn new(
        id: u8,
        channels: Vec<SampledChannelInfo>,
        rate_hz: f64,
        signal: Signal,
    ) -> Result<Self, SampledError> {
        let n_channels = channels.len();
        let is_possible = (1..=SAMPLED_CHANNELS_MAX).contains(&n_channels)
            && (1.0..=100_000.0).contains(&rate_hz)
            && rate_hz * n_channels as f64 <= 4e6;
        if !is_possible {
            return Err(SampledError { n_channels, rate_hz: rate_hz.to_string() });
        }
        let rate_millihertz = (rate_hz * 1000.0).round() as u32;
        let info = SampledGroupInfo { id, form: SampleForm::Int16, rate_millihertz, channels };
        Ok(Self { info, plates: Vec::new(), signal })
    }

    /// The description that the device announces.
    #[must_use]
    pub fn info(&self) -> &SampledGroupInfo {
        &self.info
    }

    /// The force plates whose channels the group has.
    #[must_use]
    pub fn force_plates(&self) -> &[ForcePlateInfo] {
        &self.plates
    }

    /// Samples of a batch, at most.
    pub(crate) fn batch_samples(&self) -> u64 {
        let n = u64::from(self.info.rate_millihertz) * BATCH_MS / 1_000_000;
        n.clamp(1, (SAMPLE_VALUES_MAX / self.info.channels.len().max(1)) as u64)
    }

    /// Appends `n` samples of all channels, one after another, from number `first` of the run. Those that a take does not have
    /// are left out.
    pub fn samples(&self, first: u64, n: u64, out: &mut Vec<f32>) {
        let rate_hz = f64::from(self.info.rate_millihertz) / 1000.0;
        if let Signal::Recorded(samples) = &self.signal {
            let n_channels = self.info.channels.len();
            let from = samples.runs.partition_point(|(run, _)| run.end <= first);
            for (run, place) in samples.runs.get(from..).unwrap_or_default() {
                let (start, end) = (run.start.max(first), run.end.min(first + n));
                if start >= end {
                    break;
                }
                let at = place + (start - run.start) as usize * n_channels;
                let values = samples.values.get(at..at + (end - start) as usize * n_channels);
                out.extend_from_slice(values.unwrap_or_default());
            }
            return;
        }
        for number in first..first + n {
            match &self.signal {
                Signal::Plates(plates) => {
                    let felt = plates.at(number as f64 / rate_hz);
                    let counts = self.info.channels.iter().zip(felt.as_flattened());
                    out.extend(counts.map(|(channel, value)| count(value / channel.scale)));
                }
                Signal::Recorded(_) => {}
                Signal::Electrodes { seed } => {
                    let channels = 0..self.info.channels.len() as u64;
                    out.extend(channels.map(|channel| electrode(*seed, channel, number, rate_hz)));
                }
            }
        }
    }
}

/// The nearest count of 16 bits; a converter is clipped at its ends. Never -0, which no count is.
fn count(value: f64) -> f32 {
    f32::from(value.round().clamp(-32_768.0, 32_767.0) as i16)
}

/// A sample of an electrode: noise, smoothed over two samples and differenced over four, whose size rises and falls with
/// a period of about a second.
fn electrode(seed: u64, channel: u64, number: u64, rate_hz: f64) -> f32 {
    let noise = |back: u64| {
        let at = number.wrapping_sub(back).wrapping_add(1 << 20);
        let bits = Rng::stream(seed ^ channel.wrapping_mul(0x9e37_79b9), at).next_u64();
        (bits >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    };
    // A triangle from 0 to 1: sines differ between C libraries in the last bit.
    let turns = number as f64 / rate_hz * (0.8 + 0.05 * channel as f64) + channel as f64 / TAU;
    let burst = 1.0 - (2.0 * (turns - turns.floor()) - 1.0).abs();
    let size = 30.0 + 2500.0 * burst * burst * burst;
    count(size * (noise(0) + 0.7 * noise(1) - 0.7 * noise(3) - noise(4)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::JumpSpec;

    #[test]
    fn samples_do_not_depend_on_how_they_are_divided() {
        let plates = Arc::new(ForcePlates::new(&JumpSpec::new(1, 100.0)).unwrap());
        for source in [
            SampledSource::plates(0, plates, 1000.0).unwrap(),
            SampledSource::electrodes(1, "5@2kHz".parse().unwrap(), 7).unwrap(),
        ] {
            let (mut whole, mut pieces) = (Vec::new(), Vec::new());
            source.samples(0, 500, &mut whole);
            for first in (0..500).step_by(20) {
                source.samples(first, 20, &mut pieces);
            }
            assert_eq!(whole, pieces);
            assert_eq!(whole.len(), 500 * source.info().channels.len());
            assert!(whole.iter().all(|&sample| SampleForm::Int16.has(sample)));
            assert!(whole.iter().any(|&sample| sample != 0.0));
        }
    }

    #[test]
    fn samples_of_a_take_have_parts_that_are_lost() {
        let info = SampledGroupInfo {
            id: 3,
            form: SampleForm::Float32,
            rate_millihertz: 1_000_000,
            channels: vec![SampledChannelInfo::default(); 2],
        };
        let mut samples = RecordedSamples::default();
        let columns: [&[f32]; 2] = [&[0.0, 1.0, 2.0, 3.0], &[0.5, 1.5, 2.5, 3.5]];
        samples.add(0, 0..2, &columns);
        samples.add(2, 2..3, &columns);
        samples.add(5, 3..4, &columns);
        samples.end_at(8);
        let source = SampledSource::recorded(info, Vec::new(), samples).unwrap();
        assert!(source.has_losses() && source.force_plates().is_empty());
        assert_eq!(source.parts(0, 8), [(3, true), (2, false), (1, true), (2, false)]);
        assert_eq!(source.parts(1, 3), [(2, true), (1, false)]);
        assert_eq!(source.parts(6, 2), [(2, false)]);
        assert_eq!((source.n_left(0, 5), source.n_left(6, 5), source.n_left(9, 5)), (5, 2, 0));
        let mut found = Vec::new();
        source.samples(1, 6, &mut found);
        assert_eq!(found, [1.0, 1.5, 2.0, 2.5, 3.0, 3.5]);
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        for (n_channels, rate_hz) in [(0, 1000.0), (65, 1000.0), (1, 0.5), (64, 99_000.0)] {
            let error =
                SampledSource::electrodes(0, Electrodes { n_channels, rate_hz }, 1).unwrap_err();
            assert!(error.to_string().contains("expected"), "{error}");
        }
    }
}
