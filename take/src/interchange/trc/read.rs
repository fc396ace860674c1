//! Bytes of a TRC file -> trajectories.

use super::HEADER;
use super::rows::read_rows;
use super::separator::Separator;
use crate::interchange::text;
use crate::interchange::units::{FileUnit, Millimetres};
use crate::interchange::{InterchangeError, ReadOptions, notes::Notes, origin};
use crate::motion::{Ambiguity, Foreign, Marker, Motion, MotionInfo, Source, UpAxis};

/// Reads a whole file.
pub(crate) fn read(bytes: &[u8], options: &ReadOptions) -> Result<Motion, InterchangeError> {
    let mut notes = Notes::default();
    let head = Head::parse(bytes, &mut notes.warnings)?;
    let unit = FileUnit::of(&head.unit, options, &mut notes);
    let millimetres = Millimetres::new(unit.factor, options);
    let mut data = read_rows(bytes, &head, &millimetres, &mut notes.warnings)?;
    let warnings = &mut notes.warnings;
    let frames_max = text::frames_max(bytes.len(), data.width);
    let placed = data.lines.place(Some(head.rate_hz), frames_max, warnings);
    data.rows.put_empty(&placed.missing_before);
    if let Some(announced) = head.n_frames
        && announced != data.rows.len() as u64
    {
        warnings.push(format!("{announced} frames announced, {} present.", data.rows.len()));
    }
    // A label with a space in it counts as several where spaces separate them.
    let n_labels = match (data.separator, head.n_markers) {
        (Separator::Byte(_), Some(n)) if n > 0 => usize::try_from(n).unwrap_or(usize::MAX),
        _ => data.width,
    };
    let mut labels = head.labels;
    if head.separator == Separator::Spaces && !labels.is_empty() && labels.len() != n_labels {
        warnings.push(format!(
            "Spaces separate {} labels of {n_labels} markers: which is whose is not known, and markers are numbered.",
            labels.len()
        ));
        labels.clear();
    }
    let width = data.width.max(labels.len());
    if head.n_markers.is_some_and(|n| n > 0 && n != width as u64) {
        warnings.push(format!(
            "NumMarkers is {}, the file has columns for {width} markers.",
            head.n_markers.unwrap_or(0)
        ));
    }
    let markers: Vec<Marker> = (0..width)
        .map(|column| text::marker(labels.get(column).map_or("", String::as_str), column))
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
                first_frame: data.lines.first().unwrap_or(1),
                frames_missing: head.n_frames.unwrap_or(0).saturating_sub(n_frames),
                warnings: notes.warnings,
                ambiguities: notes.ambiguities,
            },
            foreign: vec![Foreign { kind: HEADER.to_owned(), data: head.lines.into() }],
            ..MotionInfo::default()
        },
    })
}

/// What stands above the data.
pub(super) struct Head {
    rate_hz: f64,
    unit: String,
    n_frames: Option<u64>,
    pub(super) n_markers: Option<u64>,
    pub(super) labels: Vec<String>,
    /// What stands between the labels.
    pub(super) separator: Separator,
    /// Number of the line with the labels.
    pub(super) labels_line: usize,
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

pub(super) fn malformed(place: &str, message: &str) -> InterchangeError {
    InterchangeError::Malformed {
        format: "trc",
        place: place.to_owned(),
        message: message.to_owned(),
    }
}
