//! Turns chunks into events: short chunks from the buffer, long ones piece by piece as they arrive, and damaged regions
//! with the search for the next valid chunk. A chunk of which only the head is damaged is repaired: the position of the
//! next chunk gives its length, and its CRC gives its type.

use crc32fast::Hasher;

use super::{TakeEvent, TakeReader};
use crate::{
    ChannelOrder, NotATake, TakeError,
    chunk::{
        self, CHUNK_HELD_MAX, CRC_BYTES, ChunkHead, ChunkParse, HEAD_BYTES_MAX, LongChunkScan,
        LongChunks, MAY_SKIP, PAYLOAD_BYTES_MAX, PrefixCrcs, ResyncOutcome, WINDOW_BYTES, types,
    },
    foreign::{self, ForeignPart, InflateCheck},
    index::{Footer, parse_index},
    record::{
        Clock, Event, Header, Ledger, MoreChannels, Record, SampleLedger, SampledGroup, Subject,
        SummaryRecord,
    },
    sampled::{SampleTimes, SamplesChunk},
    stretch::{self, CHANNELS_MAX, Placement, StretchChain},
    varint,
};

/// The file ends inside a chunk.
const CUT: &str = "the file ends inside a chunk";

/// A chunk's CRC does not match.
const BAD_CRC: &str = "checksum does not match";

impl TakeReader {
    /// Parses the chunk at the front of the unprocessed bytes, which follow the magic or a valid chunk. Returns its size
    /// if it is complete; otherwise the state changed, and the caller tries again.
    pub(super) fn next_chunk(&mut self) -> Option<usize> {
        let waiting = &self.buffer[self.used..];
        let held_max = CHUNK_HELD_MAX.max(waiting.len() as u64);
        let offset = self.offset();
        let is_header = offset == chunk::MAGIC.len() as u64;
        let begin_damage =
            |message| Some(Damage::new(offset, waiting, message, is_header && message == CUT));
        match chunk::head(waiting) {
            ChunkHead::Valid { kind, len, .. } if len > held_max && !self.complete => {
                match self.long_chunks.is_whole(offset) {
                    None => self.scan = Some(LongChunkScan::new(offset, true)),
                    Some(false) if self.long_chunks.is_cut(offset + len) => {
                        self.damage = begin_damage(CUT);
                    }
                    Some(false) => self.damage = begin_damage(BAD_CRC),
                    Some(true) if kind == types::STRETCH && len <= stretch::BYTES_MAX => {
                        self.needed = len;
                    }
                    Some(true) => {
                        let inflates = !self.skips_content;
                        self.long_chunk = Some(LongChunk::new(kind, offset, len, inflates));
                    }
                }
                return None;
            }
            _ => {}
        }
        // After damage, chunks that begin and end anywhere are tried.
        let parsed = if self.had_damage {
            chunk::parse_at(&self.buffer, self.used, &mut self.prefixes)
        } else {
            chunk::parse(waiting)
        };
        match parsed {
            ChunkParse::Whole { len, .. } => {
                self.used += len;
                self.needed = 1;
                return Some(len);
            }
            ChunkParse::Short(needed) if !self.complete => self.needed = needed,
            ChunkParse::Short(_) => self.damage = begin_damage(CUT),
            ChunkParse::Damaged => self.damage = begin_damage(BAD_CRC),
        }
        None
    }

    /// Scans the file ahead for long chunks. After the scan, the reader requests to go back to where it began.
    pub(super) fn scan_ahead(&mut self) {
        let Some(scan) = &mut self.scan else { return };
        self.used += scan.push(&self.buffer[self.used..], self.complete);
        if !scan.is_done() && !self.complete {
            return;
        }
        let from = scan.from();
        self.long_chunks = self.scan.take().map_or_else(LongChunks::default, LongChunkScan::finish);
        self.buffer.clear();
        self.prefixes = PrefixCrcs::default();
        (self.base, self.used, self.needed) = (from, 0, 1);
        self.seek_request = Some(from);
    }
}

