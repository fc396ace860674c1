//! Sampled channels of the recording as QTM sends them: each group is an analog device, and each force plate a plate.

use mocapd_acquire::pipeline::TappedBatch;
use mocapd_drivers::{
    device::SampledGroupInfo,
    qtm::{AnalogDevice, FORCE_VALUES, ForcePlate, QtmServer},
};
use mocapd_take::{
    foreign::force_plates::{self, PlateLoad},
    interchange::plates_of_group,
};

use crate::publish::{PublishedDevice, group_record};

/// Names of the channels of a plate that is a QTM's, before its number.
const OF_QTM: [&str; FORCE_VALUES] = ["Fx", "Fy", "Fz", "Mx", "My", "Mz", "COPx", "COPy", "COPz"];

/// Where the nine values of a plate come from.
#[derive(Debug)]
enum PlateSource {
    /// The channels of a plate that stands at a known place.
    Channels(Box<force_plates::ForcePlate>),
    /// A group of a QTM, which has them.
    Group,
}

/// A group of sampled channels.
#[derive(Debug)]
struct MappedGroup {
    id: u8,
    /// Scale and offset of each channel.
    units: Vec<(f64, f64)>,
    plates: Vec<(u32, PlateSource)>,
}

/// The groups of a device.
#[derive(Debug, Default)]
pub(super) struct SampleMap {
    groups: Vec<MappedGroup>,
    analog: Vec<AnalogDevice>,
    plates: Vec<ForcePlate>,
    /// A batch in physical units, and its forces.
    physical: Vec<f64>,
    values: Vec<f32>,
}

impl SampleMap {
    pub(super) fn new(device: &PublishedDevice) -> Self {
        let mut map = Self::default();
        let (stated, _) = device.header.force_plates();
        for info in &device.sampled {
            let rate_hz = f64::from(info.rate_millihertz) / 1000.0;
            let id = device_id(info.id);
            let channels =
                info.channels.iter().map(|channel| (channel.name.clone(), channel.unit.clone()));
            map.analog.push(AnalogDevice { id, rate_hz, channels: channels.collect() });
            let mut plates = Vec::new();
            if let Some(id) = plate_of_qtm(info) {
                plates.push((id, PlateSource::Group));
                map.plates.push(ForcePlate { id, rate_hz, corners_mm: None });
            }
            for plate in plates_of_group(&stated, &group_record(info)) {
                let id = plate.number as u32;
                let corners = plate.geometry.corners_mm();
                let corners_mm = Some(corners.map(|corner| corner.map(|v| v as f32)));
                map.plates.push(ForcePlate { id, rate_hz, corners_mm });
                plates.push((id, PlateSource::Channels(Box::new(plate))));
            }
            let units = info.channels.iter().map(|c| (c.scale, c.offset)).collect();
            map.groups.push(MappedGroup { id: info.id, units, plates });
        }
        map
    }

    /// The analog devices and force plates of the settings.
    pub(super) fn devices(&self) -> (Vec<AnalogDevice>, Vec<ForcePlate>) {
        (self.analog.clone(), self.plates.clone())
    }

    /// Passes a batch on, in physical units.
    pub(super) fn add(&mut self, batch: &TappedBatch, server: &mut QtmServer) {
        let Self { groups, physical, values, .. } = self;
        let Some(group) = groups.iter().find(|group| group.id == batch.group) else { return };
        let n_channels = group.units.len().max(1);
        physical.clear();
        let units = group.units.iter().cycle();
        let all = batch.samples.iter().zip(units);
        physical.extend(all.map(|(count, (scale, offset))| (f64::from(*count) - offset) * scale));
        values.clear();
        values.extend(physical.iter().map(|value| *value as f32));
        server.add_samples(false, device_id(group.id), batch.first, values);
        for (id, source) in &group.plates {
            if let PlateSource::Channels(plate) = source {
                values.clear();
                for sample in physical.chunks_exact(n_channels) {
                    let of_plate: Vec<f64> = plate
                        .channels
                        .iter()
                        .map(|&channel| sample.get(channel).copied().unwrap_or(f64::NAN))
                        .collect();
                    values.extend(force(&plate.load(&of_plate)));
                }
            }
            server.add_samples(true, *id, batch.first, values);
        }
    }
}

/// The id of a group's device: ids of QTM begin with 1.
fn device_id(group: u8) -> u32 {
    u32::from(group) + 1
}

/// Force, moment about the centre of the plate, and point of application.
fn force(load: &PlateLoad) -> [f32; FORCE_VALUES] {
    let all = [load.force_n, load.moment_nm, load.cop_mm];
    let mut values = [0.0; FORCE_VALUES];
    for (value, of) in values.iter_mut().zip(all.as_flattened()) {
        *value = *of as f32;
    }
    values
}

/// The number of the plate whose nine values a group of a QTM has.
fn plate_of_qtm(info: &SampledGroupInfo) -> Option<u32> {
    let id = info.channels.first()?.name.strip_prefix(OF_QTM[0])?.parse().ok()?;
    let names = OF_QTM.iter().map(|name| format!("{name}{id}"));
    names.eq(info.channels.iter().map(|channel| channel.name.clone())).then_some(id)
}
