//! `NumPy` archives (`.npz`): a ZIP file with one `.npy` file for each array (NEP 1).
//!
//! | array | shape | type | content |
//! |---|---|---|---|
//! | `labels` | markers | text | the markers' names |
//! | `labelled` | markers | bool | whether the source gave the marker its name |
//! | `rate_hz` | | f64 | frames a second |
//! | `first_frame` | | i64 | the number of the first frame |
//! | `unit` | | text | `mm` |
//! | `up` | | text | the up axis: `x`, `y`, `z`, or empty if unknown |
//! | `event_frame`, `event_time_s`, `event_kind`, `event_label` | events | i64, f64, text, text | the events; frames count from 0 |
//! | `time_s` | frames | f64 | seconds from the first frame |
//! | `positions_mm` | frames, markers, 3 | f32 | NaN where a sample is missing |
//! | `analog_rate_hz`, `analog_time_s` | none; samples | f64 | of an imported C3D file: analog samples a second, and seconds from the first frame |
//! | `analog_labels`, `analog_units` | channels | text | the channels' names, made unique, and their units |
//! | `analog` | samples, channels | f32 | the values; NaN where a sample is missing |
//! | `force_plate_numbers` | plates | i64 | the numbers of the force plates that can be used |
//! | `force_plate_corners_mm` | plates, 4, 3 | f64 | their corners |
//! | `sampled_0`, with `_rate_hz`, `_time_s`, `_labels`, `_units` | as those of `analog` | | of a recording, by the number of the group: the same |
//! | `force_plates_rate_hz`, `force_plates_time_s` | none; samples | f64 | of a recording: the times of the loads |
//! | `force_plates` | samples, plates, 4, 3 | f32 | force (N), moment about the centre of the surface (N m), centre of pressure (mm; NaN without load) and free moment (N m) |
//! | `body_names` | bodies | text | of a recording: the names of the rigid bodies |
//! | `pose_positions_mm`, `pose_quaternions` | frames, bodies, 3; 4 | f32 | their positions and quaternions w, x, y, z at the times of `time_s`; NaN where a body has no pose |
//! | `pose_residuals_mm`, `pose_states` | frames, bodies | f32, u8 | how well their markers fit, NaN if unknown; 0 for a pose, or why there is none ([`PoseState::code`](crate::poses::PoseState::code)) |

use std::io::{self, BufWriter, Seek, SeekFrom, Write};

use crc32fast::Hasher;

use super::{
    InterchangeError, Result, check_frame_count,
    recorded_rows::FramePoses,
    sampled_table::{SampledColumn, SampledKind, SampledTable},
    write_frames,
};
use crate::{
    foreign::force_plates::ForcePlate,
    motion::{FrameSource, GAP, MotionEvent, MotionInfo, is_gap},
    poses::Pose,
};

/// The length of a `.npy` header is a multiple of this number of bytes, so that elements are aligned.
const ALIGNMENT: usize = 64;
/// Maximum size of a text array, bytes: every element is as long as the longest text.
const TEXT_BYTES_MAX: u64 = 1 << 26;

/// Writes an archive at the current position of `out`. The writer seeks back to fill in the checksums of the long
/// arrays, so that a program can stream the archive, as from a pipe: each member's length and checksum precede it.
///
/// # Errors
/// `Unsupported` if the labels are too long for a text array; `Io` if reading or writing fails.
pub fn write(frames: &mut dyn FrameSource, out: &mut (impl Write + Seek)) -> Result<()> {
    // One copy of the code, built with this crate.
    write_to(frames, &mut (out as &mut dyn WriteSeek))
}

trait WriteSeek: Write + Seek {}

impl<T: Write + Seek> WriteSeek for T {}

fn write_to(frames: &mut dyn FrameSource, out: &mut &mut dyn WriteSeek) -> Result<()> {
    let info = frames.info().clone();
    let mut archive = Archive::new(out)?;
    write_metadata(&info, &mut archive)?;
    write_events(&info, &mut archive)?;
    for mut table in SampledTable::all(&info)? {
        match table.kind() {
            SampledKind::Poses => write_poses(&info, frames, &mut archive)?,
            _ => write_table(&mut table, frames, &mut archive)?,
        }
    }
    let times_s = (0..info.n_frames).map(|index| index as f64 / info.rate_hz);
    write_times("time_s.npy", info.n_frames, times_s, &mut archive)?;
    let shape = [info.n_frames, info.markers.len() as u64, 3];
    let header = npy_header(F32, &shape);
    let n_bytes = array_bytes(&header, &[&shape[..], &[4]].concat());
    archive.stream("positions_mm.npy", n_bytes, |out| {
        let n_written = write_frames(frames, out, header, |buffer, _, row| {
            for &position in row {
                let position = if is_gap(position) { GAP } else { position };
                buffer.extend_from_slice(position.map(f32::to_le_bytes).as_flattened());
            }
            Ok(())
        })?;
        check_frame_count(info.n_frames, n_written)
    })?;
    Ok(archive.finish()?)
}

