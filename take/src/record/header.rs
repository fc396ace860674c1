//! HEADER and CHANNELS: everything that a reader needs before the first stretch.

use std::{
    fmt,
    io::{ErrorKind, Read},
    ops::RangeInclusive,
    time::Duration,
};

use bincode::{Decode, Encode, de::Decoder, enc::Encoder, error::DecodeError, error::EncodeError};
use mocapd_codec::{BLOCK_VERSION, CodecError, Effort, ResamplerKind, Settings, Tolerance};
use serde::Serialize;
use sha2::{Digest, Sha256};

use super::{CONFIG, LIMIT_BYTES, Record, Subject};
use crate::{
    TakeError,
    chunk::{self, ChunkParse, types},
    quantity,
    stretch::{CHANNELS_MAX, LIVE_ROWS_MAX},
    up_axis::UpAxis,
    varint::{self, Cursor},
};

/// Frame rates of takes, in Hz: one frame in a quarter of an hour, up to a thousand times the fastest rig's. With these,
/// the time of every frame is a finite number.
pub const RATES_HZ: RangeInclusive<f64> = 0.001..=1e6;

/// An entry of the channel table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// The device's id of the marker; in an import the column, from 0.
    pub marker_id: u16,
    /// The marker's label.
    pub label: String,
    /// Whether the label comes from the device or file.
    pub labelled: bool,
}

impl Channel {
    /// The label of an unlabelled column: `u001` for the first.
    #[must_use]
    pub fn unlabelled_name(column: usize) -> String {
        format!("u{:03}", column + 1)
    }
}

/// The recorded device.
#[derive(Debug, Clone, PartialEq, Eq, Default, Encode, Decode, Serialize)]
pub struct Device {
    /// Driver family.
    pub driver: String,
    /// URI with which it was opened.
    pub uri: String,
    /// Model, as stated by the device.
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// Firmware version.
    pub firmware: String,
    /// Device clock ticks per second.
    pub tick_hz: u64,
    /// Whether the serial line uses the kernel's low-latency mode.
    pub low_latency: bool,
}

/// The imported file.
#[derive(Debug, Clone, PartialEq, Default, Encode, Decode, Serialize)]
pub struct ImportSource {
    /// `c3d`, `trc`, `tsv`, `csv`; `array` for data in a program's memory.
    pub format: String,
    /// File name without folders.
    pub file: String,
    /// Unit of length as written in the file.
    pub unit: String,
    /// Factor from that unit to millimetres.
    #[serde(rename = "factor_to_mm")]
    pub factor: f64,
    /// Number of its first frame.
    pub first_frame: u64,
    /// Defects of the file and how they were read.
    pub warnings: Vec<String>,
}

/// The first chunk of a take.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Header {
    /// The program that wrote the take.
    pub software: String,
    /// Identifies the take: random in a recording; derived from file and settings in an import
    /// ([`Header::set_import_id`]).
    pub take_id: [u8; 16],
    /// Wall-clock time at the start of a recording, in milliseconds since 1970 UTC; 0 if unknown, as in an import.
    pub created_unix_ms: i64,
    /// Name of the resampler.
    pub resampler: String,
    /// Version of stretches and blocks (docs/take-format.md and docs/codec.md).
    pub codec_version: u16,
    /// Tolerance in millimetres; 0 for `lossless`.
    pub tolerance_mm: f64,
    /// Rows per second.
    pub rate_hz: f64,
    /// The vertical axis.
    pub up_axis: UpAxis,
    /// The device; `None` in an import.
    pub device: Option<Device>,
    /// The imported file; `None` in a recording.
    pub source: Option<ImportSource>,
    /// The channel table at the start of the take.
    pub channels: Vec<Channel>,
    /// Rows of a full stretch.
    pub stretch_rows: u32,
    /// Configuration of the recorder; in an import, the options other than resampler and tolerance.
    pub settings: Vec<(String, String)>,
}

/// The version of stretches and blocks that this build writes, unless keys are [further apart](LONG_KEYS_VERSION).
/// Versions 1 to 5 belong to development builds.
pub const CODEC_VERSION: u16 = 6;

/// The version of takes whose key stretches may be further apart than [`KEYS_APART_S_MAX`]: all else is as in
/// [`CODEC_VERSION`].
pub const LONG_KEYS_VERSION: u16 = 7;

