//! What a simulated Motive sends of a frame: assets, markers, force plates and devices.

use mocapd_drivers::{
    device::MarkerSample,
    natnet::{
        Asset, AssetKind, Bitstream, FrameEnd, FrameToSend, HAS_MODEL, MEASURED, MESSAGE_BYTES_MAX,
        MarkerSet, Model, NatNetMarker, NatNetServer, OCCLUDED, SampledDescription, SampledToSend,
        SetToSend, UNLABELLED, WireBody,
    },
};
use mocapd_take::motion::{Motion, Position, is_gap};

use super::{NatNetError, NatNetSettings};
use crate::{generator::PLATE_COMPONENTS, sampled::SampledSource};

/// Diameter of every marker, and its residual, which motions do not have.
const MARKER_SIZE_M: f32 = 0.014;
const RESIDUAL_M: f32 = 0.000_25;

/// Radians by which a rigid body turns in a frame.
const TURN_PER_FRAME: f64 = 0.01;

/// Id of the first unlabelled marker: unlike a marker's place, so that nobody can take one for the other.
const FIRST_ID: u32 = 1000;

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
    model: Model,
    /// The columns of each asset's markers, and of the unlabelled ones.
    assets: Vec<Vec<usize>>,
    unlabelled_columns: Vec<usize>,
    sources: Vec<SampledSource>,
    /// Samples of a channel of each source in a frame.
    samples_per_frame: Vec<u64>,
    devices: Vec<SampledDevice>,
    positions_m: Vec<Vec<[f32; 3]>>,
    bodies: Vec<WireBody>,
    labelled: Vec<NatNetMarker>,
    unlabelled: Vec<NatNetMarker>,
    /// Samples of each device: one channel after another.
    samples: Vec<Vec<f32>>,
}

/// Millimetres as metres.
fn in_m(position_mm: Position) -> [f32; 3] {
    position_mm.map(|mm| (f64::from(mm) / 1000.0) as f32)
}

/// The asset and the marker of a label.
fn divide(label: &str) -> (&str, &str) {
    match label.split_once(':') {
        Some((asset, marker)) if !asset.is_empty() && !marker.is_empty() => (asset, marker),
        _ => ("", label),
    }
}

impl Content {
    pub(super) fn new(
        motion: &Motion,
        settings: &NatNetSettings,
        rate_millihertz: u32,
    ) -> Result<Self, NatNetError> {
        let mut model = Model::default();
        let (mut assets, mut unlabelled_columns): (Vec<Vec<usize>>, _) = (Vec::new(), Vec::new());
        for (column, marker) in motion.info.markers.iter().enumerate() {
            if !marker.labelled {
                unlabelled_columns.push(column);
                continue;
            }
            let (asset, name) = divide(&marker.label);
            let index = match model.sets.iter().position(|set| set.name == asset) {
                Some(index) => index,
                None => {
                    let name = asset.to_owned();
                    let id = model.sets.len() as u32 + 1;
                    model.sets.push(MarkerSet { name: name.clone(), markers: Vec::new() });
                    let (kind, markers) = (AssetKind::Skeleton, Vec::new());
                    model.assets.push(Asset { kind, id, name, markers });
                    assets.push(Vec::new());
                    model.sets.len() - 1
                }
            };
            if let (Some(set), Some(columns)) = (model.sets.get_mut(index), assets.get_mut(index)) {
                set.markers.push(name.to_owned());
                columns.push(column);
            }
        }
        for name in &settings.rigid_bodies {
            let named = |asset: &&mut Asset| asset.name == *name;
            match model.assets.iter_mut().find(named) {
                Some(asset) => asset.kind = AssetKind::RigidBody,
                None => return Err(NatNetError::NoSuchAsset { name: name.clone() }),
            }
        }
        let mut content = Self {
            model,
            positions_m: assets.iter().map(|_| Vec::new()).collect(),
            assets,
            unlabelled_columns,
            sources: settings.sampled.clone(),
            samples_per_frame: Vec::new(),
            devices: Vec::new(),
            bodies: Vec::new(),
            labelled: Vec::new(),
            unlabelled: Vec::new(),
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
                self.model.sampled.push(SampledDescription {
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
        &self.model
    }

    /// Whether definitions and frames fit into datagrams.
    pub(super) fn check_size(&self, version: Bitstream) -> Result<(), NatNetError> {
        let mut definitions = Vec::new();
        self.model.put(version, &mut definitions);
        // Of a frame: names of sets; a position and a marker for each; samples; and less than 1 KiB besides.
        let names: usize = self.model.sets.iter().map(|set| set.name.len() + 5).sum();
        let n_labelled: usize = self.assets.iter().map(Vec::len).sum();
        let markers = n_labelled * (12 + 26) + self.unlabelled_columns.len() * 26;
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
        if let Some(name) = self.model.sets.last_mut().and_then(|set| set.markers.last_mut()) {
            name.push_str(" renamed");
        }
    }

    /// Takes over the positions of a frame, which is the `played`th since the motion began.
    pub(super) fn fill(&mut self, row: &[Position], ghosts: &[MarkerSample], played: u64) {
        self.labelled.clear();
        self.unlabelled.clear();
        let seen = |column: usize| row.get(column).copied().filter(|position| !is_gap(*position));
        for (index, columns) in self.assets.iter().enumerate() {
            let Some(positions_m) = self.positions_m.get_mut(index) else { continue };
            positions_m.clear();
            for (member, column) in columns.iter().enumerate() {
                let position_m = seen(*column).map(in_m);
                positions_m.push(position_m.unwrap_or_default());
                self.labelled.push(NatNetMarker {
                    id: ((index as u32 + 1) << 16) | (member as u32 + 1),
                    position_m: position_m.unwrap_or_default(),
                    size_m: MARKER_SIZE_M,
                    flags: HAS_MODEL | if position_m.is_some() { MEASURED } else { OCCLUDED },
                    residual_m: RESIDUAL_M,
                });
            }
        }
        let unlabelled = |id: u32, position_mm: Position| NatNetMarker {
            id: FIRST_ID + id,
            position_m: in_m(position_mm),
            size_m: MARKER_SIZE_M,
            flags: MEASURED | UNLABELLED,
            residual_m: RESIDUAL_M,
        };
        let columns = self.unlabelled_columns.iter().copied();
        let seen = columns.filter_map(|column| Some(unlabelled(column as u32, seen(column)?)));
        self.unlabelled.extend(seen);
        let ghosts = ghosts.iter().map(|ghost| unlabelled(ghost.id.into(), ghost.position_mm));
        self.unlabelled.extend(ghosts);
        self.fill_bodies(played);
        self.fill_samples(played);
    }

    /// A rigid body is where its markers are on average, and turns about the vertical; with a marker hidden it is lost.
    fn fill_bodies(&mut self, played: u64) {
        self.bodies.clear();
        for (asset, positions_m) in self.model.assets.iter().zip(&self.positions_m) {
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
        let sets: Vec<SetToSend<'_>> = self
            .model
            .sets
            .iter()
            .zip(&self.positions_m)
            .map(|(set, positions_m)| SetToSend { name: &set.name, positions_m })
            .collect();
        let skeletons = self.model.assets.iter().filter(|a| a.kind == AssetKind::Skeleton);
        let skeletons: Vec<u32> = skeletons.map(|asset| asset.id).collect();
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
            labelled: &self.labelled,
            unlabelled: &self.unlabelled,
            plates: &plates,
            devices: &devices,
            end,
        };
        server.frame(&frame, now_ns)
    }
}
