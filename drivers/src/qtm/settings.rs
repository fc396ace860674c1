//! Settings as XML, in both directions: what a client needs of them, and what a server states.

use super::{
    body_settings::{BodySettings, put_bodies, put_general_angles, read_angles, read_bodies},
    command::SettingsRequest,
    xml::{COLOURS, child, children, label_text, put, text_of},
};
use roxmltree::{Document, Node, ParsingOptions};

pub use crate::marker_ids::LABELS_MAX;

/// Most nodes of a document, several times those of [`LABELS_MAX`] labels or a thousand cameras. With this a document
/// takes 20 MB at most while it is read.
const NODES_MAX: u32 = 200_000;

/// Most attributes of a document, and of an element, counted by their `=`: QTM writes six for each point of a body, of which
/// there may be a thousand. Those of an element are compared with one another, which takes a fraction of a second in all.
const ATTRIBUTES_MAX: usize = 1 << 16;
const ELEMENT_ATTRIBUTES_MAX: usize = 1 << 10;

/// Most namespaces; QTM uses none.
const NAMESPACES_MAX: usize = 16;

/// What a client reads from settings; parts that a document does not have are `None`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Settings {
    /// Frame rate of the cameras, in Hz.
    pub frequency_hz: Option<f64>,
    /// The axis that points up, such as `+Z`.
    pub up_axis: Option<String>,
    /// Labels of the markers, in the order of frames; empty strings for markers without one.
    pub labels: Option<Vec<String>>,
    /// Rigid bodies, in the order of frames.
    pub bodies: Option<Vec<BodySettings>>,
    /// Names of the angles by which rotations are shown, such as roll, pitch and yaw.
    pub angles: Option<[String; 3]>,
    /// Analog devices.
    pub analog: Vec<AnalogDevice>,
    /// Force plates.
    pub plates: Vec<ForcePlate>,
    /// Their units.
    pub force_units: ForceUnits,
}

/// An analog device.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AnalogDevice {
    /// Its id in frames.
    pub id: u32,
    /// Samples of a channel per second.
    pub rate_hz: f64,
    /// Label and unit of each channel.
    pub channels: Vec<(String, String)>,
}

/// A force plate.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ForcePlate {
    /// Its id in frames.
    pub id: u32,
    /// Forces per second.
    pub rate_hz: f64,
    /// The corners of its surface in laboratory axes, in millimetres, if a server knows them.
    pub corners_mm: Option<[[f32; 3]; 4]>,
}

/// The units of forces.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ForceUnits {
    /// Of forces, such as `N`.
    pub force: String,
    /// Of lengths, such as `mm`; moments have the product of both.
    pub length: String,
}

impl Settings {
    /// Reads a document.
    ///
    /// # Errors
    /// A phrase that says what is wrong with it.
    pub fn parse(xml: &str) -> Result<Self, String> {
        // The parser compares each attribute with the others of its element, and copies namespaces into every child.
        let count = |part: &str| part.bytes().filter(|byte| *byte == b'=').count();
        // No attribute has a '<'.
        let is_one_full = xml.split('<').any(|element| count(element) > ELEMENT_ATTRIBUTES_MAX);
        if is_one_full
            || count(xml) > ATTRIBUTES_MAX
            || xml.matches("xmlns").count() > NAMESPACES_MAX
        {
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
            settings.angles = read_angles(general);
        }
        if let Some(markers) = child(root, "The_3D") {
            settings.up_axis = text_of(markers, "AxisUpwards").map(str::to_owned);
            settings.labels = Some(labels(markers)?);
        }
        if let Some(bodies) = child(root, "The_6D") {
            settings.bodies = Some(read_bodies(bodies));
            settings.angles = read_angles(bodies).or(settings.angles);
        }
        if let Some(analog) = child(root, "Analog") {
            let devices = children(analog, "Device").take(SAMPLED_DEVICES_MAX);
            settings.analog = devices.filter_map(analog_device).collect();
        }
        if let Some(force) = child(root, "Force") {
            let plate = |plate| {
                let id = number_of(plate, "Plate_ID")?;
                Some(ForcePlate { id, rate_hz: number_of(plate, "Frequency")?, corners_mm: None })
            };
            let plates = children(force, "Plate").take(SAMPLED_DEVICES_MAX);
            settings.plates = plates.filter_map(plate).collect();
            let unit = |name| label_text(text_of(force, name).unwrap_or_default());
            settings.force_units =
                ForceUnits { force: unit("Unit_Force"), length: unit("Unit_Length") };
        }
        Ok(settings)
    }
}

/// Most analog devices and force plates that are read: more than a system has.
const SAMPLED_DEVICES_MAX: usize = 64;

/// Most channels of an analog device that are read.
const ANALOG_CHANNELS_MAX: usize = 1024;

/// A device. From version 1.11 on its channels are elements with label and unit; before, labels and one unit.
fn analog_device(device: Node<'_, '_>) -> Option<AnalogDevice> {
    let n_channels: usize = number_of(device, "Channels")?;
    let of_channels = children(device, "Channel").map(|channel| {
        (
            text_of(channel, "Label").unwrap_or_default(),
            text_of(channel, "Unit").unwrap_or_default(),
        )
    });
    let unit = text_of(device, "Unit").unwrap_or_default();
    let of_labels = children(device, "Label").map(|label| (label.text().unwrap_or_default(), unit));
    let channels = of_channels.chain(of_labels).take(n_channels.min(ANALOG_CHANNELS_MAX));
    let mut channels: Vec<_> =
        channels.map(|(label, unit)| (label_text(label), label_text(unit))).collect();
    // The number is what frames have; labels may be missing.
    let id = number_of(device, "Device_ID")?;
    for index in channels.len()..n_channels.min(ANALOG_CHANNELS_MAX) {
        channels.push((format!("analog {id}.{}", index + 1), label_text(unit)));
    }
    Some(AnalogDevice { id, rate_hz: number_of(device, "Frequency")?, channels })
}

