//! The description of a stream: an XML document that its sender answers with, short without and whole with its channels.
//! Those that are received, and those of streams that we publish.
//!
//! Both follow the conventions of the XDF wiki. That for motion capture, "`MoCap` Meta Data"
//! (<https://github.com/sccn/xdf/wiki/MoCap-Meta-Data>), has three channels of the types `PositionX`, `PositionY` and
//! `PositionZ` for each marker, in metres by preference.

pub use labstream_core::net::StreamInfo;
use labstream_core::{
    net,
    wire::{Format, IRREGULAR_RATE},
};
use roxmltree::{Document, Node, ParsingOptions};

use super::values::ValueFormat;
use crate::{bytes::is_printable, device::SampledGroupInfo, uri::LengthUnit};

/// Longest description in bytes: 4096 channels with a label, a type, a unit and as much again of what else a program states.
pub const DESCRIPTION_BYTES_MAX: usize = 1 << 20;

/// Most channels of a stream: 1365 markers. A stream of EEG has some hundred.
const CHANNELS_MAX: usize = 4096;

/// Most nodes of a document, which bounds the memory that it takes while it is read: [`CHANNELS_MAX`] channels with ten
/// elements, their texts and the white space between them.
const NODES_MAX: u32 = 200_000;

/// Most attributes, counted by their `=`, and namespaces: LSL's documents have none.
const ATTRIBUTES_MAX: usize = 8192;
const NAMESPACES_MAX: usize = 16;

/// Longest name or label in characters; longer ones are cut off.
const TEXT_CHARS_MAX: usize = 128;

/// What a stream states about one of its channels; texts that it does not state are empty.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ChannelDescription {
    /// Its label.
    pub label: String,
    /// The marker that it belongs to.
    pub marker: String,
    /// What it measures, such as `PositionX` or `EEG`.
    pub kind: String,
    /// The unit of its values.
    pub unit: String,
}

/// What a stream states about itself.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct StreamDescription {
    /// Its name.
    pub name: String,
    /// Its type, such as `MoCap`.
    pub kind: String,
    /// Values of a sample.
    pub n_channels: usize,
    /// The form of its values.
    pub format: ValueFormat,
    /// Samples per second; 0 for a stream without a fixed rate.
    pub rate_hz: f64,
    /// The rate as it is stated, if it is none that can be recorded.
    pub odd_rate: Option<String>,
    /// The id of the source, which survives its restart; may be empty.
    pub source_id: String,
    /// The id of this stream, which does not.
    pub uid: String,
    /// The sender's machine.
    pub hostname: String,
    /// The session of the laboratory's network.
    pub session_id: String,
    /// TCP ports for data by IPv4 and IPv6, 0 for none.
    pub data_ports: [u16; 2],
    /// UDP ports for time probes.
    pub service_ports: [u16; 2],
    /// The channels as far as they are described, [`n_channels`](Self::n_channels) at most.
    pub channels: Vec<ChannelDescription>,
}

impl StreamDescription {
    /// Reads a document.
    ///
    /// # Errors
    /// A phrase that says what is wrong with it.
    pub fn parse(xml: &str) -> Result<Self, String> {
        let n_equals = xml.bytes().filter(|byte| *byte == b'=').count();
        if n_equals > ATTRIBUTES_MAX || xml.matches("xmlns").count() > NAMESPACES_MAX {
            return Err("its description has more attributes than LSL writes".to_owned());
        }
        let options =
            ParsingOptions { allow_dtd: false, nodes_limit: NODES_MAX, ..Default::default() };
        let document = Document::parse_with_options(xml, options)
            .map_err(|error| format!("its description is no XML (at line {})", error.pos().row))?;
        let root = document.root_element();
        let text = |name| clean(text_of(root, name));
        let number = |name| text_of(root, name).parse::<u16>().unwrap_or(0);
        let format = text_of(root, "channel_format");
        let n_channels = text_of(root, "channel_count").parse().unwrap_or(0);
        if !(1..=CHANNELS_MAX).contains(&n_channels) {
            return Err(format!(
                "it has {n_channels} channels, and 1 to {CHANNELS_MAX} can be recorded"
            ));
        }
        let stated_rate = text_of(root, "nominal_srate");
        let rate_hz = stated_rate.parse().unwrap_or(f64::NAN);
        let is_recordable = (1e-3..=1e6).contains(&rate_hz);
        let is_odd = !is_recordable && rate_hz != 0.0;
        let mut description = Self {
            name: text("name"),
            kind: text("type"),
            n_channels,
            format: ValueFormat::named(format)
                .ok_or_else(|| format!("its channel format '{}' is unknown", clean(format)))?,
            rate_hz: if is_recordable { rate_hz } else { 0.0 },
            odd_rate: is_odd.then(|| clean(stated_rate)),
            source_id: text("source_id"),
            uid: text("uid"),
            hostname: text("hostname"),
            session_id: text("session_id"),
            data_ports: [number("v4data_port"), number("v6data_port")],
            service_ports: [number("v4service_port"), number("v6service_port")],
            channels: Vec::new(),
        };
        if let Some(channels) = child(root, "desc").and_then(|desc| child(desc, "channels")) {
            description.read_channels(channels);
        }
        Ok(description)
    }

