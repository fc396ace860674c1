//! The payloads of everything but frames, both ways.

use super::{
    cursor::Cursor,
    error::EncodeError,
    kind,
    limits::{LABEL_BYTES_MAX, MARKERS_MAX, TEXT_BYTES_MAX},
};
use crate::device::{Command, Hello, LinkBudget, MarkerInfo, Pong, Status, Trigger};

const LABELLED: u8 = 1;

/// What makes a Hello unusable: the same rule for the side that writes and the side that reads.
fn hello_fault(hello: &Hello) -> Option<&'static str> {
    if hello.tick_hz == 0 {
        Some("tick_hz is 0; a clock must tick")
    } else if hello.rate_mhz == 0 {
        Some("rate_mhz is 0; give the rate that Start would run at")
    } else if !(hello.rate_min_mhz..=hello.rate_max_mhz).contains(&hello.rate_mhz) {
        Some("rate_mhz is outside rate_min_mhz..=rate_max_mhz")
    } else if hello.up_axis > 3 {
        Some("up_axis is none of 0 (unknown), 1 (x), 2 (y), 3 (z)")
    } else if usize::from(hello.markers_max) > MARKERS_MAX {
        Some("markers_max is above the link's 10000")
    } else {
        None
    }
}

fn put_text(
    what: &'static str,
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
        _ => Err(EncodeError::Text { what, text: text.to_owned(), bytes_max }),
    }
}

pub(super) fn put_hello(hello: &Hello, out: &mut Vec<u8>) -> Result<(), EncodeError> {
    if let Some(fault) = hello_fault(hello) {
        return Err(EncodeError::Hello(fault));
    }
    out.extend_from_slice(&hello.rate_mhz.to_le_bytes());
    out.extend_from_slice(&hello.rate_min_mhz.to_le_bytes());
    out.extend_from_slice(&hello.rate_max_mhz.to_le_bytes());
    out.extend_from_slice(&hello.tick_hz.to_le_bytes());
    out.push(hello.up_axis);
    out.extend_from_slice(&hello.markers_max.to_le_bytes());
    out.extend_from_slice(&hello.n_frames.to_le_bytes());
    put_text("model", &hello.model, TEXT_BYTES_MAX, out)?;
    put_text("serial", &hello.serial, TEXT_BYTES_MAX, out)?;
    put_text("firmware", &hello.firmware, TEXT_BYTES_MAX, out)
}

/// Replaces `hello` by that of a message, in its memory. It is worth nothing after `None`.
pub(super) fn get_hello(payload: &[u8], hello: &mut Hello) -> Option<()> {
    let mut cursor = Cursor::new(payload);
    hello.rate_mhz = cursor.u32()?;
    hello.rate_min_mhz = cursor.u32()?;
    hello.rate_max_mhz = cursor.u32()?;
    hello.tick_hz = cursor.u64()?;
    hello.up_axis = cursor.u8()?;
    hello.markers_max = cursor.u16()?;
    hello.n_frames = cursor.u64()?;
    for text in [&mut hello.model, &mut hello.serial, &mut hello.firmware] {
        replace(text, cursor.text(TEXT_BYTES_MAX)?);
    }
    cursor.end(()).filter(|()| hello_fault(hello).is_none())
}

fn replace(text: &mut String, by: &str) {
    text.clear();
    text.push_str(by);
}

/// Bytes that a marker takes in a Markers message.
pub(super) fn marker_info_bytes(marker: &MarkerInfo) -> usize {
    2 + 1 + 1 + marker.label.len()
}

pub(super) fn put_marker_info(marker: &MarkerInfo, out: &mut Vec<u8>) -> Result<(), EncodeError> {
    out.extend_from_slice(&marker.id.to_le_bytes());
    out.push(if marker.labelled { LABELLED } else { 0 });
    put_text("label", &marker.label, LABEL_BYTES_MAX, out)
}

