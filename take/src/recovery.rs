//! Recovers a damaged take: the new file has the valid chunks unchanged, records of what is lost in place of the
//! others, a ledger that closes, an index and a footer.
//!
//! [`RecoveryScan::read`] reads and decodes the file once; [`RecoveryScan::write`] then copies its valid chunks. No stretch is
//! encoded again, so every error bound that its encoder proved still holds.

mod scan;

use std::{
    collections::{HashMap, HashSet},
    io::{self, Read, Seek, SeekFrom, Write},
};

pub(crate) use self::scan::LedgerTally;
pub use self::scan::{ChannelCount, RecoveryScan};
use crate::{
    TakeError, TakeMap,
    chunk::{self, CHUNK_HELD_MAX, ChunkParse, MAGIC, types},
    damage::{Problem, push_problem},
    foreign::ForeignPart,
    reader::{TakeInput, repair_head},
    record::{
        Channel, Event, EventKind, GroupLedger, Header, SampleLedger, SampledGroup, SummaryRecord,
    },
    sampled::{
        GroupSamples, RECORDED, RecoveredSamples, SampleContent, SampleSpan, is_recorded, part_name,
    },
    stretch::{NUMBERS, ROWS_PASSED_MAX, Span, StretchHeaderWriter},
    timeline::{LossCauses, Timeline, TimelineEncoder},
    writer::TakeWriter,
};

/// The key in the settings of HEADER that marks a recovered take.
pub const RECOVERED: &str = "recovered";

/// One element of the new take.
#[derive(Debug, Clone, PartialEq, Eq)]
enum OutputChunk {
    /// A chunk copied from the damaged file.
    Copied {
        offset: u64,
        len: u64,
        kind: u8,
        /// For a stretch.
        span: Option<Span>,
    },
    /// Channel table entries in place of lost ones.
    Channels(Vec<Channel>),
    /// A stretch without rows in place of lost stretches.
    Lost { first_row: u64, rows: u64, number: u8 },
    /// Samples of a group of sampled channels, recorded as lost.
    LostSamples { span: SampleSpan, event: Event },
}

/// The kind of a chunk.
#[expect(missing_docs, reason = "docs/take-format.md has the table")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ChunkKind {
    Header,
    Channels,
    Order,
    Stretch,
    Event,
    Ledger,
    Clock,
    Subject,
    Foreign,
    SampledGroup,
    Samples,
    SampleTimes,
    SampleLedger,
    Summary,
    Index,
    Footer,
    /// A type that this version does not write, or bytes whose type is unknown.
    Other,
}

/// Every kind with its chunk type and its name in reports.
const KINDS: [(ChunkKind, Option<u8>, &str); 17] = [
    (ChunkKind::Header, Some(types::HEADER), "header"),
    (ChunkKind::Channels, Some(types::CHANNELS), "channel table"),
    (ChunkKind::Order, Some(types::ORDER), "order"),
    (ChunkKind::Stretch, Some(types::STRETCH), "stretch"),
    (ChunkKind::Event, Some(types::EVENT), "event"),
    (ChunkKind::Ledger, Some(types::LEDGER), "ledger"),
    (ChunkKind::Clock, Some(types::CLOCK), "clock"),
    (ChunkKind::Subject, Some(types::SUBJECT), "subject"),
    (ChunkKind::Foreign, Some(types::FOREIGN), "foreign"),
    (ChunkKind::SampledGroup, Some(types::SAMPLED_GROUP), "sampled group"),
    (ChunkKind::Samples, Some(types::SAMPLES), "samples"),
    (ChunkKind::SampleTimes, Some(types::SAMPLE_TIMES), "times of samples"),
    (ChunkKind::SampleLedger, Some(types::SAMPLE_LEDGER), "ledger of samples"),
    (ChunkKind::Summary, Some(types::SUMMARY), "summary"),
    (ChunkKind::Index, Some(types::INDEX), "index"),
    (ChunkKind::Footer, Some(types::FOOTER), "footer"),
    (ChunkKind::Other, None, "unknown"),
];

