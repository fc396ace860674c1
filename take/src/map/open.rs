//! Builds the map of a take from all its chunks, or from the chunk heads of a closed take: stretches are skipped, and
//! the index states which of them are keys; or from the end of a closed take alone, for a take of which only a window is
//! read, over a network.

use std::{
    io::{BufRead, BufReader, Read, Seek, SeekFrom},
    ops::Range,
};

use crc32fast::Hasher;

use super::TakeMap;
use crate::{
    TakeError, TakeEvent,
    chunk::{
        self, CHUNK_HELD_MAX, CRC_BYTES, ChunkParse, HEAD_BYTES_MAX, MAGIC, MAY_SKIP,
        PAYLOAD_BYTES_MAX, types,
    },
    damage::DamageOrigin,
    index::{Footer, IndexEntry, parse_index},
    reader::{order, record},
    record::{Header, Ledger, Record, Subject, SummaryRecord},
    stretch::ROWS_PASSED_MAX,
    traversal::TakeTraversal,
};

/// Size of one read: a few stretches of a recording, so that their heads need no read of their own.
const READ_BYTES: usize = 1 << 14;

impl TakeMap {
    /// Builds the map as fast as possible. For a closed take the index and the chunk heads are enough, and stretches
    /// are not read; any other take is [scanned](Self::scan).
    ///
    /// Damage within a stretch therefore shows only when the stretch is decoded.
    ///
    /// # Errors
    /// `NotATake`, `Unsupported`, `Io`.
    pub fn open(input: &mut (impl Read + Seek)) -> Result<Self, TakeError> {
        if let Some(map) = map_from_heads(input)? {
            return Ok(map);
        }
        Self::scan(input)
    }

    /// Builds the map of a take by checking the CRC of every chunk, without decoding samples.
    ///
    /// # Errors
    /// `NotATake`, `Unsupported`, `Io`.
    pub fn scan(input: &mut (impl Read + Seek)) -> Result<Self, TakeError> {
        input.seek(SeekFrom::Start(0))?;
        let mut map = TakeTraversal::without_decoding(input).run(|_, _| Ok(()))?.take;
        // A recovered take states its lost rows itself.
        map.damaged |= map.damage.iter().any(|lost| lost.origin == DamageOrigin::BeforeRecovery);
        Ok(map)
    }
}

/// The map of a take whose footer, index and chunk heads agree exactly; `None` for any other.
fn map_from_heads(input: &mut (impl Read + Seek)) -> Result<Option<TakeMap>, TakeError> {
    let file_bytes = input.seek(SeekFrom::End(0))?;
    let mut chunks = ChunkCursor::new(input);
    let Some((footer, keys)) = chunks.end(file_bytes)? else { return Ok(None) };
    if !chunks.begin()? {
        return Ok(None);
    }
    let mut map = None;
    let mut next_key = keys.iter().peekable();
    let mut orderable = true;
    while chunks.at < file_bytes {
        let offset = chunks.at;
        let Some((kind, chunk_bytes)) = chunks.head()? else { return Ok(None) };
        let is_known = match kind {
            types::STRETCH => {
                next_key.next_if(|key| key.offset == offset);
                orderable = false;
                chunks.go_to(offset + chunk_bytes)?;
                true
            }
            types::ORDER => {
                let Some(payload) = chunks.payload(chunk_bytes)? else { return Ok(None) };
                match add_order(&mut map, &payload, offset) {
                    Some(is_order) if orderable => {
                        orderable = !is_order;
                        true
                    }
                    _ => false,
                }
            }
            // A single wrong bit turns another type into one of these, so check their CRC.
            types::FOREIGN
            | types::INDEX
            | types::FOOTER
            | types::SAMPLED_GROUP
            | types::SAMPLES
            | types::SAMPLE_TIMES => chunks.is_whole(chunk_bytes)?,
            _ if types::ALL.contains(&kind) => {
                let Some(payload) = chunks.payload(chunk_bytes)? else { return Ok(None) };
                add_record(&mut map, kind, &payload, offset)
            }
            _ => kind & MAY_SKIP != 0 && chunks.is_whole(chunk_bytes)?,
        };
        if !is_known {
            return Ok(None);
        }
    }
    let are_in_order = chunks.at == file_bytes
        && next_key.peek().is_none()
        && keys.is_sorted_by(|a, b| a.first_row < b.first_row && a.offset < b.offset);
    let Some(map) = map.filter(|_| are_in_order) else { return Ok(None) };
    let mut map = TakeMap { n_rows: footer.n_rows, keys, finished: true, ..map };
    map.restore_order();
    Ok(map.has_plausible_rows().then_some(map))
}

