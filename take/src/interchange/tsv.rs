//! The text export of 3D data from Qualisys Track Manager (QTM).
//!
//! The header has lines of a name, a tab and a value and ends with `MARKER_NAMES` (QTM manual, "Motion data (.tsv)",
//! docs.qualisys.com). A line with trajectory types and a line with column names (`Frame`, `Time`, `Head_FL X` or
//! `Head_FL_X`) may follow, then one line for each frame, in millimetres.
//! The format has no mark for a missing sample; QTM writes zeros. Therefore `0 0 0`, empty cells and cells that are not
//! finite numbers are gaps.

use std::io::Write;

use super::{
    InterchangeError, ReadOptions, Result, check_frame_count,
    origin::off_origin,
    put_position,
    source_file::{Line, TextFile},
    table::Table,
    text::{
        self, AtOrigin, Separator, TextFrames, column_labels, kept_header, value_of, without_tabs,
    },
    units::{FileUnit, ToMillimetres},
    write_frames,
};
use crate::{
    foreign::content::NewScratch,
    motion::{Foreign, FrameSource, MotionEvent, MotionInfo, Notes, UpAxis},
    record::EventKind,
};

/// Kind of the foreign part with the header: all lines above the data, each followed by LF.
const HEADER: &str = "tsv/header";

/// Names that only QTM's header has.
const QTM_NAMES: [&[u8]; 4] = [b"NO_OF_FRAMES", b"NO_OF_MARKERS", b"FREQUENCY", b"MARKER_NAMES"];

/// Reads everything but the frames, and prepares to deliver those.
pub(super) fn open(
    file: &mut TextFile<'_, '_>,
    options: &ReadOptions,
    new_scratch: NewScratch<'_>,
) -> Result<(MotionInfo, TextFrames)> {
    let mut notes = Notes::default();
    file.use_decimal_points(&[b"FREQUENCY"])?;
    let header = TsvHeader::parse(file)?;
    let unit = FileUnit::resolve("mm", options.unit, &mut notes);
    let millimetres = ToMillimetres::new(unit.factor, options.rotation());
    let mut table = Table::new("tsv", new_scratch, millimetres).with_zeros_as_gaps();
    let mut width = header.labels.len();
    let mut first_frame = None;
    let mut lines = file.lines_below(header.n_lines)?;
    while let Some(Line { bytes: line, .. }) = lines.next()? {
        if line.trim_ascii().is_empty() {
            continue;
        }
        let mut cells = Separator::TAB.cells(line);
        for column in 0..header.lead_columns {
            let cell = cells.next().unwrap_or(&[]);
            if Some(column) == header.frame_column {
                first_frame = first_frame.or_else(|| text::whole_number(cell));
            }
        }
        width = width.max(table.read_samples(&mut cells));
        table.end_row()?;
    }
    table.end(lines.n_bytes());
    if let Some((line, cell)) = header.unread.as_ref().filter(|_| table.n_frames() == 0) {
        let message =
            format!("expected a row of numbers, found `{cell}`: correct the row and import again");
        return Err(malformed(*line, &message));
    }
    let up = options.up(UpAxis::Unknown, &mut notes);
    table.report_not_finite(&mut notes.warnings);
    table.report_damaged(&mut notes.warnings);
    let frames_missing = table.count_missing(header.n_frames, &mut notes.warnings);
    if let Some(announced) = header.n_markers.filter(|&n| n != width as u64) {
        notes.warnings.push(format!(
            "NO_OF_MARKERS is {announced}, but the file has columns for {width} markers."
        ));
    }
    let n_frames = table.n_frames();
    let first_frame = first_frame.unwrap_or(1);
    let mut events = header.events(first_frame, n_frames);
    events.sort_by_key(|event| event.frame);
    let mut frames = table.into_frames(width)?;
    frames.examine(&unit, AtOrigin::Positions, &mut notes)?;
    let info = MotionInfo {
        rate_hz: header.rate_hz,
        n_frames,
        markers: text::markers(&header.labels, width),
        up,
        source: unit.into_source("tsv", first_frame, frames_missing, notes),
        events,
        foreign: vec![Foreign::exact(HEADER, header.lines)],
        ..MotionInfo::default()
    };
    Ok((info, frames))
}

/// The lines above the data.
#[derive(Default)]
struct TsvHeader {
    rate_hz: f64,
    n_frames: Option<u64>,
    n_markers: Option<u64>,
    labels: Vec<String>,
    /// Number of columns before the first coordinate.
    lead_columns: usize,
    /// Index of the column with frame numbers.
    frame_column: Option<usize>,
    n_lines: usize,
    lines: Vec<u8>,
    /// The first line below the names of markers that is neither a row nor names of columns, and its number.
    unread: Option<(usize, String)>,
}

