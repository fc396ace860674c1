//! SUMMARY: what a reader can learn from the end of a take without reading all of it. It consists of tagged sections;
//! readers skip the unknown ones.

use std::fmt;

use bincode::{Decode, Encode, de::Decoder, enc::Encoder, error::DecodeError, error::EncodeError};

use super::{
    Header, Record, SampleLedger, deflate, inflate, put_section, sample_ledger::PoseErrorsRecord,
    section_content, statistics,
};
use crate::{ChannelOrder, TakeError, chunk::types, statistics::TakeStatistics, varint::Cursor};

/// Longest payload: two records at their limit of 4 MiB, which leaves room for copies of the header and the channel
/// table.
pub const SUMMARY_BYTES_MAX: usize = 8 << 20;

/// Longest detail of an ending, in bytes: a sentence.
pub const DETAIL_BYTES_MAX: usize = 256;

/// The only version of the section list. Each section has its own version.
const VERSION: u16 = 1;

/// The section that holds a [`TakeEnding`].
const ENDING_TAG: u64 = 1;

/// The section that holds a copy of the header with the complete channel table.
const HEADER_TAG: u64 = 2;

/// The only version of that section.
const HEADER_SECTION_VERSION: u16 = 1;

/// The section that holds [`TakeStatistics`].
const STATISTICS_TAG: u64 = 3;

/// The section that holds a [`ChannelOrder`].
const ORDER_TAG: u64 = 5;
const SAMPLE_LEDGER_TAG: u64 = 6;

/// The section that holds the largest errors of poses: those of the ledger's groups that it knows.
const POSE_ERRORS_TAG: u64 = 7;

/// Why a take ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum EndingKind {
    /// On request.
    #[default]
    Stopped,
    /// It reached its set length.
    Length,
    /// The device had no more frames, as at the end of a replay.
    DeviceEnded,
    /// The device disconnected and did not return, or could not be read.
    DeviceGone,
    /// The disk space fell to the reserve.
    DiskFull,
    /// The service was stopped.
    ServiceStopped,
    /// It was saved from the pre-roll.
    Saved,
    /// The recorder was killed or the disk failed; the take was cut off and has been recovered.
    CutOff,
    /// Another program truncated the file during the recording.
    Truncated,
    /// The file system was unmounted, or another one was mounted over it.
    Unmounted,
    /// A code of a later version.
    Other(u16),
}

impl EndingKind {
    /// All named kinds in the order of their codes, from 1.
    pub const ALL: [Self; 10] = [
        Self::Stopped,
        Self::Length,
        Self::DeviceEnded,
        Self::DeviceGone,
        Self::DiskFull,
        Self::ServiceStopped,
        Self::Saved,
        Self::CutOff,
        Self::Truncated,
        Self::Unmounted,
    ];

    /// The stored code.
    #[must_use]
    pub fn code(self) -> u16 {
        match self {
            Self::Other(code) => code,
            named => Self::ALL.iter().position(|kind| *kind == named).map_or(0, |i| i as u16 + 1),
        }
    }

    /// The kind with a stored code.
    #[must_use]
    pub fn from_code(code: u16) -> Self {
        let index = usize::from(code).checked_sub(1);
        index.and_then(|index| Self::ALL.get(index)).copied().unwrap_or(Self::Other(code))
    }

    /// The name in reports and JSON documents.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Stopped => "stopped",
            Self::Length => "length",
            Self::DeviceEnded => "device ended",
            Self::DeviceGone => "device gone",
            Self::DiskFull => "disk full",
            Self::ServiceStopped => "service stopped",
            Self::Saved => "saved",
            Self::CutOff => "cut off",
            Self::Truncated => "truncated",
            Self::Unmounted => "unmounted",
            Self::Other(_) => "other",
        }
    }

    /// The kind with this name; `Other(0)` for an unknown one.
    #[must_use]
    pub fn from_name(word: &str) -> Self {
        Self::ALL.into_iter().find(|kind| kind.name() == word).unwrap_or(Self::Other(0))
    }
}

