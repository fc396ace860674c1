//! The wide layout, one row per frame: the layout that `export` writes, and the `time,head_x,head_y,head_z,...`
//! dialect.

use std::io::Write;

use super::{HEADER, LineCells, malformed, quote};
use crate::{
    escape::from_cell,
    foreign::content::NewScratch,
    interchange::{
        ReadOptions, Result, counted, put_position,
        source_file::{Line, TextFile},
        table::{CUT_OFF, Table},
        text::{self, AtOrigin, Separator, TextFrames, column_labels},
        units::{FileUnit, ToMillimetres},
        write_frames,
    },
    motion::{Foreign, FrameSource, MotionInfo, Notes, UpAxis},
};

/// Reads everything but the frames, and prepares to deliver those.
pub(super) fn open(
    file: &mut TextFile<'_, '_>,
    options: &ReadOptions,
    new_scratch: NewScratch<'_>,
) -> Result<(MotionInfo, TextFrames)> {
    let mut notes = Notes::default();
    let header = WideHeader::parse(file)?;
    // Our own export states no unit: it is always millimetres.
    let default = if header.is_native { "mm" } else { "" };
    let stated = header.value("units").unwrap_or(default);
    let unit = FileUnit::resolve(stated, options.unit, &mut notes).or_default_millimetres();
    let millimetres = ToMillimetres::new(unit.factor, options.rotation());
    let mut table = Table::new("csv", new_scratch, millimetres);
    read_rows(&mut table, file, &header, &mut notes.warnings)?;
    let up = header.value("up").and_then(UpAxis::from_name).unwrap_or_default();
    let up = options.up(up, &mut notes);
    let n_markers = header.labels.len();
    let stated_hz = header.value("rate").and_then(|rate| text::rate(rate.as_bytes()));
    let rate_hz = table.place(stated_hz, n_markers, &mut notes.warnings).ok_or_else(|| {
        malformed(
            header.n_lines,
            "no rate: add a line such as `# rate=120` above the column names, or a time column with increasing times",
        )
    })?;
    let announced = header.value("frames").and_then(|n| text::whole_number(n.as_bytes()));
    let frames_missing = table.count_missing(announced, &mut notes.warnings);
    let (n_frames, first_frame) = (table.n_frames(), table.first_frame().unwrap_or(1));
    let mut frames = table.into_frames(n_markers)?;
    frames.examine(&unit, AtOrigin::Doubtful, &mut notes)?;
    let foreign = Foreign::exact(HEADER, header.lines);
    let info = MotionInfo {
        rate_hz,
        n_frames,
        markers: text::markers(&header.labels, n_markers),
        up,
        source: unit.into_source("csv", first_frame, frames_missing, notes),
        foreign: Some(foreign).filter(|lines| !lines.data.is_empty()).into_iter().collect(),
        ..MotionInfo::default()
    };
    Ok((info, frames))
}

/// The lines up to and including the column names.
#[derive(Default)]
struct WideHeader {
    /// The `key=value` pairs of lines that begin with `#`.
    values: Vec<(String, String)>,
    labels: Vec<String>,
    /// Whether the columns have the names of our own export: `time_s`, `LABEL.x`.
    is_native: bool,
    frame_column: Option<usize>,
    time_column: Option<usize>,
    /// Number of columns before the first coordinate.
    lead_columns: usize,
    n_lines: usize,
    lines: Vec<u8>,
}

impl WideHeader {
    fn parse(file: &mut TextFile<'_, '_>) -> Result<Self> {
        let mut header = Self::default();
        let mut lines = file.lines();
        while let Some(Line { number, bytes: line, .. }) = lines.next()? {
            header.n_lines = number;
            if let Some(comment) = line.trim_ascii_start().strip_prefix(b"#") {
                let comment = text::decode(comment);
                let pairs = comment.split_whitespace().filter_map(|word| word.split_once('='));
                let pairs = pairs.map(|(key, value)| (key.to_ascii_lowercase(), value.to_owned()));
                header.values.extend(pairs);
                header.lines.extend_from_slice(line);
                header.lines.push(b'\n');
                lines.check_header()?;
            } else if !line.trim_ascii().is_empty() {
                header.read_columns(line)?;
                return Ok(header);
            }
        }
        Err(malformed(
            1,
            "expected a line of column names, found none: not a CSV file of trajectories",
        ))
    }

