//! A take as a sequence of frames, for exporters, `verify` and the simulator.

use std::{
    io::{self, Read, Seek},
    sync::Arc,
};

use crate::{
    TakeError,
    damage::{Problem, push_problem},
    foreign::content::{Content, ScratchFile, Spool},
    foreign::{Foreign, ForeignPart},
    interchange::c3d,
    map::TakeMap,
    motion::{FrameSource, GAP, Motion, MotionEvent, MotionInfo, Position, Source},
    record::{Event, Header},
    sampled::{Recording, SampledPart, is_recorded},
    stretch::Span,
    traversal::{Decode, TakeTraversal},
};

/// Maximum number of bytes of a take's foreign parts, in memory and scratch file together.
const FOREIGN_BYTES_MAX: u64 = 1 << 28;

/// Maximum number of samples that [`read_motion`] holds: 3 GiB.
const MOTION_SAMPLES_MAX: u64 = 1 << 28;

/// The frames of a take in order, decoded stretch by stretch, in bounded memory.
///
/// A lost or damaged frame is a row of gaps; [`problems`](Self::problems) gives the reasons.
#[derive(Debug)]
pub struct TakeFrames<R> {
    info: MotionInfo,
    map: TakeMap,
    stretches: TakeTraversal<R>,
    /// The last decoded stretch.
    current: Option<Span>,
    /// By channel, the error bound that the stretch's blocks state.
    stated_mm: Vec<Option<f64>>,
    next_row: u64,
    ended: bool,
}

impl<R: Read + Seek> TakeFrames<R> {
    /// Scans the take, without decoding it, for its channel table and number of rows. [`info`](FrameSource::info) lists
    /// its foreign parts, without their content.
    ///
    /// # Errors
    /// `NotATake`, `Unsupported`, `Io`.
    pub fn open(input: R) -> Result<Self, TakeError> {
        Self::open_with(input, |_| false, || Err(io::ErrorKind::Unsupported.into()))
    }

    /// Opens a take like [`open`](Self::open), and reads the content of foreign parts whose kind is `wanted`. Content
    /// beyond 8 MiB goes into the file that `new_scratch` creates.
    ///
    /// # Errors
    /// Those of [`open`](Self::open), and `Io` for the scratch file.
    pub fn open_with(
        mut input: R,
        wanted: impl Fn(&str) -> bool,
        new_scratch: impl Fn() -> io::Result<Arc<dyn ScratchFile>>,
    ) -> Result<Self, TakeError> {
        let mut info = MotionInfo::default();
        let mut map = TakeMap::scan(&mut input)?;
        let mut foreign_bytes = 0_u64;
        let mut spool = Spool::new(new_scratch);
        for part @ ForeignPart { kind, .. } in &map.foreign {
            // Channels of a recording are not part of a file.
            if is_recorded(kind) {
                continue;
            }
            if part.sampled().is_some_and(|part| !part.is_block()) {
                push_problem(&mut map.problems, Problem::PartUnreadable { kind: kind.clone() });
                continue;
            }
            if !wanted(kind) {
                let bounds = part.bounds();
                info.foreign.push(Foreign { kind: kind.clone(), data: Content::default(), bounds });
                continue;
            }
            foreign_bytes = foreign_bytes.saturating_add(part.source_bytes());
            if foreign_bytes > FOREIGN_BYTES_MAX {
                push_problem(&mut map.problems, Problem::ForeignTooLong { kind: kind.clone() });
            } else {
                let lost = part.sampled().map(SampledPart::lost).unwrap_or_default();
                let (content, undecodable) = part.read(&mut input, &mut spool)?;
                // Those that are missing in the file are among the problems already.
                let stated = lost.iter().filter(|lost| lost.causes.is_some());
                for lost in stated.chain(&undecodable) {
                    push_problem(&mut map.problems, Problem::of_samples(kind, lost));
                }
                let restored = c3d::reordered(&content, &map.order.inverse())?;
                info.foreign.push(restored.unwrap_or(content));
            }
        }
        let is_asked = wanted(c3d::PARAMETERS) || wanted(c3d::ANALOG);
        let is_import = map.header.source.is_some();
        if is_import
            && is_asked
            && let Some(part) = c3d::analog_without_parameters(&map.foreign)
        {
            push_problem(&mut map.problems, Problem::ParametersLost);
            if wanted(c3d::PARAMETERS) {
                info.foreign.push(c3d::parameters_of_channels(part));
            }
        }
        describe(&map.header, &mut info);
        info.n_frames = map.n_rows;
        info.markers = map.channels.iter().map(Into::into).collect();
        let event = |e: &Event| MotionEvent { frame: e.row, kind: e.kind, text: e.text.clone() };
        info.subject.clone_from(&map.subject);
        info.events = map.events.iter().map(event).collect();
        // An event may be written after the stretch of a later frame.
        info.events.sort_by_key(|event| event.frame);
        Ok(Self {
            info,
            stretches: TakeTraversal::from_map(input, &map, Decode::All)?,
            map,
            current: None,
            stated_mm: Vec::new(),
            next_row: 0,
            ended: false,
        })
    }

