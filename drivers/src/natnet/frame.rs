//! Frames of data in both directions, in the layouts of bitstreams 2.10 to 4.2 (`docs/natnet.md`).

use super::message::{Bitstream, MessageKind, put_message, put_name};
use crate::bytes::{Cursor, WireValue};

/// Bytes of a position.
const POSITION_BYTES: usize = 12;

/// Bytes of a rigid body from bitstream 3.0 on: id, position, quaternion, error and flags.
const BODY_BYTES: usize = 38;

/// A marker is hidden.
pub const OCCLUDED: u16 = 0x01;
/// Its position is measured.
pub const MEASURED: u16 = 0x02;
/// Its position is computed from those of the others of its asset.
pub const MODEL_FILLED: u16 = 0x04;
/// It belongs to an asset; from bitstream 3.0 on.
pub const HAS_MODEL: u16 = 0x08;
/// It has no label; from bitstream 3.0 on.
pub const UNLABELLED: u16 = 0x10;

/// It sends its own id; from bitstream 3.0 on.
pub const ACTIVE: u16 = 0x20;

/// Models have changed since the frame before.
pub const MODELS_CHANGED: u16 = 0x02;

/// Metres as millimetres, rounded once.
pub(super) fn in_mm(position_m: [f32; 3]) -> [f32; 3] {
    position_m.map(|metres| (f64::from(metres) * 1000.0) as f32)
}

/// A marker of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct NatNetMarker {
    /// Its asset in the upper half, and its number in the asset, from 1 on, in the lower one; of an unlabelled marker what
    /// identifies it between frames.
    pub id: u32,
    /// x, y, z in metres.
    pub position_m: [f32; 3],
    /// Its diameter.
    pub size_m: f32,
    /// Flags such as [`OCCLUDED`].
    pub flags: u16,
    /// Its residual in metres; 0 before bitstream 3.0.
    pub residual_m: f32,
}

impl NatNetMarker {
    /// Bytes of a marker.
    fn bytes(version: Bitstream) -> usize {
        22 + if version.has_ticks() { 4 } else { 0 }
    }

    fn read(cursor: &mut Cursor<'_>, version: Bitstream) -> Option<Self> {
        Some(Self {
            id: cursor.get()?,
            position_m: cursor.get()?,
            size_m: cursor.get()?,
            flags: cursor.get()?,
            residual_m: if version.has_ticks() { cursor.get()? } else { 0.0 },
        })
    }

    fn put(&self, version: Bitstream, out: &mut Vec<u8>) {
        self.id.put(out);
        self.position_m.put(out);
        self.size_m.put(out);
        self.flags.put(out);
        if version.has_ticks() {
            self.residual_m.put(out);
        }
    }
}

/// A rigid body of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WireBody {
    /// Its id, as in its description.
    pub id: u32,
    /// x, y, z in metres.
    pub position_m: [f32; 3],
    /// Its rotation as a quaternion x, y, z, w.
    pub quaternion_xyzw: [f32; 4],
    /// Mean distance of its markers from where the model has them, in metres.
    pub error_m: f32,
    /// Whether it is tracked.
    pub is_tracked: bool,
}

impl WireBody {
    fn read(cursor: &mut Cursor<'_>, version: Bitstream) -> Option<Self> {
        let (id, position_m) = (cursor.get()?, cursor.get()?);
        let quaternion_xyzw = [cursor.get()?, cursor.get()?, cursor.get()?, cursor.get()?];
        if !version.has_ticks() {
            walk_counted(cursor, POSITION_BYTES + 4 + 4)?;
        }
        let error_m = cursor.get()?;
        let is_tracked = cursor.get::<u16>()? & 1 != 0;
        Some(Self { id, position_m, quaternion_xyzw, error_m, is_tracked })
    }

    fn put(&self, version: Bitstream, out: &mut Vec<u8>) {
        self.id.put(out);
        self.position_m.put(out);
        self.quaternion_xyzw.into_iter().for_each(|value| value.put(out));
        if !version.has_ticks() {
            // Number of its markers, which are sent as labelled ones.
            0_u32.put(out);
        }
        self.error_m.put(out);
        u16::from(self.is_tracked).put(out);
    }
}

