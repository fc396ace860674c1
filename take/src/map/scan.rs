//! All chunks, one after another.

use std::io::{Read, Seek, SeekFrom};

use super::TakeMap;
use crate::{
    TakeError, TakeEvent,
    foreign::ForeignPart,
    frames::{damaged, mended},
    index::IndexEntry,
    problems::Problems,
    reader::read_events_at,
    stretch::Stretch,
    table::ChannelTable,
    timeline::Causes,
};

pub(super) fn scan(
    input: &mut (impl Read + Seek),
    mut foreign: impl FnMut(ForeignPart),
) -> Result<TakeMap, TakeError> {
    input.seek(SeekFrom::Start(0))?;
    let mut map: Option<TakeMap> = None;
    let mut table = ChannelTable::default();
    // What is wrong before the header was found, if it is.
    let (mut before, mut damaged_before) = (Vec::new(), false);
    read_events_at(input, |offset, event| {
        let Some(map) = &mut map else {
            match event {
                TakeEvent::Header(header) => {
                    table.append(&header.channels);
                    map = Some(TakeMap {
                        n_held: Some(0),
                        longest_stretch: Some(0),
                        ..TakeMap::new(*header)
                    });
                }
                TakeEvent::Damaged { offset, len, message, .. } => {
                    damaged_before = true;
                    before.note(damaged(offset, len, &message));
                }
                TakeEvent::Mended { offset } => before.note(mended(offset)),
                _ => {}
            }
            return Ok(());
        };
        match event {
            TakeEvent::Foreign(part) => foreign(part),
            TakeEvent::Channels(more) => table.append(&more),
            TakeEvent::Stretch(stretch) => {
                map.stretch(&stretch, offset);
                if let Some(renamed) = table.stated(stretch.stated_channels()) {
                    map.problems.note(renamed.to_string());
                }
            }
            TakeEvent::Unplaced { rows_min, .. } => {
                map.damaged = true;
                map.n_rows = map.n_rows.max(rows_min);
            }
            TakeEvent::Footer(footer) => map.footer(footer.n_rows),
            TakeEvent::Subject(subject) => map.subject = Some(*subject),
            TakeEvent::Event(event) => map.events.push(event),
            TakeEvent::Ledger(ledger) => map.ledger = Some(*ledger),
            TakeEvent::Clock(clock) => map.clock(&clock),
            TakeEvent::Summary(summary) => map.ending = summary.ending,
            TakeEvent::Damaged { offset, len, message, .. } => {
                map.damaged = true;
                table.damaged();
                map.problems.note(damaged(offset, len, &message));
            }
            TakeEvent::Mended { offset } => map.problems.note(mended(offset)),
            TakeEvent::End { finished, .. } => {
                map.finished = finished;
                if !finished {
                    // Always, and last: whoever opens a take looks for it there.
                    map.problems.push("the take was cut off: its end is missing".to_owned());
                }
            }
            TakeEvent::Header(_) | TakeEvent::Index(_) | TakeEvent::Skipped { .. } => {}
        }
        Ok(())
    })?;
    let mut map = map.ok_or(TakeError::NotATake("no intact header was found"))?;
    map.damaged |= damaged_before;
    before.append(&mut map.problems);
    map.problems = before;
    map.channels = table.into_channels();
    Ok(map)
}

impl TakeMap {
    fn stretch(&mut self, stretch: &Stretch<'_>, offset: u64) {
        let span = stretch.span;
        self.damaged |= stretch.missing_before;
        // A recovered take says itself which rows it has not.
        let mut runs = stretch.timeline.iter().flat_map(|timeline| &timeline.runs);
        self.damaged |=
            runs.any(|run| run.lost.is_some_and(|causes| causes.contains(Causes::DAMAGED)));
        let longest = self.longest_stretch.unwrap_or_default();
        self.longest_stretch = Some(longest.max(span.n_rows.into()));
        // Rows that come twice, and those of no channel, are not held.
        if let Some(held) = &mut self.n_held
            && stretch.blocks.iter().any(|block| !block.is_empty())
        {
            *held += span.end_row().saturating_sub(span.first_row.max(self.n_rows));
        }
        if span.key && span.n_rows > 0 && span.first_row >= self.n_rows {
            self.keys.push(IndexEntry { offset, first_row: span.first_row });
        }
        self.n_rows = self.n_rows.max(span.end_row());
    }

    fn footer(&mut self, n_rows: u64) {
        if n_rows != self.n_rows {
            let found = self.n_rows;
            self.problems.note(format!("the footer tells of {n_rows} frames, {found} were found"));
        }
        if self.damaged {
            self.n_rows = self.n_rows.max(n_rows);
        }
    }
}