/// Longest time from one key stretch to the next in takes of [`CODEC_VERSION`], in seconds.
pub const KEYS_APART_S_MAX: f64 = 10.0;

/// Longest stretch of an import in which nothing moves, or whose keys are further apart than ten seconds, in seconds:
/// what one damaged byte can cost. The twelve stretches of an hour of seven still markers take 0.9 kB, beside 0.3 kB of
/// the header and the end of the take.
const LONG_STRETCH_S: f64 = 300.0;

/// Most samples of such a stretch: a reader that goes to a row decodes the stretch around it, this many in a tenth of a
/// second, and needs 48 MB for them.
const LONG_STRETCH_SAMPLES: usize = 1 << 20;

/// Most rows of a stretch of an import in which nothing moves, or whose keys are further apart than ten seconds.
pub(crate) fn long_stretch_rows(rate_hz: f64, n_channels: usize) -> usize {
    ((LONG_STRETCH_S * rate_hz) as usize)
        .min(LONG_STRETCH_SAMPLES / n_channels.max(1))
        .min(LIVE_ROWS_MAX as usize)
}

/// The chosen distance of the key stretches of an import.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum KeyDistance {
    /// At most this time from one to the next.
    Every(Duration),
    /// The first stretch is the only one.
    FirstOnly,
}

impl fmt::Display for KeyDistance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Every(distance) => write!(f, "{distance:?}"),
            Self::FirstOnly => f.write_str(NO_KEYS),
        }
    }
}

/// How the settings name [`KeyDistance::FirstOnly`].
const NO_KEYS: &str = "none";

// Blocks are part of takes, so a new block version needs a new version here.
const _: () = assert!(CODEC_VERSION >= BLOCK_VERSION);

/// The key in the settings of an import with the size of its file.
const SOURCE_BYTES: &str = "source_bytes";

/// The key in the settings of an import with the distance of its key stretches, where it was chosen.
const KEYS: &str = "keys";

/// The key in the settings of an import with the effort of its encoder, where it is above the least.
const EFFORT: &str = "effort";

/// The key in the settings of an import with a tolerance of analog channels, in the order in which they were given.
const ANALOG_TOLERANCE: &str = "analog_tolerance";

impl Header {
    /// The code of the up axis in this HEADER chunk, if no axis has it.
    #[must_use]
    pub fn unknown_up_axis(header_chunk: &[u8]) -> Option<u8> {
        /// The fields up to the axis.
        type FieldsToUpAxis = (String, [u8; 16], i64, String, u16, f64, f64, u8);
        let ChunkParse::Whole { payload, .. } = chunk::split(header_chunk) else { return None };
        let (_, body) = payload.split_first_chunk::<2>()?;
        let (fields, _) = bincode::decode_from_slice::<FieldsToUpAxis, _>(body, CONFIG).ok()?;
        let code = fields.7;
        (UpAxis::from_code(code).code() != code).then_some(code)
    }

    /// Sets the effort of the encoder.
    pub fn set_effort(&mut self, effort: Effort) {
        self.settings.retain(|(key, _)| key != EFFORT);
        if effort > Effort::MIN {
            self.settings.push((EFFORT.to_owned(), effort.to_string()));
        }
    }

    /// The effort of the encoder, the least one if none is stated.
    #[must_use]
    pub fn effort(&self) -> Effort {
        let stated = self.settings.iter().find(|(key, _)| key == EFFORT);
        stated.and_then(|(_, level)| level.parse().ok()).unwrap_or_default()
    }

    /// Sets the distance of the key stretches of an import of `n_rows` rows, and the rows of its full stretches by it.
    pub fn set_key_distance(&mut self, distance: KeyDistance, n_rows: u64) {
        self.settings.retain(|(key, _)| key != KEYS);
        self.settings.push((KEYS.to_owned(), distance.to_string()));
        self.fit_key_distance(n_rows);
    }