impl TakeMap {
    /// Whether the number of rows is that of the ledger, and possible after the last key stretch. A ledger that is missing
    /// or counts other rows needs a traversal.
    pub(super) fn has_plausible_rows(&self) -> bool {
        let last_row = self.keys.last().map_or(0, |key| key.first_row);
        let rows = |ledger: &Ledger| ledger.recorded.saturating_add(ledger.frames_lost());
        self.ledger.as_ref().map(rows) == Some(self.n_rows)
            && (last_row..=last_row.saturating_add(ROWS_PASSED_MAX)).contains(&self.n_rows)
    }
}

/// Adds a chunk other than a stretch. Returns whether it is valid.
fn add_record(map: &mut Option<TakeMap>, kind: u8, payload: &[u8], offset: u64) -> bool {
    let Some(map) = map else {
        let header = Header::from_payload(payload, offset).ok();
        let header = header.filter(|header| kind == types::HEADER && header.check().is_ok());
        let Some(header) = header else { return false };
        *map = Some(TakeMap { channels: header.channels.clone(), header, ..TakeMap::default() });
        return true;
    };
    match record(kind, payload, offset) {
        // An order that the take states and does not have needs a traversal.
        Ok(Some(TakeEvent::Summary(summary))) if summary.contradicts_order(&map.order) => {
            return false;
        }
        Ok(Some(TakeEvent::Channels(mut more))) => map.channels.append(&mut more),
        Ok(Some(event)) => map.add_content(event, offset, payload.len() as u64),
        // A newer version that a reader may skip.
        Err(TakeError::Unsupported { .. }) if kind & MAY_SKIP != 0 => map.later_samples.skip(kind),
        Err(_) => return false,
        // MODEL, which this version does not read.
        Ok(None) => return kind & MAY_SKIP != 0,
    }
    true
}

/// Sets the order of the markers. Returns whether the chunk states one, or is of a later version, which is skipped; `None` if
/// it is invalid, or the take is not an import.
fn add_order(map: &mut Option<TakeMap>, payload: &[u8], offset: u64) -> Option<bool> {
    let map = map.as_mut().filter(|map| map.header.device.is_none())?;
    match order(payload, offset, Some(map.header.channels.len())) {
        Ok(TakeEvent::Order(order)) => {
            map.order = order;
            Some(true)
        }
        Err(TakeError::Unsupported { .. }) => Some(false),
        _ => None,
    }
}

/// Reads a file chunk by chunk.
pub(super) struct ChunkCursor<R> {
    input: BufReader<R>,
    at: u64,
}

impl<R: Read + Seek> ChunkCursor<R> {
    pub(super) fn new(input: R) -> Self {
        Self { input: BufReader::with_capacity(READ_BYTES, input), at: 0 }
    }

    pub(super) fn go_to(&mut self, offset: u64) -> Result<(), TakeError> {
        match i64::try_from(i128::from(offset) - i128::from(self.at)) {
            Ok(by) => self.input.seek_relative(by)?,
            Err(_) => drop(self.input.seek(SeekFrom::Start(offset))?),
        }
        self.at = offset;
        Ok(())
    }

    /// Goes to the first chunk. Returns whether the file begins as a take does.
    fn begin(&mut self) -> Result<bool, TakeError> {
        self.go_to(0)?;
        let mut magic = [0; MAGIC.len()];
        self.input.read_exact(&mut magic)?;
        self.at = MAGIC.len() as u64;
        Ok(magic == MAGIC)
    }

    /// The payload of the chunk at the current position, if it is of type `kind` and whole.
    pub(super) fn record(&mut self, kind: u8) -> Result<Option<Vec<u8>>, TakeError> {
        match self.head()? {
            Some((found, chunk_bytes)) if found == kind => self.payload(chunk_bytes),
            _ => Ok(None),
        }
    }

