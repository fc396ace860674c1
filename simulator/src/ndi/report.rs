//! Frames as answers: `TX` in text, `BX` and `BX2` in binary.

mod gbf;

use mocapd_drivers::ndi::crc16;
use mocapd_take::motion::{Position, is_gap};

pub(super) use gbf::{Wanted, bx2};

use super::ports::Ports;

/// Reply options of `TX` and `BX`.
const TRANSFORMS: u16 = 0x0001;
const TOOL_INFO: u16 = 0x0002;
const ACTIVE_STRAY: u16 = 0x0004;
const TOOL_MARKERS: u16 = 0x0008;
const STRAYS: u16 = 0x1000;

/// `TX` gives no more strays than this.
const TX_STRAYS_MAX: usize = 50;

/// How well a simulated tool's markers fit it, millimetres.
const FIT_ERROR_MM: f32 = 0.25;

/// What there is to say about a moment.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moment<'a> {
    pub(super) ports: &'a Ports,
    /// A position a marker, millimetres; empty before the first frame.
    pub(super) row: &'a [Position],
    pub(super) number: u32,
    /// The device's clock, nanoseconds.
    pub(super) time_ns: u64,
}

impl Moment<'_> {
    fn tools(&self) -> impl Iterator<Item = (u8, u32, Option<Position>)> {
        self.ports.enabled().map(|port| {
            let position = port.column.and_then(|column| self.row.get(column)).copied();
            (port.handle, port.status(), position.filter(|position| !is_gap(*position)))
        })
    }

    fn strays(&self) -> impl Iterator<Item = Position> {
        let seen = self.row.iter().enumerate().filter(|(_, position)| !is_gap(**position));
        seen.filter(|(column, _)| !self.ports.is_tool(*column)).map(|(_, position)| *position)
    }

    /// The text of an answer to `TX`.
    pub(super) fn tx(&self, mode: u16) -> String {
        let mut text = format!("{:02X}", self.tools().count());
        for (handle, status, position) in self.tools() {
            text.push_str(&format!("{handle:02X}"));
            if mode & TRANSFORMS != 0 {
                match position.and_then(coordinates) {
                    Some(xyz) => {
                        let error = (FIT_ERROR_MM * 1e4) as i32;
                        text.push_str(&format!("+10000+00000+00000+00000{xyz}{error:+06}"));
                    }
                    None => text.push_str("MISSING"),
                }
                text.push_str(&format!("{status:08X}{:08X}", self.number));
            }
            if mode & TOOL_INFO != 0 {
                text.push_str("00000000000000000000");
            }
            if mode & ACTIVE_STRAY != 0 {
                text.push_str("MISSING");
            }
            text.push('\n');
        }
        if mode & STRAYS != 0 {
            let strays: Vec<_> =
                self.strays().filter_map(coordinates).take(TX_STRAYS_MAX).collect();
            text.push_str(&format!("{:02X}", strays.len()));
            text.push_str(&"0".repeat(strays.len().div_ceil(4)));
            text.push_str(&strays.concat());
        }
        text.push_str("0000");
        text
    }

    /// The block of an answer to `BX`.
    pub(super) fn bx(&self, mode: u16) -> Vec<u8> {
        let mut block = vec![self.tools().count() as u8];
        for (handle, status, position) in self.tools() {
            block.extend([handle, if position.is_some() { 1 } else { 2 }]);
            if mode & TRANSFORMS != 0 {
                if let Some(position) = position {
                    transform(position, &mut block);
                }
                block.extend(status.to_le_bytes());
                block.extend(self.number.to_le_bytes());
            }
            if mode & TOOL_INFO != 0 {
                block.extend([0; 11]);
            }
            // No active marker is astray, and none of a tool's own is reported.
            block.extend((mode & ACTIVE_STRAY != 0).then_some(0));
            block.extend((mode & TOOL_MARKERS != 0).then_some(0));
        }
        if mode & STRAYS != 0 {
            let n_strays = self.strays().count();
            block.push(n_strays as u8);
            block.resize(block.len() + n_strays.div_ceil(8), 0);
            self.strays().for_each(|position| coordinate_bytes(position, &mut block));
        }
        block.extend([0, 0]);
        block
    }
}

/// No turn, then the position, then the error.
fn transform(position: Position, block: &mut Vec<u8>) {
    for value in [1.0_f32, 0.0, 0.0, 0.0] {
        block.extend(value.to_le_bytes());
    }
    coordinate_bytes(position, block);
    block.extend(FIT_ERROR_MM.to_le_bytes());
}

fn coordinate_bytes(position: Position, block: &mut Vec<u8>) {
    for value in position {
        block.extend(value.to_le_bytes());
    }
}

/// Three numbers of a sign and six digits, hundredths of a millimetre; `None` where they do not fit.
fn coordinates(position: Position) -> Option<String> {
    let hundredths = position.map(|value| (f64::from(value) * 100.0).round());
    let fits = hundredths.iter().all(|value| value.abs() < 1e6);
    fits.then(|| hundredths.map(|value| format!("{:+07}", value as i64)).concat())
}

/// A binary answer around a block, whose length fits into 16 bits by construction of the device.
pub(super) fn binary(block: &[u8], out: &mut Vec<u8>) {
    let start = out.len();
    out.extend([0xC4, 0xA5]);
    out.extend((block.len() as u16).to_le_bytes());
    let header_crc = crc16(out.get(start..).unwrap_or_default());
    out.extend(header_crc.to_le_bytes());
    out.extend_from_slice(block);
    out.extend(crc16(block).to_le_bytes());
}

/// A text answer.
pub(super) fn text(text: &str, out: &mut Vec<u8>) {
    out.extend_from_slice(text.as_bytes());
    out.extend(format!("{:04X}\r", crc16(text.as_bytes())).into_bytes());
}