impl ChunkKind {
    /// The kind with this chunk type.
    #[must_use]
    pub fn of(kind: Option<u8>) -> Self {
        let found = KINDS.iter().find(|(_, of, _)| kind.is_some() && *of == kind);
        found.map_or(Self::Other, |(kind, ..)| *kind)
    }

    /// The name in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        KINDS.iter().find(|(kind, ..)| *kind == self).map_or("unknown", |(.., name)| name)
    }

    /// Whether chunks of this kind follow the last ledger of a closed take.
    fn follows_last_ledger(self) -> bool {
        matches!(self, Self::Summary | Self::Index | Self::Footer)
    }

    /// Whether a recovery rebuilds chunks of this kind, so that a damaged one loses nothing.
    #[must_use]
    pub fn is_rebuilt(self) -> bool {
        matches!(self, Self::Index | Self::Footer)
    }
}

/// Counts of chunks of one kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ChunkKindCount {
    /// The kind.
    pub kind: ChunkKind,
    /// Valid chunks.
    pub recovered: u64,
    /// Damaged chunks, and chunks that need a damaged one. An unreadable region counts as one chunk of the kind in its
    /// first byte, however many it held.
    pub discarded: u64,
}

/// Maximum number of bytes searched for a header; a header of 10 000 labels fits.
const START_BYTES_MAX: u64 = 4 << 20;

/// The reflected polynomial of CRC-32 (IEEE).
const POLYNOMIAL: u32 = 0xedb8_8320;

/// A file whose first bytes are replaced by repaired ones.
#[derive(Debug)]
pub struct RepairedStart<R> {
    input: R,
    start: Vec<u8>,
    at: u64,
}

/// Reads the start of a file and repairs what it can: the magic before a valid header, and one byte of a header.
/// Returns a reader of the repaired file and the list of repairs. Other damage stays.
///
/// A CRC identifies a single wrong byte: in a header of 300 bytes hardly any two single-byte errors give the same CRC,
/// and if two do, nothing is changed. A header with more wrong bytes can look like one with a single wrong byte, in
/// one of 50 000 cases. It is then altered to match its CRC, with content that was never written, if it can be decoded
/// at all. So ordinary readers do not repair headers, and a recovery reports the repair.
/// # Errors
/// Any error of reading `input`.
pub fn repair_start<R: Read + Seek>(mut input: R) -> io::Result<(RepairedStart<R>, Vec<Problem>)> {
    let mut start = Vec::new();
    input.seek(SeekFrom::Start(0))?;
    input.by_ref().take(START_BYTES_MAX).read_to_end(&mut start)?;
    input.seek(SeekFrom::Start(0))?;
    let mut repaired = Vec::new();
    if let Some((magic, rest)) = start.split_at_mut_checked(MAGIC.len()) {
        if let Some(at) = repair_header(rest) {
            repaired.push(Problem::HeaderByte((MAGIC.len() + at) as u64));
        }
        let header = matches!(chunk::parse(rest), ChunkParse::Whole { kind: types::HEADER, .. });
        if header && *magic != MAGIC {
            magic.copy_from_slice(&MAGIC);
            repaired.push(Problem::Magic);
        }
    }
    if repaired.is_empty() {
        start = Vec::new();
    }
    Ok((RepairedStart { input, start, at: 0 }, repaired))
}