/// The end of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct FrameEnd {
    /// SMPTE timecode, one byte each for hours, minutes, seconds and frames; 0 without one.
    pub timecode: u32,
    /// The part of a frame behind it.
    pub timecode_sub: u32,
    /// Seconds since the program's start.
    pub timestamp_s: f64,
    /// The server's clock in the middle of the exposure, when the cameras' data had arrived, and when the frame was sent; 0
    /// before bitstream 3.0.
    pub ticks: [u64; 3],
    /// Flags such as [`MODELS_CHANGED`].
    pub flags: u16,
}

/// Bytes of the frame's end without what may follow the stamps.
fn end_bytes(version: Bitstream) -> usize {
    // Latency, which 3.0 replaced by stamps; timecode and its part; seconds; flags.
    let stamps = if version.has_ticks() { 24 } else { 4 };
    8 + 8 + stamps + 2
}

/// A tag of four zeros closes a frame.
const END_TAG_BYTES: usize = 4;

/// Seconds and their fraction by a network clock, from bitstream 4.1 on.
const PRECISION_BYTES: usize = 8;

impl FrameEnd {
    /// Reads it; also whether a tag closes the frame.
    fn read(cursor: &mut Cursor<'_>, version: Bitstream) -> Option<(Self, bool)> {
        let more = cursor.len().checked_sub(end_bytes(version))?;
        // Readers of 4.1 disagree whether the network clock is there; the number of bytes tells.
        let (has_precision, has_tag) = match more {
            0 => (false, false),
            END_TAG_BYTES => (false, true),
            PRECISION_BYTES if version.has_sizes() => (true, false),
            n if n == PRECISION_BYTES + END_TAG_BYTES && version.has_sizes() => (true, true),
            _ => return None,
        };
        if !version.has_ticks() {
            cursor.get::<f32>()?;
        }
        let (timecode, timecode_sub, timestamp_s) = (cursor.get()?, cursor.get()?, cursor.get()?);
        let ticks = match version.has_ticks() {
            true => [cursor.get()?, cursor.get()?, cursor.get()?],
            false => [0; 3],
        };
        if has_precision {
            cursor.bytes(PRECISION_BYTES)?;
        }
        let flags = cursor.get()?;
        if has_tag {
            cursor.bytes(END_TAG_BYTES)?;
        }
        Some((Self { timecode, timecode_sub, timestamp_s, ticks, flags }, has_tag))
    }

    fn put(&self, version: Bitstream, out: &mut Vec<u8>) {
        if !version.has_ticks() {
            0_f32.put(out);
        }
        self.timecode.put(out);
        self.timecode_sub.put(out);
        self.timestamp_s.put(out);
        if version.has_ticks() {
            self.ticks.into_iter().for_each(|ticks| ticks.put(out));
        }
        if version.has_sizes() {
            out.extend_from_slice(&[0; PRECISION_BYTES]);
        }
        self.flags.put(out);
        out.extend_from_slice(&[0; END_TAG_BYTES]);
    }
}

/// A frame, whose parts are where they were received.
#[derive(Debug, Clone, Copy)]
pub struct FrameOfData<'a> {
    version: Bitstream,
    /// Its number. Live, it may stand still.
    pub number: u32,
    marker_sets: &'a [u8],
    others: &'a [u8],
    bodies: Section<'a>,
    labelled: &'a [u8],
    plates: &'a [u8],
    devices: &'a [u8],
    /// Numbers of rigid bodies, skeletons and other assets.
    pub n_bodies: [u32; 3],
    /// The end of the frame.
    pub end: FrameEnd,
    /// Whether a tag closes it, as Motive's do. A frame without one may be of another layout that is shorter by as much.
    pub has_tag: bool,
}

/// A section: its number of entries, and its bytes.
#[derive(Debug, Clone, Copy)]
struct Section<'a> {
    count: u32,
    content: &'a [u8],
}

