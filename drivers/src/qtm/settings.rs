//! Settings as XML, in both directions: what a client needs of them, and what a server states.

use roxmltree::{Document, Node, ParsingOptions};

pub use crate::marker_ids::LABELS_MAX;

/// Most nodes of a document, several times those of [`LABELS_MAX`] labels or a thousand cameras. With this a document
/// takes 20 MB at most while it is read.
const NODES_MAX: u32 = 200_000;

/// Most attributes of a document, counted by their `=`: QTM writes ten for each of a hundred cameras, and three for each
/// bone. All in one element, they are compared in a fraction of a second.
const ATTRIBUTES_MAX: usize = 8192;

/// Most namespaces; QTM uses none.
const NAMESPACES_MAX: usize = 16;

/// Longest label in characters; longer ones are cut off.
const LABEL_CHARS_MAX: usize = 128;

/// What a client reads from settings; parts that a document does not have are `None`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Settings {
    /// Frame rate of the cameras, in Hz.
    pub frequency_hz: Option<f64>,
    /// The axis that points up, such as `+Z`.
    pub up_axis: Option<String>,
    /// Labels of the markers, in the order of frames; empty strings for markers without one.
    pub labels: Option<Vec<String>>,
    /// Rigid bodies.
    pub n_bodies: usize,
    /// Analog channels.
    pub n_analog_channels: usize,
    /// Force plates.
    pub n_force_plates: usize,
}

impl Settings {
    /// Reads a document.
    ///
    /// # Errors
    /// A phrase that says what is wrong with it.
    pub fn parse(xml: &str) -> Result<Self, String> {
        // The parser compares each attribute with the others of its element, and copies namespaces into every child.
        let n_equals = xml.bytes().filter(|byte| *byte == b'=').count();
        if n_equals > ATTRIBUTES_MAX || xml.matches("xmlns").count() > NAMESPACES_MAX {
            return Err("it has more attributes than settings have".to_owned());
        }
        let options =
            ParsingOptions { allow_dtd: false, nodes_limit: NODES_MAX, ..Default::default() };
        // An error names a place of the document; its text may quote it, so that it is not repeated.
        let document = Document::parse_with_options(xml, options)
            .map_err(|error| format!("it is no XML (at line {})", error.pos().row))?;
        let root = document.root_element();
        let mut settings = Self::default();
        if let Some(general) = child(root, "General") {
            settings.frequency_hz =
                text_of(general, "Frequency").and_then(|text| text.parse().ok());
        }
        if let Some(markers) = child(root, "The_3D") {
            settings.up_axis = text_of(markers, "AxisUpwards").map(str::to_owned);
            settings.labels = Some(labels(markers)?);
        }
        if let Some(bodies) = child(root, "The_6D") {
            settings.n_bodies = children(bodies, "Body").count();
        }
        if let Some(analog) = child(root, "Analog") {
            settings.n_analog_channels = children(analog, "Device")
                .filter_map(|device| text_of(device, "Channels")?.parse::<usize>().ok())
                .fold(0, usize::saturating_add);
        }
        if let Some(force) = child(root, "Force") {
            settings.n_force_plates = children(force, "Plate").count();
        }
        Ok(settings)
    }
}

fn labels(markers: Node<'_, '_>) -> Result<Vec<String>, String> {
    let found = children(markers, "Label").count();
    let stated = text_of(markers, "Labels").and_then(|text| text.parse::<usize>().ok());
    match stated {
        _ if found > LABELS_MAX => {
            return Err(format!("it has {found} labels, and at most {LABELS_MAX} can be recorded"));
        }
        Some(stated) if stated == found => {}
        Some(stated) => return Err(format!("it states {stated} labels and lists {found}")),
        None => return Err("it does not state the number of labels".to_owned()),
    }
    let label = |label| {
        let name = text_of(label, "Name").unwrap_or_default();
        name.chars().filter(|c| !c.is_control()).take(LABEL_CHARS_MAX).collect::<String>()
    };
    Ok(children(markers, "Label").map(label).collect())
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

fn text_of<'a>(parent: Node<'a, '_>, name: &'static str) -> Option<&'a str> {
    Some(child(parent, name)?.text().unwrap_or_default().trim())
}

/// What a server states about its system.
#[derive(Debug, Clone, PartialEq)]
pub struct ServedSettings {
    /// Frame rate, in Hz.
    pub frequency_hz: f64,
    /// The axis that points up, such as `+Z`.
    pub up_axis: &'static str,
    /// Labels of the markers, in the order of frames.
    pub labels: Vec<String>,
}

