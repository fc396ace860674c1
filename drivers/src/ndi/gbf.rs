//! `BX2`: the General Binary Format, containers of components of items.

use super::{cursor::Cursor, seen::Seen};

/// Tools as 6D, markers that belong to none as 3D.
pub(super) const REQUEST: &str = "BX2 --6d=tools --3d=strays";

const VERSION: u16 = 1;

const FRAME: u16 = 1;
const DATA_6D: u16 = 2;
const DATA_3D: u16 = 3;

/// The handle under which strays are listed.
const STRAYS: u16 = 0xFFFF;

/// In the status of a 6D item: nothing follows.
const MISSING_6D: u16 = 0x0100;
const CODE_6D: u16 = 0x00FF;

/// In the status of a 3D item: nothing follows.
const MISSING_3D: u8 = 1;

const SECOND_NS: u64 = 1_000_000_000;

/// Bytes of a block with so many tools and strays: a container, a frame with its item and container,
/// 6D items, a list of strays.
pub(super) const fn block_bytes(tools: usize, strays: usize) -> usize {
    4 + 12 + 16 + 4 + 12 + tools * (4 + 8 * 4) + 12 + 4 + strays * (4 + 3 * 4)
}

/// Reads the answer to [`REQUEST`]; `None` when it is none.
pub(super) fn read(block: &[u8], seen: &mut Seen) -> Option<()> {
    seen.clear();
    let mut block = Cursor(block);
    for _ in 0..container(&mut block)? {
        let Component { kind, items, mut body } = component(&mut block)?;
        if kind == FRAME {
            for _ in 0..items {
                frame_item(&mut body, seen)?;
            }
            body.is_empty().then_some(())?;
        }
    }
    block.is_empty().then_some(())
}

/// The number of components.
fn container(from: &mut Cursor<'_>) -> Option<u16> {
    (from.u16()? == VERSION).then_some(())?;
    from.u16()
}

struct Component<'a> {
    kind: u16,
    items: u32,
    body: Cursor<'a>,
}

fn component<'a>(from: &mut Cursor<'a>) -> Option<Component<'a>> {
    const HEADER: usize = 12;
    let kind = from.u16()?;
    let bytes = usize::try_from(from.u32()?).ok()?;
    let _format_option = from.u16()?;
    let items = from.u32()?;
    let body = Cursor(from.take(bytes.checked_sub(HEADER)?)?);
    Some(Component { kind, items, body })
}

/// Passive, active and wireless tools have an item each, when there are such.
fn frame_item(from: &mut Cursor<'_>, seen: &mut Seen) -> Option<()> {
    let _kind_and_sequence = from.u16()?;
    let _status = from.u16()?;
    let number = from.u32()?;
    let (seconds, ns) = (from.u32()?, from.u32()?);
    seen.number(number, Some(u64::from(seconds) * SECOND_NS + u64::from(ns)));
    for _ in 0..container(from)? {
        let Component { kind, items, mut body } = component(from)?;
        match kind {
            DATA_6D => data_6d(items, &mut body, seen)?,
            DATA_3D => data_3d(items, &mut body, seen)?,
            // Buttons, alerts, images: not kept.
            _ => continue,
        }
        body.is_empty().then_some(())?;
    }
    Some(())
}

fn data_6d(items: u32, body: &mut Cursor<'_>, seen: &mut Seen) -> Option<()> {
    for _ in 0..items {
        let (handle, status) = (body.u16()?, body.u16()?);
        let mut found = None;
        if status & MISSING_6D == 0 {
            body.take(4 * 4)?;
            let position_mm = body.position()?;
            let error_mm = body.f32()?;
            // Any other code says what is doubtful about the position.
            found = (status & CODE_6D == 0).then_some((position_mm, error_mm));
        }
        seen.tool(u8::try_from(handle).ok()?, found);
    }
    Some(())
}

fn data_3d(items: u32, body: &mut Cursor<'_>, seen: &mut Seen) -> Option<()> {
    for _ in 0..items {
        let (handle, n_markers) = (body.u16()?, body.u16()?);
        for _ in 0..n_markers {
            let status = body.u8()?;
            let _reserved = body.u8()?;
            let _index = body.u16()?;
            if status == MISSING_3D {
                continue;
            }
            let position_mm = body.position()?;
            // Out of volume, saturated, a possible phantom: the device does not vouch for these.
            if status == 0 && handle == STRAYS {
                seen.stray(position_mm);
            }
        }
    }
    Some(())
}
