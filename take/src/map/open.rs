//! The map of a take: from its chunks one after another, or from their heads alone. Of a finished take stretches are passed
//! over, and the index says which of them are keys.

use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};

use crc32fast::Hasher;

use super::TakeMap;
use crate::{
    TakeError, TakeEvent,
    chunk::{
        self, CHUNK_HELD_MAX, CRC_BYTES, Front, HEAD_BYTES_MAX, MAGIC, MAY_SKIP, PAYLOAD_BYTES_MAX,
        types,
    },
    damage::Why,
    index::{Footer, IndexEntry, parse_index},
    reader::record,
    record::{Header, Record},
    stretch::ROWS_PASSED_MAX,
    traversal::TakeTraversal,
};

/// How much is read at once: a few stretches of a recording, whose heads then cost no call each.
const READ_BYTES: usize = 1 << 14;

impl TakeMap {
    /// Of a take as quickly as can be: one that was finished is known by its index and the heads of its chunks,
    /// and a stretch is not read before somebody wants it. Any other is [scanned](Self::scan).
    ///
    /// So damage within a stretch shows when it is read, not here.
    ///
    /// # Errors
    /// `NotATake`, `Unsupported`, `Io`.
    pub fn open(input: &mut (impl Read + Seek)) -> Result<Self, TakeError> {
        if let Some(map) = by_heads(input)? {
            return Ok(map);
        }
        Self::scan(input)
    }

    /// Of a take of which every chunk's checksum is looked at, and no sample decoded.
    ///
    /// # Errors
    /// `NotATake`, `Unsupported`, `Io`.
    pub fn scan(input: &mut (impl Read + Seek)) -> Result<Self, TakeError> {
        input.seek(SeekFrom::Start(0))?;
        let mut map = TakeTraversal::of_bytes(input).run(|_, _| Ok(()))?.take;
        // A recovered take says itself which rows it has not.
        map.damaged |= map.damage.iter().any(|lost| lost.why == Why::BeforeRecovery);
        Ok(map)
    }
}

/// The map of a take whose footer, index and heads agree in every byte; `None` of any other.
fn by_heads(input: &mut (impl Read + Seek)) -> Result<Option<TakeMap>, TakeError> {
    let file_bytes = input.seek(SeekFrom::End(0))?;
    let mut chunks = Chunks { input: BufReader::with_capacity(READ_BYTES, input), at: 0 };
    let Some((footer, keys)) = chunks.end(file_bytes)? else { return Ok(None) };
    chunks.go_to(0)?;
    let mut magic = [0; MAGIC.len()];
    chunks.input.read_exact(&mut magic)?;
    chunks.at = MAGIC.len() as u64;
    if magic != MAGIC {
        return Ok(None);
    }
    let mut map = None;
    let mut next_key = keys.iter().peekable();
    while chunks.at < file_bytes {
        let offset = chunks.at;
        let Some((kind, chunk_bytes)) = chunks.head()? else { return Ok(None) };
        if kind == types::STRETCH {
            next_key.next_if(|key| key.offset == offset);
        }
        let is_known = match kind {
            types::STRETCH => {
                chunks.go_to(offset + chunk_bytes)?;
                true
            }
            // One wrong bit of a type may make any other chunk one of these.
            types::FOREIGN | types::INDEX | types::FOOTER => chunks.is_whole(chunk_bytes)?,
            _ if !types::ALL.contains(&kind) => {
                kind & MAY_SKIP != 0 && chunks.is_whole(chunk_bytes)?
            }
            _ => {
                let Some(payload) = chunks.payload(chunk_bytes)? else { return Ok(None) };
                add(&mut map, kind, &payload, offset)
            }
        };
        if !is_known {
            return Ok(None);
        }
    }
    let last_row = keys.last().map_or(0, |key| key.first_row);
    // A ledger that counts other rows, or none, is for a traversal to judge.
    let ledger = map.as_ref().and_then(|map| map.ledger.as_ref());
    let rows = ledger.map(|ledger| ledger.recorded.saturating_add(ledger.frames_lost()));
    let is_sound = chunks.at == file_bytes
        && rows == Some(footer.n_rows)
        && next_key.peek().is_none()
        && keys.is_sorted_by(|a, b| a.first_row < b.first_row && a.offset < b.offset)
        && (last_row..=last_row.saturating_add(ROWS_PASSED_MAX)).contains(&footer.n_rows);
    Ok(map.filter(|_| is_sound).map(|map| TakeMap {
        n_rows: footer.n_rows,
        keys,
        finished: true,
        ..map
    }))
}

