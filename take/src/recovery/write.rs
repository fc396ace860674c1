//! The second pass over the file: copies its valid chunks.

use std::io::{Read, Seek, SeekFrom, Write};

use super::{OutputChunk, RECOVERED, RecoveryScan};
use crate::{
    TakeError,
    chunk::{self, CHUNK_HELD_MAX, ChunkParse},
    reader::repair_head,
    record::{Event, EventKind, Header, SummaryRecord},
    stretch::{NUMBERS, ROWS_PASSED_MAX, Span, StretchHeaderWriter},
    timeline::{Timeline, TimelineEncoder},
    writer::TakeWriter,
};

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
        let summary = SummaryRecord {
            ending: self.ending.clone(),
            header: Some(Box::new(Header { channels: self.channels.clone(), ..header })),
            statistics: Some(self.statistics.clone()),
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
    // Each covers the most rows that may be lost between two stretches; the last one has the given number.
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
    TakeError::corrupt("chunk", offset, "the file changed while it was read")
}
