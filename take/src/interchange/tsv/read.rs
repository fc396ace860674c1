//! A QTM text export -> trajectories.

use super::HEADER;
use crate::interchange::text::{self, Rows};
use crate::interchange::units::{FileUnit, Millimetres};
use crate::interchange::{InterchangeError, ReadOptions, notes::Notes};
use crate::motion::{
    Foreign, GAP, Marker, Motion, MotionEvent, MotionInfo, Position, Source, UpAxis,
};
use crate::record::EventKind;

/// Reads a whole file.
pub(crate) fn read(bytes: &[u8], options: &ReadOptions) -> Result<Motion, InterchangeError> {
    let mut notes = Notes::default();
    let head = Head::parse(bytes)?;
    let mut rows = Rows::default();
    let mut width = head.labels.len();
    let mut damaged = 0usize;
    let unit = FileUnit::of("mm", options, &mut notes);
    let millimetres = Millimetres::new(unit.factor, options);
    let mut first_frame = None;
    for (_, line) in text::lines(bytes).skip(head.n_lines) {
        if line.trim_ascii().is_empty() {
            continue;
        }
        let mut cells = line.split(|&b| b == b'\t');
        for column in 0..head.lead {
            let cell = cells.next().unwrap_or(&[]);
            if Some(column) == head.frame_column {
                first_frame = first_frame.or_else(|| text::whole_number(cell));
            }
        }
        width = width
            .max(rows.read_row(&mut cells, &mut damaged, |stored| position(stored, &millimetres)));
    }
    let up = options.up(UpAxis::Unknown, &mut notes);
    let Notes { mut warnings, ambiguities } = notes;
    millimetres.report(&mut warnings);
    if damaged > 0 {
        warnings.push(format!("{damaged} samples have cells that are not numbers; they are gaps."));
    }
    let n_frames = rows.len() as u64;
    if let Some(announced) = head.n_frames.filter(|&n| n != n_frames) {
        warnings.push(format!("{announced} frames announced, {n_frames} present."));
    }
    if let Some(announced) = head.n_markers.filter(|&n| n != width as u64) {
        warnings.push(format!(
            "NO_OF_MARKERS is {announced}, the file has columns for {width} markers."
        ));
    }
    let markers: Vec<Marker> = (0..width)
        .map(|column| text::marker(head.labels.get(column).map_or("", String::as_str), column))
        .collect();
    let first_frame = first_frame.unwrap_or(1);
    let mut events = head.events(first_frame, n_frames);
    events.sort_by_key(|event| event.frame);
    let positions_mm = rows.into_rectangle(width, bytes.len(), "tsv")?;
    let mut notes = Notes { warnings, ambiguities };
    unit.judge(&positions_mm, width, &mut notes);
    Ok(Motion {
        positions_mm,
        info: MotionInfo {
            rate_hz: head.rate_hz,
            n_frames,
            markers,
            up,
            source: Source {
                format: "tsv".to_owned(),
                unit: unit.stated,
                factor: unit.factor,
                first_frame,
                frames_missing: head.n_frames.unwrap_or(0).saturating_sub(n_frames),
                warnings: notes.warnings,
                ambiguities: notes.ambiguities,
            },
            events,
            foreign: vec![Foreign { kind: HEADER.to_owned(), data: head.lines.into() }],
            ..MotionInfo::default()
        },
    })
}

/// A position as exported: zeros where it is missing.
fn position(stored: [f64; 3], millimetres: &Millimetres) -> Position {
    if stored == [0.0; 3] { GAP } else { millimetres.position(stored) }
}

/// What stands above the data.
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
    fn parse(bytes: &[u8]) -> Result<Self, InterchangeError> {
        let mut head = Self {
            rate_hz: 0.0,
            n_frames: None,
            n_markers: None,
            labels: Vec::new(),
            lead: 0,
            frame_column: None,
            n_lines: 0,
            lines: Vec::new(),
        };
        let mut is_qtm = false;
        for (number, line) in text::lines(bytes) {
            let mut cells = line.split(|&b| b == b'\t');
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
                b"FREQUENCY" => head.rate_hz = text::number(value).unwrap_or(0.0),
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
        if !(head.rate_hz.is_finite() && head.rate_hz > 0.0) {
            return Err(malformed(
                1,
                "expected a FREQUENCY above 0, found none: add the line and try again",
            ));
        }
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
        let mut labels: Vec<String> = line
            .split(|&b| b == b'\t')
            .skip(1)
            .map(|cell| text::decode(cell.trim_ascii()))
            .collect();
        while labels.last().is_some_and(String::is_empty) {
            labels.pop();
        }
        self.labels = labels;
    }

    /// The columns before the first coordinate, and the labels where no `MARKER_NAMES` gave them.
    fn read_columns(&mut self, line: &[u8]) {
        let names: Vec<&[u8]> = line.split(|&b| b == b'\t').map(<[u8]>::trim_ascii).collect();
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
    let mut cells = line.split(|&b| b == b'\t').map(<[u8]>::trim_ascii);
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
    InterchangeError::Malformed {
        format: "tsv",
        place: format!("line {line}"),
        message: message.to_owned(),
    }
}
