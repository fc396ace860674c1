//! FOREIGN: parts of an imported file that a take does not model, kept for export to the same format.

pub mod analog;
pub mod content;
pub(crate) mod force_plate;
pub mod force_plates;
pub mod parameters;
pub mod tolerance;

use std::{
    io::{self, BufReader, ErrorKind, Read, Seek, SeekFrom},
    sync::Arc,
};

use flate2::{
    Compression, Decompress, FlushDecompress, Status, bufread::DeflateDecoder,
    write::DeflateEncoder,
};

use self::content::{Content, ScratchFile, Spool};
use crate::{
    TakeError,
    sampled::{LostSamples, SampledPart},
    varint,
};

/// Longest foreign part. The analog section of a C3D file stays below it even at the format's own limits.
pub(crate) const DATA_BYTES_MAX: u64 = 1 << 28;

/// A part of an imported file that a take does not model, kept for export to the same format.
#[derive(Debug, Clone, PartialEq)]
pub struct Foreign {
    /// Format and part: `c3d/parameters`, `c3d/analog`, `c3d/residuals`, `c3d/model-outputs`, `trc/header`...
    pub kind: String,
    /// The content, in the layout that docs/foreign.md gives for its kind.
    pub data: Content,
    /// The largest error of each column, in its stored samples, if samples were replaced by others within a tolerance;
    /// empty if all are those of the file.
    pub bounds: Vec<f64>,
}

impl Foreign {
    /// A part whose content is that of the file.
    #[must_use]
    pub fn exact(kind: impl Into<String>, data: impl Into<Content>) -> Self {
        Self { kind: kind.into(), data: data.into(), bounds: Vec::new() }
    }
}

/// The payload of a FOREIGN chunk.
#[derive(Debug)]
pub(crate) struct ForeignPayload {
    /// Kind and length of the content.
    pub(crate) front: Vec<u8>,
    /// The deflated content, stored where the content is.
    pub(crate) deflated: Content,
}

impl ForeignPayload {
    /// Encodes a part.
    ///
    /// # Errors
    /// `InvalidArgument` for content that is too long; `Io` if its scratch file cannot be read or written.
    pub(crate) fn of(part: &Foreign) -> Result<Self, TakeError> {
        let len = part.data.len();
        check_length(part)?;
        let mut front = Vec::new();
        varint::put_prefixed(&mut front, part.kind.as_bytes());
        varint::put(&mut front, len);
        let deflated = part.data.converted(deflated_bytes_max(len), |out| {
            let mut deflate = DeflateEncoder::new(out, Compression::best());
            io::copy(&mut part.data.reader(), &mut deflate)?;
            deflate.finish().map(|_| ())
        })?;
        Ok(Self { front, deflated })
    }
}

/// Refuses a part that is longer than a take can hold.
pub(crate) fn check_length(part: &Foreign) -> Result<(), TakeError> {
    let len = part.data.len();
    if len <= DATA_BYTES_MAX {
        return Ok(());
    }
    Err(TakeError::InvalidArgument(format!(
        "{} of {len} bytes is longer than a take can hold; import with --drop-foreign",
        part.kind
    )))
}

/// Maximum number of bytes of deflated content: a block that does not compress is stored with five more bytes, and no
/// block is shorter than 1 KiB but the last.
fn deflated_bytes_max(len: u64) -> u64 {
    len + 5 * (len / 1024) + 64
}

/// A foreign part of a take, not yet read. [`TakeFrames::open_with`](crate::TakeFrames::open_with) reads its content.
#[derive(Debug, Clone, PartialEq)]
pub struct ForeignPart {
    /// Its kind, such as `c3d/analog`.
    pub kind: String,
    stored: StoredPart,
}

/// How a take stores a part.
#[derive(Debug, Clone, PartialEq)]
enum StoredPart {
    Deflated(DeflatedPart),
    Sampled(SampledPart),
}

/// The place of a FOREIGN chunk's content.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct DeflatedPart {
    /// Size of the content.
    pub(crate) data_bytes: u64,
    /// File offset of the deflated content.
    pub(crate) at: u64,
    bytes: u64,
    /// File offset of its chunk.
    offset: u64,
}

impl From<SampledPart> for ForeignPart {
    fn from(part: SampledPart) -> Self {
        Self { kind: part.kind().to_owned(), stored: StoredPart::Sampled(part) }
    }
}

