//! The formats that are only written, parsed by hand. `tests/oracle` has other programs read them.

use std::collections::BTreeMap;
use std::io::{Cursor, Write};

use mocapd_take::interchange::{Format, InterchangeError, bids, npz};
use mocapd_take::motion::{
    GAP, Marker, Motion, MotionEvent, MotionFrames, MotionInfo, Source, UpAxis, is_gap,
};
use mocapd_take::record::EventKind;

/// `n_markers` markers over `n_frames` frames at 100 Hz, every seventh sample missing, with two events.
fn motion(n_markers: usize, n_frames: usize) -> Motion {
    let label = |i: usize| match i {
        0 => "<a> & \"b\"\t\u{4e2d}".to_owned(),
        1 | 2 => "same".to_owned(),
        i => format!("m{i}"),
    };
    let events = [(0, EventKind::Mark, "go <now>"), (n_frames as u64 / 2, EventKind::Trigger, "")];
    let info = MotionInfo {
        rate_hz: 100.0,
        n_frames: n_frames as u64,
        markers: (0..n_markers).map(|i| Marker { label: label(i), labelled: i != 3 }).collect(),
        up: UpAxis::Z,
        source: Source { factor: 1.0, first_frame: 7, ..Source::default() },
        events: events
            .map(|(frame, kind, text)| MotionEvent { frame, kind, text: text.to_owned() })
            .to_vec(),
        ..MotionInfo::default()
    };
    let sample = |i: usize| if i % 7 == 3 { GAP } else { [i as f32, -0.5, 0.25 * i as f32] };
    Motion { info, positions_mm: (0..n_markers * n_frames).map(sample).collect() }
}

fn write(format: Format, motion: &Motion) -> Vec<u8> {
    let mut bytes = Vec::new();
    format.write(&mut MotionFrames::new(motion), &mut bytes).expect("memory");
    bytes
}

fn npz(motion: &Motion) -> Vec<u8> {
    let mut archive = Cursor::new(Vec::new());
    npz::write(&mut MotionFrames::new(motion), &mut archive).expect("memory");
    archive.into_inner()
}

fn number<const N: usize>(bytes: &[u8], at: usize) -> u64 {
    bytes[at..at + N].iter().rev().fold(0, |sum, &b| sum << 8 | u64::from(b))
}

/// The members of a ZIP file from front to back; its directory must list them identically.
fn members(archive: &[u8]) -> BTreeMap<String, &[u8]> {
    let end = archive.len() - 22;
    assert_eq!(number::<4>(archive, end), 0x0605_4b50);
    let mut listed = number::<4>(archive, end + 16) as usize;
    let mut members = BTreeMap::new();
    let mut at = 0;
    while number::<4>(archive, at) == 0x0403_4b50 {
        // Stored, with no data descriptor, and with the earliest date.
        let fields = |at| [0, 2, 4].map(|field| number::<2>(archive, at + field));
        assert_eq!(fields(at + 4), [45, 0, 0]);
        assert_eq!(number::<4>(archive, at + 10), 0x0021_0000);
        let [crc, size, length] = [14, 18, 22].map(|field| number::<4>(archive, at + field));
        assert_eq!(size, length);
        let start = at + 30 + number::<2>(archive, at + 26) as usize;
        assert_eq!(number::<2>(archive, at + 28), 0, "extra");
        let name = archive[at + 30..start].to_vec();
        let member = &archive[start..start + size as usize];
        let mut sum = !0u32;
        for &byte in member {
            sum ^= u32::from(byte);
            for _ in 0..8 {
                sum = sum >> 1 ^ (0xEDB8_8320 & (sum & 1).wrapping_neg());
            }
        }
        assert_eq!(u64::from(!sum), crc, "{name:?}");
        // The directory repeats the fields from the version on, and adds the offset.
        assert_eq!(number::<4>(archive, listed), 0x0201_4b50);
        assert_eq!(archive[listed + 6..listed + 32], archive[at + 4..at + 30]);
        assert_eq!(number::<4>(archive, listed + 42) as usize, at);
        assert_eq!(archive[listed + 46..][..name.len()], name);
        listed += 46 + name.len();
        members.insert(String::from_utf8(name).expect("text"), member);
        at = start + size as usize;
    }
    assert_eq!((at, listed), (number::<4>(archive, end + 16) as usize, end));
    assert_eq!(number::<2>(archive, end + 10) as usize, members.len());
    members
}

