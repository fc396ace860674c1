//! Encoding and decoding of all payloads except frames, in both directions.

use super::{EncodeError, LABEL_BYTES_MAX, MARKERS_MAX, TEXT_BYTES_MAX};
use crate::{
    bytes::{Cursor, WireValue, wire_struct},
    device::{Command, Hello, LinkBudget, MarkerInfo, Pong, Status, Trigger},
};

/// Type bytes of the messages.
pub(super) mod kind {
    pub(in crate::link) const HELLO: u8 = 0x01;
    pub(in crate::link) const MARKERS: u8 = 0x02;
    pub(in crate::link) const SAMPLED_GROUP: u8 = 0x03;
    pub(in crate::link) const BODIES: u8 = 0x04;
    pub(in crate::link) const FORCE_PLATE: u8 = 0x05;
    pub(in crate::link) const FRAME_FLOAT: u8 = 0x10;
    pub(in crate::link) const FRAME_MICROMETRES: u8 = 0x11;
    pub(in crate::link) const FRAME_COMPACT: u8 = 0x12;
    pub(in crate::link) const SAMPLES: u8 = 0x13;
    pub(in crate::link) const POSES: u8 = 0x14;
    pub(in crate::link) const TRIGGER: u8 = 0x20;
    pub(in crate::link) const STATUS: u8 = 0x21;
    pub(in crate::link) const END_OF_STREAM: u8 = 0x22;
    pub(in crate::link) const PONG: u8 = 0x30;
    pub(in crate::link) const STARTED: u8 = 0x31;
    pub(in crate::link) const REFUSED: u8 = 0x32;
    pub(in crate::link) const RATE_SET: u8 = 0x33;

    pub(in crate::link) const IDENTIFY: u8 = 0x80;
    pub(in crate::link) const START: u8 = 0x81;
    pub(in crate::link) const STOP: u8 = 0x82;
    pub(in crate::link) const SET_RATE: u8 = 0x83;
    pub(in crate::link) const PING: u8 = 0x84;
}

const LABELLED: u8 = 1;

wire_struct!(Status { frames_produced, frames_dropped, temperature_c_100 });
wire_struct!(Trigger { device_ticks, input, kind });
wire_struct!(Pong { host_ns, device_ticks });
wire_struct!(LinkBudget { needed_bytes_per_s, available_bytes_per_s, rate_fits_millihertz });

/// The reason why a Hello is invalid; sender and receiver apply the same rule.
fn hello_error(hello: &Hello) -> Option<&'static str> {
    let rates_millihertz = hello.rate_min_millihertz..=hello.rate_max_millihertz;
    if hello.tick_hz == 0 {
        Some("tick_hz is 0: give the ticks per second of the device clock")
    } else if hello.rate_millihertz == 0 {
        Some("rate_millihertz is 0: give the frame rate of the next Start")
    } else if !rates_millihertz.contains(&hello.rate_millihertz) {
        Some("rate_millihertz is not within rate_min_millihertz..=rate_max_millihertz")
    } else if hello.up_axis > 3 {
        Some("up_axis is not one of 0 (unknown), 1 (x), 2 (y), 3 (z)")
    } else if usize::from(hello.markers_max) > MARKERS_MAX {
        Some("markers_max exceeds the link's limit of 10000")
    } else {
        None
    }
}

pub(super) fn put_text(
    field: &'static str,
    text: &str,
    bytes_max: usize,
    out: &mut Vec<u8>,
) -> Result<(), EncodeError> {
    match u8::try_from(text.len()) {
        Ok(n) if text.len() <= bytes_max && !text.contains(char::is_control) => {
            out.push(n);
            out.extend_from_slice(text.as_bytes());
            Ok(())
        }
        _ => Err(EncodeError::Text { field, text: text.to_owned(), bytes_max }),
    }
}

pub(super) fn put_hello(hello: &Hello, out: &mut Vec<u8>) -> Result<(), EncodeError> {
    if let Some(error) = hello_error(hello) {
        return Err(EncodeError::Hello(error));
    }
    hello.rate_millihertz.put(out);
    hello.rate_min_millihertz.put(out);
    hello.rate_max_millihertz.put(out);
    hello.tick_hz.put(out);
    hello.up_axis.put(out);
    hello.markers_max.put(out);
    hello.n_frames.put(out);
    put_text("model", &hello.model, TEXT_BYTES_MAX, out)?;
    put_text("serial", &hello.serial, TEXT_BYTES_MAX, out)?;
    put_text("firmware", &hello.firmware, TEXT_BYTES_MAX, out)
}

/// Decodes a Hello into `hello`, reusing its memory. After `None` its contents are unspecified.
pub(super) fn get_hello(payload: &[u8], hello: &mut Hello) -> Option<()> {
    let mut cursor = Cursor::new(payload);
    hello.rate_millihertz = cursor.get()?;
    hello.rate_min_millihertz = cursor.get()?;
    hello.rate_max_millihertz = cursor.get()?;
    hello.tick_hz = cursor.get()?;
    hello.up_axis = cursor.get()?;
    hello.markers_max = cursor.get()?;
    hello.n_frames = cursor.get()?;
    for text in [&mut hello.model, &mut hello.serial, &mut hello.firmware] {
        cursor.text(TEXT_BYTES_MAX)?.clone_into(text);
    }
    cursor.end(()).filter(|()| hello_error(hello).is_none())
}

/// Bytes of a marker in a Markers message.
pub(super) fn marker_info_bytes(marker: &MarkerInfo) -> usize {
    2 + 1 + 1 + marker.label.len()
}

pub(super) fn put_marker_info(marker: &MarkerInfo, out: &mut Vec<u8>) -> Result<(), EncodeError> {
    marker.id.put(out);
    out.push(if marker.labelled { LABELLED } else { 0 });
    put_text("label", &marker.label, LABEL_BYTES_MAX, out)
}

/// Decodes a Markers message over the first entries of `markers`, reusing their memory, and returns them.
/// Later entries are stale; they only keep the memory of their labels.
pub(super) fn get_markers<'a>(
    payload: &[u8],
    markers: &'a mut Vec<MarkerInfo>,
) -> Option<&'a [MarkerInfo]> {
    let mut cursor = Cursor::new(payload);
    let n = usize::from(cursor.get::<u16>()?);
    if n > MARKERS_MAX {
        return None;
    }
    for index in 0..n {
        let (id, flags) = (cursor.get()?, cursor.get::<u8>()?);
        let label = cursor.text(LABEL_BYTES_MAX)?;
        if flags & !LABELLED != 0 {
            return None;
        }
        let labelled = flags & LABELLED != 0;
        if let Some(marker) = markers.get_mut(index) {
            (marker.id, marker.labelled) = (id, labelled);
            label.clone_into(&mut marker.label);
        } else {
            markers.push(MarkerInfo { id, label: label.to_owned(), labelled });
        }
    }
    cursor.end(markers.get(..n)?)
}

/// Decodes a command: `None` for an unknown type, `Some(None)` for an invalid payload.
pub(super) fn get_command(kind: u8, payload: &[u8]) -> Option<Option<Command>> {
    Some(match kind {
        kind::IDENTIFY => WireValue::decode(payload).map(|()| Command::Identify),
        kind::START => WireValue::decode(payload).map(|n| Command::Start { line_bytes_per_s: n }),
        kind::STOP => WireValue::decode(payload).map(|()| Command::Stop),
        kind::SET_RATE => WireValue::decode(payload).map(Command::SetRate),
        kind::PING => WireValue::decode(payload).map(|host_ns| Command::Ping { host_ns }),
        _ => return None,
    })
}
