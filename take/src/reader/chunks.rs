//! From whole chunks to events.

use super::{TakeEvent, TakeReader};
use crate::{
    TakeError, chunk,
    chunk::{CRC_BYTES, Front, MAY_SKIP, types},
    foreign::{ForeignPart, Inflation},
    index::{Footer, parse_index},
    record::{Clock, Event, Header, Ledger, MoreChannels, Record, Subject, SummaryRecord},
    stretch::CHANNELS_MAX,
    stretch::{Chain, Placed},
};

impl TakeReader {
    /// The chunk at `start` of the buffer, whose CRC matched.
    pub(super) fn interpret(
        &mut self,
        kind: u8,
        start: usize,
        len: usize,
    ) -> Result<TakeEvent<'_>, TakeError> {
        let offset = self.base + start as u64;
        let Front::Whole { payload, .. } = chunk::split(&self.buffer[start..start + len]) else {
            return Err(TakeError::NotATake("a chunk vanished while it was read"));
        };
        let Some(chain) = &mut self.chain else {
            if kind == types::HEADER {
                let header = Header::from_payload(payload, offset)?;
                header.check()?;
                self.chain = Some(Chain::of(&header)?);
                self.bytes.header += len as u64;
                self.n_channels = header.channels.len();
                return Ok(TakeEvent::Header(Box::new(header)));
            }
            self.bytes.other += len as u64;
            let message = format!("a chunk of type {kind:02x} before the header");
            return Ok(damaged(offset, len as u64, kind, message));
        };
        let event = match kind {
            types::CHANNELS => {
                MoreChannels::from_payload(payload, offset).and_then(|MoreChannels(more)| {
                    let n_channels = self.n_channels + more.len();
                    if n_channels > CHANNELS_MAX {
                        let message = "there are more channels than marker ids".to_owned();
                        return Err(TakeError::Corrupt { what: "channel table", offset, message });
                    }
                    self.n_channels = n_channels;
                    Ok(TakeEvent::Channels(more))
                })
            }
            types::STRETCH => chain.place(payload).map(TakeEvent::from).map_err(|message| {
                TakeError::Corrupt { what: "stretch", offset, message: message.to_owned() }
            }),
            types::SUBJECT => Subject::from_payload(payload, offset)
                .map(|subject| TakeEvent::Subject(Box::new(subject))),
            types::EVENT => Event::from_payload(payload, offset).map(TakeEvent::Event),
            types::LEDGER => {
                Ledger::from_payload(payload, offset).map(|l| TakeEvent::Ledger(Box::new(l)))
            }
            types::CLOCK => {
                Clock::from_payload(payload, offset).map(|c| TakeEvent::Clock(Box::new(c)))
            }
            types::SUMMARY => SummaryRecord::from_payload(payload, offset).map(TakeEvent::Summary),
            types::FOREIGN => {
                let payload_at = offset + (len - CRC_BYTES - payload.len()) as u64;
                let place = (payload_at, payload.len() as u64);
                ForeignPart::of_payload(payload, place, offset).and_then(|part| {
                    let mut inflation = Inflation::new(part.data_bytes);
                    let from = (part.deflated_at() - payload_at) as usize;
                    inflation.push(&payload[from..]);
                    inflation.finish(offset).map(|()| TakeEvent::Foreign(part))
                })
            }
            types::INDEX => parse_index(payload, offset).map(TakeEvent::Index),
            types::FOOTER => Footer::from_payload(payload, offset)
                .and_then(|footer| footer.check(chain.rows_believed_max(), offset))
                .inspect(|_| self.seen_footer = true)
                .map(TakeEvent::Footer),
            _ if kind & MAY_SKIP != 0 => Ok(TakeEvent::Skipped { kind }),
            _ => {
                let message = match kind {
                    types::HEADER => "a second header".to_owned(),
                    _ => format!("chunk type {kind:02x} is unknown: use a newer mocapd"),
                };
                Ok(damaged(offset, len as u64, kind, message))
            }
        };
        let event = event.unwrap_or_else(|error| match error {
            TakeError::Unsupported { .. } if kind & MAY_SKIP != 0 => TakeEvent::Skipped { kind },
            error => damaged(offset, len as u64, kind, error.to_string()),
        });
        self.bytes.add(&event, len as u64);
        Ok(event)
    }
}

/// A chunk whose content is wrong.
pub(super) fn damaged(offset: u64, len: u64, kind: u8, message: String) -> TakeEvent<'static> {
    let kind = Some(kind).filter(|kind| types::ALL.contains(kind));
    TakeEvent::Damaged { offset, len, kind, message }
}

impl<'a> From<Placed<'a>> for TakeEvent<'a> {
    fn from(placed: Placed<'a>) -> Self {
        match placed {
            Placed::Stretch(stretch) => Self::Stretch(stretch),
            Placed::Unplaced { missing_before, n_rows, rows_min } => {
                Self::Unplaced { missing_before, n_rows, rows_min }
            }
        }
    }
}