/// Writes the markers of a message over the first ones of `markers`, in their memory, and gives
/// their number. Those behind are of no meaning; they stay for the memory of their labels.
pub(super) fn get_markers(payload: &[u8], markers: &mut Vec<MarkerInfo>) -> Option<usize> {
    let mut cursor = Cursor::new(payload);
    let n = usize::from(cursor.u16()?);
    if n > MARKERS_MAX {
        return None;
    }
    for index in 0..n {
        let id = cursor.u16()?;
        let flags = cursor.u8()?;
        let label = cursor.text(LABEL_BYTES_MAX)?;
        if flags & !LABELLED != 0 {
            return None;
        }
        let labelled = flags & LABELLED != 0;
        if let Some(marker) = markers.get_mut(index) {
            (marker.id, marker.labelled) = (id, labelled);
            replace(&mut marker.label, label);
        } else {
            markers.push(MarkerInfo { id, label: label.to_owned(), labelled });
        }
    }
    cursor.end(n)
}

pub(super) fn status_bytes(status: Status) -> [u8; 18] {
    let mut bytes = [0; 18];
    bytes[..8].copy_from_slice(&status.frames_produced.to_le_bytes());
    bytes[8..16].copy_from_slice(&status.frames_dropped.to_le_bytes());
    bytes[16..].copy_from_slice(&status.temperature_c_100.to_le_bytes());
    bytes
}

pub(super) fn get_status(payload: &[u8]) -> Option<Status> {
    let mut cursor = Cursor::new(payload);
    let status = Status {
        frames_produced: cursor.u64()?,
        frames_dropped: cursor.u64()?,
        temperature_c_100: cursor.i16()?,
    };
    cursor.end(status)
}

pub(super) fn get_trigger(payload: &[u8]) -> Option<Trigger> {
    let mut cursor = Cursor::new(payload);
    let trigger = Trigger { device_ticks: cursor.u64()?, input: cursor.u8()?, kind: cursor.u8()? };
    cursor.end(trigger)
}

pub(super) fn get_pong(payload: &[u8]) -> Option<Pong> {
    let mut cursor = Cursor::new(payload);
    let pong = Pong { host_ns: cursor.u64()?, device_ticks: cursor.u64()? };
    cursor.end(pong)
}

pub(super) fn budget_bytes(budget: LinkBudget) -> [u8; 20] {
    let mut bytes = [0; 20];
    bytes[..8].copy_from_slice(&budget.needed_bytes_per_s.to_le_bytes());
    bytes[8..16].copy_from_slice(&budget.available_bytes_per_s.to_le_bytes());
    bytes[16..].copy_from_slice(&budget.rate_fits_mhz.to_le_bytes());
    bytes
}

pub(super) fn get_budget(payload: &[u8]) -> Option<LinkBudget> {
    let mut cursor = Cursor::new(payload);
    let budget = LinkBudget {
        needed_bytes_per_s: cursor.u64()?,
        available_bytes_per_s: cursor.u64()?,
        rate_fits_mhz: cursor.u32()?,
    };
    cursor.end(budget)
}

pub(super) fn get_rate(payload: &[u8]) -> Option<u32> {
    let mut cursor = Cursor::new(payload);
    let rate_mhz = cursor.u32()?;
    cursor.end(rate_mhz)
}

/// `None` for a type that is no command, `Some(None)` for one whose payload cannot be one.
pub(super) fn get_command(kind: u8, payload: &[u8]) -> Option<Option<Command>> {
    let mut cursor = Cursor::new(payload);
    let command = match kind {
        kind::IDENTIFY => Some(Command::Identify),
        kind::START => cursor.u64().map(|line_bytes_per_s| Command::Start { line_bytes_per_s }),
        kind::STOP => Some(Command::Stop),
        kind::SET_RATE => cursor.u32().map(Command::SetRate),
        kind::PING => cursor.u64().map(|host_ns| Command::Ping { host_ns }),
        _ => return None,
    };
    Some(command.and_then(|command| cursor.end(command)))
}