/// Writes the times of `n` samples, in seconds.
fn write_times(
    name: &str,
    n: u64,
    times_s: impl Iterator<Item = f64>,
    archive: &mut Archive<'_, impl Write + Seek>,
) -> Result<()> {
    let header = npy_header(F64, &[n]);
    let n_bytes = array_bytes(&header, &[n, 8]);
    Ok(archive.stream(name, n_bytes, |out| {
        let mut out = BufWriter::new(out);
        out.write_all(&header)?;
        let mut times_s = times_s.map(f64::to_le_bytes);
        times_s.try_for_each(|time| out.write_all(&time))?;
        out.flush()
    })?)
}

/// Writes the arrays of the analog channels, or of the force plates.
fn write_table(
    table: &mut SampledTable<'_>,
    frames: &dyn FrameSource,
    archive: &mut Archive<'_, impl Write + Seek>,
) -> Result<()> {
    let (n_rows, n_columns) = (table.n_rows(), table.columns().len() as u64);
    let name = table.kind().name();
    // Those of an imported file are at the times of its analog samples.
    if table.is_recorded() || !table.kind().is_of_plates() {
        let rate = [npy_header(F64, &[]), table.rate_hz().to_le_bytes().to_vec()].concat();
        archive.put(&format!("{name}_rate_hz.npy"), &rate)?;
        write_times(&format!("{name}_time_s.npy"), n_rows, table.times_s(), archive)?;
    }
    let shape = match table.kind() {
        SampledKind::Analog | SampledKind::Group(_) => {
            let texts = |of: fn(&SampledColumn) -> &str| {
                text_array(&table.columns().iter().map(of).collect::<Vec<_>>())
            };
            archive.put(&format!("{name}_labels.npy"), &texts(|column| &column.name)?)?;
            archive.put(&format!("{name}_units.npy"), &texts(|column| &column.unit)?)?;
            vec![n_rows, n_columns]
        }
        SampledKind::ForcePlates(group) => {
            let plate =
                group.map_or("force_plate".to_owned(), |group| format!("force_plate_{group}"));
            let n_plates = table.plates().len() as u64;
            let mut numbers = npy_header(I64, &[n_plates]);
            let number = |plate: &ForcePlate| (plate.number as u64).to_le_bytes();
            numbers.extend(table.plates().iter().flat_map(number));
            archive.put(&format!("{plate}_numbers.npy"), &numbers)?;
            let mut corners = npy_header(F64, &[n_plates, 4, 3]);
            let plates = table.plates().iter();
            let values = plates.flat_map(|plate| plate.geometry.corners_mm()).flatten();
            corners.extend(values.flat_map(f64::to_le_bytes));
            archive.put(&format!("{plate}_corners_mm.npy"), &corners)?;
            vec![n_rows, n_plates, 4, 3]
        }
        // They have arrays of their own.
        SampledKind::Poses => return Ok(()),
    };
    let header = npy_header(F32, &shape);
    let n_bytes = array_bytes(&header, &[n_rows, n_columns, 4]);
    Ok(archive.stream(&format!("{name}.npy"), n_bytes, |out| {
        let mut out = BufWriter::new(out);
        out.write_all(&header)?;
        table.for_each_row(frames, |_, row| {
            row.iter().try_for_each(|value| out.write_all(&value.to_le_bytes()))
        })?;
        out.flush()
    })?)
}

/// Appends the numbers of a pose that an array has.
type PutPose = fn(&Pose, &mut Vec<u8>);

