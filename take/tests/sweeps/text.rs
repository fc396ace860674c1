//! Text files longer than the memory that their import may take.

use std::{
    cell::Cell,
    fmt::Write as _,
    fs::File,
    io::{self, Cursor, Read, Seek, SeekFrom},
    rc::Rc,
    sync::Arc,
};

use mocapd_take::{
    foreign::content::ScratchFile,
    interchange::{Format, InterchangeError, MotionReader, ReadOptions, ReaderSettings},
    motion::{FrameSource, GAP, Position, is_gap},
};

use crate::{counting::peak_bytes, window::Scratch};

const MARKERS: usize = 40;
const FRAMES: usize = 24_000;

/// Peak memory of an import: of the 11 MiB of positions and 22 MiB of samples of the long layout 8 MiB, and the buffer
/// of half that size from which they were moved when it was full; the times of the rows; lines and blocks.
const HELD_MAX: usize = 16 << 20;

fn new_scratch() -> io::Result<Arc<dyn ScratchFile>> {
    let file: File = tempfile::tempfile()?;
    Ok(Arc::new(Scratch(file)))
}

fn open(format: Format, input: impl Read + Seek) -> Result<Opened, InterchangeError> {
    let settings = ReaderSettings {
        options: ReadOptions::default(),
        keeps_foreign: true,
        new_scratch: &new_scratch,
        bytes_read: Arc::default(),
    };
    let mut reader = MotionReader::open(format, input, &settings)?;
    let mut row = vec![GAP; reader.info().markers.len()];
    let mut opened =
        Opened { warnings: reader.info().source.warnings.clone(), ..Opened::default() };
    while reader.next_frame(&mut row)? {
        let number = opened.n_frames;
        opened.n_gaps += row.iter().filter(|&&at| is_gap(at)).count();
        let is_right =
            |(marker, &at): (usize, &Position)| is_gap(at) || at == position(number, marker);
        opened.n_wrong += row.iter().enumerate().filter(|&sample| !is_right(sample)).count();
        opened.n_frames += 1;
    }
    // A hash of the file needs all of its bytes.
    io::copy(&mut reader.bytes(), &mut io::sink())?;
    Ok(opened)
}

#[derive(Debug, Default)]
struct Opened {
    n_frames: usize,
    n_gaps: usize,
    n_wrong: usize,
    warnings: Vec<String>,
}

/// Quarters of a millimetre, which every format writes exactly.
fn position(frame: usize, marker: usize) -> Position {
    [frame as f32 / 4.0, 900.25 + marker as f32, 1000.75 - (frame % 999) as f32]
}

/// Whether a sample is at the origin: single ones of one marker, runs of another.
fn is_at_origin(frame: usize, marker: usize) -> bool {
    (marker == 3 && frame % 100 == 50) || (marker == 5 && frame % 1000 < 20 && frame >= 1000)
}

/// A row for each frame, and the number of samples at the origin.
fn table(header: &str, separator: char, lead: impl Fn(usize) -> String) -> (String, usize) {
    let (mut text, mut n_at_origin) = (header.to_owned(), 0);
    for frame in 0..FRAMES {
        text.push_str(&lead(frame));
        for marker in 0..MARKERS {
            let at_origin = is_at_origin(frame, marker);
            n_at_origin += usize::from(at_origin);
            let [x, y, z] = if at_origin { [0.0; 3] } else { position(frame, marker) };
            write!(text, "{separator}{x:.4}{separator}{y:.4}{separator}{z:.4}").unwrap();
        }
        text.push('\n');
    }
    (text, n_at_origin)
}

/// Imports a file in little memory; `n_gaps` of its samples are missing.
fn assert_small(format: Format, text: &str, n_gaps: usize) {
    assert!(text.len() > 3 * HELD_MAX / 2, "{} bytes prove nothing", text.len());
    let mut opened = None;
    let memory = peak_bytes(|| opened = Some(open(format, Cursor::new(text)).unwrap()));
    let opened = opened.unwrap();
    assert_eq!((opened.n_frames, opened.n_gaps, opened.n_wrong), (FRAMES, n_gaps, 0), "{format:?}");
    assert!(memory < HELD_MAX, "{format:?}: {memory} bytes held: {:?}", opened.warnings);
}

fn names(name: impl Fn(usize) -> String) -> String {
    (0..MARKERS).map(name).collect()
}

