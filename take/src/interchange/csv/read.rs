//! Bytes of a CSV file -> trajectories.

use super::cells::LineCells;
use super::dialect::with_commas;
use super::{HEADER, long, motive};
use crate::escape::from_cell;
use crate::interchange::line_frames::LineFrames;
use crate::interchange::text::{self, CUT_OFF, Cells, Rows};
use crate::interchange::units::{FileUnit, Millimetres};
use crate::interchange::{InterchangeError, ReadOptions, notes::Notes, origin};
use crate::motion::{Foreign, GAP, Motion, MotionInfo, Source, UpAxis};

/// Rate of a file of one frame that states none, as of a C3D file that states none.
const RATE_OF_ONE_FRAME_HZ: f64 = 100.0;

/// Reads a whole file.
pub(crate) fn read(bytes: &[u8], options: &ReadOptions) -> Result<Motion, InterchangeError> {
    let bytes = &*with_commas(bytes);
    let mut lines = text::lines(bytes);
    let is_content = |line: &&(usize, &[u8])| {
        let line = line.1.trim_ascii();
        !line.is_empty() && !line.starts_with(b"#")
    };
    if let Some((number, line)) = lines.find(|line| is_content(&line)) {
        if long::is_long(line) {
            return long::read(bytes, number, options);
        }
        if motive::is_motive(line) {
            return motive::read(bytes, options);
        }
    }
    let mut notes = Notes::default();
    let head = Head::parse(bytes)?;
    // What we write has no line of units: it is always millimetres.
    let ours = if head.is_ours { "mm" } else { "" };
    let unit = head.value("units").unwrap_or_else(|| ours.to_owned());
    let unit = FileUnit::of(&unit, options, &mut notes).or_usually_millimetres();
    let millimetres = Millimetres::new(unit.factor, options);
    let mut data = read_rows(bytes, &head, &millimetres, &mut notes.warnings);
    let of_file = match head.value("up").as_deref() {
        Some("X" | "x") => UpAxis::X,
        Some("Y" | "y") => UpAxis::Y,
        Some("Z" | "z") => UpAxis::Z,
        _ => UpAxis::Unknown,
    };
    let up = options.up(of_file, &mut notes);
    let warnings = &mut notes.warnings;
    let stated = head.value("rate").and_then(|rate| text::number(rate.as_bytes()));
    let stated = stated.filter(|rate| rate.is_finite() && *rate > 0.0);
    let frames_max = text::frames_max(bytes.len(), head.labels.len());
    let placed = data.lines.place(stated, frames_max, warnings);
    let rate_hz = match placed.rate_hz {
        Some(rate_hz) => rate_hz,
        None if data.rows.len() == 1 => rate_of_one_frame(warnings),
        None => {
            return Err(malformed(
                head.n_lines,
                "the rate is not known: add a line `# rate=120` above the column names, or a column of rising times",
            ));
        }
    };
    data.rows.put_empty(&placed.missing_before);
    let n_frames = data.rows.len() as u64;
    let announced = head.value("frames").and_then(|n| text::whole_number(n.as_bytes()));
    let announced = announced.unwrap_or(n_frames);
    if announced != n_frames {
        warnings.push(format!("{announced} frames announced, {n_frames} present."));
    }
    let mut foreign = Vec::new();
    if !head.lines.is_empty() {
        foreign.push(Foreign { kind: HEADER.to_owned(), data: head.lines.clone().into() });
    }
    let positions_mm = data.rows.into_rectangle(head.labels.len(), bytes.len(), "csv")?;
    unit.judge(&positions_mm, head.labels.len(), &mut notes);
    origin::note_zeros(&positions_mm, head.labels.len(), &mut notes);
    Ok(Motion {
        positions_mm,
        info: MotionInfo {
            rate_hz,
            n_frames,
            markers: head
                .labels
                .iter()
                .enumerate()
                .map(|(column, label)| text::marker(label, column))
                .collect(),
            up,
            source: Source {
                format: "csv".to_owned(),
                unit: unit.stated,
                factor: unit.factor,
                first_frame: data.lines.first().unwrap_or(1),
                frames_missing: announced.saturating_sub(n_frames),
                warnings: notes.warnings,
                ambiguities: notes.ambiguities,
            },
            foreign,
            ..MotionInfo::default()
        },
    })
}

