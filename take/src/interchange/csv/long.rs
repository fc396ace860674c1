//! The long layout of statistics programs: one row for each sample, `frame,time_s,label,x_mm,y_mm,z_mm`. Missing
//! samples have no row, so lost frames and markers that were never seen do not appear. The rows may come in any order:
//! they are sorted into a rectangle of frames and markers.

use std::{
    borrow::Cow,
    collections::HashMap,
    io::{self, Read, Write},
};

use super::{LineCells, malformed, quote};
use crate::{
    escape::from_cell,
    foreign::content::{Content, ContentCursor, ContentWriter, NewScratch, Spool},
    interchange::{
        ReadOptions, Result, counted, put_position,
        source_file::{Line, TextFile},
        table::{
            self, CUT_OFF, MAX_POSITIONS_PER_BYTE, Rounding, SampleCells, parse_sample, rate_of,
        },
        text::{self, AtOrigin, POSITION_BYTES, Separator, TextFrames, column_labels, stored},
        units::{FileUnit, ToMillimetres},
        write_frames,
    },
    motion::{FrameSource, Marker, MotionInfo, Notes, Position, UpAxis, is_gap},
    stretch::CHANNELS_MAX,
};

/// The column names.
const COLUMNS: [&str; 6] = ["frame", "time_s", "label", "x_mm", "y_mm", "z_mm"];

/// Whether a line has the column names of this layout.
pub(super) fn is_long(line: &[u8]) -> bool {
    let mut cells = LineCells::new(line).map(|cell| text::decode(cell.trim_ascii()));
    COLUMNS.iter().all(|name| cells.next().is_some_and(|cell| cell.eq_ignore_ascii_case(name)))
}

/// Reads everything but the frames of a file whose column names are in line `header_line`, and prepares to deliver
/// those. Markers are in the order of their first rows.
pub(super) fn open(
    file: &mut TextFile<'_, '_>,
    header_line: usize,
    options: &ReadOptions,
    new_scratch: NewScratch<'_>,
) -> Result<(MotionInfo, TextFrames)> {
    let mut notes = Notes::default();
    let unit = FileUnit::resolve("mm", options.unit, &mut notes);
    let up = options.up(UpAxis::Unknown, &mut notes);
    let millimetres = ToMillimetres::new(unit.factor, options.rotation());
    let data = Data::read(file, header_line, &millimetres, new_scratch)?;
    let Some((first, last)) = data.frames else {
        return Err(malformed(header_line, "expected one line for each sample, found none"));
    };
    let n_markers = data.labels.len();
    let total_max = data.text_bytes.saturating_mul(MAX_POSITIONS_PER_BYTE);
    let n_frames = (last - first).checked_add(1);
    let total = n_frames.and_then(|n| n.checked_mul(n_markers as u64));
    let (Some(n_frames), Some(total)) = (n_frames, total.filter(|&total| total <= total_max))
    else {
        let message = format!(
            "frames {first} to {last} of {n_markers} markers are too many for a file of {} bytes; split the file",
            data.text_bytes
        );
        return Err(malformed(header_line, &message));
    };
    let mut rectangle = Rectangle::new(total, new_scratch)?;
    let duplicates = rectangle.fill(data.samples, (first, n_markers as u64))?;
    if data.is_cut_off {
        notes.warnings.push(CUT_OFF.to_owned());
    }
    table::report_damaged(data.damaged, &mut notes.warnings);
    if duplicates > 0 {
        notes.warnings.push(format!(
            "Repeated for the same marker and frame: {}; the last one was used.",
            counted(duplicates, "sample")
        ));
    }
    millimetres.report(&mut notes.warnings);
    let rate_hz = match data.timed {
        _ if first == last => table::rate_of_one_frame(&mut notes.warnings),
        timed => timed
            .and_then(|timed| timed.rate_hz(data.rounding))
            .ok_or_else(|| malformed(header_line, "no rate: times must increase"))?,
    };
    let mut frames = TextFrames::of_rectangle(rectangle.finish()?, (n_frames, n_markers));
    frames.examine(&unit, AtOrigin::Positions, &mut notes)?;
    let info = MotionInfo {
        rate_hz,
        n_frames,
        markers: data.labels.into_iter().map(marker).collect(),
        up,
        source: unit.into_source("csv", first, 0, notes),
        ..MotionInfo::default()
    };
    Ok((info, frames))
}

/// A marker by its label. A label such as `u012` is the number of an unlabelled marker.
fn marker(label: String) -> Marker {
    let number = label.strip_prefix('u').filter(|digits| digits.len() >= 3);
    let numbered = number.is_some_and(|digits| digits.bytes().all(|b| b.is_ascii_digit()));
    Marker { labelled: !numbered, label }
}