fn number_of<T: std::str::FromStr>(parent: Node<'_, '_>, name: &'static str) -> Option<T> {
    text_of(parent, name)?.parse().ok()
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
    let label = |label| label_text(text_of(label, "Name").unwrap_or_default());
    Ok(children(markers, "Label").map(label).collect())
}

/// What a server states about its system.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ServedSettings {
    /// Frame rate, in Hz.
    pub frequency_hz: f64,
    /// The axis that points up, such as `+Z`.
    pub up_axis: &'static str,
    /// Labels of the markers, in the order of frames.
    pub labels: Vec<String>,
    /// Rigid bodies, in the order of frames.
    pub bodies: Vec<BodySettings>,
    /// Analog devices.
    pub analog: Vec<AnalogDevice>,
    /// Force plates.
    pub plates: Vec<ForcePlate>,
}

impl ServedSettings {
    /// The document with the requested parts, as version `1.minor` has them; `None` if the system has none of them.
    #[must_use]
    pub fn to_xml(&self, minor: u32, request: SettingsRequest) -> Option<String> {
        let analog = request.analog && !self.analog.is_empty();
        let force = request.force && !self.plates.is_empty();
        let bodies = request.bodies && !self.bodies.is_empty();
        if !(request.general || request.markers || bodies || analog || force) {
            return None;
        }
        let mut xml = format!("<QTM_Parameters_Ver_1.{minor}>\n");
        if request.general {
            self.put_general(minor, &mut xml);
        }
        if request.markers {
            self.put_markers(&mut xml);
        }
        if bodies {
            put_bodies(&self.bodies, minor, &mut xml);
        }
        if analog {
            self.put_analog(minor, &mut xml);
        }
        if force {
            self.put_force(&mut xml);
        }
        Some(xml + &format!("</QTM_Parameters_Ver_1.{minor}>\n"))
    }

    fn put_analog(&self, minor: u32, xml: &mut String) {
        let unit_of = |device: &AnalogDevice| {
            device.channels.first().map_or_else(String::new, |(_, unit)| unit.clone())
        };
        xml.push_str("    <Analog>\n");
        // Before version 1.11 a device has one unit; the vendor's parser expects it above the devices.
        if minor < 11 {
            put(xml, 2, "Unit", &self.analog.first().map_or_else(String::new, unit_of));
        }
        for device in &self.analog {
            xml.push_str("        <Device>\n");
            put(xml, 3, "Device_ID", &device.id.to_string());
            put(xml, 3, "Device_Name", &format!("Board {}", device.id));
            put(xml, 3, "Channels", &device.channels.len().to_string());
            // The vendor's parser wants a whole number.
            put(xml, 3, "Frequency", &device.rate_hz.round().to_string());
            if minor < 11 {
                put(xml, 3, "Unit", &unit_of(device));
            }
            xml.push_str("            <Range>\n");
            put(xml, 4, "Min", "-10.0");
            put(xml, 4, "Max", "10.0");
            xml.push_str("            </Range>\n");
            for (label, unit) in &device.channels {
                if minor < 11 {
                    put(xml, 3, "Label", label);
                    continue;
                }
                xml.push_str("            <Channel>\n");
                put(xml, 4, "Label", label);
                put(xml, 4, "Unit", unit);
                xml.push_str("            </Channel>\n");
            }
            xml.push_str("        </Device>\n");
        }
        xml.push_str("    </Analog>\n");
    }

    fn put_force(&self, xml: &mut String) {
        xml.push_str("    <Force>\n");
        put(xml, 2, "Unit_Length", "mm");
        put(xml, 2, "Unit_Force", "N");
        for plate in &self.plates {
            xml.push_str("        <Plate>\n");
            put(xml, 3, "Plate_ID", &plate.id.to_string());
            put(xml, 3, "Frequency", &plate.rate_hz.round().to_string());
            put(xml, 3, "Name", &format!("Force plate {}", plate.id));
            if let Some(corners) = plate.corners_mm {
                xml.push_str("            <Location>\n");
                for (number, corner) in (1..).zip(corners) {
                    put_point(xml, 4, &format!("Corner{number}"), corner);
                }
                xml.push_str("            </Location>\n");
            }
            xml.push_str("        </Plate>\n");
        }
        xml.push_str("    </Force>\n");
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
        put_general_angles(minor, xml);
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

/// Appends an element with three coordinates.
fn put_point(xml: &mut String, depth: usize, name: &str, point: [f32; 3]) {
    xml.push_str(&format!("{:1$}<{name}>\n", "", 4 * depth));
    for (axis, value) in ["X", "Y", "Z"].into_iter().zip(point) {
        put(xml, depth + 1, axis, &format!("{value:.2}"));
    }
    xml.push_str(&format!("{:1$}</{name}>\n", "", 4 * depth));
}
