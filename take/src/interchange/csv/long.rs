//! The long layout: one row a sample that is present, `frame,time_s,label,x_mm,y_mm,z_mm`, as statistics programs
//! like it. Lost frames, and markers that were never seen, have no row.

use std::{borrow::Cow, collections::HashMap, io::Write};

use super::{
    dialect::{LineCells, quote},
    malformed,
};
use crate::{
    ambiguity::Notes,
    escape::from_cell,
    interchange::{
        ReadOptions, Result,
        line_frames::{Rounding, rate_of},
        put_position,
        table::{
            CUT_OFF, Cells, MAX_POSITIONS_PER_BYTE, rate_of_one_frame, report_damaged, three_cells,
        },
        text::{self, Separator, column_labels},
        units::{FileUnit, Millimetres},
        write_frames,
    },
    motion::{FrameSource, GAP, Marker, Motion, MotionInfo, Position, UpAxis, is_gap},
};

/// The names of the columns.
const COLUMNS: [&str; 6] = ["frame", "time_s", "label", "x_mm", "y_mm", "z_mm"];

/// Whether these are the names of the columns.
pub(super) fn is_long(line: &[u8]) -> bool {
    let mut cells = LineCells::new(line).map(|cell| text::decode(cell.trim_ascii()));
    COLUMNS.iter().all(|name| cells.next().is_some_and(|cell| cell.eq_ignore_ascii_case(name)))
}

/// Reads a whole file whose column names are at `head_line`. Markers come in the order in which they are first seen.
pub(super) fn read(bytes: &[u8], head_line: usize, options: &ReadOptions) -> Result<Motion> {
    let mut notes = Notes::default();
    let unit = FileUnit::of("mm", options.unit, &mut notes);
    let up = options.up(UpAxis::Unknown, &mut notes);
    let millimetres = Millimetres::new(unit.factor, options.turn());
    let data = Data::read(bytes, head_line, &millimetres)?;
    if data.is_cut_off {
        notes.warnings.push(CUT_OFF.to_owned());
    }
    report_damaged(data.damaged, &mut notes.warnings);
    if data.twice > 0 {
        notes.warnings.push(format!(
            "{} samples come twice, the same marker in the same frame; the last one counts.",
            data.twice
        ));
    }
    millimetres.report(&mut notes.warnings);
    let Some((first, last)) = data.frames() else {
        return Err(malformed(head_line, "expected a line for each sample, found none"));
    };
    let n_markers = data.labels.len();
    let n_frames = usize::try_from(last - first).ok().and_then(|n| n.checked_add(1));
    let total = n_frames.and_then(|n| n.checked_mul(n_markers));
    let earned = bytes.len().saturating_mul(MAX_POSITIONS_PER_BYTE);
    let Some(total) = total.filter(|&total| total <= earned) else {
        let message = format!(
            "frames {first} to {last} of {n_markers} markers are more than {} bytes of text can mean; split the file",
            bytes.len()
        );
        return Err(malformed(head_line, &message));
    };
    let rate_hz = match data.rate_hz() {
        _ if first == last => rate_of_one_frame(&mut notes.warnings),
        Some(rate_hz) => rate_hz,
        None => {
            let message = "the rate is not known: expected times that rise with the frames";
            return Err(malformed(head_line, message));
        }
    };
    let mut positions_mm = vec![GAP; total];
    for (frame, column, position) in data.samples {
        let row = frame.checked_sub(first).and_then(|row| usize::try_from(row).ok());
        let place = row.and_then(|row| row.checked_mul(n_markers)?.checked_add(column));
        if let Some(place) = place.and_then(|place| positions_mm.get_mut(place)) {
            *place = position;
        }
    }
    unit.judge(&positions_mm, n_markers, &mut notes);
    Ok(Motion {
        positions_mm,
        info: MotionInfo {
            rate_hz,
            n_frames: last - first + 1,
            markers: data.labels.into_iter().map(marker).collect(),
            up,
            source: unit.into_source("csv", first, 0, notes),
            ..MotionInfo::default()
        },
    })
}