impl TakeReader {
    /// Decodes the chunk in the last `len` processed bytes, whose CRC matches.
    pub(super) fn interpret(&mut self, len: usize) -> Result<TakeEvent<'_>, TakeError> {
        let offset = self.offset() - len as u64;
        let bytes = &self.buffer[self.used - len..self.used];
        let ChunkParse::Whole { kind, payload, .. } = chunk::split(bytes) else {
            return Err(TakeError::NotATake(NotATake::Changed));
        };
        let corrupt = |what, message: &str| TakeError::corrupt(what, offset, message);
        let Some(chain) = &mut self.chain else {
            if kind == types::HEADER {
                let header = Header::from_payload(payload, offset)?;
                header.check()?;
                let mut chain = StretchChain::from_header(&header)?;
                if self.skips_content {
                    chain.skip_times();
                }
                self.chain = Some(chain);
                self.bytes.header += len as u64;
                self.n_channels = header.channels.len();
                self.orderable = header.device.is_none().then_some(self.n_channels);
                return Ok(TakeEvent::Header(Box::new(header)));
            }
            self.bytes.other += len as u64;
            let message = format!("a chunk of type {kind:02x} before the header");
            return Ok(damaged(offset, len as u64, kind, message));
        };
        let payload_at = offset + (len - CRC_BYTES - payload.len()) as u64;
        if kind == types::STRETCH {
            self.orderable = None;
        }
        let event = match kind {
            // The first valid one counts.
            types::ORDER => {
                order(payload, offset, self.orderable).inspect(|_| self.orderable = None)
            }
            types::FOREIGN => foreign_part(payload, payload_at, offset, !self.skips_content),
            types::SAMPLES => {
                SamplesChunk::from_payload(payload, payload_at, offset).map(TakeEvent::Samples)
            }
            types::STRETCH => match chain.place(payload) {
                Ok(Placement::Stretch(stretch)) => Ok(TakeEvent::Stretch(stretch)),
                Ok(Placement::Unplaced { missing_before, n_rows, rows_min }) => {
                    Ok(TakeEvent::Unplaced { missing_before, n_rows, rows_min })
                }
                Err(error) => Err(corrupt("stretch", error)),
            },
            types::FOOTER => Footer::from_payload(payload, offset)
                .and_then(|footer| footer.check(chain.plausible_rows_max(), offset))
                .inspect(|_| self.has_footer = true)
                .map(TakeEvent::Footer),
            _ => match record(kind, payload, offset) {
                Ok(Some(TakeEvent::Channels(more))) => {
                    let n_channels = self.n_channels + more.len();
                    if n_channels <= CHANNELS_MAX {
                        self.n_channels = n_channels;
                        Ok(TakeEvent::Channels(more))
                    } else {
                        Err(corrupt("channel table", "more channels than marker ids"))
                    }
                }
                Ok(Some(event)) => Ok(event),
                Err(error) => Err(error),
                Ok(None) if kind & MAY_SKIP != 0 => Ok(TakeEvent::Skipped { kind }),
                Ok(None) => {
                    let message = match kind {
                        types::HEADER => "a second header".to_owned(),
                        _ => format!("unknown chunk type {kind:02x}: use a newer mocapd"),
                    };
                    Ok(damaged(offset, len as u64, kind, message))
                }
            },
        };
        let event = event.unwrap_or_else(|error| match error {
            TakeError::Unsupported { .. } if kind & MAY_SKIP != 0 => TakeEvent::Skipped { kind },
            error => damaged(offset, len as u64, kind, error.to_string()),
        });
        self.bytes.add(&event, len as u64);
        Ok(event)
    }
}

