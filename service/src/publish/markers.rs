//! Markers of the recording as QTM sends them: labelled ones in the order of the labels, the others with ids.

use mocapd_acquire::pipeline::{PipelineProgress, TappedFrame, TappedMarker, lock};
use mocapd_drivers::qtm::{FrameHeader, MISSING, ServedSettings, WireMarker};
use mocapd_take::{
    motion::UpAxis,
    record::{Channel, Header},
};

/// Id of the unlabelled marker in slot 0: unlike a marker's place, so that nobody can take one for the other.
const FIRST_ID: u32 = 1000;

/// The markers of frames, by slot.
#[derive(Debug, Default)]
pub(super) struct MarkerMap {
    is_labelled: Vec<bool>,
    labels: Vec<String>,
    pub(super) labelled: Vec<WireMarker>,
    pub(super) unlabelled: Vec<WireMarker>,
}

impl MarkerMap {
    /// Takes over the channels if there are others now. Returns whether the labels have changed.
    pub(super) fn follow(&mut self, n_channels: usize, progress: &PipelineProgress) -> bool {
        if self.is_labelled.len() == n_channels {
            return false;
        }
        // A marker that has just appeared is here once the writer knows it.
        let channels = lock(&progress.channels);
        if channels.len() == self.is_labelled.len() {
            return false;
        }
        self.is_labelled = channels.iter().map(|channel| channel.labelled).collect();
        let labels: Vec<String> = channels.iter().filter(|c| c.labelled).map(label).collect();
        let has_changed = labels != self.labels;
        self.labels = labels;
        has_changed
    }

    /// The settings of a device with these markers.
    pub(super) fn settings(&self, header: &Header) -> ServedSettings {
        ServedSettings {
            frequency_hz: header.rate_hz,
            up_axis: match header.up_axis {
                UpAxis::X => "+X",
                UpAxis::Y => "+Y",
                // A laboratory's axis; QTM has no word for an unknown one.
                UpAxis::Z | UpAxis::Unknown => "+Z",
            },
            labels: self.labels.clone(),
            ..ServedSettings::default()
        }
    }

    /// Sorts the markers of a frame.
    pub(super) fn fill(&mut self, markers: &[TappedMarker]) {
        self.labelled.clear();
        self.unlabelled.clear();
        for (slot, marker) in markers.iter().enumerate() {
            let is_seen = !marker.position_mm.iter().any(|value| value.is_nan());
            let wire = WireMarker {
                position_mm: if is_seen { marker.position_mm } else { [MISSING; 3] },
                id: FIRST_ID + slot as u32,
                residual_mm: f32::from(marker.residual_10um) / 100.0,
            };
            match self.is_labelled.get(slot) {
                Some(true) => self.labelled.push(wire),
                Some(false) if is_seen => self.unlabelled.push(wire),
                // A marker that has just appeared is left out until its label is known.
                _ => {}
            }
        }
        // Frames have as many labelled markers as the settings state.
        let missing = WireMarker { position_mm: [MISSING; 3], id: 0, residual_mm: 0.0 };
        self.labelled.resize(self.labels.len(), missing);
    }
}

fn label(channel: &Channel) -> String {
    channel.label.clone()
}

/// Number and time of a frame: the row, in which frames that were lost count, and the device's clock.
pub(super) fn header_of(frame: &TappedFrame, tick_hz: u64) -> FrameHeader {
    let time_us = u128::from(frame.device_ticks) * 1_000_000 / u128::from(tick_hz.max(1));
    FrameHeader {
        time_us: u64::try_from(time_us).unwrap_or(u64::MAX),
        // QTM's number has 32 bits, and begins again after 49 days at 1000 Hz.
        number: frame.row as u32,
    }
}