/// How to find the end of an entry.
type Walk = fn(&mut Cursor<'_>, Bitstream) -> Option<()>;

impl<'a> Section<'a> {
    /// Reads a section. A stated size is the one that counts; `is_exact` demands that its entries have it.
    fn read(
        cursor: &mut Cursor<'a>,
        version: Bitstream,
        walk: Walk,
        is_exact: bool,
    ) -> Option<Self> {
        let count = cursor.get::<u32>()?;
        // Each entry takes bytes, so that a false count ends with them.
        let walk_all = |mut entries: Cursor<'a>| {
            for _ in 0..count {
                walk(&mut entries, version)?;
            }
            Some(entries)
        };
        if !version.has_sizes() {
            let mut start = *cursor;
            let rest = walk_all(start)?;
            let content = start.bytes(start.len() - rest.len())?;
            *cursor = rest;
            return Some(Self { count, content });
        }
        let size = usize::try_from(cursor.get::<u32>()?).ok()?;
        let content = cursor.bytes(size)?;
        if is_exact {
            walk_all(Cursor::new(content))?.end(())?;
        }
        Some(Self { count, content })
    }
}

fn walk_counted(cursor: &mut Cursor<'_>, entry_bytes: usize) -> Option<()> {
    let count = usize::try_from(cursor.get::<u32>()?).ok()?;
    cursor.bytes(count.checked_mul(entry_bytes)?).map(|_| ())
}

fn walk_marker_set(cursor: &mut Cursor<'_>, _: Bitstream) -> Option<()> {
    cursor.until_nul()?;
    walk_counted(cursor, POSITION_BYTES)
}

fn walk_position(cursor: &mut Cursor<'_>, _: Bitstream) -> Option<()> {
    cursor.bytes(POSITION_BYTES).map(|_| ())
}

fn walk_body(cursor: &mut Cursor<'_>, version: Bitstream) -> Option<()> {
    if version.has_ticks() {
        return cursor.bytes(BODY_BYTES).map(|_| ());
    }
    // Id, position and quaternion; positions, ids and sizes of its markers; error and flags.
    cursor.bytes(32)?;
    walk_counted(cursor, POSITION_BYTES + 4 + 4)?;
    cursor.bytes(6).map(|_| ())
}

fn walk_skeleton(cursor: &mut Cursor<'_>, version: Bitstream) -> Option<()> {
    cursor.get::<u32>()?;
    for _ in 0..cursor.get::<u32>()? {
        walk_body(cursor, version)?;
    }
    Some(())
}

fn walk_asset(cursor: &mut Cursor<'_>, version: Bitstream) -> Option<()> {
    cursor.get::<u32>()?;
    walk_counted(cursor, BODY_BYTES)?;
    walk_counted(cursor, NatNetMarker::bytes(version))
}

fn walk_marker(cursor: &mut Cursor<'_>, version: Bitstream) -> Option<()> {
    cursor.bytes(NatNetMarker::bytes(version)).map(|_| ())
}

fn walk_sampled(cursor: &mut Cursor<'_>, _: Bitstream) -> Option<()> {
    cursor.get::<u32>()?;
    for _ in 0..cursor.get::<u32>()? {
        walk_counted(cursor, 4)?;
    }
    Some(())
}

impl<'a> FrameOfData<'a> {
    /// Reads a message's content; `None` when it has another layout. Markers and samples must have exactly the stated size;
    /// other sections that state theirs are skipped by it.
    #[must_use]
    pub fn read(body: &'a [u8], version: Bitstream) -> Option<Self> {
        let mut cursor = Cursor::new(body);
        let number = cursor.get()?;
        let mut section = |walk, is_exact| Section::read(&mut cursor, version, walk, is_exact);
        let marker_sets = section(walk_marker_set, false)?;
        let others = section(walk_position, false)?;
        let bodies = section(walk_body, false)?;
        let skeletons = section(walk_skeleton, false)?;
        let n_assets = if version.has_sizes() { section(walk_asset, false)?.count } else { 0 };
        let labelled = section(walk_marker, true)?;
        let plates = section(walk_sampled, true)?;
        let devices =
            if version.has_devices() { section(walk_sampled, true)?.content } else { &[] };
        let (end, has_tag) = FrameEnd::read(&mut cursor, version)?;
        let frame = Self {
            version,
            number,
            marker_sets: marker_sets.content,
            others: others.content,
            bodies,
            labelled: labelled.content,
            plates: plates.content,
            devices,
            n_bodies: [bodies.count, skeletons.count, n_assets],
            end,
            has_tag,
        };
        cursor.end(frame)
    }

    /// Whether the flags of its markers tell the labelled ones, as from bitstream 3.0 on.
    #[must_use]
    pub fn has_flags(&self) -> bool {
        self.version.has_ticks()
    }