/// The part of the FOREIGN chunk at file offset `offset`, whose payload begins at `payload_at`. `inflates`: its content is
/// checked.
fn foreign_part(
    payload: &[u8],
    payload_at: u64,
    offset: u64,
    inflates: bool,
) -> Result<TakeEvent<'static>, TakeError> {
    let part = ForeignPart::from_payload(payload, (payload_at, payload.len() as u64), offset)?;
    if let Some(deflated) = part.deflated().filter(|_| inflates) {
        let mut inflation = InflateCheck::new(deflated.data_bytes);
        inflation.push(&payload[(deflated.at - payload_at) as usize..]);
        inflation.finish(offset)?;
    }
    Ok(TakeEvent::Foreign(part))
}

/// The order in the ORDER chunk at file offset `offset`, of `n_channels` channels; `None` where there can be none.
pub(crate) fn order(
    payload: &[u8],
    offset: u64,
    n_channels: Option<usize>,
) -> Result<TakeEvent<'static>, TakeError> {
    let order = ChannelOrder::from_payload(payload, offset)?;
    let corrupt = |message| Err(TakeError::corrupt("order", offset, message));
    match n_channels {
        Some(n) if n == order.n_channels() => Ok(TakeEvent::Order(order)),
        Some(_) => corrupt("it is of another number of markers than the header has"),
        None => corrupt("it belongs before the first stretch of an import, once"),
    }
}

/// Decodes a chunk whose content does not depend on earlier chunks; `None` for other types.
pub(crate) fn record(
    kind: u8,
    payload: &[u8],
    offset: u64,
) -> Result<Option<TakeEvent<'static>>, TakeError> {
    Ok(Some(match kind {
        types::CHANNELS => TakeEvent::Channels(MoreChannels::from_payload(payload, offset)?.0),
        types::SUBJECT => TakeEvent::Subject(Box::new(Subject::from_payload(payload, offset)?)),
        types::EVENT => TakeEvent::Event(Event::from_payload(payload, offset)?),
        types::LEDGER => TakeEvent::Ledger(Box::new(Ledger::from_payload(payload, offset)?)),
        types::CLOCK => TakeEvent::Clock(Box::new(Clock::from_payload(payload, offset)?)),
        types::SUMMARY => TakeEvent::Summary(SummaryRecord::from_payload(payload, offset)?),
        types::INDEX => TakeEvent::Index(parse_index(payload, offset)?),
        types::SAMPLE_TIMES => TakeEvent::SampleTimes(SampleTimes::from_payload(payload, offset)?),
        types::SAMPLE_LEDGER => {
            TakeEvent::SampleLedger(Box::new(SampleLedger::from_payload(payload, offset)?))
        }
        types::SAMPLED_GROUP => {
            TakeEvent::SampledGroup(Box::new(SampledGroup::from_chunk_payload(payload, offset)?))
        }
        _ => return Ok(None),
    }))
}

/// A chunk with invalid content.
fn damaged(offset: u64, len: u64, kind: u8, message: String) -> TakeEvent<'static> {
    let kind = Some(kind).filter(|kind| types::ALL.contains(kind));
    TakeEvent::Damaged { offset, len, kind, message }
}

/// Whether a chunk of this type may be too long to hold and is skipped: an unknown type, or an index, which only
/// repeats what the stretches state. No other record can be so long.
fn may_be_skipped(kind: u8) -> bool {
    let is_read = types::ALL.contains(&kind) && ![types::MODEL, types::INDEX].contains(&kind);
    kind & MAY_SKIP != 0 && !is_read
}

/// A chunk that is too long to hold.
#[derive(Debug)]
pub(super) struct LongChunk {
    kind: u8,
    offset: u64,
    len: u64,
    /// Whether the content of a FOREIGN chunk is checked.
    inflates: bool,
    /// For a FOREIGN chunk: its header, once that was read, and the check of the content read so far.
    part: Option<Result<(ForeignPart, Option<InflateCheck>), TakeError>>,
}

impl LongChunk {
    pub(super) fn new(kind: u8, offset: u64, len: u64, inflates: bool) -> Self {
        Self { kind, offset, len, inflates, part: None }
    }

    fn end(&self) -> u64 {
        self.offset + self.len
    }

