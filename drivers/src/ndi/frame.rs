//! Parsing of the two kinds of poll replies, `BX` and `BX2`.

use crate::{
    bytes::Cursor,
    device::{BODIES_MAX, MarkerSample, Pose, PoseStatus},
};

/// Coordinates below this are the vendor's code for a missing number (-3.697314e28).
const BAD_FLOAT: f32 = -3.0e28;

/// Maximum number of stray markers of a frame that get numbers of their own: what `BX` can count.
pub(super) const STRAYS_MAX: usize = 255;

/// Maximum number of tools: port handles have 8 bits.
pub(super) const TOOLS_MAX: usize = 256;

/// A parsed frame. Its memory is reused for the next.
#[derive(Debug)]
pub(super) struct FrameData {
    /// The device's frame number; `None` when the reply has no frame.
    pub(super) number: Option<u32>,
    /// Device time at exposure in nanoseconds; `BX2` only.
    pub(super) time_ns: Option<u64>,
    /// One sample per tool, with its port handle as id.
    pub(super) tools: Vec<MarkerSample>,
    /// Their poses, of the first [`BODIES_MAX`] of the reply.
    pub(super) poses: Vec<Pose>,
    /// Positions of markers that belong to no tool, in millimetres and in the device's order.
    pub(super) strays: Vec<[f32; 3]>,
    /// Number of strays beyond [`STRAYS_MAX`].
    pub(super) strays_excess: usize,
    /// Number of positions that were not finite.
    pub(super) not_finite: u64,
}

impl FrameData {
    pub(super) fn new() -> Self {
        Self {
            number: None,
            time_ns: None,
            tools: Vec::with_capacity(TOOLS_MAX),
            poses: Vec::with_capacity(BODIES_MAX),
            strays: Vec::with_capacity(STRAYS_MAX),
            strays_excess: 0,
            not_finite: 0,
        }
    }

    pub(super) fn clear(&mut self) {
        self.number = None;
        self.time_ns = None;
        self.tools.clear();
        self.poses.clear();
        self.strays.clear();
        self.strays_excess = 0;
        self.not_finite = 0;
    }

    /// Sets the frame number. A frame in several parts has the newest of their numbers.
    pub(super) fn set_number(&mut self, number: u32, time_ns: Option<u64>) {
        let newer = self.number.is_none_or(|known| number.wrapping_sub(known).cast_signed() > 0);
        if newer {
            self.number = Some(number);
            self.time_ns = time_ns;
        }
    }

    /// Adds a tool: its pose, and a marker at its origin.
    pub(super) fn push_tool(&mut self, pose: Pose) {
        if self.tools.len() >= TOOLS_MAX {
            return;
        }
        let id = pose.body;
        let is_seen = pose.status == PoseStatus::Tracked && self.is_position(pose.position_mm);
        self.tools.push(if is_seen {
            MarkerSample {
                id,
                occluded: false,
                // 0 means that no residual is reported; NaN becomes 0.
                residual_10um: (pose.residual_mm * 100.0).round().clamp(1.0, 255.0) as u8,
                position_mm: pose.position_mm,
            }
        } else {
            MarkerSample { id, occluded: true, ..MarkerSample::default() }
        });
        if self.poses.len() < BODIES_MAX {
            let is_missing = pose.status == PoseStatus::Tracked && !is_seen;
            let pose = if is_missing { Pose::without(id, PoseStatus::Lost) } else { pose };
            self.poses.push(pose.checked());
        }
    }

    pub(super) fn push_stray(&mut self, position_mm: [f32; 3]) {
        if !self.is_position(position_mm) {
            return;
        }
        if self.strays.len() < STRAYS_MAX {
            self.strays.push(position_mm);
        } else {
            self.strays_excess += 1;
        }
    }

    fn is_position(&mut self, position_mm: [f32; 3]) -> bool {
        let finite = position_mm.iter().all(|value| value.is_finite());
        self.not_finite += u64::from(!finite);
        finite && position_mm.iter().all(|value| *value > BAD_FLOAT)
    }
}

// `BX`: a single block, in the order of port handles.

/// Reply options: transforms and status (1), stray passive markers (0x1000). Without 0x0800 the device
/// omits what lies outside its characterised volume, where its accuracy is not guaranteed.
pub(super) const BX_REQUEST: &str = "BX:1001";

const VALID: u8 = 1;
const MISSING: u8 = 2;
const DISABLED: u8 = 4;

/// Bytes of a `BX` block with this many tools and strays.
pub(super) const fn bx_block_bytes(tools: usize, strays: usize) -> usize {
    1 + tools * (2 + 8 * 4 + 4 + 4) + 1 + strays.div_ceil(8) + strays * (3 * 4) + 2
}

/// Parses the reply to [`BX_REQUEST`]; `None` when it is invalid.
pub(super) fn read_bx(block: &[u8], frame: &mut FrameData) -> Option<()> {
    frame.clear();
    let mut block = Cursor::new(block);
    for _ in 0..block.get::<u8>()? {
        let handle = block.get::<u8>()?;
        let status = block.get::<u8>()?;
        let pose = match status {
            VALID => tracked(handle.into(), &mut block)?,
            MISSING => Pose::without(handle.into(), PoseStatus::Lost),
            // No data follow.
            DISABLED => continue,
            _ => return None,
        };
        let _port_status = block.get::<u32>()?;
        frame.set_number(block.get::<u32>()?, None);
        frame.push_tool(pose);
    }
    let n_strays = usize::from(block.get::<u8>()?);
    let _out_of_volume = block.bytes(n_strays.div_ceil(8))?;
    for _ in 0..n_strays {
        frame.push_stray(block.get()?);
    }
    let _system_status = block.get::<u16>()?;
    block.end(())
}