impl fmt::Display for EndingKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// How a take ended.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct TakeEnding {
    /// The reason.
    pub kind: EndingKind,
    /// Further details, at most [`DETAIL_BYTES_MAX`] bytes; may be empty.
    pub detail: String,
}

impl TakeEnding {
    /// Creates an ending; a longer detail is truncated.
    #[must_use]
    pub fn new(kind: EndingKind, mut detail: String) -> Self {
        detail.truncate(detail.floor_char_boundary(DETAIL_BYTES_MAX));
        Self { kind, detail }
    }
}

impl From<EndingKind> for TakeEnding {
    fn from(kind: EndingKind) -> Self {
        Self { kind, detail: String::new() }
    }
}

impl Record for TakeEnding {
    const NAME: &'static str = "ending";
    const KIND: u8 = types::SUMMARY;
    const VERSION: u16 = 1;
}

const LONG_DETAIL: &str = "a detail of more than 256 bytes";

impl Encode for TakeEnding {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        if self.detail.len() > DETAIL_BYTES_MAX {
            return Err(EncodeError::Other(LONG_DETAIL));
        }
        self.kind.code().encode(encoder)?;
        self.detail.encode(encoder)
    }
}

impl Decode<()> for TakeEnding {
    fn decode<D: Decoder<Context = ()>>(decoder: &mut D) -> Result<Self, DecodeError> {
        let kind = EndingKind::from_code(u16::decode(decoder)?);
        let detail = String::decode(decoder)?;
        if detail.len() > DETAIL_BYTES_MAX {
            return Err(DecodeError::Other(LONG_DETAIL));
        }
        Ok(Self { kind, detail })
    }
}

/// The known sections of a summary.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SummaryRecord {
    /// How the take ended; `None` if not stated.
    pub ending: Option<TakeEnding>,
    /// The header, with the complete channel table of the take; `None` if not stated.
    pub header: Option<Box<Header>>,
    /// The statistics of the take, in the order of the table; `None` if not stated.
    pub statistics: Option<TakeStatistics>,
    /// The order of the markers in the source; `None` if not stated.
    pub order: Option<ChannelOrder>,
    /// The last ledger of sampled channels, with the errors of poses that were measured; `None` if the take has none.
    pub sample_ledger: Option<SampleLedger>,
}

impl SummaryRecord {
    /// Whether it states another order of the markers than this one of the take. A summary with the channel table states
    /// the order of it, if that is not the order of the source.
    pub(crate) fn contradicts_order(&self, order: &ChannelOrder) -> bool {
        match &self.order {
            Some(stated) => stated != order,
            None => self.header.is_some() && !order.is_identity(),
        }
    }

    /// Encodes the payload of its chunk.
    ///
    /// # Errors
    /// `InvalidArgument` when it is larger than a reader accepts.
    pub fn to_payload(&self) -> Result<Vec<u8>, TakeError> {
        let mut out = VERSION.to_le_bytes().to_vec();
        if let Some(ending) = &self.ending {
            put_section(&mut out, ENDING_TAG, &ending.to_payload()?);
        }
        if let Some(header) = &self.header {
            put_section(&mut out, HEADER_TAG, &header_section(header)?);
        }
        if let Some(statistics) = &self.statistics {
            put_section(&mut out, STATISTICS_TAG, &statistics::to_section(statistics)?);
        }
        if let Some(order) = &self.order {
            put_section(&mut out, ORDER_TAG, &order.to_payload());
        }
        if let Some(ledger) = &self.sample_ledger {
            put_section(&mut out, SAMPLE_LEDGER_TAG, &ledger.to_payload()?);
            if let Some(errors) = PoseErrorsRecord::of(ledger) {
                put_section(&mut out, POSE_ERRORS_TAG, &errors.to_payload()?);
            }
        }
        if out.len() > SUMMARY_BYTES_MAX {
            return Err(TakeError::InvalidArgument(format!(
                "a summary of {} bytes is larger than a take can hold ({SUMMARY_BYTES_MAX})",
                out.len()
            )));
        }
        Ok(out)
    }

