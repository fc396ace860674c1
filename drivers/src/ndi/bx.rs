//! `BX`: one block for everything, in the order of port handles.

use super::{cursor::Cursor, seen::Seen};

/// Reply options: transforms and status (1), stray passive markers (0x1000). Without 0x0800 the
/// device leaves out what lies outside its volume, where it vouches for no accuracy.
pub(super) const REQUEST: &str = "BX:1001";

const VALID: u8 = 1;
const MISSING: u8 = 2;
const DISABLED: u8 = 4;

/// Bytes of a block with so many tools and strays.
pub(super) const fn block_bytes(tools: usize, strays: usize) -> usize {
    1 + tools * (2 + 8 * 4 + 4 + 4) + 1 + strays.div_ceil(8) + strays * (3 * 4) + 2
}

/// Reads the answer to [`REQUEST`]; `None` when it is none.
pub(super) fn read(block: &[u8], seen: &mut Seen) -> Option<()> {
    seen.clear();
    let mut block = Cursor(block);
    for _ in 0..block.u8()? {
        let handle = block.u8()?;
        let status = block.u8()?;
        let found = match status {
            VALID => {
                // The quaternion is not kept: see docs/ndi.md.
                block.take(4 * 4)?;
                let position_mm = block.position()?;
                Some((position_mm, block.f32()?))
            }
            MISSING => None,
            // Nothing follows.
            DISABLED => continue,
            _ => return None,
        };
        let _port_status = block.u32()?;
        seen.number(block.u32()?, None);
        seen.tool(handle, found);
    }
    let n_strays = usize::from(block.u8()?);
    let _out_of_volume = block.take(n_strays.div_ceil(8))?;
    for _ in 0..n_strays {
        seen.stray(block.position()?);
    }
    let _system_status = block.u16()?;
    block.is_empty().then_some(())
}
