//! Small records: a version, then bincode, with bounded memory. They are decoded only after their chunk's CRC matched.
//!
//! The structure of each version is frozen; docs/take-format.md gives its bytes.

mod clock;
mod force_plate;
mod header;
mod sample_ledger;
mod sampled_group;
mod statistics;
mod subject;
mod summary;

use std::{
    io::{Read, Write},
    ops::Range,
};

use bincode::{
    Decode, Encode,
    config::{Configuration, Limit, LittleEndian, Varint},
    error::DecodeError,
};
use flate2::{Compression, bufread::DeflateDecoder, write::DeflateEncoder};

use crate::{TakeError, chunk::types, stretch::ROWS_PASSED_MAX, varint};

pub use clock::{
    CLOCK_ENTRIES_MAX, Clock, ClockBound, ClockJitter, ClockLine, ClockPoint, ClockProbe,
};
pub use force_plate::{RecordedPlate, StatedPlate};
pub(crate) use header::MoreChannels;
pub(crate) use header::long_stretch_rows;
pub use header::{
    CODEC_VERSION, Channel, Device, Header, ImportSource, KEYS_APART_S_MAX, KeyDistance,
    LONG_KEYS_VERSION, RATES_HZ,
};
pub use sample_ledger::{GroupLedger, MeasuredErrors, SampleLedger};
pub(crate) use sampled_group::SAMPLES_MAX;
pub use sampled_group::{SampleBounds, SampleForm, SampledChannel, SampledGroup};
pub use subject::{DOCUMENT_BYTES_MAX, DOCUMENTS_MAX, Document, Subject};
pub use summary::{DETAIL_BYTES_MAX, EndingKind, SUMMARY_BYTES_MAX, SummaryRecord, TakeEnding};

/// Most bytes that decoding may claim; 10 000 labels of 255 bytes fit.
pub(crate) const LIMIT_BYTES: usize = 4 << 20;

type Config = Configuration<LittleEndian, Varint, Limit<LIMIT_BYTES>>;
const CONFIG: Config = bincode::config::standard().with_little_endian().with_limit::<LIMIT_BYTES>();

/// A structure with its own chunk type and version.
pub trait Record: Encode + Decode<()> {
    /// Name in messages.
    const NAME: &'static str;
    /// Chunk type.
    const KIND: u8;
    /// The version that this build reads and writes.
    const VERSION: u16;

    /// Encodes the payload of its chunk.
    ///
    /// # Errors
    /// `InvalidArgument` when it is larger than a reader accepts.
    fn to_payload(&self) -> Result<Vec<u8>, TakeError> {
        let refused = |why: String| TakeError::InvalidArgument(format!("{} {why}", Self::NAME));
        let mut out = Self::VERSION.to_le_bytes().to_vec();
        let body = bincode::encode_to_vec(self, CONFIG)
            .map_err(|e| refused(format!("cannot be stored: {e}")))?;
        let n = body.len();
        if n > LIMIT_BYTES {
            let why = format!("of {n} bytes is larger than a take can hold ({LIMIT_BYTES})");
            return Err(refused(why));
        }
        // The limit counts the memory that decoding claims, which exceeds the encoded size, so decode to check it.
        bincode::decode_from_slice::<Self, _>(&body, CONFIG).map_err(|e| match e {
            DecodeError::Other(why) => refused(format!("is larger than a take can hold: {why}")),
            e => refused(format!("is larger than a take can hold: {e}")),
        })?;
        out.extend_from_slice(&body);
        Ok(out)
    }