/// Colours of labels, one after the other: red, green, blue, yellow, in the documents' order of bits.
const COLOURS: [u32; 4] = [0x0000_00FF, 0x0000_FF00, 0x00FF_0000, 0x0000_FFFF];

impl ServedSettings {
    /// The document with the requested parts, as version `1.minor` has them.
    #[must_use]
    pub fn to_xml(&self, minor: u32, general: bool, markers: bool) -> String {
        let mut xml = format!("<QTM_Parameters_Ver_1.{minor}>\n");
        if general {
            self.put_general(minor, &mut xml);
        }
        if markers {
            self.put_markers(&mut xml);
        }
        xml + &format!("</QTM_Parameters_Ver_1.{minor}>\n")
    }

    fn put_markers(&self, xml: &mut String) {
        xml.push_str("    <The_3D>\n");
        put(xml, 2, "AxisUpwards", self.up_axis);
        // "If the system has no valid calibration the value is empty."
        put(xml, 2, "CalibrationTime", "");
        put(xml, 2, "Labels", &self.labels.len().to_string());
        for (label, colour) in self.labels.iter().zip(COLOURS.iter().cycle()) {
            xml.push_str("        <Label>\n");
            put(xml, 3, "Name", label);
            put(xml, 3, "RGBColor", &colour.to_string());
            put(xml, 3, "Trajectory_Type", "Measured");
            xml.push_str("        </Label>\n");
        }
        xml.push_str("        <Bones></Bones>\n    </The_3D>\n");
    }

    fn put_general(&self, minor: u32, xml: &mut String) {
        xml.push_str("    <General>\n");
        put(xml, 2, "Frequency", &self.frequency_hz.to_string());
        put(xml, 2, "Capture_Time", "10.000000");
        put(xml, 2, "Start_On_External_Trigger", "false");
        if minor > 14 {
            for input in ["NO", "NC", "Software"] {
                put(xml, 2, &format!("Start_On_Trigger_{input}"), "false");
            }
        }
        xml.push_str("        <External_Time_Base>\n");
        for (name, value) in [
            ("Enabled", "false"),
            ("Signal_Source", "Control port"),
            ("Signal_Mode", "Periodic"),
            ("Frequency_Multiplier", "1"),
            ("Frequency_Divisor", "1"),
            ("Frequency_Tolerance", "1000"),
            ("Nominal_Frequency", "None"),
            ("Signal_Edge", "Negative"),
            ("Signal_Shutter_Delay", "0"),
            ("Non_Periodic_Timeout", "10.000000"),
        ] {
            put(xml, 3, name, value);
        }
        xml.push_str("        </External_Time_Base>\n");
        put_actions("Processing_Actions", false, minor, xml);
        if minor > 13 {
            put_actions("RealTime_Processing_Actions", true, minor, xml);
            put_actions("Reprocessing_Actions", false, minor, xml);
        }
        xml.push_str("    </General>\n");
    }
}

/// What QTM would do with frames: 3D tracking, and nothing else.
fn put_actions(name: &str, real_time: bool, minor: u32, xml: &mut String) {
    xml.push_str(&format!("        <{name}>\n"));
    let mut action = |name: &str, is_there: bool| {
        if is_there {
            put(xml, 3, name, "false");
        }
    };
    action("PreProcessing2D", minor > 13);
    action("TwinSystemMerge", !real_time);
    action("SplineFill", !real_time);
    for name in ["AIM", "Track6DOF", "ForceData"] {
        action(name, true);
    }
    action("GazeVector", minor > 11);
    action("SkeletonSolve", minor > 18);
    for name in ["ExportTSV", "ExportC3D", "ExportMatlabFile"] {
        action(name, !real_time);
    }
    action("ExportAviFile", !real_time && minor > 11);
    put(xml, 3, "Tracking", "3D");
    xml.push_str(&format!("        </{name}>\n"));
}

/// Appends an element with text, indented so deep.
fn put(xml: &mut String, depth: usize, name: &str, text: &str) {
    xml.push_str(&format!("{:1$}<{name}>", "", 4 * depth));
    for c in text.chars() {
        match c {
            '&' => xml.push_str("&amp;"),
            '<' => xml.push_str("&lt;"),
            '>' => xml.push_str("&gt;"),
            // XML has no way to write them.
            c if c.is_control() => xml.push('_'),
            c => xml.push(c),
        }
    }
    xml.push_str(&format!("</{name}>\n"));
}