#[test]
fn a_trc_is_read_in_little_memory_and_its_missing_samples_are_found() {
    let header = format!(
        "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tNumMarkers\tUnits\n100\t{MARKERS}\tmm\nFrame#\tTime{}\n\n",
        names(|marker| format!("\tM{marker}\t\t"))
    );
    let lead = |frame: usize| format!("{}\t{:.2}", frame + 1, frame as f64 / 100.0);
    let (text, n_at_origin) = table(&header, '\t', lead);
    assert_small(Format::Trc, &text, n_at_origin);
}

#[test]
fn a_tsv_is_read_in_little_memory() {
    let header = format!(
        "NO_OF_FRAMES\t{FRAMES}\nFREQUENCY\t100\nMARKER_NAMES{}\nFrame{}\n",
        names(|marker| format!("\tM{marker}")),
        names(|marker| format!("\tM{marker} X\tM{marker} Y\tM{marker} Z"))
    );
    let (text, n_at_origin) = table(&header, '\t', |frame| (frame + 1).to_string());
    assert_small(Format::Tsv, &text, n_at_origin);
}

#[test]
fn a_csv_with_decimal_commas_is_read_in_little_memory() {
    let header = format!("time{}\n", names(|m| format!(";M{m}.x;M{m}.y;M{m}.z")));
    let (text, _) = table(&header, ';', |frame| format!("{:.2}", frame as f64 / 100.0));
    let origin = ";0.0000;0.0000;0.0000";
    let n_at_origin = text.matches(origin).count();
    // Without these samples there is nothing to doubt.
    let text = text.replace(origin, ";;;").replace(".x", "_x").replace(".y", "_y");
    let text = text.replace(".z", "_z").replace('.', ",");
    assert_small(Format::Csv, &text, n_at_origin);
}

#[test]
fn a_long_csv_is_read_in_little_memory_in_any_order() {
    let mut text = "frame,time_s,label,x_mm,y_mm,z_mm\n".to_owned();
    let mut add = |frame: usize, marker: usize| {
        let ([x, y, z], time_s) = (position(frame, marker), frame as f64 / 100.0);
        writeln!(text, "{frame},{time_s},M{marker},{x},{y},{z}").unwrap();
    };
    // The first frame tells the order of the markers; then one marker after another.
    (0..MARKERS).for_each(|marker| add(0, marker));
    (0..MARKERS).for_each(|marker| (1..FRAMES).for_each(|frame| add(frame, marker)));
    assert_small(Format::Csv, &text, 0);
}

#[test]
fn a_line_without_end_is_refused() {
    for (format, header) in [
        (Format::Csv, "time,a_x,a_y,a_z\n0,1,2,3\n"),
        (Format::Trc, "PathFileType\n"),
        (Format::Tsv, "FREQUENCY\t60\n"),
    ] {
        let text = format!("{header}{}", "1,".repeat(5 << 20));
        let mut error = None;
        let memory = peak_bytes(|| error = open(format, Cursor::new(&text)).err());
        let message = error.unwrap().to_string();
        assert!(message.contains("more than 8 MiB") && message.contains("split"), "{message}");
        let line = format!("line {}", header.lines().count() + 1);
        assert!(message.contains(&line), "{message}");
        // A buffer of twice that size, and the one that became too small.
        assert!(memory < 4 * (8 << 20), "{format:?}: {memory} bytes held");
    }
}

/// A file that another program changes after this many bytes have been read from it.
struct Changing {
    file: Cursor<Vec<u8>>,
    left: Rc<Cell<usize>>,
}

impl Read for Changing {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let n = self.file.read(bytes)?;
        let left = self.left.get();
        self.left.set(left.saturating_sub(n));
        if left > 0 && self.left.get() == 0 {
            let first_digit = self.file.get_ref().iter().rposition(|&byte| byte == b'5').unwrap();
            self.file.get_mut()[first_digit] = b'6';
        }
        Ok(n)
    }
}

impl Seek for Changing {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

#[test]
fn a_file_that_changes_between_passes_is_refused() {
    let mut text = "time;a_x;a_y;a_z\n".to_owned();
    (0..5000).for_each(|i| writeln!(text, "{i};{i},5;2;3").unwrap());
    let read = |left: usize| {
        let left = Rc::new(Cell::new(left));
        let input = Changing { file: Cursor::new(text.clone().into_bytes()), left };
        open(Format::Csv, input)
    };
    assert_eq!(read(0).unwrap().n_frames, 5000);
    // It is read for its kind and its separator, of which the first page tells, for its decimal commas, its layout, its rows,
    // and its hash.
    for (passes, pages) in [(1, 2), (2, 2), (4, 1)] {
        let error = read(passes * text.len() + (pages << 16)).unwrap_err();
        assert_eq!(
            error.to_string(),
            "another program changed it while it was being read",
            "{passes}"
        );
    }
}