    /// Decodes the payload of the chunk at file offset `offset`, whose CRC matched.
    ///
    /// # Errors
    /// `Unsupported` for another version, `Corrupt` unless the bytes are exactly one such structure.
    fn from_payload(payload: &[u8], offset: u64) -> Result<Self, TakeError> {
        let corrupt = |message: &str| TakeError::corrupt(Self::NAME, offset, message);
        let (version, body) =
            payload.split_first_chunk::<2>().ok_or_else(|| corrupt("shorter than its version"))?;
        let (found, supported) = (u16::from_le_bytes(*version), Self::VERSION);
        if found != supported {
            return Err(TakeError::Unsupported { what: Self::NAME, found, supported });
        }
        let (record, used) = bincode::decode_from_slice(body, CONFIG)
            .map_err(|e| corrupt(&format!("cannot be decoded: {e}")))?;
        if used != body.len() {
            return Err(corrupt(&format!("{} bytes follow the record", body.len() - used)));
        }
        Ok(record)
    }
}

/// Appends the deflated `payload` to `out`.
fn deflate(out: Vec<u8>, payload: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut deflate = DeflateEncoder::new(out, Compression::best());
    deflate.write_all(payload)?;
    deflate.finish()
}

/// Inflates all of `deflated`, in bounded memory; `None` unless it is the payload of a record, or a part of one.
fn inflate(deflated: &[u8]) -> Option<Vec<u8>> {
    /// Longest payload of a record: its version and a structure at its limit.
    const PAYLOAD_BYTES_MAX: u64 = 2 + LIMIT_BYTES as u64;
    let mut inflated = DeflateDecoder::new(deflated).take(PAYLOAD_BYTES_MAX + 1);
    let mut payload = Vec::new();
    let is_whole = inflated.read_to_end(&mut payload).is_ok();
    let is_bounded = inflated.limit() > 0 && inflated.into_inner().into_inner().is_empty();
    (is_whole && is_bounded).then_some(payload)
}

/// Appends a section: its tag, its length, its content.
fn put_section(out: &mut Vec<u8>, tag: u64, section: &[u8]) {
    varint::put(out, tag);
    varint::put_prefixed(out, section);
}

/// Splits the version off the front of a section, and rejects all but `supported`.
pub(crate) fn section_content<'a>(
    section: &'a [u8],
    what: &'static str,
    supported: u16,
    offset: u64,
) -> Result<&'a [u8], TakeError> {
    let Some((version, content)) = section.split_first_chunk::<2>() else {
        return Err(TakeError::corrupt(what, offset, "shorter than its version"));
    };
    match u16::from_le_bytes(*version) {
        found if found == supported => Ok(content),
        found => Err(TakeError::Unsupported { what, found, supported }),
    }
}

/// The kind of an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Encode, Decode)]
pub enum EventKind {
    /// The operator marked a moment.
    Mark,
    /// A trigger input of the device changed.
    Trigger,
    /// A sync pulse of the device.
    SyncPulse,
    /// The device reported something.
    Device,
    /// The host noticed something: a disconnection, a reconnection, a counter that jumped.
    Host,
}

impl EventKind {
    /// The name of the kind.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Mark => "mark",
            Self::Trigger => "trigger",
            Self::SyncPulse => "sync pulse",
            Self::Device => "device",
            Self::Host => "host",
        }
    }

    /// The kind with this name.
    #[must_use]
    pub fn from_name(word: &str) -> Option<Self> {
        let all = [Self::Mark, Self::Trigger, Self::SyncPulse, Self::Device, Self::Host];
        all.into_iter().find(|kind| kind.name() == word)
    }
}

/// An event during a recording.
#[derive(Debug, Clone, PartialEq, Eq, Encode, Decode)]
pub struct Event {
    /// Its kind.
    pub kind: EventKind,
    /// The row recorded at that time.
    pub row: u64,
    /// Device time in ticks; 0 if the device did not state it.
    pub device_ticks: u64,
    /// Host monotonic time, in nanoseconds.
    pub host_ns: u64,
    /// Number of the device's input.
    pub input: u8,
    /// A description; may be empty.
    pub text: String,
}

impl Event {
    /// Creates an event at a host time; the writer sets its row.
    #[must_use]
    pub fn new(kind: EventKind, host_ns: u64, text: impl Into<String>) -> Self {
        Self { kind, row: 0, device_ticks: 0, host_ns, input: 0, text: text.into() }
    }
}

