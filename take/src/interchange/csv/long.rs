//! The long layout of statistics programs: one row for each sample, `frame,time_s,label,x_mm,y_mm,z_mm`. Missing
//! samples have no row, so lost frames and markers that were never seen do not appear.

use std::{borrow::Cow, collections::HashMap, io::Write};

use super::{
    dialect::{LineCells, quote},
    malformed,
};
use crate::{
    ambiguity::Notes,
    escape::from_cell,
    interchange::{
        ReadOptions, Result, counted, put_position,
        row_timing::{Rounding, rate_of},
        table::{self, CUT_OFF, MAX_POSITIONS_PER_BYTE, SampleCells, parse_sample},
        text::{self, Separator, column_labels, ends_mid_number},
        units::{FileUnit, MotionExtent, ToMillimetres},
        write_frames,
    },
    motion::{FrameSource, GAP, Marker, Motion, MotionInfo, Position, UpAxis, is_gap},
};

/// The column names.
const COLUMNS: [&str; 6] = ["frame", "time_s", "label", "x_mm", "y_mm", "z_mm"];

/// Whether a line has the column names of this layout.
pub(super) fn is_long(line: &[u8]) -> bool {
    let mut cells = LineCells::new(line).map(|cell| text::decode(cell.trim_ascii()));
    COLUMNS.iter().all(|name| cells.next().is_some_and(|cell| cell.eq_ignore_ascii_case(name)))
}

/// Reads a whole file whose column names are in line `header_line`. Markers are in the order of their first rows.
pub(super) fn read(bytes: &[u8], header_line: usize, options: &ReadOptions) -> Result<Motion> {
    let mut notes = Notes::default();
    let unit = FileUnit::resolve("mm", options.unit, &mut notes);
    let up = options.up(UpAxis::Unknown, &mut notes);
    let millimetres = ToMillimetres::new(unit.factor, options.rotation());
    let data = Data::read(bytes, header_line, &millimetres)?;
    if data.is_cut_off {
        notes.warnings.push(CUT_OFF.to_owned());
    }
    table::report_damaged(data.damaged, &mut notes.warnings);
    if data.duplicates > 0 {
        notes.warnings.push(format!(
            "Repeated for the same marker and frame: {}; the last one was used.",
            counted(data.duplicates as u64, "sample")
        ));
    }
    millimetres.report(&mut notes.warnings);
    let Some((first, last)) = data.frames() else {
        return Err(malformed(header_line, "expected one line for each sample, found none"));
    };
    let n_markers = data.labels.len();
    let n_frames = usize::try_from(last - first).ok().and_then(|n| n.checked_add(1));
    let total = n_frames.and_then(|n| n.checked_mul(n_markers));
    let total_max = bytes.len().saturating_mul(MAX_POSITIONS_PER_BYTE);
    let Some(total) = total.filter(|&total| total <= total_max) else {
        let message = format!(
            "frames {first} to {last} of {n_markers} markers are too many for a file of {} bytes; split the file",
            bytes.len()
        );
        return Err(malformed(header_line, &message));
    };
    let rate_hz = match data.rate_hz() {
        _ if first == last => table::rate_of_one_frame(&mut notes.warnings),
        rate_hz => rate_hz.ok_or_else(|| malformed(header_line, "no rate: times must increase"))?,
    };
    let mut positions_mm = vec![GAP; total];
    for (frame, column, position) in data.samples {
        let row = frame.checked_sub(first).and_then(|row| usize::try_from(row).ok());
        let place = row.and_then(|row| row.checked_mul(n_markers)?.checked_add(column));
        if let Some(place) = place.and_then(|place| positions_mm.get_mut(place)) {
            *place = position;
        }
    }
    unit.check(&mut MotionExtent::of(&positions_mm, n_markers), &mut notes);
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

/// A marker by its label. A label such as `u012` is the number of an unlabelled marker, in whatever column it is here.
fn marker(label: String) -> Marker {
    let number = label.strip_prefix('u').filter(|digits| digits.len() >= 3);
    let numbered = number.is_some_and(|digits| digits.bytes().all(|b| b.is_ascii_digit()));
    Marker { labelled: !numbered, label }
}

/// The parsed rows.
#[derive(Default)]
struct Data {
    labels: Vec<String>,
    samples: Vec<(u64, usize, Position)>,
    /// Frame numbers with times in seconds, in ascending order.
    times: Vec<(u64, f64)>,
    rounding: Rounding,
    damaged: usize,
    duplicates: usize,
    is_cut_off: bool,
}

impl Data {
    fn read(bytes: &[u8], header_line: usize, millimetres: &ToMillimetres) -> Result<Self> {
        let mut data = Self::default();
        let mut columns: HashMap<Vec<u8>, usize> = HashMap::new();
        let (mut n_cells, mut last_has_sample) = (COLUMNS.len(), false);
        for (number, line) in text::lines(bytes).skip(header_line) {
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
            match parse_sample(&mut position) {
                SampleCells::Position(stored) => {
                    data.samples.push((frame, column, millimetres.position(stored)));
                    last_has_sample = true;
                }
                SampleCells::Empty => {}
                SampleCells::Damaged => data.damaged += 1,
            }
        }
        let is_short = !bytes.ends_with(b"\n") && n_cells < COLUMNS.len();
        data.is_cut_off = is_short || ends_mid_number(bytes, header_line + 1, Separator::COMMA);
        if data.is_cut_off && last_has_sample {
            data.samples.pop();
        }
        data.times.sort_by_key(|&(frame, _)| frame);
        data.times.dedup_by_key(|&mut (frame, _)| frame);
        let mut places: Vec<_> =
            data.samples.iter().map(|&(frame, column, _)| (frame, column)).collect();
        places.sort_unstable();
        data.duplicates = places.windows(2).filter(|w| matches!(w, [a, b] if a == b)).count();
        Ok(data)
    }

    /// The rate from the first and the last frame that have a time.
    fn rate_hz(&self) -> Option<f64> {
        let ((first, from_s), (last, to_s)) = (*self.times.first()?, *self.times.last()?);
        rate_of((last - first) as f64, to_s - from_s, self.rounding)
    }

    /// The numbers of the first and the last frame that have a time or a sample.
    fn frames(&self) -> Option<(u64, u64)> {
        let timed = self.times.iter().map(|&(frame, _)| frame);
        let frames = timed.chain(self.samples.iter().map(|&(frame, ..)| frame));
        Some((frames.clone().min()?, frames.max()?))
    }
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
