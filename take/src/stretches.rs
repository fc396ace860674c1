//! The stretches of a take, decoded one after another from any key on: what frames and random access are made of.

use std::io::{Read, Seek, SeekFrom};

use mocapd_codec::DecodedRows;

use crate::{
    TakeError, TakeEvent, TakeReader,
    frames::{damaged, mended},
    index::IndexEntry,
    map::TakeMap,
    problems::Problems,
    reader::pull,
    record::Header,
    stretch::{Span, StretchDecoder},
    timeline::Timeline,
};

/// Decoded stretches in order, in bounded memory. What cannot be decoded is passed over, and
/// [`problems`](Self::problems) says what and why.
#[derive(Debug)]
pub struct TakeStretches<R> {
    input: R,
    header: Header,
    keys: Vec<IndexEntry>,
    reader: TakeReader,
    decoder: StretchDecoder,
    /// Rows before this one were read: a stretch that has some of them comes twice.
    read_to: u64,
    /// Stretches whose rows nobody knows reach to this row at least.
    unplaced_to: u64,
    timeline: Option<Timeline>,
    /// Damaged chunks are told here, because the map was made without reading them.
    tells_damage: bool,
    /// The damage that explains a missing stretch was told.
    damage_told: bool,
    problems: Vec<String>,
    ended: bool,
}

impl<R: Read + Seek> TakeStretches<R> {
    /// From the start of the take.
    ///
    /// # Errors
    /// `Unsupported` or `Codec` when the header cannot be used, `Io`.
    pub fn new(mut input: R, map: &TakeMap) -> Result<Self, TakeError> {
        input.seek(SeekFrom::Start(0))?;
        Ok(Self {
            input,
            header: map.header.clone(),
            keys: map.keys.clone(),
            reader: TakeReader::new(),
            decoder: StretchDecoder::new(map.header.codec()?),
            read_to: 0,
            unplaced_to: 0,
            timeline: None,
            tells_damage: map.n_held.is_none(),
            damage_told: false,
            problems: Vec::new(),
            ended: false,
        })
    }

    /// Decodes some groups of channels only, by number ([`StretchDecoder::of_groups`]); the others have no
    /// samples. To be said before the first stretch.
    ///
    /// # Errors
    /// `Unsupported` or `Codec` when the header cannot be used.
    pub fn with_groups(mut self, groups: Vec<usize>) -> Result<Self, TakeError> {
        self.decoder = StretchDecoder::of_groups(self.header.codec()?, groups);
        Ok(self)
    }

    /// Goes on at the last key stretch that begins at `row` or before it, and passes over what lies between;
    /// does nothing when no key lies ahead of what was read. At most ten seconds of the take are then decoded
    /// before `row` comes.
    ///
    /// What is wrong with stretches that are passed over is not told.
    ///
    /// # Errors
    /// `Unsupported` or `Codec` when the header cannot be used, `Io`.
    pub fn seek(&mut self, row: u64) -> Result<(), TakeError> {
        let behind = self.keys.partition_point(|key| key.first_row <= row);
        let Some(&key) = behind.checked_sub(1).and_then(|at| self.keys.get(at)) else {
            return Ok(());
        };
        if key.first_row <= self.read_to || key.offset <= self.reader.offset() || self.ended {
            return Ok(());
        }
        self.input.seek(SeekFrom::Start(key.offset))?;
        self.reader = TakeReader::from_key(&self.header, key)?;
        self.decoder.pass();
        self.read_to = key.first_row;
        self.damage_told = false;
        Ok(())
    }

    /// A reader of the same take that begins at the last key stretch at `row` or before it, and that key's place in the
    /// file; at the start of the take where there is none.
    ///
    /// # Errors
    /// `Unsupported` or `Codec` when the header cannot be used.
    pub fn reader_at(&self, row: u64) -> Result<(u64, TakeReader), TakeError> {
        let behind = self.keys.partition_point(|key| key.first_row <= row);
        match behind.checked_sub(1).and_then(|at| self.keys.get(at)) {
            Some(&key) => Ok((key.offset, TakeReader::from_key(&self.header, key)?)),
            None => Ok((0, TakeReader::new())),
        }
    }

    /// Decodes the next stretch that can be; `None` at the end of the take. Stretches without rows, which tell
    /// of lost ones alone, come with what they tell.
    ///
    /// # Errors
    /// `NotATake`, `Io`.
    pub fn next_stretch(&mut self) -> Result<Option<Span>, TakeError> {
        while !self.ended {
            match self.reader.next_event()? {
                Some(TakeEvent::Stretch(mut stretch)) => {
                    let span = stretch.span;
                    if stretch.missing_before && !std::mem::take(&mut self.damage_told) {
                        self.problems
                            .note(format!("stretches before frame {} are missing", span.first_row));
                    }
                    if span.n_rows == 0 {
                        // Rows were lost, at the end of the take as a rule.
                        self.timeline = stretch.timeline.take();
                        return Ok(Some(span));
                    }
                    let problem = if span.first_row < self.read_to {
                        self.decoder.pass();
                        "comes twice".to_owned()
                    } else {
                        match self.decoder.decode(&stretch) {
                            Ok(()) => {
                                self.read_to = span.end_row();
                                self.timeline = stretch.timeline.take();
                                return Ok(Some(span));
                            }
                            Err(error) => error.to_string(),
                        }
                    };
                    self.problems.note(format!(
                        "the stretch of {} frames from frame {} on {problem}",
                        span.n_rows, span.first_row
                    ));
                }
                Some(TakeEvent::Unplaced { missing_before, n_rows, rows_min }) => {
                    let from = self.read_to.max(self.unplaced_to);
                    self.unplaced_to = from.max(rows_min);
                    if missing_before && !std::mem::take(&mut self.damage_told) {
                        self.problems.note(format!("stretches from frame {from} on are missing"));
                    }
                    self.problems.note(format!(
                        "a stretch of {n_rows} frames, from frame {from} or later: it depends on a damaged one"
                    ));
                }
                Some(TakeEvent::Damaged { offset, len, message, .. }) => {
                    self.damage_told = true;
                    if self.tells_damage {
                        self.problems.note(damaged(offset, len, &message));
                    }
                }
                Some(TakeEvent::Mended { offset }) if self.tells_damage => {
                    self.problems.note(mended(offset));
                }
                Some(TakeEvent::End { .. }) => self.ended = true,
                Some(_) => {}
                None => pull(&mut self.input, &mut self.reader)?,
            }
        }
        Ok(None)
    }

    /// The rows of the last stretch that came, by channel; `None` where it has nothing of a channel.
    pub fn rows(&self) -> impl Iterator<Item = Option<&DecodedRows>> {
        self.decoder.rows()
    }

    /// When the rows of the last stretch were, those lost before it included; `None` in an import.
    #[must_use]
    pub fn timeline(&self) -> Option<&Timeline> {
        self.timeline.as_ref()
    }

    /// Whether the last stretch was the last of the take.
    #[must_use]
    pub fn is_ended(&self) -> bool {
        self.ended
    }

    /// What could not be decoded so far, one sentence each. What [`TakeMap::problems`] has is not repeated.
    #[must_use]
    pub fn problems(&self) -> &[String] {
        &self.problems
    }

    /// The same, to keep.
    pub(crate) fn take_problems(&mut self) -> Vec<String> {
        std::mem::take(&mut self.problems)
    }
}