#[test]
fn an_npz_holds_what_its_headers_say() {
    let source = motion(5, 40);
    let archive = npz(&source);
    let members = members(&archive);
    let body = |name: &str| {
        let array = members[name];
        let head = 10 + number::<2>(array, 8) as usize;
        (String::from_utf8_lossy(&array[10..head]).into_owned(), &array[head..])
    };
    let (head, positions) = body("positions_mm.npy");
    assert!(head.contains("'<f4'") && head.contains("(40, 5, 3,)"), "{head}");
    let words: Vec<f32> = positions.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect();
    assert_eq!(words.len(), 600);
    for (found, &expected) in words.as_chunks::<3>().0.iter().zip(&source.positions_mm) {
        assert!(is_gap(*found) == is_gap(expected) && (is_gap(expected) || *found == expected));
    }
    let (head, times) = body("time_s.npy");
    assert!(head.contains("(40,)") && times.len() == 320, "{head}");
    assert_eq!(f64::from_le_bytes(times[312..].try_into().expect("eight")), 0.39);
    assert_eq!(body("labelled.npy").1, [1, 1, 1, 0, 1]);
    assert_eq!(body("first_frame.npy").1, 7u64.to_le_bytes());
    assert_eq!(body("event_frame.npy").1, [0u64, 20].map(u64::to_le_bytes).as_flattened());
    assert!(body("event_label.npy").0.contains("'<U8'"), "{}", body("event_label.npy").0);
    assert_eq!(members.len(), 12);
    assert_eq!(npz(&source), archive);
}

#[test]
fn an_npz_whose_labels_would_need_gigabytes_is_refused() {
    let mut source = motion(200, 1);
    source.info.markers[0].label = "x".repeat(1 << 20);
    let error = npz::write(&mut MotionFrames::new(&source), &mut Cursor::new(Vec::new()));
    assert!(
        matches!(&error, Err(InterchangeError::Unsupported(text)) if text.contains(&(1 << 20).to_string())),
        "{error:?}"
    );
}

/// Tags and contents of all chunks.
fn chunks(file: &[u8]) -> Vec<(u64, &[u8])> {
    assert_eq!(&file[..4], b"XDF:");
    let mut at = 4;
    let mut chunks = Vec::new();
    while at < file.len() {
        let width = usize::from(file[at]);
        let length = match width {
            1 => number::<1>(file, at + 1),
            4 => number::<4>(file, at + 1),
            8 => number::<8>(file, at + 1),
            other => panic!("a length of {other} bytes"),
        } as usize;
        let start = at + 1 + width;
        chunks.push((number::<2>(file, start), &file[start + 2..start + length]));
        at = start + length;
    }
    assert_eq!(at, file.len());
    chunks
}

#[test]
fn an_xdf_is_a_sequence_of_chunks() {
    let source = motion(300, 70);
    let file = write(Format::Xdf, &source);
    let chunks = chunks(&file);
    let tags: Vec<u64> = chunks.iter().map(|&(tag, _)| tag).collect();
    assert_eq!(tags[..7], [1, 2, 4, 2, 4, 3, 6]);
    assert!(tags[7..tags.len() - 1].iter().all(|&tag| tag == 3) && tags.last() == Some(&6));
    let head = std::str::from_utf8(&chunks[1].1[4..]).expect("text");
    assert!(
        head.contains("<channel_count>900</channel_count>")
            && head.contains("<label>same#2.y</label>")
    );
    assert!(head.contains("&lt;a&gt; &amp; \"b\" \u{4e2d}.x<"), "{head}");
    let (mut n, mut gaps) = (0u64, 0);
    for (_, content) in chunks.iter().filter(|(tag, content)| *tag == 3 && content[0] == 1) {
        let width = usize::from(content[4]);
        n += if width == 1 { number::<1>(content, 5) } else { number::<4>(content, 5) };
        for sample in content[5 + width..].chunks(9 + 3600) {
            assert_eq!(sample[0], 8);
            gaps += sample[9..]
                .as_chunks()
                .0
                .iter()
                .filter(|&&b| f32::from_le_bytes(b).is_nan())
                .count();
        }
    }
    let missing = source.positions_mm.iter().filter(|&&p| is_gap(p)).count();
    assert_eq!((n, gaps), (70, 3 * missing));
}