    /// Labelled markers; from bitstream 3.0 on the unlabelled ones, too.
    pub fn markers(&self) -> impl Iterator<Item = NatNetMarker> + use<'a> {
        let (mut cursor, version) = (Cursor::new(self.labelled), self.version);
        std::iter::from_fn(move || NatNetMarker::read(&mut cursor, version))
    }

    /// Rigid bodies; none if those of a later version have another size.
    pub fn bodies(&self) -> impl Iterator<Item = WireBody> + use<'a> {
        let version = self.version;
        let Section { count, content } = self.bodies;
        let bytes = usize::try_from(count).ok().and_then(|count| count.checked_mul(BODY_BYTES));
        let fits = !version.has_sizes() || bytes == Some(content.len());
        let mut cursor = Cursor::new(if fits { content } else { &[] });
        std::iter::from_fn(move || WireBody::read(&mut cursor, version))
    }

    /// Positions of the section of markers without a set: before bitstream 3.0 the unlabelled ones.
    pub fn other_positions_m(&self) -> impl Iterator<Item = [f32; 3]> + use<'a> {
        let mut cursor = Cursor::new(self.others);
        std::iter::from_fn(move || cursor.get())
    }

    /// The marker sets: their names, and the positions of their markers.
    pub fn marker_sets(&self) -> impl Iterator<Item = (&'a [u8], SetPositions<'a>)> + use<'a> {
        let mut cursor = Cursor::new(self.marker_sets);
        std::iter::from_fn(move || {
            let name = cursor.until_nul()?;
            let count = usize::try_from(cursor.get::<u32>()?).ok()?;
            Some((name, SetPositions(cursor.bytes(count.checked_mul(POSITION_BYTES)?)?)))
        })
    }

    /// Force plates, and other devices.
    pub fn sampled(&self) -> impl Iterator<Item = SampledData<'a>> + use<'a> {
        let of = |is_plate: bool, content: &'a [u8]| {
            let mut cursor = Cursor::new(content);
            std::iter::from_fn(move || {
                let id = cursor.get()?;
                let n_channels = cursor.get()?;
                let mut rest = cursor;
                for _ in 0..n_channels {
                    walk_counted(&mut rest, 4)?;
                }
                let channels = cursor.bytes(cursor.len() - rest.len())?;
                Some(SampledData { is_plate, id, n_channels, channels })
            })
        };
        of(true, self.plates).chain(of(false, self.devices))
    }
}

/// Positions of a marker set.
#[derive(Debug, Clone, Copy)]
pub struct SetPositions<'a>(&'a [u8]);

impl SetPositions<'_> {
    /// The position at a place, in metres.
    #[must_use]
    pub fn get(&self, index: usize) -> Option<[f32; 3]> {
        let start = index.checked_mul(POSITION_BYTES)?;
        Cursor::new(self.0.get(start..)?).get()
    }
}

/// The samples of a force plate or another device in one frame.
#[derive(Debug, Clone, Copy)]
pub struct SampledData<'a> {
    /// Whether it is a force plate.
    pub is_plate: bool,
    /// Its number.
    pub id: u32,
    /// Number of channels.
    pub n_channels: u32,
    channels: &'a [u8],
}

impl<'a> SampledData<'a> {
    /// The channels, each with its samples.
    pub fn channels(&self) -> impl Iterator<Item = ChannelSamples<'a>> + use<'a> {
        let mut cursor = Cursor::new(self.channels);
        std::iter::from_fn(move || {
            let count = usize::try_from(cursor.get::<u32>()?).ok()?;
            Some(ChannelSamples(cursor.bytes(count.checked_mul(4)?)?))
        })
    }
}

/// Samples of a channel in one frame.
#[derive(Debug, Clone, Copy)]
pub struct ChannelSamples<'a>(&'a [u8]);

impl ChannelSamples<'_> {
    /// Number of samples.
    #[must_use]
    pub fn count(&self) -> usize {
        self.0.len() / 4
    }

    /// The sample at a place.
    #[must_use]
    pub fn get(&self, index: usize) -> Option<f32> {
        Cursor::new(self.0.get(index.checked_mul(4)?..)?).get()
    }
}