/// Writes the arrays of the poses of rigid bodies, at the times of the frames.
fn write_poses(
    info: &MotionInfo,
    frames: &dyn FrameSource,
    archive: &mut Archive<'_, impl Write + Seek>,
) -> Result<()> {
    let bodies = info.recording.as_ref().map_or(&[][..], |recording| recording.bodies());
    let names: Vec<&str> = bodies.iter().map(|body| body.name.as_str()).collect();
    archive.put("body_names.npy", &text_array(&names)?)?;
    let (n_frames, n_bodies) = (info.n_frames, bodies.len() as u64);
    let arrays: [(&str, &str, &[u64], PutPose); 4] = [
        ("pose_positions_mm", F32, &[3], |pose, out| {
            out.extend_from_slice(pose.position_mm.map(f32::to_le_bytes).as_flattened());
        }),
        ("pose_quaternions", F32, &[4], |pose, out| {
            out.extend_from_slice(pose.quaternion.map(f32::to_le_bytes).as_flattened());
        }),
        ("pose_residuals_mm", F32, &[], |pose, out| out.extend(pose.residual_mm.to_le_bytes())),
        ("pose_states", U8, &[], |pose, out| out.push(pose.state.code())),
    ];
    for (name, kind, per_pose, put) in arrays {
        let Some(mut poses) = FramePoses::open(info) else { return Ok(()) };
        let shape = [&[n_frames, n_bodies][..], per_pose].concat();
        let header = npy_header(kind, &shape);
        let bytes_each = if kind == U8 { 1 } else { 4 };
        let n_bytes = array_bytes(&header, &[&shape[..], &[bytes_each]].concat());
        archive.stream(&format!("{name}.npy"), n_bytes, |out| {
            let mut out = BufWriter::new(out);
            out.write_all(&header)?;
            let mut bytes = Vec::new();
            for _ in 0..n_frames {
                bytes.clear();
                poses.next_frame()?.iter().for_each(|pose| put(pose, &mut bytes));
                out.write_all(&bytes)?;
            }
            out.flush()
        })?;
    }
    frames.count_sampled(n_frames);
    Ok(())
}

/// The size of a `.npy` file with this header, in bytes; its data has as many bytes as the product of `factors`.
fn array_bytes(header: &[u8], factors: &[u64]) -> u64 {
    let n_bytes = factors.iter().fold(1, |product: u64, &n| product.saturating_mul(n));
    n_bytes.saturating_add(header.len() as u64)
}

/// Writes the arrays of the markers and the scalars.
fn write_metadata(info: &MotionInfo, archive: &mut Archive<'_, impl Write + Seek>) -> Result<()> {
    let labels: Vec<&str> = info.markers.iter().map(|marker| marker.label.as_str()).collect();
    archive.put("labels.npy", &text_array(&labels)?)?;
    let mut labelled = npy_header(BOOL, &[info.markers.len() as u64]);
    labelled.extend(info.markers.iter().map(|marker| u8::from(marker.labelled)));
    archive.put("labelled.npy", &labelled)?;
    let one = |kind: &str, bytes: [u8; 8]| [npy_header(kind, &[]), bytes.to_vec()].concat();
    archive.put("rate_hz.npy", &one(F64, info.rate_hz.to_le_bytes()))?;
    archive.put("first_frame.npy", &one(I64, info.source.first_frame.to_le_bytes()))?;
    archive.put("unit.npy", &text_scalar("mm"))?;
    Ok(archive.put("up.npy", &text_scalar(info.up.name().unwrap_or_default()))?)
}

fn write_events(info: &MotionInfo, archive: &mut Archive<'_, impl Write + Seek>) -> Result<()> {
    let events = &info.events;
    let n = events.len() as u64;
    let mut numbers = npy_header(I64, &[n]);
    numbers.extend(events.iter().flat_map(|event| event.frame.to_le_bytes()));
    archive.put("event_frame.npy", &numbers)?;
    let mut times = npy_header(F64, &[n]);
    let time_s = events.iter().map(|event| event.frame as f64 / info.rate_hz);
    times.extend(time_s.flat_map(f64::to_le_bytes));
    archive.put("event_time_s.npy", &times)?;
    let kinds: Vec<&str> = events.iter().map(|event| event.kind.name()).collect();
    archive.put("event_kind.npy", &text_array(&kinds)?)?;
    let labels: Vec<&str> = events.iter().map(MotionEvent::label).collect();
    Ok(archive.put("event_label.npy", &text_array(&labels)?)?)
}

