//! What a simulated Motive sends of a frame: assets, markers, force plates and devices.

use mocapd_drivers::{
    device::MarkerSample,
    natnet::{
        AssetKind, AssetTable, Bitstream, FrameEnd, FrameToSend, MESSAGE_BYTES_MAX, Model,
        NatNetServer, SampledDescription, SampledToSend, ServedMarker, SetToSend, WireBody,
    },
};
use mocapd_take::motion::{Motion, Position};

use super::{NatNetError, NatNetSettings};
use crate::{generator::PLATE_COMPONENTS, sampled::SampledSource};

/// Residual of every marker of a motion without any, and of every rigid body.
const RESIDUAL_M: f32 = 0.000_25;

/// Radians by which a rigid body turns in a frame.
const TURN_PER_FRAME: f64 = 0.01;

/// A force plate or device.
#[derive(Debug)]
struct SampledDevice {
    source: usize,
    /// The first of its channels in the source, and their number.
    first_channel: usize,
    n_channels: usize,
    is_plate: bool,
    id: u32,
}

/// The content of the current frame.
#[derive(Debug)]
pub(super) struct Content {
    table: AssetTable,
    sources: Vec<SampledSource>,
    /// Samples of a channel of each source in a frame.
    samples_per_frame: Vec<u64>,
    devices: Vec<SampledDevice>,
    bodies: Vec<WireBody>,
    /// Samples of each device: one channel after another.
    samples: Vec<Vec<f32>>,
}

impl Content {
    pub(super) fn new(
        motion: &Motion,
        settings: &NatNetSettings,
        rate_millihertz: u32,
    ) -> Result<Self, NatNetError> {
        let markers = motion.info.markers.iter();
        let labels = markers.map(|marker| marker.labelled.then_some(marker.label.as_str()));
        let mut table = AssetTable::new(labels);
        for name in &settings.rigid_bodies {
            if !table.has_asset(name) {
                return Err(NatNetError::NoSuchAsset { name: name.clone() });
            }
            table.add_body(name);
        }
        let mut content = Self {
            table,
            sources: settings.sampled.clone(),
            samples_per_frame: Vec::new(),
            devices: Vec::new(),
            bodies: Vec::new(),
            samples: Vec::new(),
        };
        content.add_devices(settings, rate_millihertz)?;
        Ok(content)
    }

    fn add_devices(
        &mut self,
        settings: &NatNetSettings,
        rate_millihertz: u32,
    ) -> Result<(), NatNetError> {
        for (source, sampled) in self.sources.iter().enumerate() {
            let info = sampled.info();
            if info.rate_millihertz % rate_millihertz != 0 {
                return Err(NatNetError::SampleRate {
                    sampled_hz: f64::from(info.rate_millihertz) / 1000.0,
                    frame_hz: f64::from(rate_millihertz) / 1000.0,
                });
            }
            self.samples_per_frame.push((info.rate_millihertz / rate_millihertz).into());
            let is_plate = !sampled.force_plates().is_empty();
            let version = settings.bitstream;
            if !is_plate && !version.has_devices() {
                return Err(NatNetError::NoDevices { version });
            }
            let n_channels = if is_plate { PLATE_COMPONENTS.len() } else { info.channels.len() };
            for (index, channels) in info.channels.chunks(n_channels).enumerate() {
                let of_kind = |device: &&SampledDevice| device.is_plate == is_plate;
                let id = self.devices.iter().filter(of_kind).count() as u32 + 1;
                self.devices.push(SampledDevice {
                    source,
                    first_channel: index * n_channels,
                    n_channels: channels.len(),
                    is_plate,
                    id,
                });
                self.samples.push(Vec::new());
                self.table.model_mut().sampled.push(SampledDescription {
                    is_plate,
                    id,
                    name: format!("{} {id}", if is_plate { "plate" } else { "device" }),
                    // Volts are those of electrodes.
                    data_type: u32::from(!is_plate),
                    channels: channels.iter().map(|channel| channel.name.clone()).collect(),
                });
            }
        }
        Ok(())
    }

    pub(super) fn model(&self) -> &Model {
        self.table.model()
    }

    /// Whether definitions and frames fit into datagrams.
    pub(super) fn check_size(&self, version: Bitstream) -> Result<(), NatNetError> {
        let mut definitions = Vec::new();
        self.model().put(version, &mut definitions);
        // Of a frame: names of sets; a position and a marker for each; samples; and less than 1 KiB besides.
        let names: usize = self.model().sets.iter().map(|set| set.name.len() + 5).sum();
        let [n_labelled, n_unlabelled] = self.table.n_markers();
        let markers = n_labelled * (12 + 26) + n_unlabelled * 26;
        let samples: usize = self
            .devices
            .iter()
            .map(|device| {
                let n = self.samples_per_frame.get(device.source).copied().unwrap_or(0) as usize;
                8 + device.n_channels * (4 + 4 * n)
            })
            .sum();
        let frame = names + markers + samples + (1 << 10);
        for (what, bytes) in [("definitions", definitions.len()), ("frames", frame)] {
            if bytes > MESSAGE_BYTES_MAX {
                return Err(NatNetError::TooLarge { what, bytes });
            }
        }
        Ok(())
    }