    /// Decodes the payload of the chunk at file offset `offset`, whose CRC matched.
    ///
    /// # Errors
    /// `Unsupported` for a newer version; `Corrupt` when the sections do not fill the payload, a known section occurs
    /// twice, or its content is invalid.
    pub fn from_payload(payload: &[u8], offset: u64) -> Result<Self, TakeError> {
        let corrupt = |message: &str| TakeError::corrupt("summary", offset, message);
        if payload.len() > SUMMARY_BYTES_MAX {
            return Err(corrupt("larger than a take can hold"));
        }
        let (version, sections) =
            payload.split_first_chunk::<2>().ok_or_else(|| corrupt("shorter than its version"))?;
        let found = u16::from_le_bytes(*version);
        if found != VERSION {
            return Err(TakeError::Unsupported { what: "summary", found, supported: VERSION });
        }
        let mut summary = Self::default();
        let mut pose_errors = None;
        let mut cursor = Cursor::new(sections);
        while !cursor.is_empty() {
            let (Some(tag), Some(section)) = (cursor.varint(), cursor.prefixed()) else {
                return Err(corrupt("a section ends outside the summary"));
            };
            let is_twice = match tag {
                ENDING_TAG => summary.ending.is_some(),
                HEADER_TAG => summary.header.is_some(),
                STATISTICS_TAG => summary.statistics.is_some(),
                ORDER_TAG => summary.order.is_some(),
                SAMPLE_LEDGER_TAG => summary.sample_ledger.is_some(),
                POSE_ERRORS_TAG => pose_errors.is_some(),
                _ => continue,
            };
            if is_twice {
                return Err(corrupt("it has a section twice"));
            }
            let read = match tag {
                POSE_ERRORS_TAG => PoseErrorsRecord::from_payload(section, offset)
                    .map(|errors| pose_errors = Some(errors)),
                _ => summary.set_section(tag, section, offset),
            };
            match read {
                // A newer version counts as an unknown section.
                Err(TakeError::Unsupported { .. }) => {}
                read => read?,
            }
        }
        if let (Some(errors), Some(ledger)) = (&pose_errors, &mut summary.sample_ledger) {
            errors.state_in(ledger);
        }
        Ok(summary)
    }

    /// Decodes a section with a known tag.
    fn set_section(&mut self, tag: u64, section: &[u8], offset: u64) -> Result<(), TakeError> {
        match tag {
            ENDING_TAG => self.ending = Some(TakeEnding::from_payload(section, offset)?),
            HEADER_TAG => self.header = Some(Box::new(header_of_section(section, offset)?)),
            STATISTICS_TAG => self.statistics = Some(statistics::of_section(section, offset)?),
            SAMPLE_LEDGER_TAG => {
                self.sample_ledger = Some(SampleLedger::from_payload(section, offset)?);
            }
            _ => self.order = Some(ChannelOrder::from_payload(section, offset)?),
        }
        Ok(())
    }
}

/// The content of the section with a header.
fn header_section(header: &Header) -> Result<Vec<u8>, TakeError> {
    let out = HEADER_SECTION_VERSION.to_le_bytes().to_vec();
    Ok(deflate(out, &header.to_payload()?)?)
}

/// Decodes the content of the section with a header, in bounded memory.
fn header_of_section(section: &[u8], offset: u64) -> Result<Header, TakeError> {
    const WHAT: &str = "header copy";
    let deflated = section_content(section, WHAT, HEADER_SECTION_VERSION, offset)?;
    let payload = inflate(deflated)
        .ok_or_else(|| TakeError::corrupt(WHAT, offset, "invalid DEFLATE data"))?;
    Header::from_payload(&payload, offset)
}

#[cfg(test)]
mod tests {
    use mocapd_testkit::random::Random;

    use super::*;
    use crate::{
        record::{Channel, ImportSource},
        statistics::ChannelStatistics,
    };

    fn of(kind: EndingKind, detail: &str) -> SummaryRecord {
        let ending = Some(TakeEnding::new(kind, detail.to_owned()));
        SummaryRecord { ending, ..SummaryRecord::default() }
    }

