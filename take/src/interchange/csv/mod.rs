//! CSV: the wide and long layouts that `export` writes, the `time,head_x,head_y,head_z,...` dialect, and Motive's
//! export. The wide layout and the dialect, which have one row per frame, are here.

pub(super) mod long;
mod motive;

use std::{borrow::Cow, io::Write};

use super::{
    InterchangeError, ReadOptions, Result, counted, put_position,
    source_file::{Conversion, Line, TextFile},
    table::{CUT_OFF, Table},
    text::{self, AtOrigin, Separator, TextFrames, column_labels},
    units::{FileUnit, ToMillimetres},
    write_frames,
};
use crate::{
    escape::{from_cell, to_cell},
    foreign::content::NewScratch,
    motion::{Foreign, FrameSource, MotionInfo, Notes, UpAxis},
};

/// Kind of the foreign part with the header lines, each followed by LF: those that begin with `#`, or in Motive's
/// export all lines above the data.
const HEADER: &str = "csv/header";

/// How the frames of a file are read.
#[derive(Debug, Clone, Copy)]
enum CsvLayout {
    Wide,
    /// The line of column names.
    Long(usize),
    Motive,
}

/// Detects the layout of a file, reads everything but the frames, and prepares to deliver those.
pub(super) fn open(
    file: &mut TextFile<'_, '_>,
    options: &ReadOptions,
    new_scratch: NewScratch<'_>,
) -> Result<(MotionInfo, TextFrames)> {
    if let Some(conversion) = to_commas(file)? {
        file.convert(conversion);
    }
    match layout(file)? {
        CsvLayout::Wide => open_wide(file, options, new_scratch),
        CsvLayout::Long(header_line) => long::open(file, header_line, options, new_scratch),
        CsvLayout::Motive => motive::open(file, options, new_scratch),
    }
}

/// The layout, from the first line with content.
fn layout(file: &mut TextFile<'_, '_>) -> Result<CsvLayout> {
    let mut lines = file.lines();
    while let Some(Line { number, bytes: line, .. }) = lines.next()? {
        let content = line.trim_ascii();
        if !content.is_empty() && !content.starts_with(b"#") {
            return Ok(match line {
                _ if long::is_long(line) => CsvLayout::Long(number),
                _ if motive::is_motive(line) => CsvLayout::Motive,
                _ => CsvLayout::Wide,
            });
        }
    }
    Ok(CsvLayout::Wide)
}

fn malformed(line: usize, message: &str) -> InterchangeError {
    InterchangeError::malformed("csv", &format!("line {line}"), message)
}

/// The cells of a line. A cell in quotes may hold commas, and quotes when they are doubled.
struct LineCells<'a> {
    rest: Option<&'a [u8]>,
    separator: u8,
}

impl<'a> LineCells<'a> {
    fn new(line: &'a [u8]) -> Self {
        Self::between(b',', line)
    }

    /// The cells of a line with another separator than commas.
    fn between(separator: u8, line: &'a [u8]) -> Self {
        Self { rest: Some(line), separator }
    }
}

impl<'a> Iterator for LineCells<'a> {
    type Item = Cow<'a, [u8]>;

    fn next(&mut self) -> Option<Self::Item> {
        let rest = self.rest?;
        let Some(quoted) = rest.strip_prefix(b"\"") else {
            let end = rest.iter().position(|&b| b == self.separator);
            self.rest = end.and_then(|end| rest.get(end + 1..));
            return Some(Cow::Borrowed(rest.get(..end.unwrap_or(rest.len())).unwrap_or(rest)));
        };
        let mut cell = Vec::new();
        let mut bytes = quoted.iter().copied().enumerate().peekable();
        while let Some((index, byte)) = bytes.next() {
            if byte != b'"' {
                cell.push(byte);
            } else if bytes.next_if(|&(_, next)| next == b'"').is_some() {
                cell.push(b'"');
            } else {
                let after = quoted.get(index + 1..).unwrap_or(&[]);
                let end = after.iter().position(|&b| b == self.separator);
                self.rest = end.and_then(|end| after.get(end + 1..));
                return Some(Cow::Owned(cell));
            }
        }
        self.rest = None;
        Some(Cow::Owned(cell))
    }
}

