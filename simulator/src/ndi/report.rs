//! Encodes frames as answers: `TX` in text, `BX` and `BX2` in binary.

use mocapd_take::motion::{Position, is_gap};

use super::Ports;

/// Reply options of `TX` and `BX`.
const TRANSFORMS: u16 = 0x0001;
const TOOL_INFO: u16 = 0x0002;
const ACTIVE_STRAY: u16 = 0x0004;
const TOOL_MARKERS: u16 = 0x0008;
const STRAYS: u16 = 0x1000;

/// Maximum number of strays in an answer to `TX`.
const TX_STRAYS_MAX: usize = 50;

/// Fit error of every simulated tool, millimetres.
const FIT_ERROR_MM: f32 = 0.25;

/// One frame, with the ports that determine what is reported.
#[derive(Debug, Clone, Copy)]
pub(super) struct FrameReport<'a> {
    pub(super) ports: &'a Ports,
    /// One position per marker, millimetres; empty before the first frame.
    pub(super) row: &'a [Position],
    pub(super) number: u32,
    /// The device's clock, nanoseconds.
    pub(super) time_ns: u64,
}

/// An enabled tool in one frame.
struct Tool {
    handle: u8,
    status: u32,
    position: Option<Position>,
}

impl FrameReport<'_> {
    fn tools(&self) -> impl Iterator<Item = Tool> {
        self.ports.enabled().map(|port| {
            let position = port.column.and_then(|column| self.row.get(column)).copied();
            let position = position.filter(|position| !is_gap(*position));
            Tool { handle: port.handle, status: port.status(), position }
        })
    }

    fn strays(&self) -> impl Iterator<Item = Position> {
        let seen = self.row.iter().enumerate().filter(|(_, position)| !is_gap(**position));
        seen.filter(|(column, _)| !self.ports.is_tool(*column)).map(|(_, position)| *position)
    }

    /// The text of an answer to `TX`.
    pub(super) fn tx(&self, mode: u16) -> String {
        let mut text = format!("{:02X}", self.tools().count());
        for Tool { handle, status, position } in self.tools() {
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
        for Tool { handle, status, position } in self.tools() {
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
            // No active strays, and no single markers of a tool.
            block.extend((mode & ACTIVE_STRAY != 0).then_some(0));
            block.extend((mode & TOOL_MARKERS != 0).then_some(0));
        }
        if mode & STRAYS != 0 {
            let n_strays = self.strays().count();
            block.push(n_strays as u8);
            block.resize(block.len() + n_strays.div_ceil(8), 0);
            self.strays().for_each(|position| floats(&position, &mut block));
        }
        block.extend([0, 0]);
        block
    }
}

/// Appends the identity rotation, the position and the fit error.
fn transform([x, y, z]: Position, block: &mut Vec<u8>) {
    floats(&[1.0, 0.0, 0.0, 0.0, x, y, z, FIT_ERROR_MM], block);
}

fn floats(values: &[f32], block: &mut Vec<u8>) {
    block.extend(values.iter().flat_map(|value| value.to_le_bytes()));
}

/// Three numbers with sign and six digits, in hundredths of a millimetre; `None` when one does not fit.
fn coordinates(position: Position) -> Option<String> {
    let hundredths = position.map(|value| (f64::from(value) * 100.0).round());
    let fits = hundredths.iter().all(|value| value.abs() < 1e6);
    fits.then(|| hundredths.map(|value| format!("{:+07}", value as i64)).concat())
}

// The General Binary Format of `BX2`.

const VERSION: u16 = 1;
const FRAME: u16 = 1;
const DATA_6D: u16 = 2;
const DATA_3D: u16 = 3;

/// Frame type of passive markers.
const PASSIVE: u8 = 2;

/// The handle of the list of strays.
const STRAYS_HANDLE: u16 = 0xFFFF;

const MISSING: u16 = 0x0100;

const COMPONENT_HEADER: usize = 12;

const SECOND_NS: u64 = 1_000_000_000;

/// Options of `BX2`: what an answer contains.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Bx2Options {
    tools: bool,
    strays: bool,
}

impl Bx2Options {
    /// Parses the options; `None` if one is unknown.
    pub(super) fn of(options: &str) -> Option<Self> {
        let mut parsed = Self { tools: true, strays: false };
        for option in options.split_ascii_whitespace() {
            match option {
                "--6d=tools" => parsed.tools = true,
                "--6d=none" => parsed.tools = false,
                "--3d=strays" | "--3d=all" => parsed.strays = true,
                "--3d=tools" | "--3d=none" => parsed.strays = false,
                "--1d=none" | "--1d=buttons" | "--sensor=none" => {}
                _ => return None,
            }
        }
        Some(parsed)
    }
}

/// The block of an answer to `BX2`; without a report, that of an answer with no new frame.
pub(super) fn bx2(report: Option<&FrameReport<'_>>, options: Bx2Options, sequence: u8) -> Vec<u8> {
    let mut block = Vec::new();
    container(report.is_some().into(), &mut block);
    let Some(report) = report else { return block };
    component(FRAME, 1, &mut block, |block| {
        block.extend([PASSIVE, sequence, 0, 0]);
        block.extend(report.number.to_le_bytes());
        block.extend(((report.time_ns / SECOND_NS) as u32).to_le_bytes());
        block.extend(((report.time_ns % SECOND_NS) as u32).to_le_bytes());
        container(u16::from(options.tools) + u16::from(options.strays), block);
        if options.tools {
            component(DATA_6D, report.tools().count(), block, |block| data_6d(report, block));
        }
        if options.strays {
            component(DATA_3D, 1, block, |block| data_3d(report, block));
        }
    });
    block
}

fn container(components: u16, block: &mut Vec<u8>) {
    block.extend(VERSION.to_le_bytes());
    block.extend(components.to_le_bytes());
}

/// Appends a component: its header, with the size, and what `body` writes.
fn component(kind: u16, items: usize, block: &mut Vec<u8>, body: impl FnOnce(&mut Vec<u8>)) {
    let mut inside = Vec::new();
    body(&mut inside);
    block.extend(kind.to_le_bytes());
    block.extend(((COMPONENT_HEADER + inside.len()) as u32).to_le_bytes());
    block.extend(0_u16.to_le_bytes());
    block.extend((items as u32).to_le_bytes());
    block.extend(inside);
}

fn data_6d(report: &FrameReport<'_>, block: &mut Vec<u8>) {
    for Tool { handle, position, .. } in report.tools() {
        block.extend(u16::from(handle).to_le_bytes());
        match position {
            Some(position) => {
                block.extend(0_u16.to_le_bytes());
                transform(position, block);
            }
            None => block.extend(MISSING.to_le_bytes()),
        }
    }
}

fn data_3d(report: &FrameReport<'_>, block: &mut Vec<u8>) {
    block.extend(STRAYS_HANDLE.to_le_bytes());
    block.extend((report.strays().count() as u16).to_le_bytes());
    for (index, position) in (0_u16..).zip(report.strays()) {
        block.extend([0, 0]);
        block.extend(index.to_le_bytes());
        floats(&position, block);
    }
}
