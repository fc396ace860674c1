//! Qualisys Track Manager's text export of 3D data.
//!
//! Lines of a name, a tab and a value, the last of them `MARKER_NAMES` (QTM manual, "Motion data (.tsv)",
//! docs.qualisys.com); perhaps a line with trajectory types and a line with column names (`Frame`, `Time`,
//! `Head_FL X` or `Head_FL_X`); then one line a frame, in millimetres.
//! The export has no mark for a missing sample: it writes zeros. Three zeros, empty cells and cells that are no
//! finite numbers are therefore gaps.

use std::io::Write;

use super::{
    InterchangeError, ReadOptions, Result, expect_frames,
    origin::beside_origin,
    put_position,
    table::Table,
    text::{self, Separator, column_labels, kept_header, plain, value_of},
    units::{FileUnit, Millimetres},
    write_frames,
};
use crate::{
    ambiguity::Notes,
    motion::{Foreign, FrameSource, Motion, MotionEvent, MotionInfo, UpAxis},
    record::EventKind,
};

/// Kind of the header lines that are kept: all lines above the data, each followed by LF.
const HEADER: &str = "tsv/header";

/// Reads a whole file.
pub(super) fn read(bytes: &[u8], options: &ReadOptions) -> Result<Motion> {
    let mut notes = Notes::default();
    let head = Head::parse(bytes)?;
    let unit = FileUnit::of("mm", options.unit, &mut notes);
    let millimetres = Millimetres::new(unit.factor, options.turn());
    let mut table = Table::new("tsv", bytes, millimetres).with_zeros_as_gaps();
    let mut width = head.labels.len();
    let mut first_frame = None;
    for (_, line) in text::lines(bytes).skip(head.n_lines) {
        if line.trim_ascii().is_empty() {
            continue;
        }
        let mut cells = Separator::TAB.cells(line);
        for column in 0..head.lead {
            let cell = cells.next().unwrap_or(&[]);
            if Some(column) == head.frame_column {
                first_frame = first_frame.or_else(|| text::whole_number(cell));
            }
        }
        width = width.max(table.read_samples(&mut cells));
        table.end_row();
    }
    let up = options.up(UpAxis::Unknown, &mut notes);
    table.report_not_finite(&mut notes.warnings);
    table.report_damaged(&mut notes.warnings);
    let frames_missing = table.n_missing(head.n_frames, &mut notes.warnings);
    if let Some(announced) = head.n_markers.filter(|&n| n != width as u64) {
        notes.warnings.push(format!(
            "NO_OF_MARKERS is {announced}, the file has columns for {width} markers."
        ));
    }
    let n_frames = table.n_frames();
    let first_frame = first_frame.unwrap_or(1);
    let mut events = head.events(first_frame, n_frames);
    events.sort_by_key(|event| event.frame);
    let positions_mm = table.into_positions(width)?;
    unit.judge(&positions_mm, width, &mut notes);
    Ok(Motion {
        positions_mm,
        info: MotionInfo {
            rate_hz: head.rate_hz,
            n_frames,
            markers: text::markers(&head.labels, width),
            up,
            source: unit.into_source("tsv", first_frame, frames_missing, notes),
            events,
            foreign: vec![Foreign { kind: HEADER.to_owned(), data: head.lines.into() }],
            ..MotionInfo::default()
        },
    })
}

/// What stands above the data.
#[derive(Default)]
struct Head {
    rate_hz: f64,
    n_frames: Option<u64>,
    n_markers: Option<u64>,
    labels: Vec<String>,
    /// Columns before the first coordinate.
    lead: usize,
    /// The column with frame numbers.
    frame_column: Option<usize>,
    n_lines: usize,
    lines: Vec<u8>,
}

impl Head {
    fn parse(bytes: &[u8]) -> Result<Self> {
        let mut head = Self::default();
        let mut rate_hz = None;
        let mut is_qtm = false;
        for (number, line) in text::lines(bytes) {
            let mut cells = Separator::TAB.cells(line);
            let first = cells.next().unwrap_or(&[]).trim_ascii();
            if !line.trim_ascii().is_empty()
                && (first.is_empty() || text::number(first).is_some())
                && is_qtm
            {
                break;
            }
            let value = cells.next().unwrap_or(&[]);
            match first {
                b"NO_OF_FRAMES" => head.n_frames = text::whole_number(value),
                b"NO_OF_MARKERS" => head.n_markers = text::whole_number(value),
                b"FREQUENCY" => rate_hz = text::rate(value),
                b"MARKER_NAMES" => head.read_labels(line),
                b"DATA_INCLUDED" if !value.trim_ascii().eq_ignore_ascii_case(b"3D") => {
                    return Err(malformed(
                        number,
                        "expected DATA_INCLUDED 3D, found other data: export 3D data",
                    ));
                }
                _ if is_column_line(line) => head.read_columns(line),
                _ => {}
            }
            is_qtm |= matches!(
                first,
                b"NO_OF_FRAMES" | b"NO_OF_MARKERS" | b"FREQUENCY" | b"MARKER_NAMES"
            );
            if !is_qtm && number >= 16 {
                break;
            }
            head.lines.extend_from_slice(line);
            head.lines.push(b'\n');
            head.n_lines = number;
        }
        if !is_qtm {
            return Err(malformed(
                1,
                "expected lines like NO_OF_FRAMES and MARKER_NAMES: not a QTM export with header",
            ));
        }
        head.rate_hz = rate_hz.ok_or_else(|| {
            malformed(1, "expected a FREQUENCY above 0, found none: add the line and try again")
        })?;
        Ok(head)
    }