    fn read_channels(&mut self, channels: Node<'_, '_>) {
        let channel = |node| ChannelDescription {
            label: clean(text_of(node, "label")),
            marker: clean(text_of(node, "marker")),
            kind: clean(text_of(node, "type")),
            unit: clean(text_of(node, "unit")),
        };
        self.channels = children(channels, "channel").map(channel).take(self.n_channels).collect();
    }

    /// Whether samples of this stream mean the same as those of an earlier one: the same rate, format, and channels.
    pub(crate) fn is_recorded_as(&self, earlier: &Self) -> bool {
        (self.n_channels, self.format, self.rate_hz.to_bits(), &self.channels)
            == (earlier.n_channels, earlier.format, earlier.rate_hz.to_bits(), &earlier.channels)
    }

    /// One phrase for users: what the stream is, and where.
    #[must_use]
    pub fn summary(&self) -> String {
        let Self { name, kind, n_channels, format, rate_hz, source_id, hostname, .. } = self;
        let kind = if kind.is_empty() { "no type" } else { kind };
        let channels = if *n_channels == 1 { "channel" } else { "channels" };
        let rate = match rate_hz {
            0.0 => "no fixed rate".to_owned(),
            hz => format!("{hz} Hz"),
        };
        let source = match source_id.as_str() {
            "" => String::new(),
            id => format!(", source_id '{id}'"),
        };
        let format = format.name();
        format!(
            "'{name}' ({kind}, {n_channels} {channels} of {format}, {rate}{source}, on {hostname})"
        )
    }
}

fn children<'a, 'input>(
    parent: Node<'a, 'input>,
    name: &'static str,
) -> impl Iterator<Item = Node<'a, 'input>> {
    parent.children().filter(move |node| node.tag_name().name() == name)
}

fn child<'a, 'input>(parent: Node<'a, 'input>, name: &'static str) -> Option<Node<'a, 'input>> {
    children(parent, name).next()
}

fn text_of<'a>(parent: Node<'a, '_>, name: &'static str) -> &'a str {
    child(parent, name).and_then(|node| node.text()).unwrap_or_default().trim()
}

/// A text on one line, of bounded length.
pub(crate) fn clean(text: &str) -> String {
    text.trim().chars().filter(|c| !c.is_control()).take(TEXT_CHARS_MAX).collect()
}

/// The axis of a channel that holds positions: 0, 1 or 2.
pub(super) fn position_axis(channel: &ChannelDescription) -> Option<usize> {
    let axes = ["positionx", "positiony", "positionz"];
    axes.iter().position(|axis| channel.kind.eq_ignore_ascii_case(axis))
}

/// The marker to which a channel of positions belongs: as it is stated, or the label without the axis at its end.
pub(super) fn marker_of(channel: &ChannelDescription, axis: usize) -> &str {
    if !channel.marker.is_empty() {
        return &channel.marker;
    }
    let label = channel.label.as_str();
    let letters = [['x', 'X'], ['y', 'Y'], ['z', 'Z']];
    let stem = letters.get(axis).and_then(|letters| label.strip_suffix(letters));
    let stem = stem.and_then(|stem| stem.strip_suffix(['.', '_', '-', ':', ' ', '/']));
    stem.filter(|stem| !stem.is_empty()).unwrap_or(label)
}

/// The unit that a channel of positions states.
pub(super) fn length_unit(text: &str) -> Option<LengthUnit> {
    let one_of = |names: &[&str]| names.iter().any(|name| text.eq_ignore_ascii_case(name));
    if one_of(&["m", "meter", "meters", "metre", "metres"]) {
        Some(LengthUnit::Metres)
    } else if one_of(&["cm", "centimeter", "centimeters", "centimetre", "centimetres"]) {
        Some(LengthUnit::Centimetres)
    } else if one_of(&["mm", "millimeter", "millimeters", "millimetre", "millimetres"]) {
        Some(LengthUnit::Millimetres)
    } else {
        None
    }
}

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