    /// Adds the sampled channels of a recording, which `input` reads from the same file, to the description of the take.
    /// `resamples`: an export may resample channels where its format needs that.
    ///
    /// # Errors
    /// Those of [`Recording::open`].
    pub fn open_recording(
        &mut self,
        input: impl Read + Seek + Send + 'static,
        resamples: bool,
    ) -> Result<(), TakeError> {
        let recording = Recording::open(&self.map, input)?;
        self.info.recording = recording.map(|recording| recording.resampling(resamples));
        Ok(())
    }

    /// Everything in the take but its samples.
    #[must_use]
    pub fn map(&self) -> &TakeMap {
        &self.map
    }

    /// Everything missing or damaged. The list is complete after the last frame, except for frames that were
    /// [skipped](Self::seek).
    #[must_use]
    pub fn problems(&self) -> &[Problem] {
        &self.map.problems
    }

    /// Skips to frame `row`. Stretches before the last key stretch, which begins at most ten seconds before `row` (five
    /// minutes in an import where nothing moves) unless keys are further apart, are not decoded. Frames that were read are not repeated.
    ///
    /// # Errors
    /// `Unsupported`, `Io`.
    pub fn seek(&mut self, row: u64) -> Result<(), TakeError> {
        self.stretches.seek(row)?;
        self.next_row = self.next_row.max(row);
        Ok(())
    }

    /// Decodes the next stretch, if there is one.
    fn advance(&mut self) -> Result<(), TakeError> {
        self.current = None;
        let span = self.stretches.next_stretch();
        let found = self.stretches.take_problems();
        found.into_iter().for_each(|problem| push_problem(&mut self.map.problems, problem));
        match span? {
            Some(span) if span.n_rows > 0 => {
                self.current = Some(span);
                let stated = self.stretches.rows().map(|rows| Some(rows?.max_error_mm));
                self.stated_mm.clear();
                self.stated_mm.extend(stated);
            }
            Some(_) => {}
            None => self.ended = true,
        }
        Ok(())
    }
}

impl<R: Read + Seek> FrameSource for TakeFrames<R> {
    fn info(&self) -> &MotionInfo {
        &self.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> io::Result<bool> {
        let at = self.next_row;
        if at >= self.info.n_frames {
            return Ok(false);
        }
        while !self.ended && self.current.is_none_or(|span| span.end_row() <= at) {
            self.advance().map_err(io::Error::other)?;
        }
        row.fill(GAP);
        let span = self.current.filter(|span| (span.first_row..span.end_row()).contains(&at));
        if let Some(span) = span {
            let i = (at - span.first_row) as usize;
            for (position, rows) in row.iter_mut().zip(self.stretches.rows()) {
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

    fn take(&self) -> Option<&TakeMap> {
        Some(&self.map)
    }

    fn is_lost(&self) -> bool {
        let Some(row) = self.next_row.checked_sub(1) else { return false };
        self.map.damaged
            && !self.current.is_some_and(|span| (span.first_row..span.end_row()).contains(&row))
    }
}

fn describe(header: &Header, info: &mut MotionInfo) {
    info.rate_hz = header.rate_hz;
    info.up = header.up_axis;
    info.source = match (&header.source, &header.device) {
        (Some(source), _) => Source {
            format: source.format.clone(),
            unit: source.unit.clone(),
            factor: source.factor,
            first_frame: source.first_frame,
            warnings: source.warnings.clone(),
            ..Source::default()
        },
        (None, device) => Source {
            format: device.as_ref().map(|d| d.driver.clone()).unwrap_or_default(),
            factor: 1.0,
            first_frame: 1,
            ..Source::default()
        },
    };
}

/// Reads a whole take into memory, for replay, with the list of its problems.
///
/// # Errors
/// `NotATake`, `Unsupported`, `Io`.
pub fn read_motion(input: impl Read + Seek) -> Result<(Motion, Vec<Problem>), TakeError> {
    let mut frames = TakeFrames::open(input)?;
    let n_markers = frames.info.markers.len();
    if frames.info.n_frames.saturating_mul(n_markers.max(1) as u64) > MOTION_SAMPLES_MAX {
        return Err(TakeError::InvalidArgument(format!(
            "{} frames of {n_markers} markers do not fit into memory; export a part of the take",
            frames.info.n_frames
        )));
    }
    let mut row = vec![GAP; n_markers];
    let mut motion = Motion { info: frames.info.clone(), positions_mm: Vec::new() };
    while frames.next_frame(&mut row)? {
        motion.positions_mm.extend_from_slice(&row);
    }
    Ok((motion, frames.map.problems))
}