/// The first and the last frame that have a time, with the first time that a row states for them.
#[derive(Debug, Clone, Copy)]
struct TimedFrames {
    first: (u64, f64),
    last: (u64, f64),
}

impl TimedFrames {
    fn add(&mut self, frame: u64, seconds: f64) {
        if frame < self.first.0 {
            self.first = (frame, seconds);
        }
        if frame > self.last.0 {
            self.last = (frame, seconds);
        }
    }

    fn rate_hz(self, rounding: Rounding) -> Option<f64> {
        let ((first, from_s), (last, to_s)) = (self.first, self.last);
        rate_of((last - first) as f64, to_s - from_s, rounding)
    }
}

/// The parsed rows.
struct Data {
    labels: Vec<String>,
    /// The [samples](PlacedSample), in the order of their rows.
    samples: Content,
    /// The numbers of the first and the last frame that have a time or a sample.
    frames: Option<(u64, u64)>,
    timed: Option<TimedFrames>,
    rounding: Rounding,
    damaged: usize,
    is_cut_off: bool,
    text_bytes: u64,
}

/// The columns of the labels so far.
#[derive(Default)]
struct Columns {
    by_label: HashMap<Vec<u8>, usize>,
    labels: Vec<String>,
}

impl Columns {
    /// The column of a label. There is none for more labels than a take can have: they would be held in memory.
    fn of(&mut self, label: &[u8]) -> Option<usize> {
        if let Some(&column) = self.by_label.get(label) {
            return Some(column);
        }
        let column = self.labels.len();
        if column == CHANNELS_MAX {
            return None;
        }
        self.by_label.insert(label.to_vec(), column);
        self.labels.push(from_cell(&text::decode(label)).into_owned());
        Some(column)
    }
}

impl Data {
    fn read(
        file: &mut TextFile<'_, '_>,
        header_line: usize,
        millimetres: &ToMillimetres,
        new_scratch: NewScratch<'_>,
    ) -> Result<Self> {
        let mut columns = Columns::default();
        let mut samples = ContentWriter::new(new_scratch);
        let (mut frames, mut timed) = (None, None::<TimedFrames>);
        let (mut rounding, mut damaged) = (Rounding::default(), 0);
        let (mut n_cells, mut last) = (COLUMNS.len(), None::<PlacedSample>);
        let mut lines = file.lines_below(header_line)?;
        while let Some(Line { number, bytes: line, .. }) = lines.next()? {
            if line.trim_ascii().is_empty() || line.starts_with(b"#") {
                continue;
            }
            if let Some(sample) = last.take() {
                extend(&mut frames, sample.frame);
                samples.write(&sample.to_bytes())?;
            }
            n_cells = LineCells::new(line).count();
            let mut cells = LineCells::new(line);
            let mut next = || cells.next().unwrap_or(Cow::Borrowed(&[]));
            let (frame, time, label) = (next(), next(), next());
            let position = [next(), next(), next()];
            let frame = text::whole_number(&frame)
                .ok_or_else(|| malformed(number, "expected a frame number in the first cell"))?;
            if let Some(seconds) = text::number(&time) {
                let at = (frame, seconds);
                timed.get_or_insert(TimedFrames { first: at, last: at }).add(frame, seconds);
                extend(&mut frames, frame);
                rounding.add(&time);
            }
            let column = columns.of(label.trim_ascii()).ok_or_else(|| {
                let message = format!("expected at most {CHANNELS_MAX} labels; split the file");
                malformed(number, &message)
            })?;
            let mut position = position.iter().map(|cell| &cell[..]);
            match parse_sample(&mut position) {
                SampleCells::Position(stored) => {
                    last = Some(PlacedSample {
                        frame,
                        column,
                        position: millimetres.position(stored),
                    });
                }
                SampleCells::Empty => {}
                SampleCells::Damaged => damaged += 1,
            }
        }
        let (is_open, text_bytes) = (lines.is_open(), lines.n_bytes());
        let is_short = is_open && n_cells < COLUMNS.len();
        let is_cut_off =
            is_short || (is_open && file.ends_mid_number(header_line, Separator::COMMA)?);
        if let Some(sample) = last.filter(|_| !is_cut_off) {
            extend(&mut frames, sample.frame);
            samples.write(&sample.to_bytes())?;
        }
        let (labels, samples) = (columns.labels, samples.finish()?);
        Ok(Self { labels, samples, frames, timed, rounding, damaged, is_cut_off, text_bytes })
    }
}

/// Extends a range of frames.
fn extend(frames: &mut Option<(u64, u64)>, frame: u64) {
    let (first, last) = frames.unwrap_or((frame, frame));
    *frames = Some((first.min(frame), last.max(frame)));
}