/// Corrects the one wrong byte of the header at the front of `bytes`, if there is exactly one. Returns its position.
fn repair_header(bytes: &mut [u8]) -> Option<usize> {
    if chunk::parse(bytes) != ChunkParse::Damaged {
        return None;
    }
    let ChunkParse::Whole { kind: types::HEADER, len, .. } = chunk::split(bytes) else {
        return None;
    };
    let (body, crc) = bytes.get_mut(..len)?.split_last_chunk_mut::<4>()?;
    let difference = crc32fast::hash(body) ^ u32::from_le_bytes(*crc);
    // The wrong byte is in the CRC itself.
    if difference.to_le_bytes().iter().filter(|&&byte| byte != 0).count() == 1 {
        *crc = crc32fast::hash(body).to_le_bytes();
        return Some(len - 4);
    }
    let (at, by) = wrong_byte(difference, body.len())?;
    // Type and length are repaired by the reader.
    body[at] ^= by;
    Some(at)
}

/// The position and XOR difference of the single byte among `len` that changes the CRC by `difference`; `None` when
/// none or several do.
fn wrong_byte(difference: u32, len: usize) -> Option<(usize, u8)> {
    let table = table();
    let mut state = difference;
    let mut found = None;
    for at in (0..len).rev() {
        // An error in this byte leaves exactly its own table entry here.
        let by = (0..=255_u8).find(|&by| table[usize::from(by)] == state).filter(|&by| by != 0);
        if let Some(by) = by
            && found.replace((at, by)).is_some()
        {
            return None;
        }
        // Undo the effect of one correct byte.
        let index = table.iter().position(|&entry| entry >> 24 == state >> 24)?;
        state = (state ^ table[index]) << 8 | index as u32;
    }
    found
}

fn table() -> [u32; 256] {
    let shift = |crc: u32, _| if crc & 1 == 1 { crc >> 1 ^ POLYNOMIAL } else { crc >> 1 };
    std::array::from_fn(|byte| (0..8).fold(byte as u32, shift))
}

impl<R: Read> Read for RepairedStart<R> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let n = self.input.read(bytes)?;
        let from = usize::try_from(self.at).unwrap_or(usize::MAX);
        if let Some(repaired) = self.start.get(from..) {
            let n = n.min(repaired.len());
            bytes[..n].copy_from_slice(&repaired[..n]);
        }
        self.at += n as u64;
        Ok(n)
    }
}

impl<R: Seek> Seek for RepairedStart<R> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.at = self.input.seek(to)?;
        Ok(self.at)
    }
}

impl<R: Read + Seek> TakeInput for RepairedStart<R> {
    type Input = Self;

    fn input(self) -> Self {
        self
    }
}

impl RecoveryScan {
    /// A short summary of the losses, for readers of the new take.
    #[must_use]
    pub fn loss_summary(&self) -> String {
        if !self.lost_anything() {
            return "nothing was lost".to_owned();
        }
        let mut parts = Vec::new();
        match self.rows_damaged() {
            0 => {}
            1 => parts.push("1 frame was damaged".to_owned()),
            rows => parts.push(format!("{rows} frames were damaged")),
        }
        if !self.finished {
            parts.push("the end was cut off".to_owned());
        }
        if !self.samples_lost_of.is_empty() {
            parts.push(format!("samples of {} were damaged", self.samples_lost_of.join(" and ")));
        }
        if self.discarded_bytes > 0 {
            parts.push(format!("{} bytes could not be read", self.discarded_bytes));
        }
        if self.contradicted {
            parts.push("a ledger was missing or wrong".to_owned());
        } else if parts.is_empty() {
            parts.push("marker names were lost".to_owned());
        }
        parts.join(", ")
    }

