//! `export` to a page: its positions, its size, and its decoder in JavaScript, which must give the same bits.

use std::{path::Path, process::Command};

use mocapd_take::{
    interchange::page_motion::{Lattice, decode_block},
    motion::{Motion, MotionEvent, Position, is_gap},
    record::EventKind,
};
use serde_json::{Value, json};

use super::Folder;
use crate::support::{assert_mentions, jump, rows};

/// What a page contains: its overview, and the bytes of its blocks.
struct Page {
    overview: Value,
    blocks: Vec<Vec<u8>>,
}

impl Page {
    fn parse(text: &str) -> Self {
        let part = |from: &str| {
            text.split_once(from).unwrap().1.split_once("</script>").unwrap().0.to_owned()
        };
        let overview = part("<script id=\"take\" type=\"application/json\">");
        let motion = part("<script id=\"motion\" type=\"text/plain\">");
        Self {
            overview: serde_json::from_str(&overview).unwrap(),
            // An empty line is a block, too: all its bits are 0.
            blocks: motion.strip_prefix('\n').unwrap().lines().map(bytes_of).collect(),
        }
    }

    fn number(&self, name: &str) -> f64 {
        self.overview["page"][name].as_f64().unwrap()
    }

    /// The positions by frame, decoded here.
    fn frames(&self) -> Vec<Vec<Position>> {
        let n_markers = self.overview["markers"].as_u64().unwrap() as usize;
        let n_frames = self.overview["frames"].as_u64().unwrap() as usize;
        let of_block = self.number("block_frames") as usize;
        let lattice =
            Lattice { added_mm: self.number("added_mm"), step_mm: self.number("step_mm") };
        let mut frames = Vec::new();
        for block in &self.blocks {
            let n = of_block.min(n_frames - frames.len());
            let positions = decode_block(block, n_markers, n, lattice);
            frames.extend(positions.chunks(n_markers).map(<[Position]>::to_vec));
        }
        frames
    }
}

/// The bytes of base64.
fn bytes_of(line: &str) -> Vec<u8> {
    let value = |digit: u8| match digit {
        b'A'..=b'Z' => u32::from(digit - b'A'),
        b'a'..=b'z' => u32::from(digit - b'a') + 26,
        b'0'..=b'9' => u32::from(digit - b'0') + 52,
        b'+' => 62,
        _ => 63,
    };
    let digits: Vec<u8> = line.bytes().filter(|digit| *digit != b'=').collect();
    let mut bytes = Vec::new();
    for four in digits.chunks(4) {
        let word = four.iter().fold(0, |word, digit| word << 6 | value(*digit));
        let word = word << (6 * (4 - four.len()));
        bytes.extend_from_slice(&word.to_be_bytes()[1..four.len()]);
    }
    bytes
}

fn distance_mm(a: Position, b: Position) -> f64 {
    a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(b)).powi(2)).sum::<f64>().sqrt()
}

/// Compares a page with the frames of its original.
fn assert_within(page: &Page, original: &[Vec<Position>], bound_mm: f64) {
    let frames = page.frames();
    assert_eq!(frames.len(), original.len());
    for (row, (found, given)) in frames.iter().zip(original).enumerate() {
        for (marker, (a, b)) in found.iter().zip(given).enumerate() {
            assert_eq!(is_gap(*a), is_gap(*b), "frame {row}, marker {marker}");
            let apart = if is_gap(*a) { 0.0 } else { distance_mm(*a, *b) };
            assert!(apart <= bound_mm, "frame {row}, marker {marker}: {apart} mm");
        }
    }
}

/// A folder with a motion file and its take.
fn folder(motion: &Motion, options: &[&str]) -> Folder {
    let folder = Folder::new();
    folder.write_motion("jump.csv", motion);
    folder.run(&[&["import", "jump.csv", "-o", "jump.take"], options].concat()).with_code(0);
    folder
}

fn frames_of(motion: &Motion) -> Vec<Vec<Position>> {
    (0..motion.n_frames()).map(|row| motion.frame(row).to_vec()).collect()
}

#[test]
fn positions_on_a_page_are_within_the_tolerance_that_is_stated() {
    let motion = jump(3, 120.0, 20.0);
    for (options, extra, total) in [
        (&["--tolerance", "0.5mm"][..], &[][..], 1.0),
        (&["--tolerance", "0.5mm"], &["--tolerance", "0.6mm"], 0.6),
        (&["--tolerance", "20mm"], &[], 40.0),
        (&["--lossless"], &[], 0.1),
    ] {
        let folder = folder(&motion, options);
        let args = [&["export", "jump.take", "-o", "jump.html", "--json"], extra].concat();
        let report = folder.run(&args).with_code(0).json();
        let page = Page::parse(&folder.text("jump.html"));
        for name in ["tolerance_mm", "added_mm", "max_added_mm"] {
            assert_eq!(report["page"][name], page.overview["page"][name], "{name}");
        }
        let stated = page.number("tolerance_mm");
        assert!((stated - total).abs() < 1e-9, "{stated} mm, not {total}");
        assert_within(&page, &frames_of(&motion), stated);
        let decoded = rows(&folder.read("jump.take")).0;
        assert_within(&page, &decoded, page.number("max_added_mm"));
        assert!(page.number("max_added_mm") <= page.number("added_mm"));
        let bound = 3 * folder.read("jump.take").len() + 150_000;
        assert!(folder.read("jump.html").len() <= bound, "{options:?}");
    }
}