    #[test]
    fn every_ending_comes_back_and_the_bytes_are_those_of_the_document() {
        for kind in EndingKind::ALL.into_iter().chain([EndingKind::Other(777)]) {
            for detail in ["", "the folder was renamed"] {
                let summary = of(kind, detail);
                let payload = summary.to_payload().unwrap();
                assert_eq!(SummaryRecord::from_payload(&payload, 0).unwrap(), summary);
            }
        }
        let bytes = example("A SUMMARY of a take whose disk was full");
        assert_eq!(of(EndingKind::DiskFull, "ok").to_payload().unwrap(), bytes);
    }

    /// The bytes of the example in the document that begins with this sentence.
    fn example(sentence: &str) -> Vec<u8> {
        let document = include_str!("../../../docs/take-format.md");
        let (_, example) = document.split_once(sentence).unwrap();
        let bytes = example.lines().skip(2).map_while(|line| line.strip_prefix("    "));
        let hex = bytes.flat_map(|line| line.split("   ").next().unwrap_or("").split_whitespace());
        hex.map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
    }

    /// The summary of the second example in the document.
    fn of_import() -> SummaryRecord {
        let channel = |(marker_id, label): (u16, &str)| Channel {
            marker_id,
            label: label.to_owned(),
            labelled: true,
        };
        let mut header = Header {
            software: "mocapd 0.1.0".to_owned(),
            resampler: "dense".to_owned(),
            codec_version: 6,
            tolerance_mm: 0.5,
            rate_hz: 120.0,
            source: Some(ImportSource {
                format: "csv".to_owned(),
                file: "heels.csv".to_owned(),
                factor: 1.0,
                ..ImportSource::default()
            }),
            channels: [(0, "LHEE"), (1, "RHEE")].map(channel).to_vec(),
            stretch_rows: 1200,
            ..Header::default()
        };
        header.set_source_bytes(5678);
        let channel =
            |(samples, gaps, knots)| ChannelStatistics { samples, gaps, knots, error_step: 63 };
        let statistics = TakeStatistics {
            channels: [(120, 0, 17), (104, 2, 21)].map(channel).to_vec(),
            rows_with_samples: 120,
            key_rows: 35,
            samples_in_key_rows: 66,
        };
        let (header, statistics) = (Some(Box::new(header)), Some(statistics));
        SummaryRecord { header, statistics, ..SummaryRecord::default() }
    }

    #[test]
    fn the_example_of_an_import_decodes() {
        let (payload, written) =
            (example("A SUMMARY of an import"), of_import().to_payload().unwrap());
        assert_eq!(payload, written, "{written:02X?}");
        assert_eq!(SummaryRecord::from_payload(&payload, 0).unwrap(), of_import());
    }

