//! The General Binary Format of `BX2`.

use super::{Moment, coordinate_bytes, transform};

const VERSION: u16 = 1;
const FRAME: u16 = 1;
const DATA_6D: u16 = 2;
const DATA_3D: u16 = 3;

/// Frames of passive markers.
const PASSIVE: u8 = 2;

/// The handle under which strays are listed.
const STRAYS: u16 = 0xFFFF;

const MISSING: u16 = 0x0100;

const COMPONENT_HEADER: usize = 12;

const SECOND_NS: u64 = 1_000_000_000;

/// What the options of `BX2` ask for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Wanted {
    tools: bool,
    strays: bool,
}

impl Wanted {
    /// `None` when an option is not known.
    pub(crate) fn of(options: &str) -> Option<Self> {
        let mut wanted = Self { tools: true, strays: false };
        for option in options.split_ascii_whitespace() {
            match option {
                "--6d=tools" => wanted.tools = true,
                "--6d=none" => wanted.tools = false,
                "--3d=strays" | "--3d=all" => wanted.strays = true,
                "--3d=tools" | "--3d=none" => wanted.strays = false,
                "--1d=none" | "--1d=buttons" | "--sensor=none" => {}
                _ => return None,
            }
        }
        Some(wanted)
    }
}

/// The block of an answer; `None` when nothing is new since the last one.
pub(crate) fn bx2(moment: Option<&Moment<'_>>, wanted: Wanted, sequence: u8) -> Vec<u8> {
    let mut block = Vec::new();
    container(moment.is_some().into(), &mut block);
    let Some(moment) = moment else { return block };
    component(FRAME, 1, &mut block, |block| {
        block.extend([PASSIVE, sequence, 0, 0]);
        block.extend(moment.number.to_le_bytes());
        block.extend(((moment.time_ns / SECOND_NS) as u32).to_le_bytes());
        block.extend(((moment.time_ns % SECOND_NS) as u32).to_le_bytes());
        container(u16::from(wanted.tools) + u16::from(wanted.strays), block);
        if wanted.tools {
            component(DATA_6D, moment.tools().count(), block, |block| data_6d(moment, block));
        }
        if wanted.strays {
            component(DATA_3D, 1, block, |block| data_3d(moment, block));
        }
    });
    block
}

fn container(components: u16, block: &mut Vec<u8>) {
    block.extend(VERSION.to_le_bytes());
    block.extend(components.to_le_bytes());
}

/// A header that knows the size of what `body` writes, and that.
fn component(kind: u16, items: usize, block: &mut Vec<u8>, body: impl FnOnce(&mut Vec<u8>)) {
    let mut inside = Vec::new();
    body(&mut inside);
    block.extend(kind.to_le_bytes());
    block.extend(((COMPONENT_HEADER + inside.len()) as u32).to_le_bytes());
    block.extend(0_u16.to_le_bytes());
    block.extend((items as u32).to_le_bytes());
    block.extend(inside);
}

fn data_6d(moment: &Moment<'_>, block: &mut Vec<u8>) {
    for (handle, _, position) in moment.tools() {
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

fn data_3d(moment: &Moment<'_>, block: &mut Vec<u8>) {
    block.extend(STRAYS.to_le_bytes());
    block.extend((moment.strays().count() as u16).to_le_bytes());
    for (index, position) in (0_u16..).zip(moment.strays()) {
        block.extend([0, 0]);
        block.extend(index.to_le_bytes());
        coordinate_bytes(position, block);
    }
}