    /// Writes the new take and returns its size in bytes. `input` is the file that was read; `software` names the
    /// program in the new take.
    ///
    /// # Errors
    /// `Io`; `Corrupt` when the file has changed since it was read.
    pub fn write(
        &self,
        mut input: impl Read + Seek,
        output: impl Write,
        software: &str,
    ) -> Result<u64, TakeError> {
        let mut header = self.header.clone();
        let note = format!("by {software}: {}", self.loss_summary());
        header.settings.push((RECOVERED.to_owned(), note.clone()));
        let mut take = TakeWriter::new(output, &header)?;
        take.order(&self.order)?;
        let tick_hz = header.device.as_ref().map_or(1, |device| device.tick_hz);
        let times = TimelineEncoder::new(tick_hz, header.rate_hz);
        let mut headers = StretchHeaderWriter::with_times(header.stretch_rows, times);
        let mut bytes = Vec::new();
        for chunk in &self.output {
            match chunk {
                OutputChunk::Copied { offset, len, span, .. } if *len > CHUNK_HELD_MAX => {
                    input.seek(SeekFrom::Start(*offset))?;
                    if !take.copy_long(*span, &mut input, *len)? {
                        return Err(changed(*offset));
                    }
                }
                OutputChunk::Copied { offset, len, kind, span } => {
                    input.seek(SeekFrom::Start(*offset))?;
                    bytes.clear();
                    // Memory grows with what the file holds; the length was validated in the first pass.
                    input.by_ref().take(*len).read_to_end(&mut bytes)?;
                    let payload = payload(&mut bytes, *kind, *offset)?;
                    match span {
                        Some(span) => take.copy_stretch(*span, payload)?,
                        None => take.chunk(*kind, payload)?,
                    }
                }
                OutputChunk::Channels(channels) => take.channels(channels)?,
                OutputChunk::LostSamples { span, event } => {
                    take.lost_samples(span)?;
                    take.event(event)?;
                }
                OutputChunk::Lost { first_row, rows, number } => {
                    write_lost(&mut take, &mut headers, *first_row, *rows, *number)?;
                }
            }
        }
        if self.lost_anything() {
            take.event(&host_event(self.rows, format!("recovered {note}")))?;
        }
        if let Some(ledger) = &self.sample_ledger {
            take.sample_ledger(ledger)?;
        }
        let mut table = self.channels.clone();
        self.order.apply_to_table(&mut table);
        let summary = SummaryRecord {
            ending: self.ending.clone(),
            header: Some(Box::new(Header { channels: table, ..header })),
            statistics: Some(self.statistics.clone()),
            order: Some(self.order.clone()).filter(|order| !order.is_identity()),
            sample_ledger: self.sample_ledger.clone(),
        };
        take.close_with(&self.ledger, &summary)?;
        Ok(take.bytes())
    }
}

/// Writes stretches without rows in place of lost rows, and an event that reports the loss.
fn write_lost<W: Write>(
    take: &mut TakeWriter<W>,
    headers: &mut StretchHeaderWriter,
    first_row: u64,
    rows: u64,
    number: u8,
) -> Result<(), TakeError> {
    let end = first_row.saturating_add(rows);
    // Each covers the maximum of rows that may be lost between two stretches; the last one has the given number.
    let pieces = rows.div_ceil(ROWS_PASSED_MAX).max(1);
    for piece in 0..pieces {
        let from = first_row.saturating_add(piece.saturating_mul(ROWS_PASSED_MAX));
        let to = from.saturating_add(ROWS_PASSED_MAX).min(end);
        let mut timeline = Timeline::default();
        timeline.restart(from);
        timeline.push_damaged(to - from);
        let back = ((pieces - 1 - piece) % u64::from(NUMBERS)) as u8;
        let number = (number + NUMBERS - back) % NUMBERS;
        let span = Span { first_row: to, n_rows: 0, key: true, number };
        let mut payload = Vec::new();
        headers.put(span, &timeline, &[], true, &mut payload);
        take.copy_stretch(span, &payload)?;
    }
    if rows > 0 {
        let frames = match rows {
            1 => format!("frame {first_row} was"),
            _ => format!("frames {first_row} to {} were", end - 1),
        };
        let text = format!("{frames} damaged in the file that this take was recovered from");
        take.event(&host_event(first_row, text))?;
    }
    Ok(())
}

fn host_event(row: u64, text: String) -> Event {
    Event { kind: EventKind::Host, row, device_ticks: 0, host_ns: 0, input: 0, text }
}