    /// Sections with matching checksums whose content is wrong.
    #[test]
    fn forged_sections_are_damage_and_cost_no_memory() {
        let whole = of_import();
        let whole_payload = whole.to_payload().unwrap();
        let mut random = Random::new(5);
        for round in 0..20_000 {
            let mut payload = whole_payload.clone();
            for _ in 0..1 + round % 3 {
                let at = 2 + random.below(payload.len() - 2);
                payload[at] = random.byte();
            }
            // An error, or figures with which nothing overflows.
            let Ok(read) = SummaryRecord::from_payload(&payload, 0) else { continue };
            let Some(statistics) = read.statistics else { continue };
            assert!(statistics.samples() <= u64::MAX / 12 && statistics.channels.len() <= 1 << 16);
            assert!(statistics.samples() >= statistics.knots());
        }
        let section = |tag, content: &[u8]| {
            let mut payload = VERSION.to_le_bytes().to_vec();
            put_section(&mut payload, tag, content);
            SummaryRecord::from_payload(&payload, 0)
        };
        let statistics = |figures: &[u8]| section(STATISTICS_TAG, &[&[1, 0], figures].concat());
        // No channels, no rows; 65 536 of them; one more; nothing after the number; more rows than any take has.
        assert!(statistics(&[0, 0]).unwrap().statistics.is_some());
        assert!(statistics(&[0x80, 0x80, 4, 0]).is_ok_and(|read| read.statistics.is_some()));
        for figures in
            [&[0x81, 0x80, 4, 0][..], &[5], &[], &[0, 0x81, 0x80, 0x80, 0x80, 0x80, 0x80, 4]]
        {
            assert!(matches!(statistics(figures), Err(TakeError::Corrupt { .. })), "{figures:?}");
        }
        // A bomb: zeros without end; a copy that is cut; bytes after it.
        let deflated = |bytes: &[u8]| deflate(vec![1, 0], bytes).unwrap();
        let header = whole.header.unwrap().to_payload().unwrap();
        let (bomb, copy) = (deflated(&vec![0; 64 << 20]), deflated(&header));
        assert!(section(HEADER_TAG, &copy).is_ok());
        for content in [
            &bomb[..],
            &copy[..copy.len() - 3],
            &[&copy[..], &[0]].concat(),
            &deflated(&header[..9]),
        ] {
            assert!(matches!(section(HEADER_TAG, content), Err(TakeError::Corrupt { .. })));
        }
        // Sections of later versions are skipped.
        for tag in [HEADER_TAG, STATISTICS_TAG] {
            assert_eq!(section(tag, &[2, 0, 9, 9]).unwrap(), SummaryRecord::default());
        }
    }

    #[test]
    fn unknown_sections_are_skipped_and_known_ones_are_checked() {
        let mut payload = VERSION.to_le_bytes().to_vec();
        put_section(&mut payload, 900, b"from a later version");
        put_section(&mut payload, ENDING_TAG, &[1, 0, 5, 0]);
        put_section(&mut payload, 901, b"");
        assert_eq!(SummaryRecord::from_payload(&payload, 0).unwrap(), of(EndingKind::DiskFull, ""));
        // A truncated payload is an error or has fewer sections; it never states another ending.
        for cut in 0..payload.len() {
            let read = SummaryRecord::from_payload(&payload[..cut], 0);
            let ending = read.ok().and_then(|summary| summary.ending);
            assert!(ending.is_none_or(|ending| ending.kind == EndingKind::DiskFull), "{cut}");
        }
        let mut twice = payload.clone();
        put_section(&mut twice, ENDING_TAG, &[1, 0, 5, 0]);
        let mut wrong = VERSION.to_le_bytes().to_vec();
        put_section(&mut wrong, ENDING_TAG, &[1, 0, 5]);
        let mut long = VERSION.to_le_bytes().to_vec();
        let detail = [&[1, 0, 5, 251, 1, 1][..], &[b'x'; DETAIL_BYTES_MAX + 1]].concat();
        put_section(&mut long, ENDING_TAG, &detail);
        for payload in [twice, wrong, long] {
            let error = SummaryRecord::from_payload(&payload, 0).unwrap_err();
            assert!(matches!(error, TakeError::Corrupt { .. }), "{error}");
        }
        let newer = SummaryRecord::from_payload(&[2, 0], 0).unwrap_err();
        assert!(matches!(newer, TakeError::Unsupported { .. }), "{newer}");
        let mut ending_of_later = VERSION.to_le_bytes().to_vec();
        put_section(&mut ending_of_later, ENDING_TAG, &[2, 0, 9, 9, 9]);
        let read = SummaryRecord::from_payload(&ending_of_later, 0).unwrap();
        assert_eq!(read, SummaryRecord::default());
    }

    #[test]
    fn a_long_detail_is_cut_between_characters() {
        let ending = TakeEnding::new(EndingKind::DeviceGone, "é".repeat(DETAIL_BYTES_MAX));
        assert_eq!(ending.detail.len(), DETAIL_BYTES_MAX);
        let ending =
            TakeEnding::new(EndingKind::DeviceGone, format!("x{}", "é".repeat(DETAIL_BYTES_MAX)));
        assert_eq!(ending.detail.len(), DETAIL_BYTES_MAX - 1);
    }
}
