//! Small records: a version, then bincode, bounded, and only ever decoded after the chunk's CRC matched.
//!
//! Structures are frozen per version; docs/take-format.md gives their bytes.

mod clock;
mod header;
mod subject;
mod summary;

use bincode::{
    Decode, Encode,
    config::{Configuration, Limit, LittleEndian, Varint},
    error::DecodeError,
};

pub use clock::{
    CLOCK_ENTRIES_MAX, Clock, ClockBound, ClockJitter, ClockLine, ClockPoint, ClockProbe,
};
pub(crate) use header::MoreChannels;
pub use header::{CODEC_VERSION, Channel, Device, Header, ImportSource};
pub use subject::{DOCUMENT_BYTES_MAX, DOCUMENTS_MAX, Document, Subject};
pub use summary::{DETAIL_BYTES_MAX, EndingKind, SUMMARY_BYTES_MAX, SummaryRecord, TakeEnding};

use crate::{TakeError, chunk::types};

/// Most bytes that decoding may claim: 10 000 labels of 255 bytes fit.
pub(crate) const LIMIT_BYTES: usize = 4 << 20;

type Config = Configuration<LittleEndian, Varint, Limit<LIMIT_BYTES>>;
const CONFIG: Config = bincode::config::standard().with_little_endian().with_limit::<LIMIT_BYTES>();

/// A structure with a chunk type and a version of its own.
pub trait Record: Encode + Decode<()> {
    /// For messages.
    const NAME: &'static str;
    /// The chunk type it travels in.
    const KIND: u8;
    /// The newest version this build reads, and the one it writes.
    const VERSION: u16;

    /// The payload of its chunk.
    ///
    /// # Errors
    /// `InvalidArgument` when it is larger than a reader would accept.
    fn to_payload(&self) -> Result<Vec<u8>, TakeError> {
        let mut out = Self::VERSION.to_le_bytes().to_vec();
        let body = bincode::encode_to_vec(self, CONFIG).map_err(|e| {
            TakeError::InvalidArgument(format!("{} cannot be stored: {e}", Self::NAME))
        })?;
        if body.len() > LIMIT_BYTES {
            return Err(TakeError::InvalidArgument(format!(
                "{} of {} bytes is larger than a take can hold ({LIMIT_BYTES})",
                Self::NAME,
                body.len()
            )));
        }
        // The limit counts what decoding claims, which is more than the bytes: ask the decoder.
        bincode::decode_from_slice::<Self, _>(&body, CONFIG).map_err(|e| {
            let why = match e {
                DecodeError::Other(why) => why.to_owned(),
                e => e.to_string(),
            };
            TakeError::InvalidArgument(format!(
                "{} is larger than a take can hold: {why}",
                Self::NAME
            ))
        })?;
        out.extend_from_slice(&body);
        Ok(out)
    }

    /// From the payload of a chunk at file offset `offset`, whose CRC matched.
    ///
    /// # Errors
    /// `Unsupported` for a newer version, `Corrupt` when the bytes are not that structure and nothing more.
    fn from_payload(payload: &[u8], offset: u64) -> Result<Self, TakeError> {
        let corrupt = |message: String| TakeError::Corrupt { what: Self::NAME, offset, message };
        let (version, body) = payload
            .split_first_chunk::<2>()
            .ok_or_else(|| corrupt("shorter than its version".into()))?;
        let found = u16::from_le_bytes(*version);
        if found != Self::VERSION {
            return Err(TakeError::Unsupported {
                what: Self::NAME,
                found,
                supported: Self::VERSION,
            });
        }
        let (record, used) = bincode::decode_from_slice(body, CONFIG)
            .map_err(|e| corrupt(format!("not decodable: {e}")))?;
        if used != body.len() {
            return Err(corrupt(format!("{} bytes follow the record", body.len() - used)));
        }
        Ok(record)
    }
}

/// What kind of thing happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Encode, Decode)]
pub enum EventKind {
    /// The operator marked a moment.
    Mark,
    /// A trigger input of the device.
    Trigger,
    /// A sync pulse of the device.
    SyncPulse,
    /// The device said something.
    Device,
    /// The host noticed something: disconnected, reconnected, a counter that jumped.
    Host,
}

impl EventKind {
    /// In words.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Mark => "mark",
            Self::Trigger => "trigger",
            Self::SyncPulse => "sync pulse",
            Self::Device => "device",
            Self::Host => "host",
        }
    }

    /// By its word.
    #[must_use]
    pub fn from_word(word: &str) -> Option<Self> {
        let all = [Self::Mark, Self::Trigger, Self::SyncPulse, Self::Device, Self::Host];
        all.into_iter().find(|kind| kind.word() == word)
    }
}

/// One event.
#[derive(Debug, Clone, PartialEq, Eq, Encode, Decode)]
pub struct Event {
    /// What kind.
    pub kind: EventKind,
    /// The row being recorded then.
    pub row: u64,
    /// Device clock, in ticks; 0 when the device did not say.
    pub device_ticks: u64,
    /// Host monotonic clock, in nanoseconds.
    pub host_ns: u64,
    /// Which input.
    pub input: u8,
    /// In words.
    pub text: String,
}

impl Event {
    /// One of a moment of the host's clock, whose row is given to it where it is put.
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

/// How the device's clock runs against the host's: `host_ns = offset_ns + 1e9 * ticks / tick_hz * (1 + drift_ppm * 1e-6)`.
#[derive(Debug, Clone, Copy, PartialEq, Encode, Decode)]
pub struct ClockFit {
    /// Host monotonic time at device tick 0, in nanoseconds.
    pub offset_ns: i64,
    /// How much faster the host's clock runs, in parts per million.
    pub drift_ppm: f64,
    /// Root mean square distance of arrivals from the line, in microseconds.
    pub residual_us: f64,
    /// Arrivals fitted.
    pub n_fitted: u64,
}

/// The counters; docs/take-format.md gives each one's meaning.
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
    /// Frames in, less frames accounted for: 0 when the ledger closes.
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

    /// Whether both balances are zero and no counter contradicted itself.
    #[must_use]
    pub fn closes(&self) -> bool {
        self.frame_balance() == 0 && self.sample_balance() == 0 && self.contradictions.is_empty()
    }

    /// Frames that the device produced and the take does not have, as far as is known.
    #[must_use]
    pub fn frames_lost(&self) -> u64 {
        self.lost().iter().fold(0, |sum, &n| sum.saturating_add(n))
    }

    /// By cause.
    fn lost(&self) -> [u64; 5] {
        [
            self.lost_on_link,
            self.dropped_by_device,
            self.lost_ring_full,
            self.lost_other,
            self.unknown_after_disconnect,
        ]
    }

    /// Whether anything at all was lost: frames, or samples of markers beyond the pool.
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