// Element types in NumPy's notation. Texts are UTF-32 of a fixed number of characters: `<U8`.
const BOOL: &str = "|b1";
const U8: &str = "|u1";
const I64: &str = "<i8";
const F32: &str = "<f4";
const F64: &str = "<f8";

/// The header of a `.npy` file; a scalar has no dimensions.
fn npy_header(kind: &str, shape: &[u64]) -> Vec<u8> {
    let shape: String = shape.iter().map(|n| format!("{n}, ")).collect();
    // A tuple of one needs its trailing comma, and longer tuples may have one.
    let shape = shape.trim_end();
    let dictionary = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}");
    let mut header = b"\x93NUMPY\x01\x00\0\0".to_vec();
    let padded = (header.len() + dictionary.len() + 1).next_multiple_of(ALIGNMENT);
    let description_bytes = (padded - header.len()) as u16;
    if let Some(place) = header.get_mut(8..10) {
        place.copy_from_slice(&description_bytes.to_le_bytes());
    }
    header.extend(dictionary.bytes());
    header.resize(padded - 1, b' ');
    header.push(b'\n');
    header
}

/// A one-dimensional array of texts.
fn text_array(texts: &[&str]) -> Result<Vec<u8>> {
    let longest = texts.iter().map(|text| text.chars().count()).max().unwrap_or(0).max(1);
    let n = texts.len() as u64;
    if n.saturating_mul(4 * longest as u64) > TEXT_BYTES_MAX {
        return Err(InterchangeError::Unsupported(format!(
            "npz stores every text at the length of the longest: {n} texts of {longest} characters are too large"
        )));
    }
    let mut array = npy_header(&format!("<U{longest}"), &[n]);
    texts.iter().for_each(|text| push_text(text, longest, &mut array));
    Ok(array)
}

/// A scalar text.
fn text_scalar(text: &str) -> Vec<u8> {
    let characters = text.chars().count().max(1);
    let mut array = npy_header(&format!("<U{characters}"), &[]);
    push_text(text, characters, &mut array);
    array
}

fn push_text(text: &str, characters: usize, out: &mut Vec<u8>) {
    let end = out.len() + 4 * characters;
    out.extend(text.chars().flat_map(|c| u32::from(c).to_le_bytes()));
    out.resize(end, 0);
}

const LOCAL: [u8; 4] = *b"PK\x03\x04";
const CENTRAL: [u8; 4] = *b"PK\x01\x02";
const END_64: [u8; 4] = *b"PK\x06\x06";
const LOCATOR_64: [u8; 4] = *b"PK\x06\x07";
const END: [u8; 4] = *b"PK\x05\x06";

/// Version needed to extract: 4.5, for ZIP64.
const VERSION: u16 = 45;
/// 1 January 1980, the earliest date. A fixed date makes the archive reproducible.
const DATE: u16 = 0x21;
/// Offset of the checksum in a local header.
const CRC_OFFSET: u64 = 14;
/// Size of a ZIP64 end of central directory record after its size field.
const END_64_BYTES: u64 = 44;

/// An archive under construction.
pub(super) struct Archive<'a, W> {
    out: &'a mut W,
    /// Position of the next byte in `out`.
    offset: u64,
    n_members: u16,
    directory: Vec<u8>,
}

impl<'a, W: Write + Seek> Archive<'a, W> {
    /// Begins an archive at the current position of `out`.
    pub(super) fn new(out: &'a mut W) -> io::Result<Self> {
        let offset = out.stream_position()?;
        Ok(Self { out, offset, n_members: 0, directory: Vec::new() })
    }

    /// Writes a member from memory.
    pub(super) fn put(&mut self, name: &str, bytes: &[u8]) -> io::Result<()> {
        let (crc, n_bytes) = (crc32fast::hash(bytes), bytes.len() as u64);
        let header_offset = self.offset;
        self.write_local_header(name, crc, n_bytes)?;
        self.write(bytes)?;
        self.add_entry(name, crc, n_bytes, header_offset);
        Ok(())
    }