/// A marker by its name. A column that has none is called by its number, whatever place it has here.
fn marker(label: String) -> Marker {
    let number = label.strip_prefix('u').filter(|digits| digits.len() >= 3);
    let numbered = number.is_some_and(|digits| digits.bytes().all(|b| b.is_ascii_digit()));
    Marker { labelled: !numbered, label }
}

/// The data as read.
#[derive(Default)]
struct Data {
    labels: Vec<String>,
    samples: Vec<(u64, usize, Position)>,
    /// The frames that have a time, in order.
    times: Vec<(u64, f64)>,
    rounding: Rounding,
    damaged: usize,
    twice: usize,
    is_cut_off: bool,
}

impl Data {
    fn read(bytes: &[u8], head_line: usize, millimetres: &Millimetres) -> Result<Self> {
        let mut data = Self::default();
        let mut columns: HashMap<Vec<u8>, usize> = HashMap::new();
        let (mut n_cells, mut last_has_sample) = (COLUMNS.len(), false);
        for (number, line) in text::lines(bytes).skip(head_line) {
            if line.trim_ascii().is_empty() || line.starts_with(b"#") {
                continue;
            }
            n_cells = LineCells::new(line).count();
            last_has_sample = false;
            let mut cells = LineCells::new(line);
            let mut next = || cells.next().unwrap_or(Cow::Borrowed(&[]));
            let (frame, time, label) = (next(), next(), next());
            let position = [next(), next(), next()];
            let frame = text::whole_number(&frame).ok_or_else(|| {
                malformed(number, "expected the number of a frame in the first cell")
            })?;
            if let Some(seconds) = text::number(&time) {
                data.times.push((frame, seconds));
                data.rounding.add(&time);
            }
            let column = *columns.entry(label.trim_ascii().to_vec()).or_insert_with_key(|label| {
                data.labels.push(from_cell(&text::decode(label)).into_owned());
                data.labels.len() - 1
            });
            let mut position = position.iter().map(|cell| &cell[..]);
            match three_cells(&mut position) {
                Cells::Position(stored) => {
                    data.samples.push((frame, column, millimetres.position(stored)));
                    last_has_sample = true;
                }
                Cells::Empty => {}
                Cells::Damaged => data.damaged += 1,
            }
        }
        let is_short = !bytes.ends_with(b"\n") && n_cells < COLUMNS.len();
        data.is_cut_off =
            is_short || text::ends_within_a_number(bytes, head_line + 1, Separator::COMMA);
        if data.is_cut_off && last_has_sample {
            data.samples.pop();
        }
        data.times.sort_by_key(|&(frame, _)| frame);
        data.times.dedup_by_key(|&mut (frame, _)| frame);
        let mut places: Vec<_> =
            data.samples.iter().map(|&(frame, column, _)| (frame, column)).collect();
        places.sort_unstable();
        data.twice = places.windows(2).filter(|w| matches!(w, [a, b] if a == b)).count();
        Ok(data)
    }

    /// Frames a second, by the frames that have times.
    fn rate_hz(&self) -> Option<f64> {
        let ((first, from_s), (last, to_s)) = (*self.times.first()?, *self.times.last()?);
        rate_of((last - first) as f64, to_s - from_s, self.rounding)
    }

    /// The first and the last frame that have a time or a sample.
    fn frames(&self) -> Option<(u64, u64)> {
        let timed = self.times.iter().map(|&(frame, _)| frame);
        let frames = timed.chain(self.samples.iter().map(|&(frame, ..)| frame));
        Some((frames.clone().min()?, frames.max()?))
    }
}

/// Writes a line of names, then one line a sample that is present: the frame's number, its time from the first frame
/// in seconds, the marker's label (told apart by `#2`, `#3`... where it is not the only one), and the position in
/// millimetres with as many digits as bring back the f32.
pub(crate) fn write(frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<()> {
    let info = frames.info().clone();
    let labels: Vec<String> =
        column_labels(&info).iter().map(|label| quote(label).into_owned()).collect();
    let head = COLUMNS.join(",") + "\n";
    write_frames(frames, out, head.into_bytes(), |lines, index, row| {
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
