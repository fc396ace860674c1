//! Encoding and decoding of force plates: where each stands, and which sampled channels are its own.

use super::{EncodeError, GROUPS_MAX, PLATES_MAX, SAMPLED_CHANNELS_MAX};
use crate::{
    bytes::{Cursor, WireValue},
    device::{ForcePlateInfo, PlateOutput},
};

/// The reason why a plate is invalid; sender and receiver apply the same rule.
fn plate_error(plate: &ForcePlateInfo) -> Option<&'static str> {
    let mut numbers = plate.corners_mm.iter().flatten().chain(&plate.origin_mm);
    if !(1..=PLATES_MAX).contains(&usize::from(plate.number)) {
        Some("its number is not within 1 to 32")
    } else if usize::from(plate.group) >= GROUPS_MAX {
        Some("the number of its group is not below 16")
    } else if plate.channels.len() != plate.output.n_channels() {
        Some("it has another number of channels than its output")
    } else if plate.channels.iter().any(|&index| usize::from(index) >= SAMPLED_CHANNELS_MAX) {
        Some("the index of a channel is not below 64")
    } else if !numbers.all(|number| number.is_finite()) {
        Some("a corner or the origin is not finite")
    } else {
        None
    }
}

pub(super) fn put_plate(plate: &ForcePlateInfo, out: &mut Vec<u8>) -> Result<(), EncodeError> {
    if let Some(error) = plate_error(plate) {
        return Err(EncodeError::ForcePlate(error));
    }
    out.extend([plate.number, plate.output.code(), plate.group]);
    out.extend_from_slice(&plate.channels);
    for number in plate.corners_mm.iter().flatten().chain(&plate.origin_mm) {
        number.put(out);
    }
    Ok(())
}

/// Decodes a plate into `plate`, reusing its memory. After `None` its contents are unspecified.
pub(super) fn get_plate(payload: &[u8], plate: &mut ForcePlateInfo) -> Option<()> {
    let mut cursor = Cursor::new(payload);
    plate.number = cursor.get()?;
    let code: u8 = cursor.get()?;
    plate.output = PlateOutput::ALL.into_iter().find(|output| output.code() == code)?;
    plate.group = cursor.get()?;
    let channels = cursor.bytes(plate.output.n_channels())?;
    plate.channels.clear();
    plate.channels.extend_from_slice(channels);
    for number in plate.corners_mm.iter_mut().flatten().chain(&mut plate.origin_mm) {
        *number = cursor.get()?;
    }
    cursor.end(()).filter(|()| plate_error(plate).is_none())
}
