//! The convention for motion capture in LSL's descriptions, "`MoCap` Meta Data" of the XDF wiki
//! (<https://github.com/sccn/xdf/wiki/MoCap-Meta-Data>): three channels of the types `PositionX`, `PositionY` and `PositionZ` for
//! each marker, in metres by preference.

use super::description::ChannelDescription;
use crate::stream_query::LengthUnit;

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

#[cfg(test)]
mod tests {
    use super::*;

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