/// Parses the pose of a tool: a quaternion w, x, y, z, the position, and the fit error, both in millimetres.
fn tracked(body: u16, from: &mut Cursor<'_>) -> Option<Pose> {
    let quaternion = [from.get()?, from.get()?, from.get()?, from.get()?];
    let (position_mm, residual_mm) = (from.get()?, from.get()?);
    Some(Pose { body, status: PoseStatus::Tracked, position_mm, quaternion, residual_mm })
}

// `BX2`: the General Binary Format, containers of components of items.

/// Requests tools as 6D data, and markers that belong to none as 3D data.
pub(super) const BX2_REQUEST: &str = "BX2 --6d=tools --3d=strays";

const VERSION: u16 = 1;

const FRAME: u16 = 1;
const DATA_6D: u16 = 2;
const DATA_3D: u16 = 3;

/// Handle of the list of strays.
const STRAYS_HANDLE: u16 = 0xFFFF;

/// In the status of a 6D item: no data follow.
const MISSING_6D: u16 = 0x0100;
const CODE_6D: u16 = 0x00FF;

/// In the status of a 3D item: no data follow.
const MISSING_3D: u8 = 1;

const SECOND_NS: u64 = 1_000_000_000;

/// Bytes of a `BX2` block with this many tools and strays: a container, a frame with its item and container,
/// 6D items, a list of strays.
pub(super) const fn bx2_block_bytes(tools: usize, strays: usize) -> usize {
    4 + 12 + 16 + 4 + 12 + tools * (4 + 8 * 4) + 12 + 4 + strays * (4 + 3 * 4)
}

/// Parses the reply to [`BX2_REQUEST`]; `None` when it is invalid.
pub(super) fn read_bx2(block: &[u8], frame: &mut FrameData) -> Option<()> {
    frame.clear();
    let mut block = Cursor::new(block);
    for _ in 0..container(&mut block)? {
        let Component { kind, items, mut body } = component(&mut block)?;
        if kind == FRAME {
            for _ in 0..items {
                frame_item(&mut body, frame)?;
            }
            body.end(())?;
        }
    }
    block.end(())
}

/// Parses the header of a container, and returns the number of components.
fn container(from: &mut Cursor<'_>) -> Option<u16> {
    (from.get::<u16>()? == VERSION).then_some(())?;
    from.get()
}

struct Component<'a> {
    kind: u16,
    items: u32,
    body: Cursor<'a>,
}

fn component<'a>(from: &mut Cursor<'a>) -> Option<Component<'a>> {
    const HEADER: usize = 12;
    let kind = from.get::<u16>()?;
    let bytes = usize::try_from(from.get::<u32>()?).ok()?;
    let _format_option = from.get::<u16>()?;
    let items = from.get::<u32>()?;
    let body = Cursor::new(from.bytes(bytes.checked_sub(HEADER)?)?);
    Some(Component { kind, items, body })
}

/// Parses a frame item. Passive, active and wireless tools have one each, if there are any.
fn frame_item(from: &mut Cursor<'_>, frame: &mut FrameData) -> Option<()> {
    let _kind_and_sequence = from.get::<u16>()?;
    let _status = from.get::<u16>()?;
    let number = from.get::<u32>()?;
    let (seconds, ns) = (from.get::<u32>()?, from.get::<u32>()?);
    frame.set_number(number, Some(u64::from(seconds) * SECOND_NS + u64::from(ns)));
    for _ in 0..container(from)? {
        let Component { kind, items, mut body } = component(from)?;
        match kind {
            DATA_6D => data_6d(items, &mut body, frame)?,
            DATA_3D => data_3d(items, &mut body, frame)?,
            // Buttons, alerts and images are not stored.
            _ => continue,
        }
        body.end(())?;
    }
    Some(())
}

fn data_6d(items: u32, body: &mut Cursor<'_>, frame: &mut FrameData) -> Option<()> {
    for _ in 0..items {
        let (handle, status) = (body.get::<u16>()?, body.get::<u16>()?);
        u8::try_from(handle).ok()?;
        let mut pose = Pose::without(handle, PoseStatus::Lost);
        if status & MISSING_6D == 0 {
            let stated = tracked(handle, body)?;
            // Any other code states why the pose is doubtful.
            let is_certain = status & CODE_6D == 0;
            pose = if is_certain { stated } else { Pose::without(handle, PoseStatus::Rejected) };
        }
        frame.push_tool(pose);
    }
    Some(())
}

fn data_3d(items: u32, body: &mut Cursor<'_>, frame: &mut FrameData) -> Option<()> {
    for _ in 0..items {
        let (handle, n_markers) = (body.get::<u16>()?, body.get::<u16>()?);
        for _ in 0..n_markers {
            let status = body.get::<u8>()?;
            let _reserved = body.get::<u8>()?;
            let _index = body.get::<u16>()?;
            if status == MISSING_3D {
                continue;
            }
            let position_mm = body.get()?;
            // Out of volume, saturated, possibly a phantom: the device does not vouch for these.
            if status == 0 && handle == STRAYS_HANDLE {
                frame.push_stray(position_mm);
            }
        }
    }
    Some(())
}
