//! The CSV export of `OptiTrack` Motive, format versions 1.2 and later.
//!
//! The first line has names and values, such as `Format Version,1.23,...,Length Units,Meters,...`, and an empty line
//! follows. The next lines describe the columns: type (`Marker`, `Rigid Body`, `Rigid Body Marker`, `Bone`...), name,
//! ID, in later versions parent, and property (`Position`, `Rotation`, a quality). Their first two cells are empty or
//! name the line (`Type`, `Name`, `ID`, `Parent`). The line `Frame,Time (Seconds),X,Y,Z,...` ends the header. Each
//! frame is one line; the cells of an occluded marker are empty.
//!
//! Motive can export the markers of a rigid body twice: as measured (`Marker`) and as solved (`Rigid Body Marker`). The
//! importer reads the measured ones.

use std::collections::HashSet;

use super::{HEADER, LineCells, malformed};
use crate::{
    foreign::content::NewScratch,
    interchange::{
        ReadOptions, Result, counted,
        source_file::{Line, TextFile},
        table::{CUT_OFF, Table},
        text::{self, AtOrigin, Separator, TextFrames},
        units::{FileUnit, ToMillimetres},
    },
    motion::{Foreign, Marker, MotionInfo, Notes, UpAxis},
};

/// The header must end within this many lines, more than any version has.
const HEADER_LINES_MAX: usize = 32;

/// Whether a file's first line is that of a Motive export.
pub(super) fn is_motive(line: &[u8]) -> bool {
    LineCells::new(line).next().is_some_and(|cell| cell.trim_ascii() == b"Format Version")
}

/// Reads everything but the frames, and prepares to deliver those.
pub(super) fn open(
    file: &mut TextFile<'_, '_>,
    options: &ReadOptions,
    new_scratch: NewScratch<'_>,
) -> Result<(MotionInfo, TextFrames)> {
    let mut notes = Notes::default();
    let header = MotiveHeader::parse(file)?;
    let columns = header.columns(&mut notes.warnings)?;
    let stated = header.value("Length Units").unwrap_or_default();
    let unit = FileUnit::resolve(stated, options.unit, &mut notes);
    let millimetres = ToMillimetres::new(unit.factor, options.rotation());
    let mut table = Table::new("csv", new_scratch, millimetres);
    read_rows(&mut table, file, (&header, &columns), &mut notes.warnings)?;
    // The export may be decimated, so an invalid export rate is not replaced by the capture rate but taken from the
    // times.
    let number = |name: &str| text::number(header.value(name)?.as_bytes());
    let stated_hz = number("Export Frame Rate").or_else(|| number("Capture Frame Rate"));
    let stated_hz = stated_hz.filter(|&hz| text::is_rate(hz));
    let rate_hz = table.place(stated_hz, columns.len(), &mut notes.warnings).ok_or_else(|| {
        malformed(1, "expected `Export Frame Rate` and a number above 0, or increasing times")
    })?;
    let announced = header.value("Total Exported Frames");
    let announced = announced.and_then(|n| text::whole_number(n.as_bytes()));
    let frames_missing = table.count_missing(announced, &mut notes.warnings);
    let (n_frames, first_frame) = (table.n_frames(), table.first_frame().unwrap_or(0));
    let mut frames = table.into_frames(columns.len())?;
    frames.examine(&unit, AtOrigin::Doubtful, &mut notes)?;
    let info = MotionInfo {
        rate_hz,
        n_frames,
        markers: columns.into_iter().map(|column| column.marker).collect(),
        up: options.up(UpAxis::Unknown, &mut notes),
        source: unit.into_source("csv", first_frame, frames_missing, notes),
        foreign: vec![Foreign::exact(HEADER, header.lines)],
        ..MotionInfo::default()
    };
    Ok((info, frames))
}

/// The object that a column belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Owner {
    /// A measured marker, labelled or not.
    Marker,
    /// A marker at its place on the solved rigid body.
    SolvedMarker,
    /// A rigid body or a bone; its position is that of its pivot.
    Body,
    /// A force plate or another device.
    Other,
}

impl Owner {
    fn of(kind: &str) -> Self {
        match kind.to_ascii_lowercase().as_str() {
            "marker" | "labeled marker" | "unlabeled marker" => Self::Marker,
            "rigid body" | "bone" | "skeleton" | "asset" | "trained markerset" => Self::Body,
            kind if kind.ends_with(" marker") => Self::SolvedMarker,
            _ => Self::Other,
        }
    }
}

/// Three columns of the file that become one marker.
struct Column {
    marker: Marker,
    owner: Owner,
    /// Indices of the columns of x, y and z.
    cells: [usize; 3],
}

/// The header, and the lines that describe the columns.
struct MotiveHeader {
    /// The cells of the first line: names and values, alternating.
    values: Vec<String>,
    /// The lines that describe the columns.
    rows: Vec<Vec<String>>,
    /// `Frame`, `Time (Seconds)`, `X`...
    axes: Vec<String>,
    n_lines: usize,
    lines: Vec<u8>,
}

impl MotiveHeader {
    fn parse(file: &mut TextFile<'_, '_>) -> Result<Self> {
        let mut kept = Vec::new();
        let mut rows: Vec<Vec<String>> = Vec::new();
        let mut lines = file.lines();
        while let Some(Line { number: n_lines, bytes: line, .. }) = lines.next()?
            && n_lines <= HEADER_LINES_MAX
        {
            kept.extend_from_slice(line);
            kept.push(b'\n');
            let cells: Vec<String> =
                LineCells::new(line).map(|cell| text::decode(cell.trim_ascii())).collect();
            if cells.first().is_some_and(|cell| cell.eq_ignore_ascii_case("Frame")) {
                let values = if rows.is_empty() { Vec::new() } else { rows.remove(0) };
                return Ok(Self { values, rows, axes: cells, n_lines, lines: kept });
            }
            if cells.iter().any(|cell| !cell.is_empty()) {
                rows.push(cells);
            }
            lines.check_header()?;
        }
        Err(malformed(
            1,
            "expected a line that begins with `Frame` within the first 32 lines of a Motive export, found none",
        ))
    }

