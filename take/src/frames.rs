//! A take as frames: what exporters, `verify` and the simulator read.

use std::io::{Read, Seek, SeekFrom};

use crate::{
    TakeError, TakeEvent, TakeReader,
    index::Footer,
    motion::{FrameSource, GAP, Motion, MotionInfo, Position, Source, UpAxis},
    reader::{pull, read_events},
    record::Header,
    stretch::{Span, StretchDecoder},
    table::ChannelTable,
    timeline::Causes,
};

pub use crate::table::nameless;

/// Most bytes of foreign parts that are held in memory.
const FOREIGN_BYTES_MAX: usize = 1 << 28;

/// Most samples of a take that [`read_motion`] holds: 3 GiB.
const MOTION_SAMPLES_MAX: u64 = 1 << 28;

/// Frames of a take in order, decoded stretch by stretch: bounded memory for a take of any length.
///
/// A lost or damaged frame is a row of gaps; [`problems`](Self::problems) says which and why.
#[derive(Debug)]
pub struct TakeFrames<R> {
    input: R,
    info: MotionInfo,
    n_held: u64,
    tolerance_mm: f64,
    damaged: bool,
    cut_off: bool,
    reader: TakeReader,
    decoder: StretchDecoder,
    /// The stretch that `decoder` holds.
    current: Option<Span>,
    /// By channel, what its blocks state.
    stated_mm: Vec<Option<f64>>,
    next_row: u64,
    /// The damage that explains a missing stretch was told.
    damage_told: bool,
    problems: Vec<String>,
    ended: bool,
}

impl<R: Read + Seek> TakeFrames<R> {
    /// Reads the take once without decoding it, for its channel table and its number of rows.
    ///
    /// # Errors
    /// `NotATake`, `Unsupported`, `Io`.
    pub fn open(mut input: R) -> Result<Self, TakeError> {
        let mut info = MotionInfo::default();
        let mut header = None;
        let mut problems = Vec::new();
        let mut table = ChannelTable::default();
        let mut n_held = 0_u64;
        let mut damaged = false;
        let mut cut_off = false;
        let mut foreign_bytes = 0;
        read_events(&mut input, |event| {
            match event {
                TakeEvent::Header(found) => {
                    describe(&found, &mut info);
                    table.append(&found.channels);
                    header = Some(found);
                }
                TakeEvent::Channels(more) => table.append(&more),
                TakeEvent::Stretch(stretch) => {
                    damaged |= stretch.missing_before;
                    // A recovered take says itself which rows it has not.
                    damaged |=
                        stretch.timeline.iter().flat_map(|t| &t.runs).any(|run| {
                            run.lost.is_some_and(|causes| causes.contains(Causes::DAMAGED))
                        });
                    // Rows that come twice, and those of no channel, are not held.
                    if stretch.blocks.iter().any(|block| !block.is_empty()) {
                        let first = stretch.span.first_row.max(info.n_frames);
                        n_held += stretch.span.end_row().saturating_sub(first);
                    }
                    info.n_frames = info.n_frames.max(stretch.span.end_row());
                    if let Some(renamed) = table.stated(stretch.stated_channels()) {
                        problems.push(renamed.to_string());
                    }
                }
                TakeEvent::Unplaced { rows_min, .. } => {
                    damaged = true;
                    info.n_frames = info.n_frames.max(rows_min);
                }
                TakeEvent::Footer(Footer { n_rows, .. }) => {
                    if n_rows != info.n_frames {
                        let found = info.n_frames;
                        problems.push(format!(
                            "the footer tells of {n_rows} frames, {found} were found"
                        ));
                    }
                    if damaged {
                        info.n_frames = info.n_frames.max(n_rows);
                    }
                }
                TakeEvent::Foreign(part) => {
                    foreign_bytes += part.data.len();
                    if foreign_bytes > FOREIGN_BYTES_MAX {
                        problems
                            .push(format!("{}: more foreign data than a take can hold", part.kind));
                    } else {
                        info.foreign.push(part);
                    }
                }
                TakeEvent::Damaged { offset, len, message, .. } => {
                    damaged = true;
                    table.damaged();
                    problems.push(format!("{len} bytes at byte {offset}: {message}"));
                }
                TakeEvent::Mended { offset } => problems.push(mended(offset)),
                TakeEvent::End { finished: false, .. } => {
                    cut_off = true;
                    problems.push("the take was cut off: its end is missing".into());
                }
                _ => {}
            }
            Ok(())
        })?;
        let header = header.ok_or(TakeError::NotATake("no intact header was found"))?;
        info.markers = table.channels().iter().map(Into::into).collect();
        input.seek(SeekFrom::Start(0))?;
        Ok(Self {
            input,
            info,
            n_held,
            tolerance_mm: header.tolerance_mm,
            damaged,
            cut_off,
            reader: TakeReader::new(),
            decoder: StretchDecoder::new(header.codec()?),
            current: None,
            stated_mm: Vec::new(),
            next_row: 0,
            damage_told: false,
            problems,
            ended: false,
        })
    }

    /// How many of its frames lie in a stretch that was found. The others were lost, and come as gaps.
    #[must_use]
    pub fn n_held(&self) -> u64 {
        self.n_held
    }

    /// The bound that was asked for; 0 for `lossless`.
    #[must_use]
    pub fn tolerance_mm(&self) -> f64 {
        self.tolerance_mm
    }