    /// Footer and index, if they end the file.
    pub(super) fn end(
        &mut self,
        file_bytes: u64,
    ) -> Result<Option<(Footer, Vec<IndexEntry>)>, TakeError> {
        let footer_bytes = Footer::CHUNK_BYTES as u64;
        let Some(footer_at) = file_bytes.checked_sub(footer_bytes) else { return Ok(None) };
        self.input.seek(SeekFrom::Start(footer_at))?;
        let mut last = [0; Footer::CHUNK_BYTES];
        self.input.read_exact(&mut last)?;
        self.at = file_bytes;
        let Some(footer) = Footer::from_chunk(&last) else { return Ok(None) };
        if footer.index_offset >= footer_at {
            return Ok(None);
        }
        self.go_to(footer.index_offset)?;
        let Some((types::INDEX, chunk_bytes)) = self.head()? else { return Ok(None) };
        if footer.index_offset + chunk_bytes != footer_at {
            return Ok(None);
        }
        let Some(payload) = self.payload(chunk_bytes)? else { return Ok(None) };
        let keys = parse_index(&payload, footer.index_offset).ok();
        Ok(keys.map(|keys| (footer, keys)))
    }

    /// Type and size in bytes of the chunk at the current position, which does not change.
    fn head(&mut self) -> Result<Option<(u8, u64)>, TakeError> {
        let mut bytes = Vec::with_capacity(HEAD_BYTES_MAX);
        let found = self.input.fill_buf()?;
        if found.len() >= HEAD_BYTES_MAX {
            bytes.extend_from_slice(&found[..HEAD_BYTES_MAX]);
        } else {
            // Near the end of the buffer, and of the file.
            self.input.by_ref().take(HEAD_BYTES_MAX as u64).read_to_end(&mut bytes)?;
            self.input.seek_relative(-(bytes.len() as i64))?;
        }
        Ok(match chunk::split(&bytes) {
            ChunkParse::Whole { kind, len, .. } => Some((kind, len as u64)),
            ChunkParse::Short(len) if len > bytes.len() as u64 && bytes.len() > 1 => {
                Some((bytes[0], len)).filter(|_| len <= PAYLOAD_BYTES_MAX + 10)
            }
            _ => None,
        })
    }

    /// Skips a chunk of `chunk_bytes`. Returns whether its CRC matches.
    fn is_whole(&mut self, chunk_bytes: u64) -> Result<bool, TakeError> {
        let mut left = chunk_bytes.saturating_sub(CRC_BYTES as u64);
        let mut crc = Hasher::new();
        while left > 0 {
            let found = self.input.fill_buf()?;
            let n = found.len().min(usize::try_from(left).unwrap_or(usize::MAX));
            if n == 0 {
                return Ok(false);
            }
            crc.update(&found[..n]);
            self.input.consume(n);
            left -= n as u64;
        }
        let mut stored = Vec::with_capacity(CRC_BYTES);
        self.input.by_ref().take(CRC_BYTES as u64).read_to_end(&mut stored)?;
        self.at += chunk_bytes;
        Ok(stored == crc.finalize().to_le_bytes())
    }

    /// The payload of a chunk of `chunk_bytes`, if its CRC matches and it is short enough to hold. All records are, and
    /// so is the index of a take of months.
    fn payload(&mut self, chunk_bytes: u64) -> Result<Option<Vec<u8>>, TakeError> {
        if chunk_bytes > CHUNK_HELD_MAX {
            return Ok(None);
        }
        let mut chunk = Vec::new();
        self.input.by_ref().take(chunk_bytes).read_to_end(&mut chunk)?;
        self.at += chunk.len() as u64;
        Ok(match chunk::parse(&chunk) {
            ChunkParse::Whole { payload, len, .. } if len as u64 == chunk_bytes => {
                Some(payload.to_vec())
            }
            _ => None,
        })
    }
}

/// What the end of a closed take states: the header and the channels, the key stretches, the last ledger.
#[derive(Debug, Clone, PartialEq)]
pub struct TakeTail {
    /// The take, without what is stated elsewhere: events, subject, clock lines, foreign parts.
    pub map: TakeMap,
    /// File offset after the last stretch.
    stretches_end: u64,
}