    /// A value of the first line.
    fn value(&self, name: &str) -> Option<&str> {
        let (pairs, _) = self.values.as_chunks::<2>();
        let found = pairs.iter().find(|[key, _]| key.eq_ignore_ascii_case(name));
        // An unquoted comma in a value shifts all later cells by one.
        let shifted = || {
            let at = self.values.iter().position(|cell| cell.eq_ignore_ascii_case(name))?;
            self.values.get(at + 1)
        };
        found.map(|[_, value]| value).or_else(shifted).map(String::as_str)
    }

    /// The columns with positions. Warns of columns that are left out.
    fn columns(&self, warnings: &mut Vec<String>) -> Result<Vec<Column>> {
        let named = |name: &str| {
            self.rows.iter().find(|row| {
                row.iter().take(2).any(|cell| cell.trim_end_matches(':').eq_ignore_ascii_case(name))
            })
        };
        // Lines without a name of their own are in this order; the last one has the properties (`Position`,
        // `Rotation`...).
        let types = named("Type").or(self.rows.first());
        let names = named("Name").or(self.rows.get(1));
        let (Some(types), Some(names), Some(properties)) = (types, names, self.rows.last()) else {
            return Err(malformed(
                self.n_lines,
                "expected lines with the type, name and property of each column above this line",
            ));
        };
        let cell = |row: &[String], at: usize| row.get(at).map_or("", String::as_str).to_owned();
        let is = |row: &[String], at: usize, text: &str| {
            row.get(at).is_some_and(|cell| cell.eq_ignore_ascii_case(text))
        };
        let mut columns: Vec<Column> = Vec::new();
        let mut left_out = 0usize;
        let mut at = 1;
        while at < self.axes.len() {
            let is_position = is(properties, at, "Position")
                && ["X", "Y", "Z"].iter().enumerate().all(|(i, axis)| is(&self.axes, at + i, axis));
            let owner = Owner::of(&cell(types, at));
            if !is_position || owner == Owner::Other {
                // The line has its name above the column of times.
                let is_time = at == 1 && cell(&self.axes, at).starts_with("Time");
                left_out += usize::from(!is_time && !cell(types, at).is_empty());
                at += 1;
                continue;
            }
            let name = cell(names, at);
            let mut marker = text::marker(&name, columns.len());
            marker.labelled &= !name.to_ascii_lowercase().starts_with("unlabeled");
            columns.push(Column { marker, owner, cells: [at, at + 1, at + 2] });
            at += 3;
        }
        let measured = columns.iter().filter(|column| column.owner == Owner::Marker);
        let measured: HashSet<_> = measured.map(|column| column.marker.label.clone()).collect();
        let n_all = columns.len();
        columns.retain(|column| {
            column.owner != Owner::SolvedMarker || !measured.contains(&column.marker.label)
        });
        let n_duplicates = n_all - columns.len();
        if n_duplicates > 0 {
            warnings.push(format!(
                "{} exported twice, as measured and as solved with the body; the measured positions were read.",
                counted(n_duplicates as u64, "marker")
            ));
        }
        let n_bodies = columns.iter().filter(|column| column.owner == Owner::Body).count();
        if n_bodies > 0 {
            warnings.push(format!(
                "Rigid bodies and bones whose positions were read as markers: {n_bodies}."
            ));
        }
        if left_out > 0 {
            warnings.push(format!(
                "{} without positions (rotations, qualities, devices) left out.",
                counted(left_out as u64, "column")
            ));
        }
        if columns.is_empty() {
            return Err(malformed(
                self.n_lines,
                "expected columns with positions of markers or bodies, found none: include them in Motive's export",
            ));
        }
        Ok(columns)
    }
}

fn read_rows(
    table: &mut Table<'_>,
    file: &mut TextFile<'_, '_>,
    (header, columns): (&MotiveHeader, &[Column]),
    warnings: &mut Vec<String>,
) -> Result<()> {
    let mut n_cells = 0;
    let mut lines = file.lines_below(header.n_lines)?;
    while let Some(Line { bytes: line, .. }) = lines.next()? {
        if line.trim_ascii().is_empty() {
            continue;
        }
        let cells: Vec<&[u8]> = Separator::COMMA.cells(line).collect();
        n_cells = cells.len();
        let cell = |at: usize| cells.get(at).copied().unwrap_or(&[]);
        table.begin_row(cell(0), cell(1));
        for column in columns {
            table.read_sample(&mut column.cells.iter().map(|&at| cell(at)));
        }
        table.end_row()?;
    }
    let is_open = lines.is_open();
    table.end(lines.n_bytes());
    let is_short = is_open && n_cells < header.axes.len();
    if is_short || (is_open && file.ends_mid_number(header.n_lines, Separator::COMMA)?) {
        let is_cut = |column: &Column| column.cells.iter().any(|&at| at + 1 == n_cells);
        let cut = columns.iter().position(is_cut);
        cut.into_iter().for_each(|column| table.drop_truncated(column));
        warnings.push(CUT_OFF.to_owned());
    }
    table.report_not_finite(warnings);
    table.report_damaged(warnings);
    Ok(())
}