impl ForeignPart {
    /// Parses the FOREIGN chunk at file offset `offset`, whose payload of `payload_bytes` begins at `payload_at` with `front`.
    pub(crate) fn from_payload(
        front: &[u8],
        (payload_at, payload_bytes): (u64, u64),
        offset: u64,
    ) -> Result<Self, TakeError> {
        let mut cursor = varint::Cursor::new(front);
        let (kind, data_bytes) =
            parse_front(&mut cursor).map_err(|error| corrupt(offset, error))?;
        let in_front = (front.len() - cursor.rest().len()) as u64;
        let stored = StoredPart::Deflated(DeflatedPart {
            data_bytes,
            at: payload_at + in_front,
            bytes: payload_bytes.saturating_sub(in_front),
            offset,
        });
        Ok(Self { kind: kind.to_owned(), stored })
    }

    /// Size of its content.
    #[must_use]
    pub fn data_bytes(&self) -> u64 {
        match &self.stored {
            StoredPart::Deflated(part) => part.data_bytes,
            StoredPart::Sampled(part) => part.data_bytes(),
        }
    }

    /// Size of its content if no sample were lost, to which limits apply.
    pub(crate) fn source_bytes(&self) -> u64 {
        match &self.stored {
            StoredPart::Deflated(part) => part.data_bytes,
            StoredPart::Sampled(part) => part.source_bytes(),
        }
    }

    /// Size of the encoded content in the take.
    #[must_use]
    pub fn stored_bytes(&self) -> u64 {
        match &self.stored {
            StoredPart::Deflated(part) => part.bytes,
            StoredPart::Sampled(part) => part.stored_bytes(),
        }
    }

    /// The largest error of each column, as in [`Foreign::bounds`].
    #[must_use]
    pub fn bounds(&self) -> Vec<f64> {
        self.sampled().map(SampledPart::bounds).unwrap_or_default()
    }

    /// Its groups of sampled channels; `None` if it is stored in a FOREIGN chunk.
    #[must_use]
    pub fn sampled(&self) -> Option<&SampledPart> {
        match &self.stored {
            StoredPart::Deflated(_) => None,
            StoredPart::Sampled(part) => Some(part),
        }
    }

    /// Its groups of sampled channels, to which others may be added.
    pub(crate) fn sampled_mut(&mut self) -> Option<&mut SampledPart> {
        match &mut self.stored {
            StoredPart::Deflated(_) => None,
            StoredPart::Sampled(part) => Some(part),
        }
    }

    /// The place of its content in a FOREIGN chunk.
    pub(crate) fn deflated(&self) -> Option<&DeflatedPart> {
        match &self.stored {
            StoredPart::Deflated(part) => Some(part),
            StoredPart::Sampled(_) => None,
        }
    }

    /// Reads the content from the same file. Returns also the samples whose blocks cannot be decoded; in place of these,
    /// and of lost ones, the content has NaN, or 0 for residuals.
    ///
    /// # Errors
    /// `Io`; `Corrupt` when the file has changed since it was parsed; `InvalidArgument` if a description is missing.
    pub(crate) fn read(
        &self,
        input: &mut (impl Read + Seek),
        spool: &mut Spool<impl Fn() -> io::Result<Arc<dyn ScratchFile>>>,
    ) -> Result<(Foreign, Vec<LostSamples>), TakeError> {
        let (data, undecodable) = match &self.stored {
            StoredPart::Deflated(part) => (part.read(input, spool)?, Vec::new()),
            StoredPart::Sampled(_) if self.source_bytes() > DATA_BYTES_MAX => {
                let message = format!("{}: longer than a take can hold", self.kind);
                return Err(TakeError::InvalidArgument(message));
            }
            StoredPart::Sampled(part) => part.read(input, spool)?,
        };
        Ok((Foreign { kind: self.kind.clone(), data, bounds: self.bounds() }, undecodable))
    }