/// A chunk that is no stretch; says whether it is as it must be.
fn add(map: &mut Option<TakeMap>, kind: u8, payload: &[u8], offset: u64) -> bool {
    let Some(map) = map else {
        let header = Header::from_payload(payload, offset).ok();
        let header = header.filter(|header| kind == types::HEADER && header.check().is_ok());
        *map = header.map(|header| TakeMap {
            channels: header.channels.clone(),
            header,
            ..TakeMap::default()
        });
        return map.is_some();
    };
    match record(kind, payload, offset) {
        Some(Ok(TakeEvent::Channels(mut more))) => map.channels.append(&mut more),
        Some(Ok(event)) => map.keep(event),
        // Of a newer version: a reader may go on without it.
        Some(Err(TakeError::Unsupported { .. })) if kind & MAY_SKIP != 0 => {}
        Some(Err(_)) => return false,
        // MODEL, which this version does not read.
        None => return kind & MAY_SKIP != 0,
    }
    true
}

/// A file, chunk by chunk.
struct Chunks<R> {
    input: BufReader<R>,
    at: u64,
}

impl<R: Read + Seek> Chunks<R> {
    fn go_to(&mut self, offset: u64) -> Result<(), TakeError> {
        match i64::try_from(i128::from(offset) - i128::from(self.at)) {
            Ok(by) => self.input.seek_relative(by)?,
            Err(_) => drop(self.input.seek(SeekFrom::Start(offset))?),
        }
        self.at = offset;
        Ok(())
    }

    /// Footer and index, if the file ends with them.
    fn end(&mut self, file_bytes: u64) -> Result<Option<(Footer, Vec<IndexEntry>)>, TakeError> {
        let footer_bytes = Footer::CHUNK_BYTES as u64;
        let Some(footer_at) = file_bytes.checked_sub(footer_bytes) else { return Ok(None) };
        self.input.seek(SeekFrom::Start(footer_at))?;
        self.at = footer_at;
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

    /// Type and length in bytes of the chunk here; nothing is passed over.
    fn head(&mut self) -> Result<Option<(u8, u64)>, TakeError> {
        let mut bytes = Vec::with_capacity(HEAD_BYTES_MAX);
        let found = self.input.fill_buf()?;
        if found.len() >= HEAD_BYTES_MAX {
            bytes.extend_from_slice(&found[..HEAD_BYTES_MAX]);
        } else {
            // Where a buffer ends, and at the end of the file.
            self.input.by_ref().take(HEAD_BYTES_MAX as u64).read_to_end(&mut bytes)?;
            self.input.seek_relative(-(bytes.len() as i64))?;
        }
        Ok(match chunk::split(&bytes) {
            Front::Whole { kind, len, .. } => Some((kind, len as u64)),
            Front::Short(len) if len > bytes.len() as u64 && bytes.len() > 1 => {
                Some((bytes[0], len)).filter(|_| len <= PAYLOAD_BYTES_MAX + 10)
            }
            _ => None,
        })
    }

    /// Passes over the chunk of so many bytes here; says whether its checksum matches.
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

    /// The payload of the chunk of so many bytes here, if its checksum matches. No record, and no index of a take of
    /// months, is so long that it would not be held.
    fn payload(&mut self, chunk_bytes: u64) -> Result<Option<Vec<u8>>, TakeError> {
        if chunk_bytes > CHUNK_HELD_MAX {
            return Ok(None);
        }
        let mut chunk = Vec::new();
        self.input.by_ref().take(chunk_bytes).read_to_end(&mut chunk)?;
        self.at += chunk.len() as u64;
        Ok(match chunk::front(&chunk) {
            Front::Whole { payload, len, .. } if len as u64 == chunk_bytes => {
                Some(payload.to_vec())
            }
            _ => None,
        })
    }
}
