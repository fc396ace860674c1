//! Samples of analog devices and force plates on their way into frames: each stream gets those since its last frame.
//!
//! Places count the samples that a server was given, from 0 on; their numbers may jump and begin again.

use super::QtmServer;
use crate::qtm::{
    command::Components,
    frame::{COMPONENT_BYTES, DEVICE_BYTES, SampledComponent},
    sampled::{FORCE_VALUES, SampledComponentKind, SamplesToSend},
    settings::ServedSettings,
};

/// Samples that are kept for streams with few frames, in seconds.
const KEPT_S: f64 = 2.0;

/// Values that are kept of all devices together: twice as many, a quarter of what may wait for a client, are there at
/// most.
const KEPT_VALUES_MAX: usize = 1 << 17;

/// The last samples of a device or plate.
#[derive(Debug)]
pub(super) struct SampleHistory {
    is_force: bool,
    id: u32,
    n_channels: usize,
    rate_hz: f64,
    /// Number and place of the first sample that is kept.
    first: u64,
    place: u64,
    samples: Vec<f32>,
    samples_max: usize,
    /// Place at which the samples of the present frame begin.
    frame_start: u64,
    missing: Vec<f32>,
}

impl SampleHistory {
    fn new(
        (is_force, id, n_channels): (bool, u32, usize),
        rate_hz: f64,
        values_max: usize,
    ) -> Self {
        let n_channels = n_channels.max(1);
        let samples = ((rate_hz * KEPT_S) as usize).min(values_max / n_channels).max(1);
        Self {
            is_force,
            id,
            n_channels,
            rate_hz,
            first: 0,
            place: 0,
            samples: Vec::new(),
            samples_max: samples * n_channels,
            frame_start: 0,
            missing: vec![f32::NAN; n_channels],
        }
    }

    /// Those of all devices of a system.
    pub(super) fn of(settings: &ServedSettings) -> Vec<Self> {
        let n_devices = settings.analog.len() + settings.plates.len();
        let values_max = KEPT_VALUES_MAX / n_devices.max(1);
        let analog = settings.analog.iter().map(|device| {
            Self::new((false, device.id, device.channels.len()), device.rate_hz, values_max)
        });
        let plate = |plate: &crate::qtm::ForcePlate| {
            Self::new((true, plate.id, FORCE_VALUES), plate.rate_hz, values_max)
        };
        analog.chain(settings.plates.iter().map(plate)).collect()
    }

    /// Values that come in so many seconds; no more than are kept.
    fn values_of(&self, seconds: f64) -> usize {
        let samples = (self.rate_hz * seconds).floor() as usize;
        samples.saturating_mul(self.n_channels).min(self.samples_max)
    }

    fn n_samples(&self) -> u64 {
        (self.samples.len() / self.n_channels) as u64
    }

    /// Place of the next sample.
    fn end(&self) -> u64 {
        self.place + self.n_samples()
    }

    fn add(&mut self, first: u64, samples: &[f32]) {
        if first != self.first + self.n_samples() {
            self.place = self.end();
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
            self.place += n as u64;
        }
    }

    /// The samples from this place on, in one component.
    fn since(&self, place: u64, kind: SampledComponentKind) -> SamplesToSend<'_> {
        let skipped = place.clamp(self.place, self.end()) - self.place;
        let mut samples =
            self.samples.get(skipped as usize * self.n_channels..).unwrap_or_default();
        if kind.is_single() {
            let last = samples.len().saturating_sub(self.n_channels);
            samples = samples.get(last..).filter(|s| !s.is_empty()).unwrap_or(&self.missing);
        }
        let first = (self.first + skipped) as u32;
        SamplesToSend { id: self.id, n_channels: self.n_channels, first, samples }
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
    pub(super) fn set_sample_ends(&self, places: &mut Vec<u64>) {
        places.clear();
        places.extend(self.sample_ends());
    }

    /// The places of the next samples.
    pub(super) fn sample_ends(&self) -> impl Iterator<Item = u64> {
        self.histories.iter().map(SampleHistory::end)
    }

    /// Bytes that the components of samples of a frame have on average, if there are so many frames a second.
    pub(super) fn sample_bytes(&self, wanted: Components, hz: f64) -> impl Iterator<Item = usize> {
        let bytes = move |kind: SampledComponentKind| {
            let device = |history: &SampleHistory| {
                let values = match kind.is_single() {
                    true => history.n_channels,
                    false => history.values_of(1.0 / hz),
                };
                DEVICE_BYTES + size_of::<f32>() * values
            };
            let histories = self.histories.iter();
            let histories = histories.filter(move |history| history.is_force == kind.is_force());
            COMPONENT_BYTES + histories.map(device).sum::<usize>()
        };
        wanted.samples().map(bytes)
    }

    /// Samples from these places on that are not kept any more.
    pub(super) fn samples_gone(&self, wanted: Components, from: &[u64]) -> u64 {
        let is_wanted = |history: &&SampleHistory| {
            wanted.samples().any(|kind| kind.is_force() == history.is_force && !kind.is_single())
        };
        let gone = |(history, from): (&SampleHistory, &u64)| history.place.saturating_sub(*from);
        let histories = self.histories.iter().zip(from);
        histories.filter(|(history, _)| is_wanted(history)).map(gone).sum()
    }

    /// The components of samples that a client wants, from these places on, or else those of the present frame.
    pub(super) fn sampled_components<'a>(
        &'a self,
        wanted: Components,
        from: Option<&[u64]>,
    ) -> impl Iterator<Item = SampledComponent<'a>> {
        let of_kind = move |kind: SampledComponentKind| {
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
        components.filter(|component| !component.devices.is_empty())
    }
}