/// A text as a cell. Quotes protect separators, quotes, outer spaces and a leading `#`; escapes ([`crate::escape`])
/// stand for characters that would break the line.
#[must_use]
pub fn quote(text: &str) -> Cow<'_, str> {
    let text = to_cell(text);
    if text.contains([',', '"']) || text.trim() != text.as_ref() || text.starts_with('#') {
        return Cow::Owned(format!("\"{}\"", text.replace('"', "\"\"")));
    }
    text
}

/// A conversion of lines to commas between cells and points in numbers, as the readers expect; `None` if they have
/// them already.
///
/// # Errors
/// Those of reading the file.
fn to_commas(file: &mut TextFile<'_, '_>) -> Result<Option<Box<Conversion>>> {
    let Some(separator) = separator(file)? else { return Ok(None) };
    let has_points = has_points(separator, file)?;
    Ok(Some(Box::new(move |line, out| {
        if line.trim_ascii_start().starts_with(b"#") {
            out.extend_from_slice(line);
            return;
        }
        for (index, cell) in LineCells::between(separator, line).enumerate() {
            out.extend((index > 0).then_some(b','));
            put(&cell, has_points, out);
        }
    })))
}

fn put(cell: &[u8], has_points: bool, out: &mut Vec<u8>) {
    if text::number(cell).is_some() {
        out.extend_from_slice(cell.trim_ascii());
    } else if !has_points && let Some(number) = text::with_point(cell) {
        out.extend_from_slice(&number);
    } else {
        out.extend_from_slice(quote(&text::decode(cell.trim_ascii())).as_bytes());
    }
}

/// Whether any number has a decimal point: then commas separate thousands.
fn has_points(separator: u8, file: &mut TextFile<'_, '_>) -> Result<bool> {
    let is_with_point = |cell: &[u8]| cell.contains(&b'.') && text::number(cell).is_some();
    let mut lines = file.lines();
    while let Some(Line { bytes: line, .. }) = lines.next()? {
        if !line.starts_with(b"#")
            && line.contains(&b'.')
            && LineCells::between(separator, line).any(|cell| is_with_point(&cell))
        {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Detects the separator from the line of column names; `None` if the file has commas and no quotes around numbers.
fn separator(file: &mut TextFile<'_, '_>) -> Result<Option<u8>> {
    let mut lines = file.lines();
    let mut commas = None;
    while let Some(Line { bytes: line, .. }) = lines.next()? {
        if line.trim_ascii().is_empty() || line.starts_with(b"#") {
            continue;
        }
        if let Some(commas) = commas {
            return Ok((commas > 1 && line.starts_with(b"\"")).then_some(b','));
        }
        let count = |separator: u8| LineCells::between(separator, line).count();
        let most = [b';', b'\t'].into_iter().max_by_key(|&separator| count(separator));
        if let Some(most) = most.filter(|&most| count(most) > count(b',')) {
            return Ok(Some(most));
        }
        commas = Some(count(b','));
    }
    Ok(None)
}

/// Reads everything but the frames, and prepares to deliver those.
pub(super) fn open_wide(
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

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn quoted_texts_round_trip(texts in proptest::collection::vec("[a-zA-Z\",# .é]{0,8}", 1..6)) {
            let line = texts.iter().map(|t| quote(t).into_owned()).collect::<Vec<_>>().join(",");
            let found: Vec<String> =
                LineCells::new(line.as_bytes()).map(|c| String::from_utf8(c.into_owned()).expect("UTF-8")).collect();
            prop_assert_eq!(found, texts);
        }
    }

    #[test]
    fn an_open_quote_ends_with_the_line() {
        let found: Vec<_> = LineCells::new(b"a,\"b,c").collect();
        assert_eq!(found, [Cow::Borrowed(&b"a"[..]), Cow::Borrowed(b"b,c")]);
    }
}
