//! Descriptions of streams, by the conventions of the XDF wiki.

use labstream_core::{
    net::StreamInfo,
    wire::{Format, IRREGULAR_RATE, Value},
};
use mocapd_drivers::device::{SampledChannelInfo, SampledGroupInfo};
use mocapd_take::motion::Marker;

/// The stream of positions: three channels of a marker, in metres.
pub(super) fn positions(name: &str, markers: &[Marker], rate_hz: f64) -> StreamInfo {
    let n_channels = 3 * markers.len() as u32;
    let mut info = StreamInfo::new(name, "MoCap", n_channels, Format::Float32, rate_hz);
    name.clone_into(&mut info.source_id);
    let labels: Vec<String> =
        markers.iter().enumerate().map(|(column, marker)| label(marker, column)).collect();
    let setup = info.desc.append_child("setup");
    setup.append_child_value("name", name);
    let listed = setup.append_child("markers");
    for label in &labels {
        listed.append_child("marker").append_child_value("label", label);
    }
    let channels = info.desc.append_child("channels");
    for label in &labels {
        for axis in ["X", "Y", "Z"] {
            let channel = channels.append_child("channel");
            channel.append_child_value("label", &format!("{label}.{}", axis.to_ascii_lowercase()));
            channel.append_child_value("marker", label);
            channel.append_child_value("type", &format!("Position{axis}"));
            channel.append_child_value("unit", "meters");
        }
    }
    manufacturer(&mut info);
    info
}

/// A stream of sampled channels.
pub(super) fn samples(name: &str, group: &SampledGroupInfo) -> StreamInfo {
    let n_channels = group.channels.len() as u32;
    let rate_hz = f64::from(group.rate_millihertz) / 1000.0;
    let is_plates = group.channels.iter().any(|channel| channel.unit == "N");
    let (kind, what) = if is_plates { ("Force", "plates") } else { ("EMG", "emg") };
    let name = format!("{name}-{what}-{}", group.id);
    let mut info = StreamInfo::new(&name, kind, n_channels, Format::Float32, rate_hz);
    info.source_id = name;
    let channels = info.desc.append_child("channels");
    for stated in &group.channels {
        let channel = channels.append_child("channel");
        channel.append_child_value("label", &stated.name);
        channel.append_child_value("type", kind);
        channel.append_child_value("unit", &stated.unit);
    }
    manufacturer(&mut info);
    info
}

/// The stream of events: one text at irregular times.
pub(super) fn events(name: &str) -> StreamInfo {
    let name = format!("{name}-events");
    let mut info = StreamInfo::new(&name, "Markers", 1, Format::String, IRREGULAR_RATE);
    info.source_id = name;
    manufacturer(&mut info);
    info
}

fn manufacturer(info: &mut StreamInfo) {
    let acquisition = info.desc.append_child("acquisition");
    acquisition.append_child_value("manufacturer", "mocapd");
    acquisition.append_child_value("model", concat!("mocapd-sim ", env!("CARGO_PKG_VERSION")));
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