    /// Sets the rows of full stretches of an import of `n_rows` rows by the stated distance of its keys, if one is
    /// stated. These are at most those set before; but a take that has keys further apart than ten seconds is of a later
    /// version, and has longer stretches.
    pub(crate) fn fit_key_distance(&mut self, n_rows: u64) {
        let Some(rows) = self.key_rows() else { return };
        let rows_max = (KEYS_APART_S_MAX * self.rate_hz) as usize;
        if rows > rows_max.max(1) && n_rows > rows_max as u64 {
            self.codec_version = LONG_KEYS_VERSION;
            let longest = long_stretch_rows(self.rate_hz, self.channels.len());
            let longest = longest.max(self.stretch_rows as usize).max(1);
            // Stretches of one length fill the distance.
            let rows = rows.min(usize::try_from(n_rows).unwrap_or(usize::MAX)).max(1);
            self.stretch_rows = rows.div_ceil(rows.div_ceil(longest)) as u32;
        } else {
            self.stretch_rows = self.stretch_rows.min(u32::try_from(rows).unwrap_or(u32::MAX));
        }
    }

    /// The distance of the key stretches of an import as it is stated, if it was chosen.
    #[must_use]
    pub fn key_distance(&self) -> Option<&str> {
        let stated = self.settings.iter().find(|(key, _)| key == KEYS);
        stated.map(|(_, distance)| distance.as_str())
    }

    /// The rows between the key stretches of an import, at least one, if their distance was chosen.
    #[must_use]
    pub fn key_rows(&self) -> Option<usize> {
        let distance = self.key_distance()?;
        if distance == NO_KEYS {
            return Some(usize::MAX);
        }
        let distance = quantity::duration_above_zero(distance).ok()?;
        Some(((distance.as_secs_f64() * self.rate_hz) as usize).max(1))
    }

    /// Whether key stretches may be further apart than ten seconds.
    #[must_use]
    pub fn has_long_keys(&self) -> bool {
        self.codec_version == LONG_KEYS_VERSION
    }

    /// Sets the tolerances of analog channels that the take was imported with, in the order in which they were given.
    pub fn set_analog_tolerances(&mut self, stated: impl IntoIterator<Item = String>) {
        self.settings.retain(|(key, _)| key != ANALOG_TOLERANCE);
        let stated = stated.into_iter();
        self.settings.extend(stated.map(|one| (ANALOG_TOLERANCE.to_owned(), one)));
    }

    /// Sets the size of the imported file in bytes.
    pub fn set_source_bytes(&mut self, bytes: u64) {
        self.unset_source_bytes();
        self.settings.push((SOURCE_BYTES.to_owned(), bytes.to_string()));
    }

    /// The size of the imported file in bytes; `None` in a recording, and in imports of earlier versions.
    #[must_use]
    pub fn source_bytes(&self) -> Option<u64> {
        let (_, bytes) = self.settings.iter().find(|(key, _)| key == SOURCE_BYTES)?;
        bytes.parse().ok()
    }

    /// Removes the size of the imported file, for a take that does not have exactly its frames.
    pub(crate) fn unset_source_bytes(&mut self) {
        self.settings.retain(|(key, _)| key != SOURCE_BYTES);
    }

