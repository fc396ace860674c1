//! HEADER and CHANNELS: what a reader must know before the first stretch.

use bincode::{Decode, Encode};
use mocapd_codec::{BLOCK_VERSION, CodecError, ResamplerKind, Settings, Tolerance};

use super::Record;
use crate::{
    TakeError,
    chunk::types,
    motion::{Marker, UpAxis},
};

/// One entry of the channel table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// The device's id; in an import the column, from 0.
    pub marker_id: u16,
    /// The marker's name.
    pub label: String,
    /// Whether the name came from the device or file.
    pub labelled: bool,
}

/// The device that was recorded.
#[derive(Debug, Clone, PartialEq, Eq, Default, Encode, Decode)]
pub struct Device {
    /// Driver family.
    pub driver: String,
    /// How it was opened.
    pub uri: String,
    /// Model, as it says.
    pub model: String,
    /// Serial number.
    pub serial: String,
    /// Firmware version.
    pub firmware: String,
    /// Device clock ticks a second.
    pub tick_hz: u64,
    /// Whether the line runs in the kernel's low-latency mode.
    pub low_latency: bool,
}

/// The file that was imported.
#[derive(Debug, Clone, PartialEq, Default, Encode, Decode)]
pub struct ImportSource {
    /// `c3d`, `trc`, `tsv`, `csv`; `array` for what was in a program's memory.
    pub format: String,
    /// Its name, without folders.
    pub file: String,
    /// Unit as found.
    pub unit: String,
    /// Factor to millimetres.
    pub factor: f64,
    /// Number of its first frame.
    pub first_frame: u64,
    /// What was wrong with it and how it was read all the same.
    pub warnings: Vec<String>,
}

/// The first chunk of a take.
#[derive(Debug, Clone, PartialEq)]
pub struct Header {
    /// What wrote it.
    pub software: String,
    /// So that two takes are never mistaken for each other: random in a recording, in an import made
    /// of its file and settings ([`Header::set_import_id`]).
    pub take_id: [u8; 16],
    /// Wall clock at the start of a recording, in milliseconds since 1970 UTC; 0 where none is known,
    /// as in an import.
    pub created_unix_ms: i64,
    /// Resampler, by name.
    pub resampler: String,
    /// Version of stretches and blocks (docs/take-format.md and docs/codec.md).
    pub codec_version: u16,
    /// Tolerance in millimetres; 0 for `lossless`.
    pub tolerance_mm: f64,
    /// Rows a second.
    pub rate_hz: f64,
    /// 0 unknown, 1 x, 2 y, 3 z.
    pub up_axis: u8,
    /// The device; absent in an import.
    pub device: Option<Device>,
    /// The file; absent in a recording.
    pub source: Option<ImportSource>,
    /// The channel table at the start.
    pub channels: Vec<Channel>,
    /// Rows of a full stretch.
    pub stretch_rows: u32,
    /// The configuration that made it: in an import what was chosen beside resampler and tolerance.
    pub settings: Vec<(String, String)>,
}

/// The format of stretches and blocks that this build writes and reads. 1 to 4 were those of development
/// versions.
pub const CODEC_VERSION: u16 = 6;

// Blocks are a part of it: a new version of theirs is a new one of takes, too.
const _: () = assert!(CODEC_VERSION >= BLOCK_VERSION);

impl Header {
    /// The codec's settings, checked.
    ///
    /// # Errors
    /// `Codec` for an unknown resampler or a tolerance out of range, `Unsupported` for another block format.
    pub fn codec(&self) -> Result<Settings, TakeError> {
        if self.codec_version != CODEC_VERSION {
            return Err(TakeError::Unsupported {
                what: "block format",
                found: self.codec_version,
                supported: CODEC_VERSION,
            });
        }
        let kind: ResamplerKind = self.resampler.parse()?;
        let mm = if kind.is_lossless() { Tolerance::MAX_MM } else { self.tolerance_mm };
        Ok(Settings { kind, tolerance: Tolerance::from_mm(mm)? })
    }

    /// Stores the codec's settings.
    pub fn set_codec(&mut self, settings: &Settings) {
        self.resampler = settings.kind.to_string();
        self.codec_version = CODEC_VERSION;
        self.tolerance_mm = if settings.kind.is_lossless() { 0.0 } else { settings.tolerance.mm() };
    }

    /// Rejects a header whose numbers make no sense to a reader.
    ///
    /// # Errors
    /// `Codec(InvalidArgument)` naming the field.
    pub fn check(&self) -> Result<(), TakeError> {
        if !(self.rate_hz.is_finite() && self.rate_hz > 0.0) {
            let message = format!("a take cannot run at {} Hz", self.rate_hz);
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

impl From<&Channel> for Marker {
    fn from(channel: &Channel) -> Self {
        Self { label: channel.label.clone(), labelled: channel.labelled }
    }
}

impl UpAxis {
    /// As HEADER stores it.
    #[must_use]
    pub fn code(self) -> u8 {
        match self {
            Self::Unknown => 0,
            Self::X => 1,
            Self::Y => 2,
            Self::Z => 3,
        }
    }

    /// From what HEADER stores; anything else is unknown.
    #[must_use]
    pub fn from_code(code: u8) -> Self {
        match code {
            1 => Self::X,
            2 => Self::Y,
            3 => Self::Z,
            _ => Self::Unknown,
        }
    }
}