/// A folder in memory.
#[derive(Default)]
struct Files(BTreeMap<String, Vec<u8>>);

impl bids::DatasetFolder for Files {
    fn file(&mut self, path: &str) -> std::io::Result<Box<dyn Write + '_>> {
        Ok(Box::new(self.0.entry(path.to_owned()).or_default()))
    }

    fn common_file(&mut self, path: &str) -> std::io::Result<Box<dyn Write + '_>> {
        self.file(path)
    }
}

#[test]
fn a_bids_folder_has_one_column_per_coordinate() {
    let source = motion(300, 50);
    let names = bids::BidsLabels::new("7", None, "jump", None).expect("letters and digits");
    let mut files = Files::default();
    bids::write(&mut MotionFrames::new(&source), &names, &mut files).expect("memory");
    let text = |path: &str| String::from_utf8(files.0[path].clone()).expect("text");
    let of =
        |suffix: &str| text(&format!("sub-7/motion/sub-7_task-jump_tracksys-optical_{suffix}"));
    let rows: Vec<Vec<String>> = of("motion.tsv")
        .lines()
        .map(|line| line.split('\t').map(str::to_owned).collect())
        .collect();
    assert!(rows.len() == 50 && rows.iter().all(|row| row.len() == 900));
    assert_eq!(rows[0][9..12], ["n/a", "n/a", "n/a"]);
    assert_eq!(rows[1][..3], ["300", "-0.5", "75"]);
    let channels = of("channels.tsv");
    assert_eq!(channels.lines().count(), 901);
    assert!(channels.contains("\nsame#2_z\tz\tPOS\tsame#2\tmm\tglobal\n"), "{channels}");
    assert!(of("motion.json").contains("\"SamplingFrequency\": 100"));
    assert_eq!(
        of("events.tsv"),
        "onset\tduration\ttrial_type\tkind\n0\t0\tgo <now>\tmark\n0.25\t0\ttrigger\ttrigger\n"
    );
    assert_eq!(text("participants.tsv"), "participant_id\nsub-7\n");
}

#[test]
fn long_takes_and_none_at_all() {
    for (n_markers, n_frames) in [(1, 70_000), (0, 3), (300, 2)] {
        let source = motion(n_markers, n_frames);
        assert_eq!(members(&npz(&source)).len(), 12);
        assert!(chunks(&write(Format::Xdf, &source)).len() >= 5);
        let names = bids::BidsLabels::new("7", None, "jump", None).expect("letters and digits");
        let mut files = Files::default();
        let written = bids::write(&mut MotionFrames::new(&source), &names, &mut files);
        assert_eq!(written.is_ok(), n_markers > 0);
    }
}

#[test]
fn export_only_formats_say_so() {
    for format in [Format::Npz, Format::Xdf, Format::Bids, Format::Mot] {
        assert!(!format.is_read());
        let error = format.read(b"PK").expect_err("written only");
        assert!(matches!(error, InterchangeError::Unsupported(_)), "{error:?}");
        let message = error.to_string();
        for readable in ["c3d", "trc", "tsv", "csv"] {
            assert!(message.contains(readable), "{message}");
        }
    }
    let mut out = Vec::new();
    for format in [Format::Bids, Format::Npz] {
        assert!(format.write(&mut MotionFrames::new(&motion(1, 1)), &mut out).is_err());
    }
}