/// The payload of a chunk that is valid, or whose head can be repaired.
fn payload(bytes: &mut [u8], kind: u8, offset: u64) -> Result<&[u8], TakeError> {
    if !matches!(chunk::parse(bytes), ChunkParse::Whole { .. }) {
        repair_head(bytes);
    }
    match chunk::parse(bytes) {
        ChunkParse::Whole { kind: found, payload, len } if found == kind && len == bytes.len() => {
            Ok(payload)
        }
        _ => Err(changed(offset)),
    }
}

fn changed(offset: u64) -> TakeError {
    TakeError::corrupt("chunk", offset, "another program changed the file while it was being read")
}

/// Which chunks of sampled channels a recovery copies.
#[derive(Debug, Default)]
struct KeptSamples {
    /// The chunks that are copied by their file offsets, with the records of lost samples before them.
    chunks: HashMap<u64, Vec<OutputChunk>>,
    /// Records of lost samples after the last chunk of a group.
    lost_at_end: Vec<OutputChunk>,
    /// The kinds of the foreign parts that lost samples.
    kinds: Vec<String>,
    /// The ledger of the samples that are kept, of a recording.
    ledger: Option<SampleLedger>,
    /// Samples whose blocks cannot be decoded.
    undecodable: Vec<Problem>,
    /// The chunks of known groups that are not copied, unless they are among `chunks`.
    known: HashSet<u64>,
    /// Whether some groups are of a later version; chunks that belong to no known group are theirs.
    has_later_groups: bool,
}

impl KeptSamples {
    /// Decodes all samples of a take. Those of a part that lacks the description of a channel are not kept: the part
    /// cannot be read.
    fn find(take: &TakeMap, input: &mut (impl Read + Seek)) -> Result<Self, TakeError> {
        let mut kept = Self { has_later_groups: take.later_samples.groups, ..Self::default() };
        for part in take.foreign.iter().filter_map(ForeignPart::sampled) {
            for group in part.groups() {
                kept.known.insert(group.offset);
                kept.known.extend(group.chunk_offsets());
            }
            if part.missing_channels().is_some() {
                kept.add_kind(part.kind());
                continue;
            }
            for group in part.groups() {
                let undecodable = group.decode(input, |_, _| Ok(()))?;
                for lost in &undecodable {
                    let problem = Problem::of_samples(part.kind(), lost);
                    push_problem(&mut kept.undecodable, problem);
                }
                let recovered = group.recovered(&undecodable);
                if is_recorded(&group.group.kind) {
                    let ledger = kept.ledger.get_or_insert_default();
                    ledger.groups.push(group_ledger(take, group, &recovered));
                }
                kept.add_group(take, group, recovered);
            }
        }
        kept.close_ledger(take.sample_ledger.as_ref());
        if take.later_samples.ledger && take.finished && kept.kinds.is_empty() {
            // The ledger of a later version is copied, and states more than a new one could.
            kept.ledger = None;
        }
        Ok(kept)
    }

    /// Completes the ledger with what only the last one of the file states: batches that were refused, and groups whose
    /// description is lost, and with it all their samples. Those of later versions keep their samples and their counts.
    fn close_ledger(&mut self, stated: Option<&SampleLedger>) {
        if stated.is_none() && self.ledger.is_none() {
            return;
        }
        let ledger = self.ledger.get_or_insert_default();
        ledger.finished = true;
        if let Some(stated) = stated {
            ledger.batches_refused = stated.batches_refused;
            let is_kept =
                |group: &GroupLedger| ledger.groups.iter().any(|g| g.group == group.group);
            let lost: Vec<&GroupLedger> =
                stated.groups.iter().filter(|group| !is_kept(group)).collect();
            for group in lost {
                if self.has_later_groups {
                    ledger.groups.push(*group);
                    continue;
                }
                ledger.groups.push(group.without_samples());
                if !self.kinds.iter().any(|known| known == part_name(RECORDED)) {
                    self.kinds.push(part_name(RECORDED).to_owned());
                }
            }
        }
        ledger.groups.sort_by_key(|group| group.group);
    }