fn put_channel(channels: &mut net::Node, label: &str, of: (&str, &str), kind: &str, unit: &str) {
    let channel = channels.append_child("channel");
    channel.append_child_value("label", label);
    channel.append_child_value(of.0, of.1);
    channel.append_child_value("type", kind);
    channel.append_child_value("unit", unit);
}

/// A text without characters that XML does not allow, and without spaces around it, which readers leave out.
fn plain(text: &str) -> String {
    let text: String = text.chars().map(|c| if is_printable(c) { c } else { ' ' }).collect();
    text.trim().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn document(fields: &str, desc: &str) -> String {
        format!(
            "<?xml version=\"1.0\"?>\n<info>\n\t<name>Rig &amp; Co</name>\n\t<type>MoCap</type>\n\t\
             <channel_count>3</channel_count>{fields}<source_id>s1</source_id>\n\t\
             <nominal_srate>240.0000000000000</nominal_srate><uid>u-1</uid><hostname>lab</hostname>\n\t\
             <session_id>default</session_id><v4address></v4address><v4data_port>16572</v4data_port>\
             <v4service_port>16573</v4service_port>{desc}\n</info>\n"
        )
    }

    #[test]
    fn channels_and_ports_are_read_and_texts_unescaped() {
        let channels = "<desc><channels><channel><label>A.x</label><marker>A</marker><type>PositionX</type>\
                        <unit>meters</unit></channel></channels></desc>";
        let xml = document("<channel_format>float32</channel_format>", channels);
        let read = StreamDescription::parse(&xml).unwrap();
        assert_eq!((read.name.as_str(), read.n_channels, read.rate_hz), ("Rig & Co", 3, 240.0));
        assert_eq!((read.data_ports, read.service_ports), ([16_572, 0], [16_573, 0]));
        assert_eq!(read.channels.len(), 1);
        let channel = ChannelDescription {
            label: "A.x".to_owned(),
            marker: "A".to_owned(),
            kind: "PositionX".to_owned(),
            unit: "meters".to_owned(),
        };
        assert_eq!(read.channels[0], channel);
        assert!(read.summary().contains("'Rig & Co' (MoCap, 3 channels of float32, 240 Hz"));
    }

    #[test]
    fn documents_that_no_stream_sends_are_refused_with_the_reason() {
        let float = "<channel_format>float32</channel_format>";
        for (xml, reason) in [
            ("no XML".to_owned(), "no XML"),
            (document("<channel_format>int128</channel_format>", ""), "'int128'"),
            (document(float, "").replace(">3<", ">0<"), "0 channels"),
            (document(float, "").replace(">3<", ">5000<"), "5000 channels"),
            (document(float, &"<a b='1'/>".repeat(9000)), "attributes"),
            (format!("<!DOCTYPE info [<!ENTITY a 'b'>]>{}", document(float, "")), "no XML"),
        ] {
            let error = StreamDescription::parse(&xml).unwrap_err();
            assert!(error.contains(reason), "{error}");
        }
    }

    #[test]
    fn a_marker_is_named_by_its_element_or_by_the_label_without_its_axis() {
        for (marker, label, axis, expected) in [
            ("LASI", "LASI.x", 0, "LASI"),
            ("", "LASI.x", 0, "LASI"),
            ("", "head top_Y", 1, "head top"),
            ("", "LASI", 2, "LASI"),
            ("", "Lx", 0, "Lx"),
            ("", ".x", 0, ".x"),
            ("", "A.x", 1, "A.x"),
        ] {
            let channel = ChannelDescription {
                marker: marker.to_owned(),
                label: label.to_owned(),
                ..ChannelDescription::default()
            };
            assert_eq!(marker_of(&channel, axis), expected, "{marker} {label}");
        }
    }

    #[test]
    fn units_of_length_are_known_by_both_spellings() {
        for (text, mm) in [("meters", 1000.0), ("Millimetres", 1.0), ("cm", 10.0), ("M", 1000.0)] {
            assert_eq!(length_unit(text).unwrap().mm(), mm, "{text}");
        }
        assert_eq!(length_unit("inch"), None);
        assert_eq!(length_unit(""), None);
    }
}