impl Record for Event {
    const NAME: &'static str = "event";
    const KIND: u8 = types::EVENT;
    const VERSION: u16 = 1;
}

/// The relation of the two clocks: `host_ns = offset_ns + 1e9 * ticks / tick_hz * (1 + drift_ppm * 1e-6)`.
#[derive(Debug, Clone, Copy, PartialEq, Encode, Decode)]
pub struct ClockFit {
    /// Host monotonic time at device tick 0, in nanoseconds.
    pub offset_ns: i64,
    /// How much faster the host's clock runs, in parts per million.
    pub drift_ppm: f64,
    /// Root mean square distance of arrivals from the line, in microseconds.
    pub residual_us: f64,
    /// Number of arrivals fitted.
    pub n_fitted: u64,
}

/// Counters of frames, samples and link messages; docs/take-format.md defines each.
#[derive(Debug, Clone, PartialEq, Default, Encode, Decode)]
#[expect(missing_docs, reason = "docs/take-format.md, The ledger")]
pub struct Ledger {
    pub finished: bool,
    pub frames_sent: u64,
    pub recorded: u64,
    pub lost_on_link: u64,
    pub dropped_by_device: u64,
    pub lost_ring_full: u64,
    pub lost_other: u64,
    pub duplicates: u64,
    pub unknown_after_disconnect: u64,
    pub samples_announced: u64,
    pub samples_present: u64,
    pub samples_occluded: u64,
    pub samples_not_finite: u64,
    pub markers_dropped: u64,
    pub link_bytes: u64,
    pub link_bytes_skipped: u64,
    pub link_messages: u64,
    pub link_messages_damaged: u64,
    pub link_messages_unknown: u64,
    pub contradictions: Vec<String>,
    pub clock: Option<ClockFit>,
}

impl Ledger {
    /// Frames sent, less frames accounted for: 0 when the ledger closes.
    #[must_use]
    pub fn frame_balance(&self) -> i128 {
        let lost = self.lost().map(i128::from).iter().sum::<i128>();
        i128::from(self.frames_sent) - i128::from(self.recorded) - lost
    }

    /// Samples announced, less samples accounted for: 0 when the ledger closes.
    #[must_use]
    pub fn sample_balance(&self) -> i128 {
        i128::from(self.samples_announced)
            - i128::from(self.samples_present)
            - i128::from(self.samples_occluded)
    }

    /// Whether both balances are zero and no counter contradicts another.
    #[must_use]
    pub fn closes(&self) -> bool {
        self.frame_balance() == 0 && self.sample_balance() == 0 && self.contradictions.is_empty()
    }

    /// Frames that the device produced and the take lacks, if the loss is known.
    #[must_use]
    pub fn frames_lost(&self) -> u64 {
        self.lost().iter().fold(0, |sum, &n| sum.saturating_add(n))
    }