    fn read_columns(&mut self, line: &[u8]) -> Result<()> {
        let names: Vec<String> =
            LineCells::new(line).map(|cell| text::decode(cell.trim_ascii())).collect();
        let named = |known: &[&str]| {
            let is_known = |name: &String| known.iter().any(|k| name.eq_ignore_ascii_case(k));
            names.iter().position(is_known).filter(|&column| column < 2)
        };
        self.frame_column = named(&["frame", "frame#"]);
        self.time_column = named(&["time_s", "time"]);
        self.lead_columns = [self.frame_column, self.time_column].iter().flatten().count();
        for axes in names.get(self.lead_columns..).unwrap_or(&[]).chunks(3) {
            let label = label_of(axes).ok_or_else(|| {
                let message = format!(
                    "expected three columns NAME.x, NAME.y, NAME.z (or NAME_x...) for each marker, found `{}`",
                    axes.iter().map(|name| text::shortened(name)).collect::<Vec<_>>().join("`, `")
                );
                malformed(self.n_lines, &message)
            })?;
            self.labels.push(from_cell(label).into_owned());
        }
        if self.lead_columns == 0 && self.labels.is_empty() {
            return Err(malformed(
                self.n_lines,
                "expected the columns frame, time_s or time, and markers, found none of them",
            ));
        }
        let name = |column: usize| names.get(column).map(String::as_str);
        self.is_native = self.time_column.is_some_and(|column| name(column) == Some("time_s"))
            && name(self.lead_columns).is_none_or(|first| first.ends_with(".x"));
        Ok(())
    }

    /// The value of a key; the last one if there are several.
    fn value(&self, key: &str) -> Option<&str> {
        self.values.iter().rev().find(|(k, _)| k == key).map(|(_, value)| value.as_str())
    }
}

/// The label that three column names share before `.x`, `.y`, `.z` or `_x`, `_y`, `_z`.
fn label_of(columns: &[String]) -> Option<&str> {
    let [x, y, z] = columns else { return None };
    let without = |name: &'_ str, axis: char| -> Option<usize> {
        let start = name.strip_suffix([axis, axis.to_ascii_uppercase()])?;
        let start = start.strip_suffix(['.', '_', ' '])?;
        Some(start.len())
    };
    let label = x.get(..without(x, 'x')?)?;
    let same = y.get(..without(y, 'y')?)? == label && z.get(..without(z, 'z')?)? == label;
    same.then_some(label)
}

fn read_rows(
    table: &mut Table<'_>,
    file: &mut TextFile<'_, '_>,
    header: &WideHeader,
    warnings: &mut Vec<String>,
) -> Result<()> {
    let n_lead = header.lead_columns;
    let mut extra = 0usize;
    let mut n_cells = 0;
    let mut lines = file.lines_below(header.n_lines)?;
    while let Some(Line { bytes: line, is_open, .. }) = lines.next()? {
        if line.trim_ascii().is_empty() || line.starts_with(b"#") {
            continue;
        }
        if is_open
            && Separator::COMMA.cells(line).nth(n_lead).is_none()
            && !header.labels.is_empty()
        {
            // The last line ends within its frame number or time.
            n_cells = 0;
            break;
        }
        let lead_cell = |column: Option<usize>| {
            let at = column.filter(|&at| at < n_lead);
            at.and_then(|at| Separator::COMMA.cells(line).nth(at)).unwrap_or(&[])
        };
        table.begin_row(lead_cell(header.frame_column), lead_cell(header.time_column));
        n_cells = 0;
        let mut cells = Separator::COMMA.cells(line).inspect(|_| n_cells += 1).skip(n_lead);
        for _ in &header.labels {
            table.read_sample(&mut cells);
        }
        extra += usize::from(cells.any(|cell| !cell.trim_ascii().is_empty()));
        cells.for_each(drop);
        table.end_row()?;
    }
    let is_open = lines.is_open();
    table.end(lines.n_bytes());
    let is_short = is_open && n_cells < n_lead + 3 * header.labels.len();
    if is_short || (is_open && file.ends_mid_number(header.n_lines, Separator::COMMA)?) {
        if n_cells > n_lead {
            table.drop_truncated((n_cells - n_lead - 1) / 3);
        }
        warnings.push(CUT_OFF.to_owned());
    }
    table.report_not_finite(warnings);
    table.report_damaged(warnings);
    if extra > 0 {
        let lines = counted(extra as u64, "line");
        warnings.push(format!("More cells than columns, the surplus ignored: {lines}."));
    }
    Ok(())
}

/// Writes the column names, then one line for each frame: its number, its time from the first frame in seconds, and
/// three cells for each marker in millimetres, empty for a missing sample.
pub(crate) fn write(frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<()> {
    let info = frames.info().clone();
    let mut header = b"frame,time_s".to_vec();
    for label in column_labels(&info) {
        for axis in ["x", "y", "z"] {
            write!(header, ",{}", quote(&format!("{label}.{axis}")))?;
        }
    }
    header.push(b'\n');
    write_frames(frames, out, header, |line, index, row| {
        let number = info.source.first_frame.saturating_add(index);
        write!(line, "{number},{}", index as f64 / info.rate_hz)?;
        for &position in row {
            line.push(b',');
            put_position(line, position, b',', "")?;
        }
        line.push(b'\n');
        Ok(())
    })?;
    Ok(())
}