    /// Writes a member of `n_bytes` bytes, which `fill` writes.
    ///
    /// # Errors
    /// Those of writing, and an error if `fill` writes another number of bytes than `n_bytes`.
    pub(super) fn stream(
        &mut self,
        name: &str,
        n_bytes: u64,
        fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> io::Result<()> {
        let header_offset = self.offset;
        self.write_local_header(name, 0, n_bytes)?;
        let mut member = MemberWriter { out: &mut *self.out, crc: Hasher::new(), n_bytes: 0 };
        fill(&mut member)?;
        let MemberWriter { crc, n_bytes: written, .. } = member;
        if written != n_bytes {
            let message = format!("{name}: expected {n_bytes} bytes, got {written}");
            return Err(io::Error::other(message));
        }
        let crc = crc.finalize();
        self.offset += written;
        self.out.seek(SeekFrom::Start(header_offset + CRC_OFFSET))?;
        self.out.write_all(&crc.to_le_bytes())?;
        self.out.seek(SeekFrom::Start(self.offset))?;
        self.add_entry(name, crc, n_bytes, header_offset);
        Ok(())
    }

    /// Writes the central directory and its end records.
    pub(super) fn finish(mut self) -> io::Result<()> {
        let directory = std::mem::take(&mut self.directory);
        let (start, n_bytes, n) = (self.offset, directory.len() as u64, self.n_members);
        self.write(&directory)?;
        let end = self.offset;
        let mut last = Vec::new();
        if saturated(start) == u32::MAX {
            last.extend(END_64);
            last.extend(END_64_BYTES.to_le_bytes());
            put_u16s(&mut last, &[VERSION, VERSION, 0, 0, 0, 0]);
            put_u64s(&mut last, &[n.into(), n.into(), n_bytes, start]);
            last.extend(LOCATOR_64);
            // Number of the disk with the end record, offset of that record, number of disks.
            put_u16s(&mut last, &[0, 0]);
            put_u64s(&mut last, &[end]);
            put_u16s(&mut last, &[1, 0]);
        }
        last.extend(END);
        put_u16s(&mut last, &[0, 0, n, n]);
        last.extend([n_bytes, start].map(saturated).map(u32::to_le_bytes).as_flattened());
        put_u16s(&mut last, &[0]);
        self.write(&last)?;
        self.out.flush()
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.offset += bytes.len() as u64;
        self.out.write_all(bytes)
    }

    /// Writes the local header of a member.
    fn write_local_header(&mut self, name: &str, crc: u32, n_bytes: u64) -> io::Result<()> {
        let mut header = LOCAL.to_vec();
        let extra = extra(&[n_bytes, n_bytes]);
        put_common(&mut header, name, crc, n_bytes, extra.len());
        header.extend(name.bytes());
        header.extend(extra);
        self.write(&header)
    }

    /// Adds a member to the central directory.
    fn add_entry(&mut self, name: &str, crc: u32, n_bytes: u64, header_offset: u64) {
        let out = &mut self.directory;
        out.extend(CENTRAL);
        put_u16s(out, &[VERSION]);
        let extra = extra(&[n_bytes, n_bytes, header_offset]);
        put_common(out, name, crc, n_bytes, extra.len());
        put_u16s(out, &[0; 5]);
        out.extend(saturated(header_offset).to_le_bytes());
        out.extend(name.bytes());
        out.extend(extra);
        self.n_members += 1;
    }
}

/// Passes the bytes of a member on, with their checksum and count.
struct MemberWriter<'a, W> {
    out: &'a mut W,
    crc: Hasher,
    n_bytes: u64,
}

impl<W: Write> Write for MemberWriter<'_, W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let n = self.out.write(bytes)?;
        self.crc.update(&bytes[..n]);
        self.n_bytes += n as u64;
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Appends the fields that local header and directory entry share: from the version to the length of the extra field.
fn put_common(out: &mut Vec<u8>, name: &str, crc: u32, n_bytes: u64, n_extra: usize) {
    put_u16s(out, &[VERSION, 0, 0, 0, DATE]);
    out.extend([crc, saturated(n_bytes), saturated(n_bytes)].map(u32::to_le_bytes).as_flattened());
    put_u16s(out, &[name.len() as u16, n_extra as u16]);
}

/// The ZIP64 extra field: the numbers that do not fit into 32 bits. Empty if all fit.
fn extra(numbers: &[u64]) -> Vec<u8> {
    let long: Vec<u64> = numbers.iter().copied().filter(|&n| saturated(n) == u32::MAX).collect();
    let mut extra = Vec::new();
    if !long.is_empty() {
        put_u16s(&mut extra, &[1, 8 * long.len() as u16]);
        put_u64s(&mut extra, &long);
    }
    extra
}

