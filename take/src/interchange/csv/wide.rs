//! A row a frame: what `export` writes, and the `time,head_x,head_y,head_z,...` dialect.

use std::io::Write;

use super::{
    HEADER,
    dialect::{LineCells, quote},
    malformed,
};
use crate::{
    ambiguity::Notes,
    escape::from_cell,
    interchange::{
        ReadOptions, Result, origin, put_position,
        table::{CUT_OFF, Table},
        text::{self, Separator, column_labels},
        units::{FileUnit, Millimetres},
        write_frames,
    },
    motion::{Foreign, FrameSource, Motion, MotionInfo, UpAxis},
};

/// Reads a whole file.
pub(super) fn read(bytes: &[u8], options: &ReadOptions) -> Result<Motion> {
    let mut notes = Notes::default();
    let head = Head::parse(bytes)?;
    // What we write has no line of units: it is always millimetres.
    let ours = if head.is_ours { "mm" } else { "" };
    let unit = FileUnit::of(head.value("units").unwrap_or(ours), options.unit, &mut notes)
        .or_usually_millimetres();
    let mut table = Table::new("csv", bytes, Millimetres::new(unit.factor, options.turn()));
    read_rows(&mut table, &head, &mut notes.warnings);
    let up = head.value("up").and_then(UpAxis::from_name).unwrap_or_default();
    let up = options.up(up, &mut notes);
    let n_markers = head.labels.len();
    let stated_hz = head.value("rate").and_then(|rate| text::rate(rate.as_bytes()));
    let rate_hz = table.place(stated_hz, n_markers, &mut notes.warnings).ok_or_else(|| {
        malformed(
            head.n_lines,
            "the rate is not known: add a line `# rate=120` above the column names, or a column of rising times",
        )
    })?;
    let announced = head.value("frames").and_then(|n| text::whole_number(n.as_bytes()));
    let frames_missing = table.n_missing(announced, &mut notes.warnings);
    let (n_frames, first_frame) = (table.n_frames(), table.first_frame().unwrap_or(1));
    let positions_mm = table.into_positions(n_markers)?;
    unit.judge(&positions_mm, n_markers, &mut notes);
    origin::note_zeros(&positions_mm, n_markers, &mut notes);
    let markers = text::markers(&head.labels, n_markers);
    let foreign = Foreign { kind: HEADER.to_owned(), data: head.lines.into() };
    Ok(Motion {
        positions_mm,
        info: MotionInfo {
            rate_hz,
            n_frames,
            markers,
            up,
            source: unit.into_source("csv", first_frame, frames_missing, notes),
            foreign: Some(foreign).filter(|lines| !lines.data.is_empty()).into_iter().collect(),
            ..MotionInfo::default()
        },
    })
}

/// What stands above the data.
#[derive(Default)]
struct Head {
    /// `key=value` of the lines that begin with `#`.
    values: Vec<(String, String)>,
    labels: Vec<String>,
    /// Whether the columns are named as we name them: `time_s`, `LABEL.x`.
    is_ours: bool,
    frame_column: Option<usize>,
    time_column: Option<usize>,
    /// Columns before the first coordinate.
    lead: usize,
    n_lines: usize,
    lines: Vec<u8>,
}

impl Head {
    fn parse(bytes: &[u8]) -> Result<Self> {
        let mut head = Self::default();
        for (number, line) in text::lines(bytes) {
            head.n_lines = number;
            if let Some(comment) = line.trim_ascii_start().strip_prefix(b"#") {
                let comment = text::decode(comment);
                let pairs = comment.split_whitespace().filter_map(|word| word.split_once('='));
                let pairs = pairs.map(|(key, value)| (key.to_ascii_lowercase(), value.to_owned()));
                head.values.extend(pairs);
                head.lines.extend_from_slice(line);
                head.lines.push(b'\n');
            } else if !line.trim_ascii().is_empty() {
                head.read_columns(line)?;
                return Ok(head);
            }
        }
        Err(malformed(
            1,
            "expected a line with the names of columns, found none: not a CSV file of trajectories",
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
        self.lead = [self.frame_column, self.time_column].iter().flatten().count();
        for axes in names.get(self.lead..).unwrap_or(&[]).chunks(3) {
            let label = label_of(axes).ok_or_else(|| {
                let message = format!(
                    "expected three columns NAME.x, NAME.y, NAME.z (or NAME_x...) for each marker, found `{}`",
                    axes.join("`, `")
                );
                malformed(self.n_lines, &message)
            })?;
            self.labels.push(from_cell(label).into_owned());
        }
        if self.lead == 0 && self.labels.is_empty() {
            return Err(malformed(
                self.n_lines,
                "expected the columns frame, time_s or time and markers, found none of them",
            ));
        }
        let name = |column: usize| names.get(column).map(String::as_str);
        self.is_ours = self.time_column.is_some_and(|column| name(column) == Some("time_s"))
            && name(self.lead).is_none_or(|first| first.ends_with(".x"));
        Ok(())
    }

    /// The last value of a key.
    fn value(&self, key: &str) -> Option<&str> {
        self.values.iter().rev().find(|(k, _)| k == key).map(|(_, value)| value.as_str())
    }
}

/// The name that three columns share before `.x`, `.y`, `.z` or `_x`, `_y`, `_z`.
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

fn read_rows(table: &mut Table<'_>, head: &Head, warnings: &mut Vec<String>) {
    let bytes = table.bytes;
    let mut extra = 0usize;
    let mut n_cells = 0;
    let is_open = !bytes.ends_with(b"\n");
    let mut lines = text::lines(bytes).skip(head.n_lines).peekable();
    while let Some((_, line)) = lines.next() {
        if line.trim_ascii().is_empty() || line.starts_with(b"#") {
            continue;
        }
        n_cells = Separator::COMMA.cells(line).count();
        if is_open && lines.peek().is_none() && n_cells <= head.lead && !head.labels.is_empty() {
            // Not even its number and time are known to be whole.
            break;
        }
        let lead = |column: Option<usize>| {
            let at = column.filter(|&at| at < head.lead);
            at.and_then(|at| Separator::COMMA.cells(line).nth(at)).unwrap_or(&[])
        };
        table.begin_row(lead(head.frame_column), lead(head.time_column));
        let mut cells = Separator::COMMA.cells(line).skip(head.lead);
        for _ in &head.labels {
            table.read_sample(&mut cells);
        }
        extra += usize::from(cells.any(|cell| !cell.trim_ascii().is_empty()));
        table.end_row();
    }
    let is_short = is_open && n_cells < head.lead + 3 * head.labels.len();
    if is_short || text::ends_within_a_number(bytes, head.n_lines + 1, Separator::COMMA) {
        if n_cells > head.lead {
            table.drop_cut((n_cells - head.lead - 1) / 3);
        }
        warnings.push(CUT_OFF.to_owned());
    }
    table.report_not_finite(warnings);
    table.report_damaged(warnings);
    if extra > 0 {
        warnings.push(format!(
            "{extra} lines have more cells than there are columns; they were left out."
        ));
    }
}

/// Writes a line of names, then one line a frame: its number, its time from the first frame in seconds, and three
/// cells a marker in millimetres, empty where the sample is missing.
pub(crate) fn write(frames: &mut dyn FrameSource, out: &mut dyn Write) -> Result<()> {
    let info = frames.info().clone();
    let mut head = b"frame,time_s".to_vec();
    for label in column_labels(&info) {
        for axis in ["x", "y", "z"] {
            write!(head, ",{}", quote(&format!("{label}.{axis}")))?;
        }
    }
    head.push(b'\n');
    write_frames(frames, out, head, |line, index, row| {
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