    /// Samples of the first device in a frame.
    pub(super) fn samples_per_frame(&self) -> u32 {
        self.samples_per_frame.first().map_or(0, |n| *n as u32)
    }

    /// Gives the last labelled marker another name.
    pub(super) fn rename_last(&mut self) {
        let model = self.table.model_mut();
        if let Some(name) = model.sets.last_mut().and_then(|set| set.markers.last_mut()) {
            name.push_str(" renamed");
        }
    }

    /// Takes over the positions of a frame, which is the `played`th since the motion began.
    /// `residuals` has those of the motion in units of 10 micrometres, if it has some.
    pub(super) fn fill(
        &mut self,
        (row, residuals): (&[Position], Option<&[u8]>),
        ghosts: &[MarkerSample],
        played: u64,
    ) {
        let residual_m = |column: usize| match residuals {
            Some(counts) => f32::from(counts.get(column).copied().unwrap_or(0)) / 1e5,
            None => RESIDUAL_M,
        };
        self.table.fill(|column| {
            let position_mm = row.get(column).copied()?;
            Some(ServedMarker { position_mm, residual_m: residual_m(column) })
        });
        for ghost in ghosts {
            let served = ServedMarker { position_mm: ghost.position_mm, residual_m: RESIDUAL_M };
            self.table.add_unlabelled(ghost.id.into(), served);
        }
        self.fill_bodies(played);
        self.fill_samples(played);
    }

    /// A rigid body is where its markers are on average, and turns about the vertical; with a marker hidden it is lost.
    fn fill_bodies(&mut self, played: u64) {
        self.bodies.clear();
        let sets = self.table.sets().map(|(_, positions_m)| positions_m);
        for (asset, positions_m) in self.table.model().assets.iter().zip(sets) {
            if asset.kind != AssetKind::RigidBody {
                continue;
            }
            let is_tracked = !positions_m.contains(&[0.0; 3]);
            let n = positions_m.len().max(1) as f64;
            let mean = |axis: usize| {
                let values = positions_m.iter().filter_map(|position| position.get(axis));
                (values.map(|value| f64::from(*value)).sum::<f64>() / n) as f32
            };
            let half = played as f64 * TURN_PER_FRAME / 2.0;
            self.bodies.push(WireBody {
                id: asset.id,
                position_m: [mean(0), mean(1), mean(2)],
                quaternion_xyzw: [0.0, half.sin() as f32, 0.0, half.cos() as f32],
                error_m: RESIDUAL_M,
                is_tracked,
            });
        }
    }

    fn fill_samples(&mut self, played: u64) {
        let mut taken = Vec::new();
        for (device, samples) in self.devices.iter().zip(&mut self.samples) {
            let Some(source) = self.sources.get(device.source) else { continue };
            let n = self.samples_per_frame.get(device.source).copied().unwrap_or(0);
            let info = source.info();
            taken.clear();
            source.samples(played * n, n, &mut taken);
            samples.clear();
            let channels = device.first_channel..device.first_channel + device.n_channels;
            for channel in channels {
                let scale = info.channels.get(channel).map_or(1.0, |channel| channel.scale);
                let counts = taken.iter().skip(channel).step_by(info.channels.len().max(1));
                samples.extend(counts.map(|count| (f64::from(*count) * scale) as f32));
            }
        }
    }

    /// Sends the frame. Returns how many datagrams it takes; `None` when it does not fit into one.
    pub(super) fn send(
        &self,
        server: &mut NatNetServer,
        number: u32,
        end: FrameEnd,
        now_ns: u64,
    ) -> Option<usize> {
        let sets = self.table.sets();
        let sets: Vec<SetToSend<'_>> =
            sets.map(|(set, positions_m)| SetToSend { name: &set.name, positions_m }).collect();
        let skeletons = self.table.skeletons();
        let of_kind = |is_plate: bool| -> Vec<SampledToSend<'_>> {
            let all = self.devices.iter().zip(&self.samples);
            let some = all.filter(|(device, _)| device.is_plate == is_plate);
            let sent = some.map(|(device, samples)| SampledToSend {
                id: device.id,
                n_channels: device.n_channels,
                samples,
            });
            sent.collect()
        };
        let (plates, devices) = (of_kind(true), of_kind(false));
        let frame = FrameToSend {
            number,
            sets: &sets,
            bodies: &self.bodies,
            skeletons: &skeletons,
            labelled: self.table.labelled(),
            unlabelled: self.table.unlabelled(),
            plates: &plates,
            devices: &devices,
            end,
        };
        server.frame(&frame, now_ns)
    }
}
