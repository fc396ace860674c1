//! Bytes of a TRC file -> trajectories.

use super::HEADER;
use super::separator::Separator;
use crate::interchange::text::{self, Rows};
use crate::interchange::units::{FileUnit, Millimetres};
use crate::interchange::{InterchangeError, ReadOptions, notes::Notes, origin};
use crate::motion::{Ambiguity, Foreign, Marker, Motion, MotionInfo, Source, UpAxis};

/// Reads a whole file.
pub(crate) fn read(bytes: &[u8], options: &ReadOptions) -> Result<Motion, InterchangeError> {
    let mut notes = Notes::default();
    let head = Head::parse(bytes, &mut notes.warnings)?;
    let unit = FileUnit::of(&head.unit, options, &mut notes);
    let millimetres = Millimetres::new(unit.factor, options);
    let data = read_rows(bytes, &head, &millimetres, &mut notes.warnings);
    let warnings = &mut notes.warnings;
    if let Some(announced) = head.n_frames
        && announced != data.rows.len() as u64
    {
        warnings.push(format!("{announced} frames announced, {} present.", data.rows.len()));
    }
    let width = data.width.max(head.labels.len());
    if head.n_markers.is_some_and(|n| n > 0 && n != width as u64) {
        warnings.push(format!(
            "NumMarkers is {}, the file has columns for {width} markers.",
            head.n_markers.unwrap_or(0)
        ));
    }
    let markers: Vec<Marker> = (0..width)
        .map(|column| text::marker(head.labels.get(column).map_or("", String::as_str), column))
        .collect();
    let n_frames = data.rows.len() as u64;
    let mut positions_mm = data.rows.into_rectangle(width, bytes.len(), "trc")?;
    let samples = origin::remove(&mut positions_mm, width);
    if samples > 0 {
        notes.ambiguous(Ambiguity::Origin { samples, gaps: true });
    }
    unit.judge(&positions_mm, width, &mut notes);
    Ok(Motion {
        positions_mm,
        info: MotionInfo {
            rate_hz: head.rate_hz,
            n_frames,
            markers,
            up: options.up(UpAxis::Unknown, &mut notes),
            source: Source {
                format: "trc".to_owned(),
                unit: unit.stated,
                factor: unit.factor,
                first_frame: data.first_frame.unwrap_or(1),
                frames_missing: head.n_frames.unwrap_or(0).saturating_sub(n_frames),
                warnings: notes.warnings,
                ambiguities: notes.ambiguities,
            },
            foreign: vec![Foreign { kind: HEADER.to_owned(), data: head.lines }],
            ..MotionInfo::default()
        },
    })
}

/// What stands above the data.
struct Head {
    rate_hz: f64,
    unit: String,
    n_frames: Option<u64>,
    n_markers: Option<u64>,
    labels: Vec<String>,
    /// What stands between the cells of a line.
    separator: Separator,
    /// Number of the line with the labels.
    labels_line: usize,
    /// The lines above it, without line ends, each followed by LF.
    lines: Vec<u8>,
}

impl Head {
    fn parse(bytes: &[u8], warnings: &mut Vec<String>) -> Result<Self, InterchangeError> {
        let mut lines = text::lines(bytes);
        let mut kept = Vec::new();
        let mut values = Vec::new();
        let (labels_line, labels) = loop {
            let Some((number, line)) = lines.next() else {
                return Err(malformed(
                    "line 4",
                    "expected a line that begins with `Frame#` and `Time`, found none: not a TRC file",
                ));
            };
            if line
                .trim_ascii_start()
                .get(..6)
                .is_some_and(|start| start.eq_ignore_ascii_case(b"Frame#"))
            {
                break (number, line);
            }
            if number > 16 {
                return Err(malformed(
                    "line 1",
                    "expected `Frame#` within 16 lines: not a TRC file",
                ));
            }
            let names = kept.split(|&b| b == b'\n').nth_back(1).unwrap_or(&[]);
            if names
                .trim_ascii_start()
                .get(..8)
                .is_some_and(|start| start.eq_ignore_ascii_case(b"DataRate"))
            {
                values = cells(names).zip(cells(line)).collect();
                values = values
                    .into_iter()
                    .map(|(name, value)| (name.to_ascii_lowercase(), value))
                    .collect();
            }
            kept.extend_from_slice(line);
            kept.push(b'\n');
        };
        let value =
            |name: &str| values.iter().find(|(n, _)| n == name).map(|(_, value)| value.as_str());
        let number = |name: &str| text::number(value(name)?.as_bytes());
        let usable = |rate: &f64| rate.is_finite() && *rate > 0.0;
        let Some(rate_hz) =
            number("datarate").filter(usable).or_else(|| number("camerarate").filter(usable))
        else {
            return Err(malformed(
                "line 3",
                "expected the rate under `DataRate`, a number above 0: mend the line and try again",
            ));
        };
        let separator = Separator::of(labels);
        let count = |name: &str| text::whole_number(value(name)?.as_bytes());
        let n_markers = count("nummarkers");
        Ok(Self {
            rate_hz,
            unit: value("units").unwrap_or_default().to_owned(),
            n_frames: count("numframes"),
            n_markers,
            labels: labels_of(labels, separator, n_markers, warnings),
            separator,
            labels_line,
            lines: kept,
        })
    }
}

