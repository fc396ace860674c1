//! Analog devices and force plates of a simulated QTM: the same signals as on the link, in physical units.

use mocapd_drivers::qtm::{AnalogDevice, FORCE_VALUES, ForcePlate, QtmServer};

use crate::device::frame_after_ns;
use crate::sampled::SampledSource;

/// Metres to the millimetres of the point of application.
const MM_PER_M: f64 = 1000.0;

/// A group of sampled channels, as a device or as plates.
#[derive(Debug)]
struct FileSignal {
    source: SampledSource,
    /// Ids of its device, or of its plates.
    ids: Vec<u32>,
    /// Samples taken before the file was started, and since.
    before: u64,
    in_file: u64,
}

/// The samples of a file that is played.
#[derive(Debug)]
pub(super) struct FileSamples {
    signals: Vec<FileSignal>,
    counts: Vec<f32>,
    values: Vec<f32>,
}

impl FileSamples {
    pub(super) fn new(sources: &[SampledSource]) -> Self {
        let (mut n_devices, mut n_plates) = (0, 0);
        let signals = sources.iter().map(|source| {
            let (n, last) = match source.force_plates().len() {
                0 => (1, &mut n_devices),
                n => (n, &mut n_plates),
            };
            let ids = (0..n as u32).map(|index| *last + 1 + index).collect();
            *last += n as u32;
            FileSignal { source: source.clone(), ids, before: 0, in_file: 0 }
        });
        Self { signals: signals.collect(), counts: Vec::new(), values: Vec::new() }
    }

    /// What the settings state.
    pub(super) fn devices(&self) -> (Vec<AnalogDevice>, Vec<ForcePlate>) {
        let (mut devices, mut plates) = (Vec::new(), Vec::new());
        for FileSignal { source, ids, .. } in &self.signals {
            let info = source.info();
            let rate_hz = f64::from(info.rate_millihertz) / 1000.0;
            if !source.force_plates().is_empty() {
                let corners = source.force_plates().iter().map(|plate| Some(plate.corners_mm));
                let plate =
                    |(id, corners_mm): (&u32, _)| ForcePlate { id: *id, rate_hz, corners_mm };
                plates.extend(ids.iter().zip(corners).map(plate));
            } else {
                let channel = |c: &mocapd_drivers::device::SampledChannelInfo| {
                    (c.name.clone(), c.unit.clone())
                };
                let channels: Vec<_> = info.channels.iter().map(channel).collect();
                let device =
                    |id: &u32| AnalogDevice { id: *id, rate_hz, channels: channels.clone() };
                devices.extend(ids.iter().map(device));
            }
        }
        (devices, plates)
    }

    /// The file begins: its samples are numbered on.
    pub(super) fn start(&mut self) {
        for signal in &mut self.signals {
            signal.before += std::mem::take(&mut signal.in_file);
        }
    }

    /// QTM was switched off: numbers begin again.
    pub(super) fn reset(&mut self) {
        for signal in &mut self.signals {
            (signal.before, signal.in_file) = (0, 0);
        }
    }

    /// Adds the samples that were taken up to this time since the file was started.
    pub(super) fn add_until(&mut self, file_ns: u64, server: &mut QtmServer) {
        let Self { signals, counts, values } = self;
        for signal in signals {
            let info = signal.source.info();
            let mut end = signal.in_file;
            while frame_after_ns(end, info.rate_millihertz) <= file_ns {
                end += 1;
            }
            counts.clear();
            signal.source.samples(signal.in_file, end - signal.in_file, counts);
            let first = signal.before + signal.in_file;
            signal.in_file = end;
            for (index, id) in signal.ids.iter().enumerate() {
                values.clear();
                let is_force = !signal.source.force_plates().is_empty();
                for sample in counts.chunks_exact(info.channels.len()) {
                    let physical = sample.iter().zip(&info.channels);
                    let physical =
                        physical.map(|(count, c)| (f64::from(*count) - c.offset) * c.scale);
                    if is_force {
                        let of_plate: Vec<f64> = physical.skip(6 * index).take(6).collect();
                        values.extend(force_of(&of_plate));
                    } else {
                        values.extend(physical.map(|value| value as f32));
                    }
                }
                server.add_samples(is_force, *id, first, values);
            }
        }
    }
}

/// Force, moment and point of application from the six components of a plate.
#[must_use]
pub fn force_of(components: &[f64]) -> [f32; FORCE_VALUES] {
    let mut values = [0.0; FORCE_VALUES];
    for (value, component) in values.iter_mut().zip(components) {
        *value = *component as f32;
    }
    if let [_, _, fz, mx, my, ..] = components
        && *fz > 0.0
    {
        values[6] = (-my / fz * MM_PER_M) as f32;
        values[7] = (mx / fz * MM_PER_M) as f32;
    }
    values
}