/// What stands above the data.
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
    fn parse(bytes: &[u8]) -> Result<Self, InterchangeError> {
        let mut values = Vec::new();
        let mut kept = Vec::new();
        for (number, line) in text::lines(bytes) {
            if let Some(comment) = line.trim_ascii_start().strip_prefix(b"#") {
                let comment = text::decode(comment);
                let pairs = comment.split_whitespace().filter_map(|word| word.split_once('='));
                values
                    .extend(pairs.map(|(key, value)| (key.to_ascii_lowercase(), value.to_owned())));
                kept.extend_from_slice(line);
                kept.push(b'\n');
            } else if !line.trim_ascii().is_empty() {
                return Self::columns(line, number, values, kept);
            }
        }
        Err(malformed(
            1,
            "expected a line with the names of columns, found none: not a CSV file of trajectories",
        ))
    }

    fn columns(
        line: &[u8],
        number: usize,
        values: Vec<(String, String)>,
        lines: Vec<u8>,
    ) -> Result<Self, InterchangeError> {
        let names: Vec<String> =
            LineCells::new(line).map(|cell| text::decode(cell.trim_ascii())).collect();
        let named = |known: &[&str]| {
            names.iter().position(|name| known.iter().any(|k| name.eq_ignore_ascii_case(k)))
        };
        let frame_column = named(&["frame", "frame#"]).filter(|&column| column < 2);
        let time_column = named(&["time_s", "time"]).filter(|&column| column < 2);
        let lead = usize::from(frame_column.is_some()) + usize::from(time_column.is_some());
        let mut labels = Vec::new();
        for axes in names.get(lead..).unwrap_or(&[]).chunks(3) {
            let label = label_of(axes).ok_or_else(|| {
                malformed(
                    number,
                    &format!(
                        "expected three columns NAME.x, NAME.y, NAME.z (or NAME_x...) for each marker, found `{}`",
                        axes.join("`, `")
                    ),
                )
            })?;
            labels.push(from_cell(label).into_owned());
        }
        if lead == 0 && labels.is_empty() {
            return Err(malformed(
                number,
                "expected the columns frame, time_s or time and markers, found none of them",
            ));
        }
        let is_ours = time_column
            .is_some_and(|column| names.get(column).is_some_and(|name| name == "time_s"))
            && names.get(lead).is_none_or(|first| first.ends_with(".x"));
        Ok(Self {
            values,
            labels,
            is_ours,
            frame_column,
            time_column,
            lead,
            n_lines: number,
            lines,
        })
    }

    /// The last value of a key.
    fn value(&self, key: &str) -> Option<String> {
        self.values.iter().rev().find(|(k, _)| k == key).map(|(_, value)| value.clone())
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

/// The data as read.
#[derive(Default)]
struct Data {
    rows: Rows,
    lines: LineFrames,
}

fn read_rows(
    bytes: &[u8],
    head: &Head,
    millimetres: &Millimetres,
    warnings: &mut Vec<String>,
) -> Data {
    let mut data = Data::default();
    let mut damaged = 0usize;
    let mut extra = 0usize;
    let mut n_cells = 0;
    let is_open = !bytes.ends_with(b"\n");
    let mut lines = text::lines(bytes).skip(head.n_lines).peekable();
    while let Some((_, line)) = lines.next() {
        if line.trim_ascii().is_empty() || line.starts_with(b"#") {
            continue;
        }
        n_cells = line.split(|&b| b == b',').count();
        if is_open && lines.peek().is_none() && n_cells <= head.lead && !head.labels.is_empty() {
            // Not even its number and time are known to be whole.
            break;
        }
        let mut cells = line.split(|&b| b == b',');
        let (mut number, mut time) = (&[][..], &[][..]);
        for column in 0..head.lead {
            let cell = cells.next().unwrap_or(&[]);
            if Some(column) == head.frame_column {
                number = cell;
            } else if Some(column) == head.time_column {
                time = cell;
            }
        }
        data.lines.line(number, time);
        for _ in &head.labels {
            data.rows.push(match text::three_cells(&mut cells) {
                Cells::Position(position) => millimetres.position(position),
                Cells::Empty => GAP,
                Cells::Damaged => {
                    damaged += 1;
                    GAP
                }
            });
        }
        extra += usize::from(cells.any(|cell| !cell.trim_ascii().is_empty()));
        data.rows.end_row();
    }
    let is_short = is_open && n_cells < head.lead + 3 * head.labels.len();
    let cells = |line| <[u8]>::split(line, |&b: &u8| b == b',');
    if is_short || text::ends_within_a_number(bytes, head.n_lines + 1, cells) {
        if n_cells > head.lead {
            data.rows.drop_cut((n_cells - head.lead - 1) / 3);
        }
        warnings.push(CUT_OFF.to_owned());
    }
    millimetres.report(warnings);
    if damaged > 0 {
        warnings.push(format!("{damaged} samples have cells that are not numbers; they are gaps."));
    }
    if extra > 0 {
        warnings.push(format!(
            "{extra} lines have more cells than there are columns; they were left out."
        ));
    }
    data
}

/// What is taken where one frame tells no rate.
pub(super) fn rate_of_one_frame(warnings: &mut Vec<String>) -> f64 {
    warnings.push(format!("One frame tells no rate; {RATE_OF_ONE_FRAME_HZ} Hz was taken."));
    RATE_OF_ONE_FRAME_HZ
}

pub(super) fn malformed(line: usize, message: &str) -> InterchangeError {
    InterchangeError::Malformed {
        format: "csv",
        place: format!("line {line}"),
        message: message.to_owned(),
    }
}
