//! The description of a stream: an XML document that its sender answers with, short without and whole with its channels.

use roxmltree::{Document, Node, ParsingOptions};

use super::values::ValueFormat;

/// Longest description in bytes: 4096 channels with a label, a type, a unit and as much again of what else a program states.
pub const DESCRIPTION_BYTES_MAX: usize = 1 << 20;

/// Most channels of a stream: 1365 markers. A stream of EEG has some hundred.
pub(super) const CHANNELS_MAX: usize = 4096;

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
}
