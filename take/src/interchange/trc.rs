//! Track Row Column (TRC), the text format of Motion Analysis that `OpenSim` and Cortex read and write.
//!
//! Three header lines (path, names, values) are followed by a line with `Frame#`, `Time` and a label in every third
//! column, a line `X1 Y1 Z1 X2 ...`, in some files an empty line, and one line for each frame. Tabs separate the cells;
//! some scripts write commas or spaces.
//! A file of unlabelled points has no labels, its `NumMarkers` is 0 and its rows differ in length.

use std::io::Write;

use super::{
    InterchangeError, ReadOptions, Result, check_frame_count, counted,
    origin::off_origin,
    put_position,
    source_file::{Line, TextFile},
    table::{CUT_OFF, Table},
    text::{self, AtOrigin, Separator, TextFrames, column_labels, without_tabs},
    units::{FileUnit, ToMillimetres},
    write_frames,
};
use crate::{
    foreign::content::NewScratch,
    motion::{Foreign, FrameSource, MotionInfo, Notes, UpAxis},
};

/// Kind of the foreign part with the header lines: the lines above the labels, unchanged.
const HEADER: &str = "trc/header";

/// Number of cells before the first coordinate: frame number and time.
const LEAD_CELLS: usize = 2;

/// The line of labels must be within this many lines.
const HEADER_LINES_MAX: usize = 16;

/// Reads everything but the frames, and prepares to deliver those.
pub(super) fn open(
    file: &mut TextFile<'_, '_>,
    options: &ReadOptions,
    new_scratch: NewScratch<'_>,
) -> Result<(MotionInfo, TextFrames)> {
    let mut notes = Notes::default();
    file.use_decimal_points(&[])?;
    let header = TrcHeader::parse(file, &mut notes.warnings)?;
    let unit = FileUnit::resolve(&header.unit, options.unit, &mut notes);
    let millimetres = ToMillimetres::new(unit.factor, options.rotation());
    let mut table = Table::new("trc", new_scratch, millimetres);
    let warnings = &mut notes.warnings;
    let separator = separator_of_rows(file, &header)?;
    let width = read_rows(&mut table, file, &header, separator, warnings)?;
    table.place(Some(header.rate_hz), width, warnings);
    let frames_missing = table.count_missing(header.n_frames, warnings);
    // A label with a space in it counts as several if spaces are the separator.
    let n_labels = match (separator, header.n_markers) {
        (Separator::Byte(_), Some(n)) if n > 0 => usize::try_from(n).unwrap_or(usize::MAX),
        _ => width,
    };
    let mut labels = header.labels;
    if header.separator == Separator::Spaces && !labels.is_empty() && labels.len() != n_labels {
        warnings.push(format!(
            "{} labels separated by spaces for {n_labels} markers; the labels were ignored, as they cannot be matched.",
            labels.len()
        ));
        labels.clear();
    }
    let width = width.max(labels.len());
    if let Some(n) = header.n_markers.filter(|&n| n > 0 && n != width as u64) {
        warnings.push(format!("NumMarkers is {n}, but the file has columns for {width} markers."));
    }
    let first_frame = table.first_frame().unwrap_or(1);
    let n_frames = table.n_frames();
    let mut frames = table.into_frames(width)?;
    frames.examine(&unit, AtOrigin::Missing, &mut notes)?;
    let info = MotionInfo {
        rate_hz: header.rate_hz,
        n_frames,
        markers: text::markers(&labels, width),
        up: options.up(UpAxis::Unknown, &mut notes),
        source: unit.into_source("trc", first_frame, frames_missing, notes),
        foreign: vec![Foreign::exact(HEADER, header.lines)],
        ..MotionInfo::default()
    };
    Ok((info, frames))
}

/// The header lines and the labels.
struct TrcHeader {
    rate_hz: f64,
    unit: String,
    n_frames: Option<u64>,
    n_markers: Option<u64>,
    labels: Vec<String>,
    /// The separator of the labels.
    separator: Separator,
    /// Number of the line of labels.
    labels_line: usize,
    /// The lines above the labels, each followed by LF.
    lines: Vec<u8>,
}