#[test]
fn the_report_states_the_tolerance() {
    let folder = folder(&jump(1, 60.0, 2.0), &[]);
    let ran = folder.run(&["export", "jump.take", "-o", "jump.html"]).with_code(0);
    assert_mentions(
        &ran.stderr,
        &["jump.html", "within 1 mm", "take within 0.5 mm", "adds at most"],
    );
    for (value, format) in [("0.5mm", "jump2.html"), ("0.4mm", "jump2.html"), ("1mm", "jump2.csv")]
    {
        let line = folder.refuses(&["export", "jump.take", "-o", format, "--tolerance", value], 2);
        assert_mentions(&line, &["--tolerance"]);
    }
}

#[test]
fn a_page_of_a_part_has_its_frames_events_and_gaps() {
    let mut motion = jump(2, 100.0, 4.0);
    for (frame, text) in [(50, "before"), (150, "</script><script>alert(1)"), (390, "after")] {
        motion.info.events.push(MotionEvent {
            frame,
            kind: EventKind::Mark,
            text: text.to_owned(),
        });
    }
    motion.info.markers[0].label = "</script><!--".to_owned();
    let folder = Folder::new();
    folder.write("jump.tsv", {
        let mut bytes = Vec::new();
        let mut frames = mocapd_take::motion::MotionFrames::new(&motion);
        mocapd_take::interchange::Format::Tsv.write(&mut frames, &mut bytes).unwrap();
        bytes
    });
    folder.run(&["import", "jump.tsv", "-o", "jump.take"]).with_code(0);
    let args = ["export", "jump.take", "-o", "p.html", "--from", "1s", "--to", "3s"];
    folder.run(&args).with_code(0);
    let page = Page::parse(&folder.text("p.html"));
    assert_eq!((&page.overview["frames"], &page.overview["seconds"]), (&json!(200), &json!(2.0)));
    assert_eq!(page.overview["labels"][0], "</script><!--");
    assert_eq!(page.overview["events"].as_array().unwrap().len(), 1);
    assert_eq!(page.overview["events"][0]["frame"], 50);
    let original = &frames_of(&motion)[100..300];
    assert_within(&page, original, page.number("tolerance_mm"));
    let gaps = &page.overview["page"]["gaps"];
    for (row, frame) in original.iter().enumerate() {
        let missing = frame.iter().filter(|at| is_gap(**at)).count();
        assert_eq!(gaps["missing_samples"][row], missing, "frame {row}");
    }
}

#[test]
fn a_page_of_a_damaged_take_says_so() {
    let motion = jump(6, 120.0, 60.0);
    let folder = folder(&motion, &[]);
    let mut take = folder.read("jump.take");
    let middle = take.len() / 2;
    take[middle..middle + 8].fill(0x55);
    folder.write("hurt.take", take);
    folder.run(&["export", "hurt.take", "-o", "hurt.html"]).with_code(3);
    let page = Page::parse(&folder.text("hurt.html"));
    assert_ne!(page.overview["problems_total"], 0, "{}", page.overview["problems"]);
    let lost = page.overview["page"]["gaps"]["lost_frames"].as_array().unwrap();
    let empty = page.frames().iter().filter(|row| row.iter().all(|at| is_gap(*at))).count();
    let lost: u64 = lost.iter().map(|n| n.as_u64().unwrap()).sum();
    assert!(lost > 0 && lost as usize == empty, "{lost} lost, {empty} without a marker");
}

/// The decoder of the page, in JavaScript, run by Node.
#[test]
fn the_decoder_of_the_page_gives_the_same_bits() {
    let Ok(node) = Command::new("node").arg("--version").output() else {
        eprintln!(
            "skipped: there is no node; the test of the dashboard decodes pages in a browser"
        );
        return;
    };
    assert!(node.status.success());
    let mut far = jump(5, 120.0, 12.0);
    far.positions_mm[7] = [2.5e9, -1.0, f32::MIN_POSITIVE];
    far.positions_mm[700] = [1e30, 0.0, -1e30];
    for (motion, options) in
        [(&jump(4, 240.0, 15.0), &["--tolerance", "0.5mm"][..]), (&far, &["--lossless"])]
    {
        let folder = folder(motion, options);
        folder.run(&["export", "jump.take", "-o", "jump.html"]).with_code(0);
        let page = Page::parse(&folder.text("jump.html"));
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/dashboard/decode_page.mjs");
        let ran = Command::new("node").arg(script).arg(folder.path("jump.html")).output().unwrap();
        assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
        let found: Vec<u32> = ran
            .stdout
            .chunks_exact(4)
            .map(|bytes| u32::from_le_bytes(bytes.try_into().unwrap()))
            .collect();
        // NaN has no sign that decoders agree on.
        let bits = |v: f32| if v.is_nan() { f32::NAN.to_bits() } else { v.to_bits() };
        let expected: Vec<u32> = page.frames().into_iter().flatten().flatten().map(bits).collect();
        let found: Vec<u32> = found.into_iter().map(|v| bits(f32::from_bits(v))).collect();
        assert_eq!(found.len(), expected.len());
        let differ = found.iter().zip(&expected).position(|(a, b)| a != b);
        assert_eq!(differ, None);
    }
}