    /// What lies among the frames; the rest stays in the lines that are kept.
    fn events(&self, first_frame: u64, n_frames: u64) -> Vec<MotionEvent> {
        let event = |(_, line): (usize, &[u8])| {
            let mut cells = line.strip_prefix(b"EVENT\t")?.split(|&b| b == b'\t');
            let text = text::decode(cells.next()?.trim_ascii());
            let number = cells.next().and_then(text::whole_number);
            let mut by_time = || {
                let frame = (text::number(cells.next()?)? * self.rate_hz).round();
                (frame >= 0.0).then_some(frame as u64)
            };
            let frame = match number {
                Some(number) => number.checked_sub(first_frame)?,
                None => by_time()?,
            };
            (frame < n_frames).then_some(MotionEvent { frame, kind: EventKind::Mark, text })
        };
        text::lines(&self.lines).filter_map(event).collect()
    }

    fn read_labels(&mut self, line: &[u8]) {
        let cells = Separator::TAB.cells(line).skip(1);
        let mut labels: Vec<String> = cells.map(|cell| text::decode(cell.trim_ascii())).collect();
        while labels.last().is_some_and(String::is_empty) {
            labels.pop();
        }
        self.labels = labels;
    }

    /// The columns before the first coordinate, and the labels where no `MARKER_NAMES` gave them.
    fn read_columns(&mut self, line: &[u8]) {
        let names: Vec<&[u8]> = Separator::TAB.cells(line).map(<[u8]>::trim_ascii).collect();
        self.lead = names.iter().take_while(|name| is_lead(name)).count();
        self.frame_column = names.iter().position(|name| name.eq_ignore_ascii_case(b"Frame"));
        if self.labels.is_empty() {
            let coordinates = names.iter().skip(self.lead).step_by(3);
            self.labels =
                coordinates.filter_map(|name| Some(text::decode(without_axis(name)?))).collect();
        }
    }
}

/// Columns that QTM puts before the coordinates.
fn is_lead(name: &[u8]) -> bool {
    name.eq_ignore_ascii_case(b"Frame") || name.eq_ignore_ascii_case(b"Time")
}

/// A line with the names of columns: it begins with `Frame` or `Time`, or with a name that ends in X.
fn is_column_line(line: &[u8]) -> bool {
    let mut cells = Separator::TAB.cells(line).map(<[u8]>::trim_ascii);
    let first = cells.next().unwrap_or(&[]);
    is_lead(first)
        || (without_axis(first).is_some()
            && cells.next().is_some_and(|next| without_axis(next).is_some()))
}

/// A column's name without ` X`, `_X`, ` Y`...
fn without_axis(name: &[u8]) -> Option<&[u8]> {
    let (start, [b' ' | b'_', b'X' | b'Y' | b'Z' | b'x' | b'y' | b'z']) =
        name.split_last_chunk::<2>()?
    else {
        return None;
    };
    Some(start.trim_ascii())
}

fn malformed(line: usize, message: &str) -> InterchangeError {
    InterchangeError::malformed("tsv", format!("line {line}"), message)
}

/// Writes a whole file: millimetres, LF, missing samples as zeros, as many digits as bring back the f32. The numbers
/// of the frames and their times stand before the positions when they say more than the line's place.
pub(super) fn write(frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<()> {
    let info = frames.info().clone();
    let first_frame = info.source.first_frame;
    // A line without columns would be empty, and empty lines are no frames.
    let numbered = first_frame != 1 || info.markers.is_empty();
    let mut head = Vec::new();
    write_head(&mut head, &info, numbered)?;
    let n_written = write_frames(frames, out, head, |line, index, row| {
        if numbered {
            let number = first_frame.saturating_add(index);
            write!(line, "{number}\t{}\t", index as f64 / info.rate_hz)?;
        }
        for (column, &position) in row.iter().enumerate() {
            line.extend((column > 0).then_some(b'\t'));
            put_position(line, beside_origin(position), b'\t', "0.000")?;
        }
        line.push(b'\n');
        Ok(())
    })?;
    Ok(expect_frames(info.n_frames, n_written)?)
}

fn write_head(line: &mut Vec<u8>, info: &MotionInfo, numbered: bool) -> Result<()> {
    let kept = &kept_header(info, HEADER)?[..];
    let original =
        |name: &str, else_: &str| value_of(kept, name).unwrap_or_else(|| else_.to_owned());
    writeln!(line, "NO_OF_FRAMES\t{}", info.n_frames)?;
    writeln!(line, "NO_OF_CAMERAS\t{}", original("NO_OF_CAMERAS", "0"))?;
    writeln!(line, "NO_OF_MARKERS\t{}", info.markers.len())?;
    writeln!(line, "FREQUENCY\t{}", info.rate_hz)?;
    writeln!(line, "NO_OF_ANALOG\t0\nANALOG_FREQUENCY\t0")?;
    writeln!(line, "DESCRIPTION\t{}", original("DESCRIPTION", "--"))?;
    writeln!(line, "TIME_STAMP\t{}\nDATA_INCLUDED\t3D", original("TIME_STAMP", "--"))?;
    for event in &info.events {
        let number = info.source.first_frame.saturating_add(event.frame);
        let time_s = event.frame as f64 / info.rate_hz;
        writeln!(line, "EVENT\t{}\t{number}\t{time_s}", plain(event.label()))?;
    }
    line.extend(b"MARKER_NAMES");
    let labels = column_labels(info);
    for label in &labels {
        write!(line, "\t{}", plain(label))?;
    }
    line.push(b'\n');
    if numbered {
        line.extend(b"Frame\tTime");
        for label in labels.iter().map(|label| plain(label)) {
            write!(line, "\t{label} X\t{label} Y\t{label} Z")?;
        }
        line.push(b'\n');
    }
    Ok(())
}
