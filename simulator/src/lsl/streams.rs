//! The streams of a motion, and the values of their samples.

use labstream_core::{net::StreamInfo, wire::Value};
use mocapd_drivers::{
    device::{SampledChannelInfo, SampledGroupInfo},
    lsl::Publisher,
};
use mocapd_take::motion::Marker;

const PROGRAM: &str = concat!("mocapd-sim ", env!("CARGO_PKG_VERSION"));

fn publisher(name: &str) -> Publisher<'_> {
    Publisher { name, source_id: name, program: PROGRAM }
}

/// The stream of positions.
pub(super) fn positions(name: &str, markers: &[Marker], rate_hz: f64) -> StreamInfo {
    let labels: Vec<String> =
        markers.iter().enumerate().map(|(column, marker)| label(marker, column)).collect();
    publisher(name).positions(&labels, rate_hz)
}

/// A stream of sampled channels.
pub(super) fn samples(name: &str, group: &SampledGroupInfo) -> StreamInfo {
    let is_plates = group.channels.iter().any(|channel| channel.unit == "N");
    let (kind, what) = if is_plates { ("Force", "plates") } else { ("EMG", "emg") };
    publisher(&format!("{name}-{what}-{}", group.id)).samples(kind, group)
}

/// The stream of events.
pub(super) fn events(name: &str) -> StreamInfo {
    publisher(&format!("{name}-events")).events()
}

fn label(marker: &Marker, column: usize) -> String {
    if marker.label.is_empty() { format!("u{:03}", column + 1) } else { marker.label.clone() }
}

/// The values of one sample of a group, in the units of its channels.
pub(super) fn values(counts: &[f32], channels: &[SampledChannelInfo]) -> Vec<Value> {
    let value = |(count, channel): (&f32, &SampledChannelInfo)| {
        Value::F32(((f64::from(*count) - channel.offset) * channel.scale) as f32)
    };
    counts.iter().zip(channels).map(value).collect()
}