/// A number as 32 bits; all ones if it does not fit and is in the ZIP64 fields.
fn saturated(n: u64) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

fn put_u16s(out: &mut Vec<u8>, numbers: &[u16]) {
    out.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
}

fn put_u64s(out: &mut Vec<u8>, numbers: &[u64]) {
    out.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_match_those_of_numpy() {
        for (shape, expected) in [
            (&[][..], "'shape': (), }"),
            (&[7][..], "'shape': (7,), }"),
            (&[7, 2, 3], "'shape': (7, 2, 3,), }"),
        ] {
            let header = npy_header(F32, shape);
            assert!(header.len().is_multiple_of(ALIGNMENT) && header.ends_with(b"\n"));
            assert_eq!(usize::from(u16::from_le_bytes([header[8], header[9]])), header.len() - 10);
            let text = String::from_utf8_lossy(&header[10..]).into_owned();
            assert!(text.starts_with("{'descr': '<f4', ") && text.contains(expected), "{text}");
        }
    }

    #[test]
    fn texts_are_padded_to_the_longest() {
        let array = text_array(&["a", "", "\u{4e2d}b"]).unwrap();
        let header = npy_header("<U2", &[3]).len();
        let code_points: Vec<u32> =
            array[header..].as_chunks().0.iter().map(|&b| u32::from_le_bytes(b)).collect();
        assert_eq!(code_points, [0x61, 0, 0, 0, 0x4e2d, 0x62]);
        let long = "x".repeat(1 << 20);
        assert!(text_array(&[long.as_str(); 1000]).is_err());
    }

    /// Writes the headers of members beyond 4 GiB without their bytes.
    #[test]
    fn numbers_beyond_32_bits_are_in_the_zip64_fields() {
        let mut file = tempfile::tempfile().unwrap();
        let far = 5 << 30;
        file.seek(SeekFrom::Start(far)).unwrap();
        let mut archive = Archive::new(&mut file).unwrap();
        archive.write_local_header("a", 7, far).unwrap();
        archive.add_entry("a", 7, far, 0);
        archive.put("b", &[1, 2, 3]).unwrap();
        let b_at = far + 30 + 1 + 20;
        let start = archive.offset;
        let directory = archive.directory.clone();
        archive.finish().unwrap();

        let mut written = Vec::new();
        file.seek(SeekFrom::Start(far)).unwrap();
        io::Read::read_to_end(&mut file, &mut written).unwrap();
        let longs = |longs: &[u64]| longs.iter().flat_map(|n| n.to_le_bytes()).collect::<Vec<u8>>();
        let (head, rest) = written.split_at(51);
        assert_eq!(head[18..26], [0xff; 8]);
        assert_eq!(head[26..31], [1, 0, 20, 0, b'a']);
        assert_eq!(head[31..], [&[1, 0, 16, 0][..], &longs(&[far, far])].concat());
        assert_eq!(
            rest[14..30],
            [crc32fast::hash(&[1, 2, 3]), 3, 3, 1].map(u32::to_le_bytes).concat()
        );

        let (of_a, of_b) = directory.split_at(46 + 1 + 20);
        assert_eq!((&of_a[20..28], &of_a[42..46]), (&[0xff; 8][..], &[0; 4][..]));
        assert_eq!(of_a[47..], [&[1, 0, 16, 0][..], &longs(&[far, far])].concat());
        assert_eq!((&of_b[20..28], &of_b[42..46]), (&[3, 0, 0, 0, 3, 0, 0, 0][..], &[0xff; 4][..]));
        assert_eq!(of_b[47..], [&[1, 0, 8, 0][..], &longs(&[b_at])].concat());

        let last = &written[(start - far) as usize + directory.len()..];
        assert_eq!(last.len(), 56 + 20 + 22);
        assert_eq!(last[24..56], longs(&[2, 2, directory.len() as u64, start]));
        assert_eq!(last[64..72], longs(&[start + directory.len() as u64]));
        assert_eq!(last[76 + 16..76 + 20], [0xff; 4]);
    }

    #[test]
    fn a_member_of_an_unexpected_length_is_an_error() {
        let mut out = io::Cursor::new(Vec::new());
        let mut archive = Archive::new(&mut out).unwrap();
        let error = archive.stream("a", 4, |out| out.write_all(b"abc")).unwrap_err();
        assert_eq!(error.to_string(), "a: expected 4 bytes, got 3");
    }
}
