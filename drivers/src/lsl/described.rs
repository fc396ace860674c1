//! Descriptions of streams that we publish, by the conventions of the XDF wiki.

pub use labstream_core::net::StreamInfo;
use labstream_core::{
    net::Node,
    wire::{Format, IRREGULAR_RATE},
};

use crate::device::SampledGroupInfo;

/// The name of this machine. `labstream-core` reads it from `/proc/sys`, which the sandbox of our unit hides.
#[must_use]
pub fn hostname() -> String {
    rustix::system::uname().nodename().to_string_lossy().into_owned()
}

/// Channels of a body in a stream of poses, each with its type and its unit: the quaternion's real part, then its three axial
/// components.
const POSE_CHANNELS: [(&str, &str, &str); 7] = [
    ("x", "PositionX", "meters"),
    ("y", "PositionY", "meters"),
    ("z", "PositionZ", "meters"),
    ("qw", "OrientationA", "normalized"),
    ("qx", "OrientationB", "normalized"),
    ("qy", "OrientationC", "normalized"),
    ("qz", "OrientationD", "normalized"),
];

/// The program that publishes a stream.
#[derive(Debug, Clone, Copy)]
pub struct Publisher<'a> {
    /// Name of the stream, and the id of its source, which stays the same after a restart.
    pub name: &'a str,
    /// The id of its source.
    pub source_id: &'a str,
    /// Name and version of the program.
    pub program: &'a str,
}

impl Publisher<'_> {
    fn info(&self, kind: &str, n_channels: usize, format: Format, rate_hz: f64) -> StreamInfo {
        let mut info = StreamInfo::new(self.name, kind, n_channels as u32, format, rate_hz);
        self.source_id.clone_into(&mut info.source_id);
        info.hostname = hostname();
        info
    }

    fn acquisition(&self, info: &mut StreamInfo) {
        let acquisition = info.desc.append_child("acquisition");
        acquisition.append_child_value("manufacturer", "mocapd");
        acquisition.append_child_value("model", &plain(self.program));
    }

    /// A stream of positions: three channels of each marker, in metres.
    #[must_use]
    pub fn positions<S: AsRef<str>>(&self, labels: &[S], rate_hz: f64) -> StreamInfo {
        let labels: Vec<String> = labels.iter().map(|label| plain(label.as_ref())).collect();
        let mut info = self.info("MoCap", 3 * labels.len(), Format::Float32, rate_hz);
        let setup = info.desc.append_child("setup");
        setup.append_child_value("name", &plain(self.name));
        let listed = setup.append_child("markers");
        for label in &labels {
            listed.append_child("marker").append_child_value("label", label);
        }
        let channels = info.desc.append_child("channels");
        for label in &labels {
            for (suffix, kind, unit) in POSE_CHANNELS.into_iter().take(3) {
                put_channel(channels, &format!("{label}.{suffix}"), ("marker", label), kind, unit);
            }
        }
        self.acquisition(&mut info);
        info
    }

    /// A stream of poses: position in metres and orientation as a quaternion of each body.
    #[must_use]
    pub fn poses<S: AsRef<str>>(&self, bodies: &[S], rate_hz: f64) -> StreamInfo {
        let bodies: Vec<String> = bodies.iter().map(|body| plain(body.as_ref())).collect();
        let n_channels = POSE_CHANNELS.len() * bodies.len();
        let mut info = self.info("MoCap", n_channels, Format::Float32, rate_hz);
        let setup = info.desc.append_child("setup");
        setup.append_child_value("name", &plain(self.name));
        let listed = setup.append_child("objects");
        for body in &bodies {
            let object = listed.append_child("object");
            object.append_child_value("class", "Rigid");
            object.append_child_value("label", body);
        }
        let channels = info.desc.append_child("channels");
        for body in &bodies {
            for (suffix, kind, unit) in POSE_CHANNELS {
                put_channel(channels, &format!("{body}.{suffix}"), ("object", body), kind, unit);
            }
        }
        self.acquisition(&mut info);
        info
    }

    /// A stream of sampled channels, of this type.
    #[must_use]
    pub fn samples(&self, kind: &str, group: &SampledGroupInfo) -> StreamInfo {
        let rate_hz = f64::from(group.rate_millihertz) / 1000.0;
        let mut info = self.info(kind, group.channels.len(), Format::Float32, rate_hz);
        let channels = info.desc.append_child("channels");
        for stated in &group.channels {
            let channel = channels.append_child("channel");
            channel.append_child_value("label", &plain(&stated.name));
            channel.append_child_value("type", kind);
            channel.append_child_value("unit", &plain(&stated.unit));
        }
        self.acquisition(&mut info);
        info
    }

    /// A stream of events: one text at irregular times.
    #[must_use]
    pub fn events(&self) -> StreamInfo {
        let mut info = self.info("Markers", 1, Format::String, IRREGULAR_RATE);
        let channels = info.desc.append_child("channels");
        channels.append_child("channel").append_child_value("label", "event");
        self.acquisition(&mut info);
        info
    }
}

fn put_channel(channels: &mut Node, label: &str, of: (&str, &str), kind: &str, unit: &str) {
    let channel = channels.append_child("channel");
    channel.append_child_value("label", label);
    channel.append_child_value(of.0, of.1);
    channel.append_child_value("type", kind);
    channel.append_child_value("unit", unit);
}

/// A text without characters that XML does not allow, and without spaces around it, which readers leave out.
fn plain(text: &str) -> String {
    let is_refused = |c: char| c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}');
    let text: String = text.chars().map(|c| if is_refused(c) { ' ' } else { c }).collect();
    text.trim().to_owned()
}