impl TakeTail {
    /// Reads the end of a take: some kilobytes of most takes. `None` for a take that was cut off, or whose end states
    /// neither header nor channels, as in takes of earlier versions: [`TakeMap::open`] reads those.
    ///
    /// # Errors
    /// `Unsupported` or `Codec` when this build cannot use the header, `Io`.
    pub fn read(input: &mut (impl Read + Seek)) -> Result<Option<Self>, TakeError> {
        let file_bytes = input.seek(SeekFrom::End(0))?;
        let mut chunks = ChunkCursor::new(input);
        let Some((footer, keys)) = chunks.end(file_bytes)? else { return Ok(None) };
        if footer.ledger_offset >= footer.index_offset {
            return Ok(None);
        }
        chunks.go_to(footer.ledger_offset)?;
        let Some(ledger) = chunks.record(types::LEDGER)? else { return Ok(None) };
        let Ok(ledger) = Ledger::from_payload(&ledger, footer.ledger_offset) else {
            return Ok(None);
        };
        let Some(summary) = chunks.record(types::SUMMARY)? else { return Ok(None) };
        let Ok(summary) = SummaryRecord::from_payload(&summary, footer.ledger_offset) else {
            return Ok(None);
        };
        let Some(header) = summary.header else { return Ok(None) };
        header.check()?;
        let order = summary.order.unwrap_or_default();
        // The header has the markers that appeared later, too.
        if order.n_channels() > header.channels.len() {
            return Ok(None);
        }
        let mut map = TakeMap {
            channels: header.channels.clone(),
            header: *header,
            n_rows: footer.n_rows,
            keys,
            ledger: Some(ledger),
            ending: summary.ending,
            statistics: summary.statistics,
            finished: true,
            order,
            ..TakeMap::default()
        };
        map.restore_order();
        let tail = Self { map, stretches_end: footer.ledger_offset };
        Ok(tail.is_sound().then_some(tail))
    }

    /// Adds the subject that the beginning of the take states: writers put it behind the header. `None` if the take does not
    /// begin with a header, or with that of another take than the end states: only the whole file tells which one is right.
    ///
    /// # Errors
    /// `Io`.
    pub fn with_subject(
        mut self,
        input: &mut (impl Read + Seek),
    ) -> Result<Option<Self>, TakeError> {
        input.seek(SeekFrom::Start(0))?;
        let mut chunks = ChunkCursor::new(input);
        if !chunks.begin()? {
            return Ok(None);
        }
        let offset = chunks.at;
        let header = chunks.record(types::HEADER)?;
        let header = header.and_then(|payload| Header::from_payload(&payload, offset).ok());
        if !header.is_some_and(|header| self.continues(&header)) {
            return Ok(None);
        }
        let offset = chunks.at;
        let payload = chunks.record(types::SUBJECT)?;
        self.map.subject = payload.and_then(|payload| Subject::from_payload(&payload, offset).ok());
        Ok(Some(self))
    }

    /// Whether the end states the take that begins with this header. Markers may have been added since.
    fn continues(&self, header: &Header) -> bool {
        let stated = &self.map.header;
        stated.take_id == header.take_id
            && stated.rate_hz.to_bits() == header.rate_hz.to_bits()
            && stated.channels.len() >= header.channels.len()
    }

    /// Whether the parts agree with each other.
    fn is_sound(&self) -> bool {
        let keys = &self.map.keys;
        let in_order = keys.is_sorted_by(|a, b| a.first_row < b.first_row && a.offset < b.offset);
        in_order
            && self.map.has_plausible_rows()
            && keys.last().is_none_or(|last| last.offset < self.stretches_end)
    }