    fn add_kind(&mut self, kind: &str) {
        if !self.kinds.iter().any(|known| known == kind) {
            self.kinds.push(kind.to_owned());
        }
    }

    fn add_group(&mut self, take: &TakeMap, group: &GroupSamples, samples: Vec<RecoveredSamples>) {
        let of_group = std::iter::once(group.offset).chain(group.times_offsets());
        self.chunks.extend(of_group.map(|offset| (offset, Vec::new())));
        let mut lost = Vec::new();
        for samples in samples {
            match samples {
                RecoveredSamples::Chunk { offset } => {
                    self.chunks.insert(offset, std::mem::take(&mut lost));
                }
                RecoveredSamples::Lost { first, n } => {
                    self.add_kind(part_name(&group.group.kind));
                    lost.push(lost_samples(take, &group.group, first, n));
                }
            }
        }
        self.lost_at_end.append(&mut lost);
    }

    /// Whether the chunk at this file offset is copied.
    fn keeps(&self, offset: u64) -> bool {
        let is_of_later = self.has_later_groups && !self.known.contains(&offset);
        is_of_later || self.chunks.contains_key(&offset)
    }

    /// The records of lost samples before the chunk at this file offset.
    fn lost_at(&self, offset: u64) -> Vec<OutputChunk> {
        self.chunks.get(&offset).cloned().unwrap_or_default()
    }
}

/// The ledger of a group whose chunks are kept: the counts of the samples that it has, and those that no chunk shows.
fn group_ledger(
    take: &TakeMap,
    group: &GroupSamples,
    recovered: &[RecoveredSamples],
) -> GroupLedger {
    let number = group.group.number;
    let stated = take.sample_ledger.iter().flat_map(|ledger| &ledger.groups);
    let stated = stated.copied().find(|stated| stated.group == number).unwrap_or_default();
    let kept: HashSet<u64> = recovered
        .iter()
        .filter_map(|samples| match samples {
            RecoveredSamples::Chunk { offset } => Some(*offset),
            RecoveredSamples::Lost { .. } => None,
        })
        .collect();
    let mut ledger = group.ledger(|offset| kept.contains(&offset));
    let damaged = recovered.iter().map(|samples| match samples {
        RecoveredSamples::Lost { n, .. } => *n,
        RecoveredSamples::Chunk { .. } => 0,
    });
    ledger.lost_other = damaged.fold(ledger.lost_other, u64::saturating_add);
    ledger.taken = ledger.stored.saturating_add(ledger.lost());
    let GroupLedger { duplicates, jumps, .. } = stated;
    let errors = group.pose_errors(take.sample_ledger.as_ref());
    GroupLedger { duplicates, jumps, errors, ..ledger }
}

fn lost_samples(take: &TakeMap, group: &SampledGroup, first: u64, n: u64) -> OutputChunk {
    let content = SampleContent::Lost(LossCauses::DAMAGED);
    let span = SampleSpan { group: group.number, first, n, content };
    let channel = u64::from(group.first_channel);
    let text = format!(
        "samples {first} to {} of {}, channels {} to {}, were damaged in the file that this take was recovered from",
        span.end() - 1,
        part_name(&group.kind),
        channel + 1,
        channel + group.channels.len() as u64
    );
    let row = match group.samples_per_frame {
        // By the rates, which is as near as an event needs to be.
        0 => (first as f64 * take.header.rate_hz / group.rate_hz) as u64,
        ratio => first / u64::from(ratio),
    };
    let row = row.min(take.n_rows.saturating_sub(1));
    OutputChunk::LostSamples { span, event: Event { row, ..Event::new(EventKind::Host, 0, text) } }
}