/// A marker set to send.
#[derive(Debug, Clone, Copy)]
pub struct SetToSend<'a> {
    /// Its name.
    pub name: &'a str,
    /// Positions of its markers, in metres.
    pub positions_m: &'a [[f32; 3]],
}

/// A force plate or device to send.
#[derive(Debug, Clone, Copy)]
pub struct SampledToSend<'a> {
    /// Its number.
    pub id: u32,
    /// Number of channels.
    pub n_channels: usize,
    /// Samples of one channel after another.
    pub samples: &'a [f32],
}

impl SampledToSend<'_> {
    fn put(&self, out: &mut Vec<u8>) {
        self.id.put(out);
        (self.n_channels as u32).put(out);
        let n_samples = self.samples.len() / self.n_channels.max(1);
        for channel in 0..self.n_channels {
            // A frame without samples has each channel all the same.
            let samples = self.samples.iter().skip(channel * n_samples).take(n_samples);
            (samples.len() as u32).put(out);
            samples.for_each(|sample| sample.put(out));
        }
    }
}

/// What a server sends of a frame.
#[derive(Debug, Clone, Copy, Default)]
pub struct FrameToSend<'a> {
    /// Its number.
    pub number: u32,
    /// The marker sets.
    pub sets: &'a [SetToSend<'a>],
    /// The rigid bodies.
    pub bodies: &'a [WireBody],
    /// Ids of skeletons, which are sent without bones.
    pub skeletons: &'a [u32],
    /// Labelled markers.
    pub labelled: &'a [NatNetMarker],
    /// Unlabelled markers. Before bitstream 3.0 only their positions are sent.
    pub unlabelled: &'a [NatNetMarker],
    /// The force plates.
    pub plates: &'a [SampledToSend<'a>],
    /// Other devices; not before bitstream 2.11.
    pub devices: &'a [SampledToSend<'a>],
    /// The end of the frame.
    pub end: FrameEnd,
}

/// Appends a section.
fn put_section(
    count: usize,
    version: Bitstream,
    out: &mut Vec<u8>,
    write: impl FnOnce(&mut Vec<u8>),
) {
    (count as u32).put(out);
    if !version.has_sizes() {
        return write(out);
    }
    let start = out.len();
    0_u32.put(out);
    write(out);
    put_size(start, out);
}

/// Writes the number of bytes behind a field of four into that field.
pub(super) fn put_size(start: usize, out: &mut [u8]) {
    let size = (out.len() - start - 4) as u32;
    if let Some(field) = out.get_mut(start..start + 4) {
        field.copy_from_slice(&size.to_le_bytes());
    }
}

/// Appends a frame of data.
pub fn put_frame(frame: &FrameToSend<'_>, version: Bitstream, out: &mut Vec<u8>) {
    put_message(MessageKind::Frame, out, |out| {
        frame.number.put(out);
        put_section(frame.sets.len(), version, out, |out| {
            for set in frame.sets {
                put_name(set.name, out);
                (set.positions_m.len() as u32).put(out);
                set.positions_m.iter().for_each(|position| position.put(out));
            }
        });
        let others = if version.has_ticks() { &[] } else { frame.unlabelled };
        put_section(others.len(), version, out, |out| {
            others.iter().for_each(|marker| marker.position_m.put(out));
        });
        put_section(frame.bodies.len(), version, out, |out| {
            frame.bodies.iter().for_each(|body| body.put(version, out));
        });
        put_section(frame.skeletons.len(), version, out, |out| {
            for id in frame.skeletons {
                id.put(out);
                0_u32.put(out);
            }
        });
        if version.has_sizes() {
            put_section(0, version, out, |_| {});
        }
        let unlabelled = if version.has_ticks() { frame.unlabelled } else { &[] };
        put_section(frame.labelled.len() + unlabelled.len(), version, out, |out| {
            let markers = frame.labelled.iter().chain(unlabelled);
            markers.for_each(|marker| marker.put(version, out));
        });
        let mut put_all = |all: &[SampledToSend<'_>]| {
            put_section(all.len(), version, out, |out| all.iter().for_each(|one| one.put(out)));
        };
        put_all(frame.plates);
        if version.has_devices() {
            put_all(frame.devices);
        }
        frame.end.put(version, out);
    });
}