    /// Whether its end is missing.
    #[must_use]
    pub fn is_cut_off(&self) -> bool {
        self.cut_off
    }

    /// What is missing or damaged, one sentence each. Complete after the last frame.
    #[must_use]
    pub fn problems(&self) -> &[String] {
        &self.problems
    }

    /// Decodes the next stretch that can be; `false` at the end.
    fn advance(&mut self) -> Result<bool, TakeError> {
        while !self.ended {
            match self.reader.next_event()? {
                Some(TakeEvent::Stretch(stretch)) => {
                    let span = stretch.span;
                    if stretch.missing_before && !std::mem::take(&mut self.damage_told) {
                        self.problems
                            .push(format!("stretches before frame {} are missing", span.first_row));
                    }
                    if span.n_rows == 0 {
                        // The take ends with lost rows.
                        continue;
                    }
                    let problem = if span.first_row < self.next_row {
                        self.decoder.pass();
                        "comes twice".to_owned()
                    } else {
                        match self.decoder.decode(&stretch) {
                            Ok(()) => {
                                self.current = Some(span);
                                let stated =
                                    self.decoder.rows().map(|rows| Some(rows?.max_error_mm));
                                self.stated_mm.clear();
                                self.stated_mm.extend(stated);
                                return Ok(true);
                            }
                            Err(error) => error.to_string(),
                        }
                    };
                    self.problems.push(format!(
                        "the stretch of {} frames from frame {} on {problem}",
                        span.n_rows, span.first_row
                    ));
                }
                Some(TakeEvent::Unplaced { missing_before, n_rows, .. }) => {
                    let from = self.next_row;
                    if missing_before && !std::mem::take(&mut self.damage_told) {
                        self.problems.push(format!("stretches from frame {from} on are missing"));
                    }
                    self.problems.push(format!(
                        "a stretch of {n_rows} frames, from frame {from} or later, depends on a damaged stretch"
                    ));
                }
                Some(TakeEvent::Damaged { .. }) => self.damage_told = true,
                Some(TakeEvent::End { .. }) => self.ended = true,
                Some(_) => {}
                None => pull(&mut self.input, &mut self.reader)?,
            }
        }
        Ok(false)
    }
}

impl<R: Read + Seek> FrameSource for TakeFrames<R> {
    fn info(&self) -> &MotionInfo {
        &self.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> std::io::Result<bool> {
        let at = self.next_row;
        if at >= self.info.n_frames {
            return Ok(false);
        }
        while !self.ended && self.current.is_none_or(|span| span.end_row() <= at) {
            self.current = None;
            self.advance().map_err(std::io::Error::other)?;
        }
        row.fill(GAP);
        if let Some(span) =
            self.current.filter(|span| (span.first_row..span.end_row()).contains(&at))
        {
            let i = (at - span.first_row) as usize;
            for (position, rows) in row.iter_mut().zip(self.decoder.rows()) {
                if let Some(rows) = rows.filter(|rows| rows.present[i]) {
                    *position = rows.positions[i];
                }
            }
        }
        self.next_row += 1;
        Ok(true)
    }

    fn stated_error_mm(&self, column: usize) -> Option<f64> {
        if self.is_lost() { None } else { self.stated_mm.get(column).copied().flatten() }
    }

    fn is_lost(&self) -> bool {
        let Some(row) = self.next_row.checked_sub(1) else { return false };
        self.damaged
            && !self.current.is_some_and(|span| (span.first_row..span.end_row()).contains(&row))
    }
}

/// What to say of a chunk whose head was damaged.
#[must_use]
pub fn mended(offset: u64) -> String {
    format!("the head of the chunk at byte {offset} is damaged; its content is whole")
}

fn describe(header: &Header, info: &mut MotionInfo) {
    info.rate_hz = header.rate_hz;
    info.up = UpAxis::from_code(header.up_axis);
    info.source = match (&header.source, &header.device) {
        (Some(source), _) => Source {
            format: source.format.clone(),
            unit: source.unit.clone(),
            factor: source.factor,
            first_frame: source.first_frame,
            frames_missing: 0,
            warnings: source.warnings.clone(),
        },
        (None, device) => Source {
            format: device.as_ref().map(|d| d.driver.clone()).unwrap_or_default(),
            factor: 1.0,
            first_frame: 1,
            ..Source::default()
        },
    };
}

/// A whole take in memory, for replay, and what is missing from it.
///
/// # Errors
/// `NotATake`, `Unsupported`, `Io`.
pub fn read_motion(input: impl Read + Seek) -> Result<(Motion, Vec<String>), TakeError> {
    let mut frames = TakeFrames::open(input)?;
    let n_markers = frames.info.markers.len();
    if frames.info.n_frames.saturating_mul(n_markers.max(1) as u64) > MOTION_SAMPLES_MAX {
        return Err(TakeError::InvalidArgument(format!(
            "{} frames of {n_markers} markers are more than fit into memory: export a part of the take",
            frames.info.n_frames
        )));
    }
    let mut row = vec![GAP; n_markers];
    let mut motion = Motion { info: frames.info.clone(), positions_mm: Vec::new() };
    while frames.next_frame(&mut row)? {
        motion.positions_mm.extend_from_slice(&row);
    }
    Ok((motion, frames.problems))
}