    /// Checks the next bytes of a FOREIGN chunk, which begin at file offset `at`.
    fn check(&mut self, at: u64, bytes: &[u8]) {
        if self.kind != types::FOREIGN {
            return;
        }
        let part = self.part.get_or_insert_with(|| {
            let ChunkHead::Valid { head_bytes, .. } = chunk::head(bytes) else {
                return Err(TakeError::NotATake(NotATake::Changed));
            };
            let payload_at = self.offset + head_bytes as u64;
            let payload_bytes = self.len - head_bytes as u64 - CRC_BYTES as u64;
            let front = &bytes[head_bytes..];
            let inflation = |part: &ForeignPart| InflateCheck::new(part.data_bytes());
            ForeignPart::from_payload(front, (payload_at, payload_bytes), self.offset)
                .map(|part| (self.inflates.then(|| inflation(&part)), part))
                .map(|(inflation, part)| (part, inflation))
        });
        if let Ok((part, Some(inflation))) = part {
            let from = part.deflated().map_or(at, |part| part.at).saturating_sub(at) as usize;
            let end = (self.offset + self.len - CRC_BYTES as u64).saturating_sub(at);
            let end = bytes.len().min(usize::try_from(end).unwrap_or(usize::MAX));
            inflation.push(bytes.get(from..end).unwrap_or_default());
        }
    }
}

impl TakeReader {
    /// Reads on through the long chunk. Returns whether its end was reached.
    pub(super) fn read_long_chunk(&mut self) -> bool {
        let at = self.offset();
        let Some(long_chunk) = &mut self.long_chunk else { return true };
        let waiting = &self.buffer[self.used..];
        let front_bytes = HEAD_BYTES_MAX + foreign::FRONT_BYTES;
        if at == long_chunk.offset && waiting.len() < front_bytes && !self.complete {
            return false;
        }
        let left = usize::try_from(long_chunk.end() - at).unwrap_or(usize::MAX);
        let next = &waiting[..waiting.len().min(left)];
        long_chunk.check(at, next);
        self.used += next.len();
        self.needed = 1;
        next.len() == left || self.complete
    }

    /// The event of a long chunk that was read to its end.
    pub(super) fn finish_long_chunk(&mut self) -> Result<TakeEvent<'static>, TakeError> {
        let end = self.offset();
        let Some(chunk) = self.long_chunk.take().filter(|chunk| chunk.end() == end) else {
            return Err(TakeError::NotATake(NotATake::Changed));
        };
        let LongChunk { kind, offset, len, part, .. } = chunk;
        let Some(chain) = self.chain.as_mut() else {
            self.bytes.other += len;
            let message = format!("a chunk of type {kind:02x} before the header");
            return Ok(damaged(offset, len, kind, message));
        };
        let event = match part {
            Some(part) => part.and_then(|(part, inflation)| {
                let checked = inflation.map_or(Ok(()), |inflation| inflation.finish(offset));
                checked.map(|()| TakeEvent::Foreign(part))
            }),
            None if may_be_skipped(kind) => Ok(TakeEvent::Skipped { kind }),
            None => {
                if kind == types::STRETCH {
                    chain.break_off();
                }
                Err(TakeError::corrupt("chunk", offset, "longer than a take can hold"))
            }
        };
        let event = event.unwrap_or_else(|error| damaged(offset, len, kind, error.to_string()));
        self.bytes.add(&event, len);
        Ok(event)
    }
}

/// A damaged region, from `offset` to the reader's position.
#[derive(Debug)]
pub(super) struct Damage {
    pub(super) offset: u64,
    /// Its first bytes.
    head: Vec<u8>,
    message: &'static str,
    /// Whether the region is so long that its beginning is no longer buffered.
    pub(super) start_dropped: bool,
    /// Whether the region is the take's header, and the file ends within it.
    header_cut: bool,
}

impl Damage {
    /// The region that begins with `bytes` at file offset `offset`.
    pub(super) fn new(offset: u64, bytes: &[u8], message: &'static str, header_cut: bool) -> Self {
        let head = bytes[..bytes.len().min(HEAD_BYTES_MAX)].to_vec();
        Self { offset, head, message, start_dropped: false, header_cut }
    }