    /// The bytes of the file that hold `rows`: first those that are likely to be enough, then the others up to the next
    /// key stretch. Where within its key stretches a row is stored is known only by reading them; a reader stops when it
    /// has the rows.
    #[must_use]
    pub fn window(&self, rows: &Range<u64>) -> [Range<u64>; 2] {
        let keys = &self.map.keys;
        let key_of = |row: u64| keys.partition_point(|key| key.first_row <= row).saturating_sub(1);
        // Whatever is asked for, and whatever a damaged take states, the window is of rows that there are.
        let last_row = rows.end.min(self.map.n_rows).saturating_sub(1).max(rows.start);
        let (first, last) = (key_of(rows.start), key_of(last_row));
        let (Some(first), Some(key)) = (keys.get(first), keys.get(last)) else {
            return [0..0, 0..0];
        };
        let next = keys.get(last + 1);
        let end = next.map_or(self.stretches_end, |next| next.offset);
        let end_row = next.map_or(self.map.n_rows, |next| next.first_row);
        let held = end_row.saturating_sub(key.first_row).max(1);
        // Rows are read up to the end of their stretch; a key stretch has about twice the bytes of another one.
        let stretch_rows = u64::from(self.map.header.stretch_rows).max(1);
        let needed =
            last_row.saturating_add(1).saturating_sub(key.first_row).div_ceil(stretch_rows);
        let needed = needed.saturating_add(1).saturating_mul(stretch_rows).min(held);
        let share = needed as f64 / held as f64 * LIKELY_FACTOR;
        let likely = (end.saturating_sub(key.offset) as f64 * share.min(1.0)).ceil() as u64;
        let likely = key.offset.saturating_add(likely).min(end);
        [first.offset..likely, likely..end]
    }
}

/// By how much the bytes of a window may exceed those of an average one of its rows before a second range is needed.
const LIKELY_FACTOR: f64 = 1.15;

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    const TAKE: &[u8] = include_bytes!("../../tests/golden/v6/fast-1mm.mtake");

    #[test]
    fn the_end_of_a_take_states_the_order_of_its_markers() {
        let take = include_bytes!("../../tests/golden/v6/dense-order.mtake");
        let map = TakeMap::open(&mut Cursor::new(take)).unwrap();
        let tail = TakeTail::read(&mut Cursor::new(take)).unwrap().map(|tail| tail.map);
        let stated =
            |map: &TakeMap| (map.order.clone(), map.channels.clone(), map.statistics.clone());
        assert!(!map.order.is_identity());
        assert_eq!(tail.as_ref().map(stated), Some(stated(&map)));
    }

    #[test]
    fn the_ends_of_a_take_are_those_of_one_take() {
        let begins_with = |header: &Header| {
            let payload = header.to_payload().unwrap();
            let ChunkParse::Whole { len, .. } = chunk::split(&TAKE[MAGIC.len()..]) else {
                panic!("the take has no header")
            };
            let mut take = MAGIC.to_vec();
            chunk::put(&mut take, types::HEADER, &payload).unwrap();
            take.extend_from_slice(&TAKE[MAGIC.len() + len..]);
            let tail = TakeTail::read(&mut Cursor::new(TAKE)).unwrap().unwrap();
            tail.with_subject(&mut Cursor::new(take)).unwrap().is_some()
        };
        let map = TakeMap::open(&mut Cursor::new(TAKE)).unwrap();
        let (header, n_channels) = (map.header, map.channels.len());
        let with_channels = |n: usize| {
            let channels = header.channels.iter().cycle().take(n).cloned().collect();
            Header { channels, ..header.clone() }
        };
        assert!(begins_with(&header) && begins_with(&with_channels(n_channels)));
        assert!(header.channels.len() < n_channels, "markers were added");
        assert!(!begins_with(&with_channels(n_channels + 1)));
        assert!(!begins_with(&Header { rate_hz: header.rate_hz * 2.0, ..header.clone() }));
        assert!(!begins_with(&Header { take_id: [7; 16], ..header.clone() }));
    }

    #[test]
    fn a_window_of_any_rows_is_in_the_take() {
        let Some(mut tail) = TakeTail::read(&mut Cursor::new(TAKE)).unwrap() else {
            panic!("the take has no summary")
        };
        let n_rows = tail.map.n_rows;
        let rows = [0, 1, n_rows - 1, n_rows, n_rows + 1, u64::MAX - 1, u64::MAX];
        for stretch_rows in [0, 1, tail.map.header.stretch_rows, u32::MAX] {
            tail.map.header.stretch_rows = stretch_rows;
            for (first, end) in rows.iter().flat_map(|&first| rows.map(|end| (first, end))) {
                let [likely, rest] = tail.window(&(first..end));
                assert!(likely.start <= likely.end && likely.end <= rest.end, "{first}..{end}");
                assert!(rest.end <= TAKE.len() as u64, "{first}..{end}: {rest:?}");
            }
        }
    }
}
