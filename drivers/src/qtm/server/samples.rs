//! Samples of analog devices and force plates on their way into frames: each stream gets those since its last frame.

use super::QtmServer;
use crate::qtm::{
    command::Components,
    frame::SampledComponent,
    sampled::{FORCE_VALUES, SampledComponentKind, SamplesToSend},
    settings::ServedSettings,
};

/// Samples that are kept for streams with few frames, in seconds.
const KEPT_S: f64 = 2.0;

/// The last samples of a device or plate.
#[derive(Debug)]
pub(super) struct SampleHistory {
    is_force: bool,
    id: u32,
    n_channels: usize,
    /// Number of the first sample that is kept.
    first: u64,
    samples: Vec<f32>,
    samples_max: usize,
    /// Where the samples of the present frame begin.
    frame_start: u64,
    missing: Vec<f32>,
}

impl SampleHistory {
    fn new(is_force: bool, id: u32, n_channels: usize, rate_hz: f64) -> Self {
        let n_channels = n_channels.max(1);
        let samples_max = (rate_hz * KEPT_S).max(1.0) as usize * n_channels;
        let missing = vec![f32::NAN; n_channels];
        Self {
            is_force,
            id,
            n_channels,
            first: 0,
            samples: Vec::new(),
            samples_max,
            frame_start: 0,
            missing,
        }
    }

    /// Those of all devices of a system.
    pub(super) fn of(settings: &ServedSettings) -> Vec<Self> {
        let analog = settings
            .analog
            .iter()
            .map(|device| Self::new(false, device.id, device.channels.len(), device.rate_hz));
        let plates = settings.plates.iter();
        let plates = plates.map(|plate| Self::new(true, plate.id, FORCE_VALUES, plate.rate_hz));
        analog.chain(plates).collect()
    }

    /// Number of the next sample.
    fn end(&self) -> u64 {
        self.first + (self.samples.len() / self.n_channels) as u64
    }

    fn add(&mut self, first: u64, samples: &[f32]) {
        if first != self.end() {
            self.samples.clear();
            self.first = first;
        }
        self.samples.extend_from_slice(samples);
        // Amortised: what is removed is as long as what stays.
        if self.samples.len() > 2 * self.samples_max {
            let excess = self.samples.len() - self.samples_max;
            let n = excess.div_ceil(self.n_channels);
            self.samples.drain(..n * self.n_channels);
            self.first += n as u64;
        }
    }

    /// The samples from this number on, in one component.
    fn since(&self, number: u64, kind: SampledComponentKind) -> SamplesToSend<'_> {
        let number = number.clamp(self.first, self.end());
        let at = (number - self.first) as usize * self.n_channels;
        let mut samples = self.samples.get(at..).unwrap_or_default();
        if kind.is_single() {
            let last = samples.len().saturating_sub(self.n_channels);
            samples = samples.get(last..).filter(|s| !s.is_empty()).unwrap_or(&self.missing);
        }
        SamplesToSend { id: self.id, n_channels: self.n_channels, first: number as u32, samples }
    }
}

impl QtmServer {
    /// Adds samples of an analog device, or of a force plate, one after another, which the next frame has. `first` counts
    /// those that the device took.
    pub fn add_samples(&mut self, is_force: bool, id: u32, first: u64, samples: &[f32]) {
        let history = self.histories.iter_mut();
        if let Some(history) = history.into_iter().find(|h| (h.is_force, h.id) == (is_force, id)) {
            history.add(first, samples);
        }
    }

    /// The next frame has the samples that are added from now on.
    pub(super) fn end_frame(&mut self) {
        for history in &mut self.histories {
            history.frame_start = history.end();
        }
    }

    /// Where a stream that starts now gets its samples from.
    pub(super) fn sample_starts(&self) -> Vec<u64> {
        self.histories.iter().map(|history| history.frame_start).collect()
    }

    /// Where a stream that got the present frame gets its samples from next.
    pub(super) fn sample_ends_now(&self) -> Vec<u64> {
        self.histories.iter().map(SampleHistory::end).collect()
    }

    /// The components of samples that a client wants, from these numbers on, or else those of the present frame.
    pub(super) fn sampled_components(
        &self,
        wanted: Components,
        from: Option<&[u64]>,
    ) -> Vec<SampledComponent<'_>> {
        let of_kind = |kind: SampledComponentKind| {
            let histories = self.histories.iter().enumerate();
            let histories = histories.filter(|(_, history)| history.is_force == kind.is_force());
            let devices = histories.map(|(index, history)| {
                let from = from.and_then(|from| from.get(index).copied());
                history.since(from.unwrap_or(history.frame_start), kind)
            });
            // Qualisys's clients disagree on whether a device without samples has a sample number.
            let devices = devices.filter(|device| !device.samples.is_empty());
            SampledComponent { kind, devices: devices.collect() }
        };
        let components = wanted.samples().map(of_kind);
        components.filter(|component| !component.devices.is_empty()).collect()
    }
}
