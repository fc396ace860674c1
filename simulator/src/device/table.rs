//! The marker table: columns of a motion as ids and labels of a device.

use mocapd_drivers::device::{MarkerInfo, MarkerSample};
use mocapd_drivers::link::LABEL_BYTES_MAX;
use mocapd_take::motion::{Marker, Position, is_gap};

/// One entry a column, its id the column, and what had to be changed in the labels.
///
/// Unlabelled slots are announced with a temporary id and no name.
pub(super) fn announce(markers: &[Marker]) -> (Vec<MarkerInfo>, Vec<String>) {
    let mut warnings = Vec::new();
    let table = (0u16..)
        .zip(markers)
        .map(|(id, marker)| {
            let label = if marker.labelled { marker.label.as_str() } else { "" };
            let sayable = sayable(label);
            if sayable != label {
                warnings.push(format!(
                    "label '{}' cannot travel on the link, sent as '{sayable}'",
                    label.escape_debug()
                ));
            }
            MarkerInfo { id, label: sayable, labelled: marker.labelled }
        })
        .collect();
    (table, warnings)
}

/// Without control characters, cut to what the link carries.
fn sayable(label: &str) -> String {
    let clean: String = label.chars().map(|c| if c.is_control() { '_' } else { c }).collect();
    let end = (0..=clean.len().min(LABEL_BYTES_MAX)).rev().find(|i| clean.is_char_boundary(*i));
    clean.get(..end.unwrap_or(0)).unwrap_or_default().to_owned()
}

/// Fills `samples` with one frame, and counts the positions in it.
///
/// A labelled marker without a position is listed as occluded; an unlabelled one is not listed, as nobody can
/// say that it still exists.
pub(super) fn list(table: &[MarkerInfo], row: &[Position], samples: &mut Vec<MarkerSample>) -> u32 {
    samples.clear();
    let mut present = 0;
    for (marker, &position_mm) in table.iter().zip(row) {
        let occluded = is_gap(position_mm);
        if !occluded {
            present += 1;
            samples.push(MarkerSample { id: marker.id, position_mm, ..MarkerSample::default() });
        } else if marker.labelled {
            samples.push(MarkerSample { id: marker.id, occluded, ..MarkerSample::default() });
        }
    }
    present
}