    /// The chunk type in its first byte, if it is a valid one.
    fn kind(&self) -> Option<u8> {
        self.head.first().copied().filter(|kind| types::ALL.contains(kind))
    }

    /// Whether the region is exactly one chunk according to its own head, and not a stretch: then no stretch was
    /// lost in it. Where bytes are missing, the region consists of pieces of two chunks, and no head fits its
    /// length.
    fn is_single_non_stretch(&self, damaged_bytes: u64) -> bool {
        let ChunkHead::Valid { kind, len, .. } = chunk::head(&self.head) else { return false };
        len == damaged_bytes && kind != types::STRETCH && types::ALL.contains(&kind)
    }
}

impl TakeReader {
    /// Searches for the next valid chunk; `None` when more of the file is needed.
    pub(super) fn find_next(&mut self) -> Option<TakeEvent<'static>> {
        // No chunk begins at the region's own first byte.
        let (offset, start_dropped) = self.damage.as_ref().map(|d| (d.offset, d.start_dropped))?;
        if !self.complete && self.buffer.len() - self.used < WINDOW_BYTES {
            self.needed = WINDOW_BYTES as u64;
            return None;
        }
        let from = self.used + usize::from(self.offset() == offset);
        let is_whole = |at: usize| self.long_chunks.is_whole(self.base + at as u64);
        match chunk::resync(&self.buffer, &mut self.prefixes, from, self.complete, is_whole) {
            ResyncOutcome::Found(at) => return self.end_damage(at),
            ResyncOutcome::NotBefore(at) if self.complete => return self.end_damage(at),
            ResyncOutcome::NotBefore(at) => {
                self.used = at;
                if let Some(damage) = &mut self.damage {
                    damage.start_dropped = true;
                }
            }
            ResyncOutcome::NeedsScan(at) => {
                let start = if start_dropped { self.base + at as u64 } else { offset };
                self.used = (start - self.base) as usize;
                self.scan = Some(LongChunkScan::new(start, false));
            }
        }
        None
    }

    /// Ends the region at `at` in the buffer, where the next chunk begins or the file ends. A region that is one chunk
    /// with a damaged head is repaired and read next.
    fn end_damage(&mut self, at: usize) -> Option<TakeEvent<'static>> {
        let damage = self.damage.take()?;
        self.had_damage = true;
        let offset = damage.offset;
        self.used = at;
        self.needed = 1;
        let len = self.offset() - offset;
        if !damage.start_dropped && len <= CHUNK_HELD_MAX {
            let start = (offset - self.base) as usize;
            if repair_head(&mut self.buffer[start..at]) {
                self.prefixes.discard_before(at);
                self.used = start;
                return Some(TakeEvent::Repaired { offset });
            }
        }
        self.bytes.other += len;
        if damage.header_cut {
            self.header_cut_until = self.offset();
        }
        let may_be_stretch = !damage.is_single_non_stretch(len);
        if may_be_stretch && let Some(chain) = &mut self.chain {
            chain.break_off();
        }
        let (kind, message) = (damage.kind(), damage.message.to_owned());
        Some(TakeEvent::Damaged { offset, len, kind, message })
    }
}

/// Restores the head of the single chunk in `region`, if its CRC matches with one of the chunk types. Returns
/// whether it did. By chance, one of the fourteen types matches in one of 3.1 * 10^8 damaged regions.
pub(crate) fn repair_head(region: &mut [u8]) -> bool {
    let Some(payload_len) = payload_len(region.len() as u64) else { return false };
    let mut head = vec![0];
    varint::put(&mut head, payload_len);
    let Some((body, crc)) = region.split_last_chunk::<CRC_BYTES>() else { return false };
    let mut payload = Hasher::new();
    payload.update(&body[head.len()..]);
    let fits = |kind: &u8| {
        head[0] = *kind;
        let mut hasher = Hasher::new();
        hasher.update(&head);
        hasher.combine(&payload);
        hasher.finalize().to_le_bytes() == *crc
    };
    let Some(kind) = types::ALL.into_iter().find(fits) else { return false };
    head[0] = kind;
    region[..head.len()].copy_from_slice(&head);
    true
}

