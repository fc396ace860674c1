//! Model definitions in both directions: names of assets, markers and channels (`docs/natnet.md`).

use super::{
    frame::put_size,
    message::{Bitstream, MessageKind, put_message, put_name, text_of},
};
use crate::bytes::{Cursor, WireValue};

/// Types of descriptions.
const MARKER_SET: u32 = 0;
const RIGID_BODY: u32 = 1;
const SKELETON: u32 = 2;
const FORCE_PLATE: u32 = 3;
const DEVICE: u32 = 4;
const CAMERA: u32 = 5;
const ASSET: u32 = 6;

/// The first bitstream whose descriptions of rigid bodies have a quaternion.
const QUATERNION: Bitstream = Bitstream::new(4, 2);

/// Bytes of a force plate's description between its serial number and its type: width, length, origin, a calibration of 12
/// by 12 and four corners, all of them float32.
const PLATE_GEOMETRY_BYTES: usize = 4 * (1 + 1 + 3 + 144 + 12);

/// Names of the markers of a set.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct MarkerSet {
    /// The set's name.
    pub name: String,
    /// Its markers' names, in their order.
    pub markers: Vec<String>,
}

/// What an asset is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AssetKind {
    /// A rigid body.
    RigidBody,
    /// A skeleton.
    Skeleton,
    /// A trained marker set, from bitstream 4.1 on.
    Trained,
}

/// An asset with an id.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Asset {
    /// What it is.
    pub kind: AssetKind,
    /// Its id, which ids of markers have in their upper half.
    pub id: u32,
    /// Its name; the marker set with its markers has the same.
    pub name: String,
    /// Names of its markers, where its description has them.
    pub markers: Vec<String>,
}

/// A force plate or another device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SampledDescription {
    /// Whether it is a force plate.
    pub is_plate: bool,
    /// Its number in frames.
    pub id: u32,
    /// Its name, or its serial number.
    pub name: String,
    /// The type of its values: 0 for calibrated ones, 1 for volts.
    pub data_type: u32,
    /// Its channels' names.
    pub channels: Vec<String>,
}

/// Everything that is described.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Model {
    /// The marker sets.
    pub sets: Vec<MarkerSet>,
    /// Rigid bodies, skeletons and trained marker sets.
    pub assets: Vec<Asset>,
    /// Force plates and other devices.
    pub sampled: Vec<SampledDescription>,
    /// Number of cameras.
    pub n_cameras: u32,
    /// Descriptions of a type that is not known, skipped by their size.
    pub n_unknown: u32,
}

/// Why definitions cannot be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ModelError {
    /// A description of this type, which is not known and states no size.
    UnknownType(u32),
    /// Another layout.
    Layout,
}

fn text(cursor: &mut Cursor<'_>) -> Option<String> {
    cursor.until_nul().map(text_of)
}

/// Counted texts. Each takes a byte, so that a false count ends with them.
fn texts(cursor: &mut Cursor<'_>) -> Option<Vec<String>> {
    let count = cursor.get::<u32>()?;
    let mut texts = Vec::new();
    for _ in 0..count {
        texts.push(text(cursor)?);
    }
    Some(texts)
}

impl Model {
    /// Reads a message's content.
    ///
    /// # Errors
    /// When it has another layout, or has a description that cannot be skipped.
    pub fn read(body: &[u8], version: Bitstream) -> Result<Self, ModelError> {
        let mut cursor = Cursor::new(body);
        let mut model = Self::default();
        let count: u32 = cursor.get().ok_or(ModelError::Layout)?;
        for _ in 0..count {
            let kind: u32 = cursor.get().ok_or(ModelError::Layout)?;
            if version.has_sizes() {
                let size: u32 = cursor.get().ok_or(ModelError::Layout)?;
                let content = usize::try_from(size).ok().and_then(|size| cursor.bytes(size));
                let mut content = Cursor::new(content.ok_or(ModelError::Layout)?);
                model.read_sized(kind, &mut content, version).ok_or(ModelError::Layout)?;
            } else {
                let is_known = (MARKER_SET..=CAMERA).contains(&kind)
                    && (version.major >= 3 || kind <= SKELETON);
                if !is_known {
                    return Err(ModelError::UnknownType(kind));
                }
                model.read_one(kind, &mut cursor, version).ok_or(ModelError::Layout)?;
            }
        }
        cursor.end(model).ok_or(ModelError::Layout)
    }

    /// Reads a description that has all of these bytes.
    fn read_sized(
        &mut self,
        kind: u32,
        content: &mut Cursor<'_>,
        version: Bitstream,
    ) -> Option<()> {
        match kind {
            RIGID_BODY => {
                let asset = read_body(content)?;
                // A quaternion is in front of the markers from 4.2 on, which not all know: what fits the size is right.
                let mut markers = Vec::new();
                let skips = if version >= QUATERNION { [16, 0] } else { [0, 16] };
                for skipped in skips {
                    let mut rest = *content;
                    if rest.bytes(skipped).is_none() {
                        continue;
                    }
                    if let Some(found) = read_body_markers(&mut rest, version)
                        && rest.len() == 0
                    {
                        markers = found;
                        break;
                    }
                }
                self.assets.push(Asset { markers, ..asset });
            }
            SKELETON => {
                let name = text(content)?;
                let (kind, id) = (AssetKind::Skeleton, content.get()?);
                self.assets.push(Asset { kind, id, name, markers: Vec::new() });
            }
            ASSET => {
                let name = text(content)?;
                let _type: u32 = content.get()?;
                let (kind, id) = (AssetKind::Trained, content.get()?);
                self.assets.push(Asset { kind, id, name, markers: Vec::new() });
            }
            MARKER_SET | FORCE_PLATE | DEVICE | CAMERA => self.read_one(kind, content, version)?,
            _ => self.n_unknown += 1,
        }
        Some(())
    }

