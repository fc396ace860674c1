//! Settings of rigid bodies, in both directions and in both forms: as elements up to version 1.20, then as attributes.

use std::fmt::Write as _;

use roxmltree::Node;

use super::xml::{COLOURS, child, children, label_text, put, text_of};

/// The version from which on colours and points are attributes.
const ATTRIBUTES_FROM: u32 = 21;

/// Names of the angles of QTM's own definition: about x, y and z.
const ANGLES: [(&str, &str); 3] = [("First", "Roll"), ("Second", "Pitch"), ("Third", "Yaw")];

/// A rigid body.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BodySettings {
    /// Its name.
    pub name: String,
    /// Red, green and blue.
    pub colour: Option<[u8; 3]>,
    /// The markers that define it, in its own axes, in millimetres.
    pub points_mm: Vec<[f32; 3]>,
}

/// The bodies of a document's `The_6D`, in the order of frames.
pub(super) fn read_bodies(bodies: Node<'_, '_>) -> Vec<BodySettings> {
    children(bodies, "Body").map(read_body).collect()
}

fn read_body(body: Node<'_, '_>) -> BodySettings {
    let number = |node: Node<'_, '_>, name| -> Option<f32> {
        let text = node.attribute(name).or_else(|| text_of(node, name))?;
        text.trim().parse().ok().filter(|value: &f32| value.is_finite())
    };
    let point = |point| Some([number(point, "X")?, number(point, "Y")?, number(point, "Z")?]);
    // Up to version 1.20 they are children of the body.
    let points = children(child(body, "Points").unwrap_or(body), "Point");
    BodySettings {
        name: label_text(text_of(body, "Name").unwrap_or_default()),
        colour: read_colour(body),
        points_mm: points.filter_map(point).collect(),
    }
}

fn read_colour(body: Node<'_, '_>) -> Option<[u8; 3]> {
    if let Some(colour) = child(body, "Color") {
        let part = |name| colour.attribute(name)?.trim().parse().ok();
        return Some([part("R")?, part("G")?, part("B")?]);
    }
    let text = text_of(body, "RGBColor")?;
    // The documents say that it is a number, and their example has six digits to the base of 16.
    if text.len() == 6 && text.bytes().any(|digit| !digit.is_ascii_digit()) {
        let [_, red, green, blue] = u32::from_str_radix(text, 16).ok()?.to_be_bytes();
        return Some([red, green, blue]);
    }
    let [red, green, blue, _] = text.parse::<u32>().ok()?.to_le_bytes();
    Some([red, green, blue])
}

/// The names of the angles that a document's `The_6D` or `General` states.
pub(super) fn read_angles(parent: Node<'_, '_>) -> Option<[String; 3]> {
    let names = child(parent, "Euler").or_else(|| child(parent, "EulerAngles"))?;
    let name = |(name, _)| names.attribute(name).or_else(|| text_of(names, name)).map(label_text);
    let [first, second, third] = ANGLES.map(name);
    Some([first?, second?, third?])
}

/// Appends the bodies as version `1.minor` has them.
pub(super) fn put_bodies(bodies: &[BodySettings], minor: u32, xml: &mut String) {
    xml.push_str("    <The_6D>\n");
    put(xml, 2, "Bodies", &bodies.len().to_string());
    for (body, colour) in bodies.iter().zip(COLOURS.iter().cycle()) {
        let [red, green, blue, _] = colour.to_le_bytes();
        let colour = body.colour.unwrap_or([red, green, blue]);
        xml.push_str("        <Body>\n");
        put(xml, 3, "Name", &body.name);
        match minor < ATTRIBUTES_FROM {
            true => put_elements(body, colour, xml),
            false => put_attributes(body, (colour, minor), xml),
        }
        xml.push_str("        </Body>\n");
    }
    // From version 1.21 on the vendor's parser finds them in `General`.
    if (16..ATTRIBUTES_FROM).contains(&minor) {
        xml.push_str("        <Euler>\n");
        ANGLES.iter().for_each(|(place, name)| put(xml, 3, place, name));
        xml.push_str("        </Euler>\n");
    }
    xml.push_str("    </The_6D>\n");
}

/// Appends the names of angles where `General` has them.
pub(super) fn put_general_angles(minor: u32, xml: &mut String) {
    if minor >= ATTRIBUTES_FROM {
        let [first, second, third] = ANGLES.map(|(place, name)| format!("{place}=\"{name}\""));
        xml.push_str(&format!("        <EulerAngles {first} {second} {third}/>\n"));
    }
}

fn put_elements(body: &BodySettings, [red, green, blue]: [u8; 3], xml: &mut String) {
    put(xml, 3, "RGBColor", &u32::from_le_bytes([red, green, blue, 0]).to_string());
    for (index, point) in body.points_mm.iter().enumerate() {
        xml.push_str("            <Point>\n");
        for (axis, value) in ["X", "Y", "Z"].into_iter().zip(point) {
            put(xml, 4, axis, &value.to_string());
        }
        put(xml, 4, "Virtual", "False");
        put(xml, 4, "PhysicalId", &(index + 1).to_string());
        xml.push_str("            </Point>\n");
    }
}

/// The limits of tracking are those of QTM's examples: a body here is what its source says, and not tracked by them.
fn put_attributes(
    body: &BodySettings,
    ([red, green, blue], minor): ([u8; 3], u32),
    xml: &mut String,
) {
    if minor >= 24 {
        put(xml, 3, "Enabled", "true");
    }
    let mut line = |text: &str| xml.push_str(&format!("            {text}\n"));
    line(&format!("<Color R=\"{red}\" G=\"{green}\" B=\"{blue}\"/>"));
    line("<MaximumResidual>10.000000</MaximumResidual>");
    line("<MinimumMarkersInBody>3</MinimumMarkersInBody>");
    line("<BoneLengthTolerance>10.000000</BoneLengthTolerance>");
    line("<Filter Preset=\"No filter\"/>");
    line("<Points>");
    for (index, [x, y, z]) in body.points_mm.iter().enumerate() {
        let id = index + 1;
        line(&format!(
            "    <Point X=\"{x}\" Y=\"{y}\" Z=\"{z}\" Virtual=\"0\" PhysicalId=\"{id}\" Name=\"{id}\"/>"
        ));
    }
    line("</Points>");
    line(
        "<Data_origin X=\"0.000000\" Y=\"0.000000\" Z=\"0.000000\" Relative_body=\"1\">0</Data_origin>",
    );
    let mut identity = String::new();
    for (row, column) in (1..=3).flat_map(|row| (1..=3).map(move |column| (row, column))) {
        let value = if row == column { "1.000000" } else { "0.000000" };
        // Writing to a text cannot fail.
        write!(identity, "R{row}{column}=\"{value}\" ").ok();
    }
    line(&format!("<Data_orientation {identity}Relative_body=\"1\">0</Data_orientation>"));
}
