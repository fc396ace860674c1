//! Records into bytes.

use super::{Entry, MAGIC, PAYLOAD_BYTES_MAX, Record, VERSION};

/// Appends what a log begins with.
pub fn put_head(out: &mut Vec<u8>) {
    out.extend_from_slice(&MAGIC);
    out.push(VERSION);
}

/// Appends a record. A payload that is longer than [`PAYLOAD_BYTES_MAX`] goes as several.
pub fn put_record(record: &Record<'_>, out: &mut Vec<u8>) {
    let Record { time_ns, entry } = record;
    let (number, baud);
    let payload = match entry {
        Entry::FromDevice(bytes) | Entry::ToDevice(bytes) => bytes,
        Entry::Opened(words) => words.as_bytes(),
        Entry::Missing(bytes) => {
            number = bytes.to_le_bytes();
            &number[..]
        }
        Entry::Baud(value) => {
            baud = value.to_le_bytes();
            &baud[..]
        }
        Entry::Break | Entry::Closed | Entry::End => &[],
    };
    let mut rest = payload;
    loop {
        let (now, later) = rest.split_at(rest.len().min(PAYLOAD_BYTES_MAX));
        let start = out.len();
        out.push(entry.kind());
        out.extend_from_slice(&time_ns.to_le_bytes());
        out.extend_from_slice(&(now.len() as u32).to_le_bytes());
        out.extend_from_slice(now);
        let crc = crc32fast::hash(out.get(start..).unwrap_or_default());
        out.extend_from_slice(&crc.to_le_bytes());
        if later.is_empty() {
            return;
        }
        rest = later;
    }
}