impl TrcHeader {
    fn parse(file: &mut TextFile<'_, '_>, warnings: &mut Vec<String>) -> Result<Self> {
        let begins_with = |line: &[u8], name: &[u8]| {
            let start = line.trim_ascii_start().get(..name.len());
            start.is_some_and(|start| start.eq_ignore_ascii_case(name))
        };
        let mut lines = file.lines();
        let mut kept = Vec::new();
        let mut values: Vec<(String, String)> = Vec::new();
        let (labels_line, labels) = loop {
            lines.check_header()?;
            let Some(Line { number, bytes: line, .. }) = lines.next()? else {
                return Err(malformed(
                    "line 4",
                    "expected a line that begins with `Frame#` and `Time`, found none: not a TRC file",
                ));
            };
            if begins_with(line, b"Frame#") {
                break (number, line.to_vec());
            }
            if number > HEADER_LINES_MAX {
                return Err(malformed(
                    "line 1",
                    "expected `Frame#` within 16 lines: not a TRC file",
                ));
            }
            let names = kept.split(|&b| b == b'\n').nth_back(1).unwrap_or(&[]);
            if begins_with(names, b"DataRate") {
                let names = cells(names).map(|name| name.to_ascii_lowercase());
                values = names.zip(cells(line)).collect();
            }
            kept.extend_from_slice(line);
            kept.push(b'\n');
        };
        let value = |name: &str| Some(values.iter().find(|(n, _)| n == name)?.1.as_str());
        let rate = |name: &str| text::rate(value(name)?.as_bytes());
        let Some(rate_hz) = rate("datarate").or_else(|| rate("camerarate")) else {
            return Err(malformed(
                "line 3",
                "expected a rate above 0 under `DataRate`: correct the line and import again",
            ));
        };
        let separator = Separator::of(&labels);
        let count = |name: &str| text::whole_number(value(name)?.as_bytes());
        let n_markers = count("nummarkers");
        Ok(Self {
            rate_hz,
            unit: value("units").unwrap_or_default().to_owned(),
            n_frames: count("numframes"),
            n_markers,
            labels: labels_of(&labels, separator, n_markers, warnings),
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

/// The labels: the first of every three cells. All non-empty cells if there are as many cells as markers, if other
/// cells are not empty, or if the separator is spaces, which leave no cell empty.
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
    let is_between = |(index, cell): (usize, &String)| index % 3 != 0 && !cell.is_empty();
    if !cells.iter().enumerate().any(is_between) {
        return cells.into_iter().step_by(3).collect();
    }
    if n_markers == Some(cells.len() as u64) {
        warnings.push("Labels are in every column instead of every third.".to_owned());
        return cells;
    }
    cells.retain(|cell| !cell.is_empty());
    let labels = counted(cells.len() as u64, "label");
    warnings.push(format!("Not in every third column, read in order: {labels}."));
    cells
}

fn malformed(place: &str, message: &str) -> InterchangeError {
    InterchangeError::malformed("trc", place, message)
}

/// Lines or rows with a defect.
#[derive(Default)]
struct Defects {
    n: u64,
    first: usize,
}

impl Defects {
    fn add(&mut self, line: usize) {
        if self.n == 0 {
            self.first = line;
        }
        self.n += 1;
    }

    fn report(&self, defect: &str, what: &str, warnings: &mut Vec<String>) {
        if self.n > 0 {
            let (found, first) = (counted(self.n, what), self.first);
            warnings.push(format!("{defect}: {found}, first line {first}."));
        }
    }
}

/// Reads all lines below the labels. Returns the number of markers in the widest row.
fn read_rows(
    table: &mut Table<'_>,
    file: &mut TextFile<'_, '_>,
    header: &TrcHeader,
    separator: Separator,
    warnings: &mut Vec<String>,
) -> Result<usize> {
    let exact_width = match separator {
        Separator::Byte(_) => None,
        Separator::Spaces => exact_width(file, header)?,
    };
    let mut width = exact_width.unwrap_or(0);
    let (mut skipped_lines, mut skipped_rows) = (Defects::default(), Defects::default());
    let mut n_cells = 0;
    let mut lines = file.lines_below(header.labels_line)?;
    while let Some(Line { number: at, bytes: line, .. }) = lines.next()? {
        if frame_number(line, separator).is_none() {
            // Skips the line X1 Y1 Z1... and empty lines without a warning.
            let own = Separator::of(line);
            let is_empty = own.cells(line).next().is_none_or(|cell| cell.trim_ascii().is_empty());
            if !is_empty && !is_axes(own, line) {
                skipped_lines.add(at);
            }
            continue;
        }
        n_cells = 0;
        let mut cells = separator.cells(line).inspect(|_| n_cells += 1);
        table.begin_row(cells.next().unwrap_or(&[]), cells.next().unwrap_or(&[]));
        if is_aligned(line, separator, exact_width) {
            width = width.max(table.read_samples(&mut cells));
        } else {
            skipped_rows.add(at);
            cells.for_each(drop);
        }
        table.end_row()?;
    }
    let is_open = lines.is_open();
    table.end(lines.n_bytes());
    let is_row_open = is_open && n_cells > LEAD_CELLS;
    if is_row_open && file.ends_mid_number(header.labels_line, separator)? {
        table.drop_truncated((n_cells - LEAD_CELLS - 1) / 3);
        warnings.push(CUT_OFF.to_owned());
    }
    skipped_lines.report("Without a frame number, left out", "line", warnings);
    let defect = "With a wrong number of cells or another separator, read as gaps";
    skipped_rows.report(defect, "row", warnings);
    table.report_damaged(warnings);
    table.report_not_finite(warnings);
    Ok(width)
}

/// The frame number that a row begins with, also if the row has another separator; `None` for lines that are not
/// rows.
fn frame_number(line: &[u8], separator: Separator) -> Option<u64> {
    let of = |separator: Separator| text::whole_number(separator.cells(line).next()?);
    of(separator).or_else(|| of(Separator::of(line)))
}

/// The separator of all rows: that of the labels if any row has it, otherwise that of the first row. Below labels
/// between spaces, that of the first row.
fn separator_of_rows(file: &mut TextFile<'_, '_>, header: &TrcHeader) -> Result<Separator> {
    let of_labels = header.separator;
    let mut first = None;
    let mut lines = file.lines_below(header.labels_line)?;
    while let Some(Line { bytes: line, .. }) = lines.next()? {
        let own = Separator::of(line);
        if frame_number(line, own).is_none() {
            continue;
        }
        if of_labels == Separator::Spaces {
            return Ok(own);
        }
        if of_labels.is_in(line) {
            return Ok(of_labels);
        }
        first.get_or_insert(own);
    }
    Ok(first.unwrap_or(of_labels))
}

/// The number of markers that a complete row between spaces has. Such a row cannot have empty cells: if a marker is
/// missing, the row is shorter and does not show which one. The number comes from `NumMarkers` or the labels, whichever
/// more rows agree with. `None` if the file states neither: rows of unlabelled points differ in length.
///
/// # Errors
/// `Malformed` if no row agrees with either number.
fn exact_width(file: &mut TextFile<'_, '_>, header: &TrcHeader) -> Result<Option<usize>> {
    let announced = header.n_markers.and_then(|n| usize::try_from(n).ok()).filter(|&n| n > 0);
    let labelled = Some(header.labels.len()).filter(|&n| n > 0);
    let (mut n_rows, mut by_number, mut by_labels) = (0_usize, 0_usize, 0_usize);
    let mut lines = file.lines_below(header.labels_line)?;
    while let Some(Line { bytes: line, .. }) = lines.next()? {
        if frame_number(line, Separator::Spaces).is_some() {
            n_rows += 1;
            let width = width_of(line);
            by_number += usize::from(width.is_some() && width == announced);
            by_labels += usize::from(width.is_some() && width == labelled);
        }
    }
    let preferred = if by_labels > by_number { labelled } else { announced.or(labelled) };
    let Some(width) = preferred else { return Ok(None) };
    if n_rows > 0 && by_number.max(by_labels) == 0 {
        let message = format!(
            "expected rows of {} cells (frame, time, and three for each of {width} markers), found none: cells \
             separated by spaces cannot be empty, so missing markers cannot be identified; separate them with tabs",
            width.saturating_mul(3).saturating_add(LEAD_CELLS)
        );
        return Err(malformed("data", &message));
    }
    Ok(Some(width))
}

/// The number of markers in a row between spaces; `None` if the row ends within a marker.
fn width_of(line: &[u8]) -> Option<usize> {
    let n_cells = Separator::Spaces.cells(line).count().checked_sub(LEAD_CELLS)?;
    n_cells.is_multiple_of(3).then_some(n_cells / 3)
}

/// Whether the cells of a row can be assigned to markers.
fn is_aligned(line: &[u8], separator: Separator, exact_width: Option<usize>) -> bool {
    match separator {
        Separator::Spaces => width_of(line).is_some_and(|n| exact_width.unwrap_or(n) == n),
        // A row of a frame number alone has no separator: it is a frame without positions.
        Separator::Byte(_) => separator.is_in(line) || text::whole_number(line).is_some(),
    }
}

/// Whether a line is the line of axes `X1 Y1 Z1 X2...`, with at least three cells.
fn is_axes(separator: Separator, line: &[u8]) -> bool {
    let is_axis = |cell: &[u8]| match cell.trim_ascii().split_first() {
        Some((axis, number)) => b"XYZxyz".contains(axis) && number.iter().all(u8::is_ascii_digit),
        None => true,
    };
    separator.cells(line).nth(2).is_some() && separator.cells(line).all(is_axis)
}

/// Writes a whole file in `OpenSim`'s dialect: millimetres, LF line ends, missing samples as empty cells, numbers with
/// the digits that restore the f32.
///
/// Lines end in a tab, as `OpenSim` writes them. Its reader ignores an empty cell after the last tab, so without that
/// tab a row whose last sample is missing would lack a cell.
pub(super) fn write(frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<()> {
    let info = frames.info().clone();
    let first_frame = info.source.first_frame.max(1);
    let mut header = Vec::new();
    write_header(&mut header, &info, first_frame)?;
    let n_written = write_frames(frames, out, header, |line, index, row| {
        write!(line, "{}\t{}\t", first_frame + index, index as f64 / info.rate_hz)?;
        for &position in row {
            put_position(line, off_origin(position), b'\t', "")?;
            line.push(b'\t');
        }
        line.push(b'\n');
        Ok(())
    })?;
    Ok(check_frame_count(info.n_frames, n_written)?)
}

fn write_header(line: &mut Vec<u8>, info: &MotionInfo, first_frame: u64) -> Result<()> {
    let n_markers = info.markers.len();
    let kept = &text::kept_header(info, HEADER)?[..];
    let path = text::lines(kept).find(|(_, line)| line.starts_with(b"PathFileType"));
    line.extend(path.map_or(&b"PathFileType\t4\t(X/Y/Z)\tmocapd.trc"[..], |(_, path)| path));
    let original = |name: &str| original_value(kept, name);
    let camera_rate = original("CameraRate").unwrap_or_else(|| info.rate_hz.to_string());
    let original_rate = original("OrigDataRate").unwrap_or_else(|| info.rate_hz.to_string());
    let original_first = original("OrigDataStartFrame").unwrap_or_else(|| first_frame.to_string());
    let original_frames = original("OrigNumFrames").unwrap_or_else(|| info.n_frames.to_string());
    write!(
        line,
        "\nDataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n\
         {}\t{camera_rate}\t{}\t{n_markers}\tmm\t{original_rate}\t{original_first}\t{original_frames}\nFrame#\tTime\t",
        info.rate_hz, info.n_frames
    )?;
    // OpenSim's tables need unique labels that are not empty.
    for label in column_labels(info) {
        write!(line, "{}\t\t\t", without_tabs(&label))?;
    }
    line.extend(b"\n\t\t");
    for column in 1..=n_markers {
        write!(line, "X{column}\tY{column}\tZ{column}\t")?;
    }
    line.extend(b"\n\n");
    Ok(())
}

/// A value of the imported file's header, found by its name in the lines of names and values.
fn original_value(kept: &[u8], name: &str) -> Option<String> {
    let mut lines = text::lines(kept).map(|(_, line)| line);
    let names = lines.find(|line| line.starts_with(b"DataRate"))?;
    let values = lines.next()?;
    let column =
        names.split(|&b| b == b'\t').position(|cell| cell.trim_ascii() == name.as_bytes())?;
    let value = text::decode(values.split(|&b| b == b'\t').nth(column)?.trim_ascii());
    (!value.is_empty()).then_some(value)
}