/// Writes the column names, then one line for each sample: the frame number, the time from the first frame in seconds,
/// the marker's label (made unique by `#2`, `#3`...), and the position in millimetres with the digits that restore the
/// f32.
pub(crate) fn write(frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<()> {
    let info = frames.info().clone();
    let labels: Vec<String> =
        column_labels(&info).iter().map(|label| quote(label).into_owned()).collect();
    let header = COLUMNS.join(",") + "\n";
    write_frames(frames, out, header.into_bytes(), |lines, index, row| {
        let number = info.source.first_frame.saturating_add(index);
        let time_s = index as f64 / info.rate_hz;
        for (label, &position) in labels.iter().zip(row).filter(|(_, at)| !is_gap(**at)) {
            write!(lines, "{number},{time_s},{label},")?;
            put_position(lines, position, b',', "")?;
            lines.push(b'\n');
        }
        Ok(())
    })?;
    Ok(())
}

/// A sample of the long layout.
#[derive(Debug, Clone, Copy)]
pub(super) struct PlacedSample {
    pub(super) frame: u64,
    pub(super) column: usize,
    pub(super) position: Position,
}

/// Bytes of a sample: frame, column and position.
const SAMPLE_BYTES: usize = 8 + 4 + POSITION_BYTES;

impl PlacedSample {
    /// Its bytes. A take has fewer columns than a `u32` counts.
    pub(super) fn to_bytes(self) -> [u8; SAMPLE_BYTES] {
        let mut bytes = [0; SAMPLE_BYTES];
        bytes[..8].copy_from_slice(&self.frame.to_le_bytes());
        bytes[8..12].copy_from_slice(&(self.column as u32).to_le_bytes());
        bytes[12..].copy_from_slice(&stored(self.position));
        bytes
    }
}

/// Positions that are held between two writes: 4 kB of them. In files that are sorted by frame they are adjacent
/// samples; in others more would only be copied.
const HELD_POSITIONS: u64 = 341;

/// The positions of all frames and markers, frame by frame; zeros where there is none.
pub(super) struct Rectangle {
    content: Content,
    /// The positions that are held, and the number of the first.
    held: Vec<[u8; POSITION_BYTES]>,
    from: u64,
    n_positions: u64,
}

impl Rectangle {
    /// `n_positions` without any sample.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn new(n_positions: u64, new_scratch: NewScratch<'_>) -> io::Result<Self> {
        let n_bytes = n_positions.saturating_mul(POSITION_BYTES as u64);
        let content = Spool::new(new_scratch).zeros(n_bytes)?;
        Ok(Self { content, held: Vec::new(), from: 0, n_positions })
    }

    /// Stores samples; frames count from `first`. Returns how many replaced another sample.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn fill(
        &mut self,
        samples: Content,
        (first, n_markers): (u64, u64),
    ) -> io::Result<u64> {
        let n_samples = samples.len() / SAMPLE_BYTES as u64;
        let mut samples = ContentCursor::new(samples);
        let mut duplicates = 0;
        for _ in 0..n_samples {
            let (mut frame, mut column) = ([0; 8], [0; 4]);
            let mut position = [0; POSITION_BYTES];
            samples.read_exact(&mut frame)?;
            samples.read_exact(&mut column)?;
            samples.read_exact(&mut position)?;
            let row = u64::from_le_bytes(frame).saturating_sub(first);
            let place = row * n_markers + u64::from(u32::from_le_bytes(column));
            if let Some(held) = self.hold(place)? {
                duplicates += u64::from(*held != [0; POSITION_BYTES]);
                *held = position;
            }
        }
        Ok(duplicates)
    }

    /// The positions.
    ///
    /// # Errors
    /// Those of the scratch file.
    pub(super) fn finish(mut self) -> io::Result<Content> {
        self.write_held()?;
        Ok(self.content)
    }

    fn hold(&mut self, place: u64) -> io::Result<Option<&mut [u8; POSITION_BYTES]>> {
        let from = place - place % HELD_POSITIONS;
        if self.held.is_empty() || from != self.from {
            self.write_held()?;
            let n_held = self.n_positions.saturating_sub(from).min(HELD_POSITIONS);
            self.held.resize(n_held as usize, [0; POSITION_BYTES]);
            self.from = from;
            self.content.read_at(from * POSITION_BYTES as u64, self.held.as_flattened_mut())?;
        }
        Ok(self.held.get_mut((place - from) as usize))
    }

    fn write_held(&mut self) -> io::Result<()> {
        self.content.write_at(self.from * POSITION_BYTES as u64, self.held.as_flattened())
    }
}