impl TsvHeader {
    fn parse(file: &mut TextFile<'_, '_>) -> Result<Self> {
        let mut header = Self::default();
        let mut rate_hz = None;
        let mut is_qtm = false;
        let mut lines = file.lines();
        while let Some(Line { number, bytes: line, .. }) = lines.next()? {
            let (first, value) = first_cells(line);
            let is_data = first.is_empty() || text::number(first).is_some();
            if is_qtm && is_data && !line.trim_ascii().is_empty() {
                break;
            }
            match first {
                b"NO_OF_FRAMES" => header.n_frames = text::whole_number(value),
                b"NO_OF_MARKERS" => header.n_markers = text::whole_number(value),
                b"FREQUENCY" => rate_hz = text::rate(value),
                b"MARKER_NAMES" => header.read_labels(line),
                b"DATA_INCLUDED" if !value.trim_ascii().eq_ignore_ascii_case(b"3D") => {
                    return Err(malformed(
                        number,
                        "expected DATA_INCLUDED 3D, found other data: export 3D data from QTM",
                    ));
                }
                _ if is_column_line(line) => header.read_columns(line),
                _ if !header.labels.is_empty() && !is_of_types(line) => {
                    let cell = || (number, text::shortened(&text::decode(first)));
                    header.unread.get_or_insert_with(cell);
                }
                _ => {}
            }
            is_qtm |= QTM_NAMES.contains(&first);
            if !is_qtm && number >= 16 {
                break;
            }
            header.lines.extend_from_slice(line);
            header.lines.push(b'\n');
            header.n_lines = number;
            lines.check_header()?;
        }
        if !is_qtm {
            return Err(malformed(
                1,
                "expected lines such as NO_OF_FRAMES and MARKER_NAMES: not a QTM export with a header",
            ));
        }
        header.rate_hz = rate_hz.ok_or_else(|| {
            malformed(1, "expected a FREQUENCY above 0, found none: add the line and import again")
        })?;
        Ok(header)
    }

    /// The events within the frames of the file. Others remain in the kept header only.
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

    /// Reads the line of column names: the lead columns, and the labels if there is no `MARKER_NAMES`.
    fn read_columns(&mut self, line: &[u8]) {
        let names: Vec<&[u8]> = Separator::TAB.cells(line).map(<[u8]>::trim_ascii).collect();
        self.lead_columns = names.iter().take_while(|name| is_lead_column(name)).count();
        self.frame_column = names.iter().position(|name| name.eq_ignore_ascii_case(b"Frame"));
        if self.labels.is_empty() {
            let columns = names.iter().skip(self.lead_columns).step_by(3);
            self.labels = columns.filter_map(|name| without_axis(name)).map(text::decode).collect();
        }
    }
}

/// The first cell of a line, trimmed, and the second.
fn first_cells(line: &[u8]) -> (&[u8], &[u8]) {
    let mut cells = Separator::TAB.cells(line);
    (cells.next().unwrap_or(&[]).trim_ascii(), cells.next().unwrap_or(&[]))
}

/// Whether a column is one of those that QTM puts before the coordinates.
fn is_lead_column(name: &[u8]) -> bool {
    name.eq_ignore_ascii_case(b"Frame") || name.eq_ignore_ascii_case(b"Time")
}

/// Whether a line has column names: it begins with `Frame` or `Time`, or with two names that end in an axis.
fn is_column_line(line: &[u8]) -> bool {
    let mut cells = Separator::TAB.cells(line).map(<[u8]>::trim_ascii);
    let first = cells.next().unwrap_or(&[]);
    is_lead_column(first)
        || (without_axis(first).is_some()
            && cells.next().is_some_and(|next| without_axis(next).is_some()))
}

/// Whether a line has the types of the trajectories, which QTM writes below the names of markers.
fn is_of_types(line: &[u8]) -> bool {
    line.starts_with(b"TRAJECTORY_TYPES") || line.trim_ascii().is_empty()
}

/// A column name without its ending ` X`, `_X`, ` Y`...; `None` if it has none.
fn without_axis(name: &[u8]) -> Option<&[u8]> {
    match name.split_last_chunk::<2>()? {
        (start, [b' ' | b'_', b'X' | b'Y' | b'Z' | b'x' | b'y' | b'z']) => Some(start.trim_ascii()),
        _ => None,
    }
}

fn malformed(line: usize, message: &str) -> InterchangeError {
    InterchangeError::malformed("tsv", &format!("line {line}"), message)
}

/// Writes a whole file: millimetres, LF line ends, missing samples as zeros, numbers with the digits that restore the
/// f32. The columns `Frame` and `Time` are written only if the first frame is not number 1.
pub(super) fn write(frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<()> {
    let info = frames.info().clone();
    let first_frame = info.source.first_frame;
    // Without markers, rows need the frame numbers: readers skip empty lines.
    let numbered = first_frame != 1 || info.markers.is_empty();
    let mut header = Vec::new();
    write_header(&mut header, &info, numbered)?;
    let n_written = write_frames(frames, out, header, |line, index, row| {
        if numbered {
            let number = first_frame.saturating_add(index);
            write!(line, "{number}\t{}\t", index as f64 / info.rate_hz)?;
        }
        for (column, &position) in row.iter().enumerate() {
            line.extend((column > 0).then_some(b'\t'));
            put_position(line, off_origin(position), b'\t', "0.000")?;
        }
        line.push(b'\n');
        Ok(())
    })?;
    Ok(check_frame_count(info.n_frames, n_written)?)
}

fn write_header(line: &mut Vec<u8>, info: &MotionInfo, numbered: bool) -> Result<()> {
    let kept = &kept_header(info, HEADER)?[..];
    let original = |name: &str, or: &str| value_of(kept, name).unwrap_or_else(|| or.to_owned());
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
        writeln!(line, "EVENT\t{}\t{number}\t{time_s}", without_tabs(event.label()))?;
    }
    line.extend(b"MARKER_NAMES");
    let labels = column_labels(info);
    for label in &labels {
        write!(line, "\t{}", without_tabs(label))?;
    }
    line.push(b'\n');
    if numbered {
        line.extend(b"Frame\tTime");
        for label in labels.iter().map(|label| without_tabs(label)) {
            write!(line, "\t{label} X\t{label} Y\t{label} Z")?;
        }
        line.push(b'\n');
    }
    Ok(())
}