/// The payload length of a chunk of `chunk_len` bytes.
fn payload_len(chunk_len: u64) -> Option<u64> {
    let varint_len = |value: u64| u64::from(64 - (value | 1).leading_zeros()).div_ceil(7);
    let mut lens = (2..=HEAD_BYTES_MAX as u64).filter_map(|head| {
        let payload = chunk_len.checked_sub(head + CRC_BYTES as u64)?;
        (varint_len(payload) == head - 1).then_some(payload)
    });
    lens.rfind(|&len| len <= PAYLOAD_BYTES_MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        TakeEvent, TakeWriter,
        chunk::{self, HASHED_BYTES, types},
        reader::read_events,
        record::{CODEC_VERSION, Header},
        varint,
    };

    fn empty_take() -> Vec<u8> {
        let header = Header {
            software: "test".to_owned(),
            take_id: [7; 16],
            created_unix_ms: 0,
            resampler: "dense".to_owned(),
            codec_version: CODEC_VERSION,
            tolerance_mm: 1.0,
            rate_hz: 100.0,
            up_axis: crate::motion::UpAxis::Unknown,
            device: None,
            source: None,
            channels: Vec::new(),
            stretch_rows: 50,
            settings: Vec::new(),
        };
        let mut bytes = Vec::new();
        TakeWriter::new(&mut bytes, &header).unwrap();
        bytes
    }

    /// Each small chunk is followed by the head of a long one. All of the rest may be that chunk, or may be damaged and
    /// contain the next small chunk.
    #[test]
    fn no_byte_is_hashed_for_every_head_before_it() {
        for claimed in [3_000, 100_000, 1 << 20] {
            let mut bytes = empty_take();
            let (start, end) = (bytes.len(), bytes.len() + claimed + (256 << 10));
            while bytes.len() < end {
                bytes.push(types::STRETCH);
                varint::put(&mut bytes, claimed as u64);
                chunk::put(&mut bytes, types::EVENT, &[]).unwrap();
            }
            let before = HASHED_BYTES.get();
            let mut n_damaged = 0;
            read_events(&bytes, |event| {
                n_damaged += usize::from(matches!(event, TakeEvent::Damaged { .. }));
                Ok(())
            })
            .unwrap();
            let hashed = HASHED_BYTES.get() - before;
            // The false heads, and the events, which lack a version.
            assert!(n_damaged > (end - start) / 11, "{n_damaged} of {} bytes", bytes.len());
            let ratio = hashed / bytes.len() as u64;
            assert!(ratio <= 100, "{ratio} bytes hashed a byte, of {claimed} claimed");
        }
    }

    #[test]
    fn type_and_length_are_repaired_and_nothing_else() {
        for n in [0, 1, 100, 126, 127, 128, 129, 16_383, 16_384, 20_000] {
            let payload: Vec<u8> = (0..n).map(|i| (i * 7) as u8).collect();
            let mut good = Vec::new();
            chunk::put(&mut good, types::STRETCH, &payload).unwrap();
            let head_len = good.len() - n - CRC_BYTES;
            for at in 0..good.len().min(300) {
                let mut damaged = good.clone();
                damaged[at] ^= 0x41;
                assert_eq!(repair_head(&mut damaged), at < head_len, "byte {at} of {n}");
                assert_eq!(damaged == good, at < head_len, "byte {at} of {n}");
            }
            let mut zeroed = good.clone();
            zeroed[..head_len].fill(0);
            assert!(repair_head(&mut zeroed) && zeroed == good, "{n}");
            assert!(!repair_head(&mut good[1..].to_vec()));
        }
        assert!(!repair_head(&mut []));
        assert!(!repair_head(&mut [0; 5]));
    }
}