    /// Reads the content like [`read`](Self::read), for another take: samples have the form of the source. Returns also
    /// the samples that are lost, whose numbers in the content mean nothing, and those that cannot be decoded.
    ///
    /// # Errors
    /// Those of [`read`](Self::read).
    pub(crate) fn read_for_edit(
        &self,
        input: &mut (impl Read + Seek),
        spool: &mut Spool<impl Fn() -> io::Result<Arc<dyn ScratchFile>>>,
    ) -> Result<(Foreign, Vec<LostSamples>, Vec<LostSamples>), TakeError> {
        match &self.stored {
            StoredPart::Sampled(part) if self.source_bytes() <= DATA_BYTES_MAX => {
                let (data, lost, undecodable) = part.read_source_form(input, spool)?;
                Ok((
                    Foreign { kind: self.kind.clone(), data, bounds: self.bounds() },
                    lost,
                    undecodable,
                ))
            }
            _ => {
                let (part, undecodable) = self.read(input, spool)?;
                Ok((part, Vec::new(), undecodable))
            }
        }
    }
}

impl DeflatedPart {
    fn read(
        &self,
        input: &mut (impl Read + Seek),
        spool: &mut Spool<impl Fn() -> io::Result<Arc<dyn ScratchFile>>>,
    ) -> Result<Content, TakeError> {
        input.seek(SeekFrom::Start(self.at))?;
        let deflated = BufReader::new(input.by_ref().take(self.bytes));
        let mut inflated = DeflateDecoder::new(deflated);
        let data = spool.put(&mut inflated, self.data_bytes);
        let data = data.map_err(|error| match error.kind() {
            ErrorKind::InvalidInput | ErrorKind::InvalidData | ErrorKind::UnexpectedEof => {
                corrupt(self.offset, &format!("invalid DEFLATE data: {error}"))
            }
            _ => error.into(),
        })?;
        if data.len() != self.data_bytes {
            return Err(corrupt(self.offset, WRONG_LENGTH));
        }
        Ok(data)
    }
}

const WRONG_LENGTH: &str = "its length is not the stated one";

/// Longest kind of a part whose chunk is too long to hold. Importers write kinds of at most 20 bytes.
const LONG_KIND_BYTES_MAX: u64 = 64;

/// Maximum number of bytes of kind and length of such a part: two varints and the kind.
pub(crate) const FRONT_BYTES: usize = 10 + LONG_KIND_BYTES_MAX as usize + 10;

/// Whether these bytes are a plausible start of a long FOREIGN chunk's payload.
pub(crate) fn may_begin_with(payload: &[u8]) -> bool {
    parse_front(&mut varint::Cursor::new(payload)).is_ok_and(|(kind, _)| {
        let is_printable = kind.bytes().all(|byte| byte.is_ascii_graphic());
        is_printable && (1..=LONG_KIND_BYTES_MAX).contains(&(kind.len() as u64))
    })
}