    /// `take_id` as 32 hexadecimal digits.
    #[must_use]
    pub fn take_id_text(&self) -> String {
        self.take_id.iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// The codec's settings, validated.
    ///
    /// # Errors
    /// `UnknownResampler`; `Codec` for a tolerance out of range, `Unsupported` for another block format.
    pub fn codec(&self) -> Result<Settings, TakeError> {
        let found = self.codec_version;
        if !(CODEC_VERSION..=LONG_KEYS_VERSION).contains(&found) {
            let supported = found.clamp(CODEC_VERSION, LONG_KEYS_VERSION);
            return Err(TakeError::Unsupported { what: "block format", found, supported });
        }
        let unknown = |_| TakeError::UnknownResampler(self.resampler.clone());
        let kind: ResamplerKind = self.resampler.parse().map_err(unknown)?;
        let mm = if kind.is_lossless() { Tolerance::MAX_MM } else { self.tolerance_mm };
        Ok(Settings { kind, tolerance: Tolerance::from_mm(mm)? })
    }

    /// Sets the fields that describe the codec.
    pub fn set_codec(&mut self, settings: &Settings) {
        self.resampler = settings.kind.to_string();
        self.codec_version = CODEC_VERSION;
        self.tolerance_mm = if settings.kind.is_lossless() { 0.0 } else { settings.tolerance.mm() };
    }

    /// Rejects a header with invalid numbers.
    ///
    /// # Errors
    /// Those of [`codec`](Self::codec), and `Codec(InvalidArgument)` naming the field.
    pub fn check(&self) -> Result<(), TakeError> {
        if !RATES_HZ.contains(&self.rate_hz) {
            let message = format!(
                "invalid frame rate: {} Hz, expected {} to {}",
                self.rate_hz,
                RATES_HZ.start(),
                RATES_HZ.end()
            );
            return Err(CodecError::InvalidArgument(message).into());
        }
        self.codec().map(drop)
    }
}

impl Record for Header {
    const NAME: &'static str = "header";
    const KIND: u8 = types::HEADER;
    const VERSION: u16 = 2;
}

/// The payload of CHANNELS.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct MoreChannels(pub(crate) Vec<Channel>);

impl Record for MoreChannels {
    const NAME: &'static str = "channel table";
    const KIND: u8 = types::CHANNELS;
    const VERSION: u16 = 2;
}

// Stored form: the fields in order, with the channel table as a byte string.

impl Encode for Header {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        self.software.encode(encoder)?;
        self.take_id.encode(encoder)?;
        self.created_unix_ms.encode(encoder)?;
        self.resampler.encode(encoder)?;
        self.codec_version.encode(encoder)?;
        self.tolerance_mm.encode(encoder)?;
        self.rate_hz.encode(encoder)?;
        self.up_axis.code().encode(encoder)?;
        self.device.encode(encoder)?;
        self.source.encode(encoder)?;
        write_channels(&self.channels).encode(encoder)?;
        self.stretch_rows.encode(encoder)?;
        self.settings.encode(encoder)
    }
}

impl Decode<()> for Header {
    fn decode<D: Decoder<Context = ()>>(decoder: &mut D) -> Result<Self, DecodeError> {
        // Struct expressions evaluate their fields in the order written.
        Ok(Self {
            software: String::decode(decoder)?,
            take_id: <[u8; 16]>::decode(decoder)?,
            created_unix_ms: i64::decode(decoder)?,
            resampler: String::decode(decoder)?,
            codec_version: u16::decode(decoder)?,
            tolerance_mm: f64::decode(decoder)?,
            rate_hz: f64::decode(decoder)?,
            up_axis: UpAxis::from_code(u8::decode(decoder)?),
            device: Option::<Device>::decode(decoder)?,
            source: Option::<ImportSource>::decode(decoder)?,
            channels: MoreChannels::decode(decoder)?.0,
            stretch_rows: u32::decode(decoder)?,
            settings: Vec::<(String, String)>::decode(decoder)?,
        })
    }
}

impl Encode for MoreChannels {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        write_channels(&self.0).encode(encoder)
    }
}

impl Decode<()> for MoreChannels {
    fn decode<D: Decoder<Context = ()>>(decoder: &mut D) -> Result<Self, DecodeError> {
        let bytes = Vec::<u8>::decode(decoder)?;
        read_channels(&bytes).map(Self).map_err(DecodeError::Other)
    }
}

impl Header {
    /// Derives `take_id` from all other fields of this header, the bytes of the imported file, and the subject if there
    /// is one, as a UUID of version 8 (RFC 9562, 5.8). Call it when nothing else will change.
    ///
    /// The header has program, resampler, versions, tolerance, file and settings, so equal ids mean equal imports.
    /// docs/take-format.md gives the steps.
    ///
    /// # Errors
    /// `InvalidArgument` when the header is larger than a take can hold; `Io` when `source` cannot be read.
    pub fn set_import_id(
        &mut self,
        mut source: impl Read,
        subject: Option<&Subject>,
    ) -> Result<(), TakeError> {
        self.take_id = [0; 16];
        let mut hash = Sha256::new().chain_update(self.to_payload()?);
        let mut bytes = vec![0; SOURCE_BLOCK_BYTES];
        loop {
            match source.read(&mut bytes) {
                Ok(0) => break,
                Ok(n) => hash.update(&bytes[..n]),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error.into()),
            }
        }
        let subject = subject.map_or(Ok(Vec::new()), Subject::to_payload)?;
        let hash = hash.chain_update(subject).finalize();
        self.take_id.iter_mut().zip(hash).for_each(|(byte, of_hash)| *byte = of_hash);
        self.take_id[6] = self.take_id[6] & 0x0f | 0x80;
        self.take_id[8] = self.take_id[8] & 0x3f | 0x80;
        Ok(())
    }
}