    /// Every counter with its name, in the order of docs/take-format.md.
    #[must_use]
    pub fn counters(&self) -> [(&'static str, u64); 18] {
        self.clone().counters_mut().map(|(name, count)| (name, *count))
    }

    /// Adds every counter of another ledger.
    pub fn add_counters(&mut self, other: &Self) {
        for ((_, sum), (_, count)) in self.counters_mut().into_iter().zip(other.counters()) {
            *sum = sum.saturating_add(count);
        }
    }

    fn counters_mut(&mut self) -> [(&'static str, &mut u64); 18] {
        [
            ("frames_sent", &mut self.frames_sent),
            ("recorded", &mut self.recorded),
            ("lost_on_link", &mut self.lost_on_link),
            ("dropped_by_device", &mut self.dropped_by_device),
            ("lost_ring_full", &mut self.lost_ring_full),
            ("lost_other", &mut self.lost_other),
            ("duplicates", &mut self.duplicates),
            ("unknown_after_disconnect", &mut self.unknown_after_disconnect),
            ("samples_announced", &mut self.samples_announced),
            ("samples_present", &mut self.samples_present),
            ("samples_occluded", &mut self.samples_occluded),
            ("samples_not_finite", &mut self.samples_not_finite),
            ("markers_dropped", &mut self.markers_dropped),
            ("link_bytes", &mut self.link_bytes),
            ("link_bytes_skipped", &mut self.link_bytes_skipped),
            ("link_messages", &mut self.link_messages),
            ("link_messages_damaged", &mut self.link_messages_damaged),
            ("link_messages_unknown", &mut self.link_messages_unknown),
        ]
    }

    /// Lost frames by cause.
    fn lost(&self) -> [u64; 5] {
        [
            self.lost_on_link,
            self.dropped_by_device,
            self.lost_ring_full,
            self.lost_other,
            self.unknown_after_disconnect,
        ]
    }

    /// Whether anything was lost: frames, or samples of markers beyond the channel pool.
    #[must_use]
    pub fn lost_anything(&self) -> bool {
        self.frames_lost() > 0 || self.markers_dropped > 0
    }
}

impl Record for Ledger {
    const NAME: &'static str = "ledger";
    const KIND: u8 = types::LEDGER;
    const VERSION: u16 = 1;
}

/// Key of the setting that states the requested length of a take, as it was written.
pub const SPLIT_SETTING: &str = "split";

/// Key of the setting that states the id of the series' first take, in hexadecimal.
pub const SERIES_SETTING: &str = "series";

/// Key of the setting that states the number of the take in the series, from 1.
pub const PART_SETTING: &str = "part";

/// Key of the setting that states which row of the recording is row 0 of the take.
pub const FIRST_FRAME_SETTING: &str = "part_first_frame";

/// Which rows of a divided recording a take has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct SeriesPlace {
    series: String,
    rows: Range<u64>,
}

impl SeriesPlace {
    /// The place of a take of `n_rows` rows; `None` if its header states none.
    pub(crate) fn of(header: &Header, n_rows: u64) -> Option<Self> {
        let setting = |wanted: &str| {
            let found = header.settings.iter().find(|(key, _)| key == wanted);
            found.map(|(_, value)| value.as_str())
        };
        let first_row: u64 = setting(FIRST_FRAME_SETTING)?.parse().ok()?;
        let rows = first_row..first_row.checked_add(n_rows)?;
        Some(Self { series: setting(SERIES_SETTING)?.to_owned(), rows })
    }

    /// Rows of the recording between a take and a later one; `None` if they are not of one series, not in order, or
    /// farther apart than a take can hold.
    pub(crate) fn rows_between(before: Option<Self>, after: Option<Self>) -> Option<u64> {
        let (before, after) = before.zip(after)?;
        let rows = after.rows.start.checked_sub(before.rows.end)?;
        (before.series == after.series && rows < ROWS_PASSED_MAX).then_some(rows)
    }

    /// Sets the place of a take without its first `rows` rows.
    pub(crate) fn advance(header: &mut Header, rows: u64) {
        let first_row = header.settings.iter_mut().find(|(key, _)| key == FIRST_FRAME_SETTING);
        if let Some((_, value)) = first_row
            && let Ok(row) = value.parse::<u64>()
        {
            *value = row.saturating_add(rows).to_string();
        }
    }

    /// Turns the place of a take into that of a take in which others follow it. It remains if all are of `one_series`.
    pub(crate) fn join(header: &mut Header, one_series: bool) {
        let keys = [SPLIT_SETTING, PART_SETTING, SERIES_SETTING, FIRST_FRAME_SETTING];
        // The joined take is no longer one of the takes into which the recording was divided.
        let untrue = if one_series { &keys[..2] } else { &keys[..] };
        header.settings.retain(|(key, _)| !untrue.contains(&key.as_str()));
    }
}