/// Parses the kind and the length of the content.
fn parse_front<'a>(cursor: &mut varint::Cursor<'a>) -> Result<(&'a str, u64), &'static str> {
    let kind = cursor.prefixed().and_then(|kind| std::str::from_utf8(kind).ok());
    let kind = kind.ok_or("its kind is missing or not UTF-8")?;
    let len = cursor.varint().ok_or("its length is missing")?;
    if len > DATA_BYTES_MAX { Err("longer than a take can hold") } else { Ok((kind, len)) }
}

fn corrupt(offset: u64, message: &str) -> TakeError {
    TakeError::corrupt("foreign part", offset, message)
}

/// Size of the buffer for inflated bytes.
const INFLATED_BYTES: usize = 1 << 13;

/// Inflates a part to validate it, and discards the output.
#[derive(Debug)]
pub(crate) struct InflateCheck {
    inflater: Decompress,
    stated_bytes: u64,
    is_ended: bool,
    message: Option<String>,
}

impl InflateCheck {
    /// A check of a part whose content has `stated_bytes`.
    pub(crate) fn new(stated_bytes: u64) -> Self {
        Self { inflater: Decompress::new(false), stated_bytes, is_ended: false, message: None }
    }

    /// Inflates the next deflated bytes.
    pub(crate) fn push(&mut self, mut bytes: &[u8]) {
        let mut inflated = [0; INFLATED_BYTES];
        while !self.is_ended && self.message.is_none() {
            let before = (self.inflater.total_in(), self.inflater.total_out());
            match self.inflater.decompress(bytes, &mut inflated, FlushDecompress::None) {
                Ok(status) => self.is_ended = status == Status::StreamEnd,
                Err(error) => self.message = Some(format!("invalid DEFLATE data: {error}")),
            }
            let taken = (self.inflater.total_in() - before.0) as usize;
            let produced = (self.inflater.total_out() - before.1) as usize;
            bytes = bytes.get(taken..).unwrap_or_default();
            if self.inflater.total_out() > self.stated_bytes {
                self.message = Some(WRONG_LENGTH.to_owned());
            }
            if bytes.is_empty() && produced < INFLATED_BYTES || taken == 0 && produced == 0 {
                return;
            }
        }
    }

    /// Ends the check of the part at file offset `offset`.
    pub(crate) fn finish(self, offset: u64) -> Result<(), TakeError> {
        match self.message {
            Some(message) => Err(corrupt(offset, &message)),
            None if !self.is_ended => Err(corrupt(offset, "invalid DEFLATE data: truncated")),
            None if self.inflater.total_out() == self.stated_bytes => Ok(()),
            None => Err(corrupt(offset, WRONG_LENGTH)),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::{content::MemoryScratch, *};

    fn to_payload(part: &Foreign) -> Vec<u8> {
        let ForeignPayload { front, deflated } = ForeignPayload::of(part).unwrap();
        [front, deflated.to_vec(u64::MAX).unwrap().unwrap()].concat()
    }

    fn read(payload: &[u8]) -> Result<Foreign, TakeError> {
        let len = payload.len() as u64;
        let part = ForeignPart::from_payload(payload, (0, len), 0)?;
        let mut inflation = InflateCheck::new(part.data_bytes());
        payload[part.deflated().unwrap().at as usize..]
            .chunks(7)
            .for_each(|piece| inflation.push(piece));
        inflation.finish(0)?;
        let mut spool = Spool::new(|| unreachable!("few bytes"));
        part.read(&mut Cursor::new(payload), &mut spool).map(|(part, _)| part)
    }

    #[test]
    fn a_part_round_trips_and_damage_is_an_error() {
        for len in [0, 5, 4000, 100_000] {
            let data: Vec<_> = (0..len).map(|i: u64| (i * i / 3) as u8).collect();
            let part = Foreign::exact("c3d/analog", data);
            let payload = to_payload(&part);
            assert!(may_begin_with(&payload));
            assert_eq!(read(&payload).unwrap(), part);
            for cut in (0..payload.len()).step_by(1 + payload.len() / 500) {
                assert!(read(&payload[..cut]).is_err(), "{cut} of {len}");
            }
        }
    }

    #[test]
    fn a_part_is_deflated_equally_in_memory_and_in_a_scratch_file() {
        let new_scratch = || Ok(Arc::new(MemoryScratch::default()) as Arc<dyn ScratchFile>);
        let mut spool = Spool::new(new_scratch);
        // The first content takes what may be in memory.
        spool.zeros(8 << 20).unwrap();
        let mut state = 7_u32;
        for (len, smooth) in [(0, 0), (1, 0), (300_000, 1), (300_000, 200), (9 << 20, 1)] {
            let byte = |i: u64| {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                if i.is_multiple_of(smooth.max(1)) { (state >> 24) as u8 } else { i as u8 / 16 }
            };
            let bytes: Vec<u8> = (0..len).map(byte).collect();
            let spooled = spool.put(&mut &bytes[..], len).unwrap();
            let part = |data| Foreign::exact("c3d/analog", data);
            let in_memory = to_payload(&part(bytes.into()));
            assert!(in_memory == to_payload(&part(spooled)), "{len} bytes, {smooth}");
            assert!(
                in_memory.len() as u64 <= deflated_bytes_max(len) + 16,
                "{len} bytes, {smooth}"
            );
        }
    }

    #[test]
    fn a_part_longer_than_a_take_can_hold_is_refused_without_its_content() {
        let part = Foreign::exact("a", Content::omitted(DATA_BYTES_MAX + 1));
        let error = ForeignPayload::of(&part).unwrap_err();
        assert!(error.to_string().contains("import with --drop-foreign"), "{error}");
    }

    #[test]
    fn a_wrong_length_is_an_error() {
        let part = Foreign::exact("a", vec![7; 300]);
        let mut payload = to_payload(&part);
        assert_eq!(payload[2..4], [0xac, 0x02]);
        for stated in [0xab, 0xad] {
            payload[2] = stated;
            assert!(read(&payload).is_err());
        }
    }
}