/// Bytes of a source that are hashed at a time.
const SOURCE_BLOCK_BYTES: usize = 1 << 16;

/// Most bytes that a label shares with the previous one: the largest value of a nibble.
const MAX_SHARED: usize = 15;
/// A suffix length up to 13 is stored in the nibble; these two values announce other fields.
const LONG: u8 = 14;
const UNUSUAL: u8 = 15;
/// Memory that a reader needs for an entry besides its label.
const ENTRY_BYTES: usize = 32;

/// What the next entry is predicted from: the label of the previous one, if any, the marker id after its own, and
/// whether it is labelled.
fn prediction(previous: Option<&Channel>) -> (&[u8], u16, bool) {
    let Some(Channel { marker_id, label, labelled }) = previous else { return (&[], 0, true) };
    (label.as_bytes(), marker_id.wrapping_add(1), *labelled)
}

fn shared(a: &[u8], b: &[u8]) -> usize {
    a.iter().zip(b).take(MAX_SHARED).take_while(|(a, b)| a == b).count()
}

/// Encodes a channel table.
fn write_channels(channels: &[Channel]) -> Vec<u8> {
    let mut out = Vec::new();
    let mut previous = None;
    for channel in channels {
        let Channel { marker_id, label, labelled } = channel;
        let (previous_label, next_id, was_labelled) = prediction(previous);
        let shared = shared(previous_label, label.as_bytes());
        let suffix = &label.as_bytes()[shared..];
        let usual = *marker_id == next_id && *labelled == was_labelled;
        let short = u8::try_from(suffix.len()).ok().filter(|&n| n < LONG);
        let low = if usual { short.unwrap_or(LONG) } else { UNUSUAL };
        out.push((shared as u8) << 4 | low);
        if !usual {
            varint::put(&mut out, u64::from(*marker_id) << 1 | u64::from(*labelled));
        }
        if low >= LONG {
            varint::put(&mut out, suffix.len() as u64);
        }
        out.extend_from_slice(suffix);
        previous = Some(channel);
    }
    out
}

const CUT: &str = "the channel table is truncated or has an overlong varint";