    /// Reads a description of a type below [`ASSET`].
    fn read_one(&mut self, kind: u32, cursor: &mut Cursor<'_>, version: Bitstream) -> Option<()> {
        match kind {
            MARKER_SET => {
                let name = text(cursor)?;
                self.sets.push(MarkerSet { name, markers: texts(cursor)? });
            }
            RIGID_BODY => {
                let asset = read_body(cursor)?;
                let markers = if version.major >= 3 {
                    read_body_markers(cursor, version)?
                } else {
                    Vec::new()
                };
                self.assets.push(Asset { markers, ..asset });
            }
            SKELETON => {
                let name = text(cursor)?;
                let (kind, id) = (AssetKind::Skeleton, cursor.get()?);
                for _ in 0..cursor.get::<u32>()? {
                    read_body(cursor)?;
                    if version.major >= 3 {
                        read_body_markers(cursor, version)?;
                    }
                }
                self.assets.push(Asset { kind, id, name, markers: Vec::new() });
            }
            FORCE_PLATE => {
                let (id, name) = (cursor.get()?, text(cursor)?);
                cursor.bytes(PLATE_GEOMETRY_BYTES)?;
                let _type: u32 = cursor.get()?;
                let (data_type, channels) = (cursor.get()?, texts(cursor)?);
                let is_plate = true;
                self.sampled.push(SampledDescription { is_plate, id, name, data_type, channels });
            }
            DEVICE => {
                let (id, name) = (cursor.get()?, text(cursor)?);
                let _serial = text(cursor)?;
                let _type: u32 = cursor.get()?;
                let (data_type, channels) = (cursor.get()?, texts(cursor)?);
                let is_plate = false;
                self.sampled.push(SampledDescription { is_plate, id, name, data_type, channels });
            }
            _ => {
                // A camera: name, position and quaternion.
                text(cursor)?;
                cursor.bytes(28)?;
                self.n_cameras += 1;
            }
        }
        Some(())
    }

    /// Appends the message: marker sets, rigid bodies without markers, skeletons without bones, force plates without geometry, and devices. Descriptions of
    /// force plates and devices are left out before bitstream 3.0, which has none.
    pub fn put(&self, version: Bitstream, out: &mut Vec<u8>) {
        let has_sampled = version.major >= 3;
        let of_kind = |kind| self.assets.iter().filter(move |asset| asset.kind == kind);
        let bodies = || of_kind(AssetKind::RigidBody);
        let skeletons = || of_kind(AssetKind::Skeleton);
        let sampled = || self.sampled.iter().filter(|_| has_sampled);
        put_message(MessageKind::Model, out, |out| {
            let count =
                self.sets.len() + bodies().count() + skeletons().count() + sampled().count();
            (count as u32).put(out);
            for set in &self.sets {
                put_description(MARKER_SET, version, out, |out| {
                    put_name(&set.name, out);
                    put_names(&set.markers, out);
                });
            }
            for asset in bodies() {
                put_description(RIGID_BODY, version, out, |out| {
                    put_name(&asset.name, out);
                    asset.id.put(out);
                    // No parent, and at its place.
                    (-1_i32).put(out);
                    [0.0_f32; 3].put(out);
                    if version >= QUATERNION {
                        [0.0_f32, 0.0, 0.0, 1.0].into_iter().for_each(|value| value.put(out));
                    }
                    if has_sampled {
                        0_u32.put(out);
                    }
                });
            }
            for asset in skeletons() {
                put_description(SKELETON, version, out, |out| {
                    put_name(&asset.name, out);
                    asset.id.put(out);
                    0_u32.put(out);
                });
            }
            for device in sampled() {
                let kind = if device.is_plate { FORCE_PLATE } else { DEVICE };
                put_description(kind, version, out, |out| device.put(out));
            }
        });
    }
}

impl SampledDescription {
    fn put(&self, out: &mut Vec<u8>) {
        self.id.put(out);
        put_name(&self.name, out);
        if self.is_plate {
            out.extend_from_slice(&[0; PLATE_GEOMETRY_BYTES]);
        } else {
            // Its serial number.
            put_name(&self.name, out);
        }
        0_u32.put(out);
        self.data_type.put(out);
        put_names(&self.channels, out);
    }
}

/// The beginning of a rigid body's description: name, id, parent and position.
fn read_body(cursor: &mut Cursor<'_>) -> Option<Asset> {
    let (name, id) = (text(cursor)?, cursor.get()?);
    cursor.bytes(4 + 12)?;
    Some(Asset { kind: AssetKind::RigidBody, id, name, markers: Vec::new() })
}

/// Its markers, from bitstream 3.0 on: positions and labels, and from 4.0 on names.
fn read_body_markers(cursor: &mut Cursor<'_>, version: Bitstream) -> Option<Vec<String>> {
    let count = usize::try_from(cursor.get::<u32>()?).ok()?;
    cursor.bytes(count.checked_mul(12 + 4)?)?;
    let mut names = Vec::new();
    if version.major >= 4 {
        for _ in 0..count {
            names.push(text(cursor)?);
        }
    }
    Some(names)
}

fn put_names(names: &[String], out: &mut Vec<u8>) {
    (names.len() as u32).put(out);
    names.iter().for_each(|name| put_name(name, out));
}

fn put_description(
    kind: u32,
    version: Bitstream,
    out: &mut Vec<u8>,
    write: impl FnOnce(&mut Vec<u8>),
) {
    kind.put(out);
    if !version.has_sizes() {
        return write(out);
    }
    let start = out.len();
    0_u32.put(out);
    write(out);
    put_size(start, out);
}