/// The trimmed cells of a header line.
fn cells(line: &[u8]) -> impl Iterator<Item = String> + '_ {
    Separator::of(line).cells(line).map(|cell| text::decode(cell.trim_ascii()))
}

/// The labels: every three cells, or in every cell where as many follow each other as there are markers, or where cells
/// cannot be empty.
fn labels_of(
    line: &[u8],
    separator: Separator,
    n_markers: Option<u64>,
    warnings: &mut Vec<String>,
) -> Vec<String> {
    let mut cells: Vec<String> = cells(line).skip(2).collect();
    while cells.last().is_some_and(String::is_empty) {
        cells.pop();
    }
    if separator == Separator::Spaces {
        if n_markers.is_some_and(|n| n > 0 && n != cells.len() as u64) {
            warnings.push(format!(
                "Spaces separate the {} labels of {} markers: a label with a space counts as several.",
                cells.len(),
                n_markers.unwrap_or(0)
            ));
        }
        return cells;
    }
    let between =
        cells.iter().enumerate().filter(|(index, cell)| index % 3 != 0 && !cell.is_empty()).count();
    if between == 0 {
        return cells.into_iter().step_by(3).collect();
    }
    if n_markers == Some(cells.len() as u64) {
        warnings.push("Labels stand in every column, not in every third.".to_owned());
        return cells;
    }
    cells.retain(|cell| !cell.is_empty());
    warnings.push(format!(
        "Labels do not stand in every third column; {} were taken in order.",
        cells.len()
    ));
    cells
}

/// The data as read.
#[derive(Default)]
struct Data {
    rows: Rows,
    /// Markers of the widest row.
    width: usize,
    first_frame: Option<u64>,
}

fn read_rows(
    bytes: &[u8],
    head: &Head,
    millimetres: &Millimetres,
    warnings: &mut Vec<String>,
) -> Data {
    let mut data = Data::default();
    let mut skipped = Skipped::default();
    let mut expected = None;
    for (number, line) in text::lines(bytes).skip(head.labels_line) {
        // A line without the separator of the labels has one of its own.
        let separator =
            if head.separator.is_in(line) { head.separator } else { Separator::of(line) };
        let mut cells = separator.cells(line);
        let first = cells.next().unwrap_or(&[]);
        let Some(frame) = text::whole_number(first) else {
            // The line X1 Y1 Z1... and empty lines.
            if !line.trim_ascii().is_empty()
                && !first.trim_ascii().is_empty()
                && !is_axes(separator, line)
            {
                skipped.line(number);
            }
            continue;
        };
        if expected.is_some_and(|expected| expected != frame) {
            skipped.jumps += 1;
        }
        expected = Some(frame.saturating_add(1));
        data.first_frame.get_or_insert(frame);
        cells.next();
        let columns = data
            .rows
            .read_row(&mut cells, &mut skipped.cells, |stored| millimetres.position(stored));
        data.width = data.width.max(columns);
    }
    skipped.report(warnings);
    millimetres.report(warnings);
    data
}

/// Whether a line holds nothing but `X1 Y1 Z1 X2...`, three cells at least.
fn is_axes(separator: Separator, line: &[u8]) -> bool {
    let is_axis = |cell: &[u8]| match cell.trim_ascii().split_first() {
        Some((axis, number)) => b"XYZxyz".contains(axis) && number.iter().all(u8::is_ascii_digit),
        None => true,
    };
    separator.cells(line).nth(2).is_some() && separator.cells(line).all(is_axis)
}

/// What could not be read.
#[derive(Default)]
struct Skipped {
    first_line: usize,
    lines: usize,
    cells: usize,
    jumps: usize,
}

impl Skipped {
    fn line(&mut self, number: usize) {
        if self.lines == 0 {
            self.first_line = number;
        }
        self.lines += 1;
    }

    fn report(&self, warnings: &mut Vec<String>) {
        if self.lines > 0 {
            warnings.push(format!(
                "{} lines do not begin with a frame number and were left out, the first is line {}.",
                self.lines, self.first_line
            ));
        }
        if self.cells > 0 {
            warnings.push(format!(
                "{} samples have cells that are not numbers; they are gaps.",
                self.cells
            ));
        }
        if self.jumps > 0 {
            warnings.push(format!(
                "Frame numbers do not rise by one in {} places; lines were taken as successive frames.",
                self.jumps
            ));
        }
    }
}

fn malformed(place: &str, message: &str) -> InterchangeError {
    InterchangeError::Malformed {
        format: "trc",
        place: place.to_owned(),
        message: message.to_owned(),
    }
}