/// Decodes a channel table that fills `bytes`.
fn read_channels(bytes: &[u8]) -> Result<Vec<Channel>, &'static str> {
    let mut bytes = Cursor::new(bytes);
    let mut channels: Vec<Channel> = Vec::new();
    let mut claimed = 0_u64;
    while !bytes.is_empty() {
        if channels.len() == CHANNELS_MAX {
            return Err("more than 65536 markers");
        }
        let (previous_label, mut marker_id, mut labelled) = prediction(channels.last());
        let head = bytes.byte().ok_or(CUT)?;
        let shared = usize::from(head >> 4);
        if head & 15 == UNUSUAL {
            let both = bytes.varint().ok_or(CUT)?;
            labelled = both & 1 == 1;
            marker_id = u16::try_from(both >> 1).map_err(|_| "a marker id exceeds 65535")?;
        }
        let n = if head & 15 >= LONG { bytes.varint().ok_or(CUT)? } else { u64::from(head & 15) };
        let beginning = previous_label
            .get(..shared)
            .ok_or("a label repeats more bytes than the one before it has")?;
        // Limit the memory of the table like that of other records: a byte here may claim at most as much.
        claimed = (claimed + (ENTRY_BYTES + shared) as u64).saturating_add(n);
        if claimed > LIMIT_BYTES as u64 {
            return Err("the channel table is larger than a take can hold");
        }
        let label = [beginning, bytes.take(n).ok_or(CUT)?].concat();
        let label = String::from_utf8(label).map_err(|_| "a label is not UTF-8")?;
        channels.push(Channel { marker_id, label, labelled });
    }
    Ok(channels)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header() -> Header {
        Header {
            software: "mocapd 0.1.0".to_owned(),
            take_id: [7; 16],
            created_unix_ms: 0,
            resampler: "dense".to_owned(),
            codec_version: CODEC_VERSION,
            tolerance_mm: 0.5,
            rate_hz: 120.0,
            up_axis: UpAxis::Z,
            device: None,
            source: Some(ImportSource {
                format: "csv".to_owned(),
                file: "jump.csv".to_owned(),
                factor: 1.0,
                ..ImportSource::default()
            }),
            channels: vec![Channel { marker_id: 0, label: "head".to_owned(), labelled: true }],
            stretch_rows: 1200,
            settings: Vec::new(),
        }
    }

    fn id(header: &Header, source: &[u8]) -> [u8; 16] {
        let mut header = header.clone();
        header.set_import_id(source, None).unwrap();
        header.take_id
    }

    #[test]
    fn it_is_what_the_format_says() {
        // Computed with Python's hashlib over a payload assembled field by field after docs/take-format.md.
        let id = id(&Header { codec_version: 4, ..header() }, b"frame,time_s\n");
        assert_eq!(u128::from_be_bytes(id), 0x6025_74d8_73e9_80b4_9ab3_7376_bd1c_3941);
    }

    #[test]
    fn a_resampler_of_a_later_version_asks_for_an_update() {
        let later = Header { resampler: "dense:better".to_owned(), ..header() };
        let error = later.check().unwrap_err().to_string();
        let expected = ["written by a newer mocapd", "'dense:better'", "update mocapd"];
        assert!(expected.iter().all(|part| error.contains(part)), "{error}");
        assert!(!error.contains("spline"), "names for the command line: {error}");
    }

    #[test]
    fn it_depends_on_the_file_and_every_setting_and_not_on_the_id_before() {
        let first = id(&header(), b"a");
        assert_eq!(first, id(&Header { take_id: [0; 16], ..header() }, b"a"));
        assert_eq!((first[6] >> 4, first[8] >> 6), (8, 2), "version and variant of the UUID");
        let others = [
            id(&header(), b"b"),
            id(&header(), b""),
            id(&Header { software: "mocapd 0.2.0".to_owned(), ..header() }, b"a"),
            id(&Header { resampler: "fast".to_owned(), ..header() }, b"a"),
            id(&Header { codec_version: LONG_KEYS_VERSION, ..header() }, b"a"),
            id(&Header { tolerance_mm: 1.0, ..header() }, b"a"),
            id(&Header { source: None, ..header() }, b"a"),
            id(&Header { settings: vec![(String::new(), String::new())], ..header() }, b"a"),
        ];
        for (i, other) in others.iter().enumerate() {
            assert!(*other != first && !others[..i].contains(other), "{i}: {other:02x?}");
        }
        let mut of_anna = header();
        let anna = Subject { name: "Anna".to_owned(), documents: Vec::new() };
        of_anna.set_import_id(&b"a"[..], Some(&anna)).unwrap();
        assert_ne!(of_anna.take_id, first);
    }

    fn channel(marker_id: u16, label: &str, labelled: bool) -> Channel {
        Channel { marker_id, label: label.to_owned(), labelled }
    }

    #[test]
    fn what_is_usual_takes_a_byte_and_what_is_new_in_the_label() {
        let table = [channel(0, "L.Elbow", true), channel(1, "L.Wrist", true)];
        assert_eq!(write_channels(&table), b"\x07L.Elbow\x25Wrist");
        assert_eq!(read_channels(&write_channels(&table)).unwrap(), table);
    }

    #[test]
    fn any_table_comes_back() {
        let long = "ä".repeat(120);
        let table = [
            channel(7, "", false),
            channel(8, "u001", false),
            channel(8, "u001", false),
            channel(65535, &long, true),
            channel(0, &format!("{long}1"), true),
            channel(1, "ö", true),
        ];
        assert_eq!(read_channels(&write_channels(&table)).unwrap(), table);
        assert_eq!(read_channels(&[]).unwrap(), []);
    }

    #[test]
    fn bad_bytes_are_errors() {
        // Shares bytes with nothing; truncated; a number too long, twice; not UTF-8; an id beyond 16 bits.
        for bytes in [
            &b"\x11a"[..],
            b"\x05ab",
            b"\x0e\xff\xff\xff\x01",
            b"\x0e\x81\x00a",
            b"\x01\xff",
            b"\x0f\xff\xff\x7f\x00",
        ] {
            assert!(read_channels(bytes).is_err(), "{bytes:?}");
        }
        // One byte per entry: memory stays within the limit.
        assert!(read_channels(&vec![0; LIMIT_BYTES]).is_err());
    }
}
