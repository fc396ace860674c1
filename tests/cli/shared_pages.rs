//! `export` to a page: its positions, its size, and its decoder in JavaScript, which must give the same bits.

use std::{io::Cursor, path::Path, process::Command};

use mocapd_acquire::pipeline::PipelineConfig;
use mocapd_codec::Settings;
use mocapd_drivers::device::PoseFrame;
use mocapd_simulator::generator::{JumpSpec, Occlusion, RigidBodies};
use mocapd_take::{
    TakeMap,
    interchange::page_motion::{Lattice, decode_block, pose_of},
    motion::{Motion, MotionEvent, Position, is_gap},
    poses::{Pose, PosesByRow},
    record::EventKind,
};
use serde_json::{Value, json};

use super::Folder;
use crate::support::{TICK_HZ, assert_mentions, config, dense, feed, jump, lossless, rows, start};

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

    fn count(&self, name: &str) -> usize {
        self.overview[name].as_u64().unwrap() as usize
    }

    fn n_bodies(&self) -> usize {
        self.overview["page"]["bodies"].as_array().unwrap().len()
    }

    fn lattice(&self) -> Lattice {
        Lattice { added_mm: self.number("added_mm"), step_mm: self.number("step_mm") }
    }

    /// The trajectories of markers and bodies by block and frame, decoded here.
    fn decoded(&self) -> Vec<Vec<Vec<Position>>> {
        let n_columns = self.count("markers") + 2 * self.n_bodies();
        let of_block = self.number("block_frames") as usize;
        let blocks = self.blocks.iter().enumerate().map(|(i, block)| {
            let n = of_block.min(self.count("frames") - i * of_block);
            let positions = decode_block(block, n_columns, n, self.lattice());
            positions.chunks(n_columns).map(<[Position]>::to_vec).collect()
        });
        blocks.collect()
    }

    /// The positions of the markers by frame.
    fn frames(&self) -> Vec<Vec<Position>> {
        let n_markers = self.count("markers");
        let frames = self.decoded().into_iter().flatten();
        frames.map(|frame| frame[..n_markers].to_vec()).collect()
    }

    /// The poses of the bodies in a frame.
    fn poses(&self, frame: &[Position]) -> Vec<Pose> {
        let bodies = frame[self.count("markers")..].chunks_exact(2);
        bodies.map(|body| pose_of([body[0], body[1]], self.lattice())).collect()
    }

    /// Everything in the order of `decode_page.mjs`.
    fn values(&self) -> Vec<f32> {
        let mut values = Vec::new();
        for block in self.decoded() {
            for frame in &block {
                values.extend(frame[..self.count("markers")].as_flattened());
            }
            for pose in block.iter().flat_map(|frame| self.poses(frame)) {
                values.extend([f32::from(pose.state.code()), pose.residual_mm]);
                values.extend(pose.position_mm);
                values.extend(pose.quaternion);
            }
        }
        values
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

const BODIES: usize = 5;

/// Occlusions of markers and bodies.
const OCCLUSION: Occlusion = Occlusion { fraction: 0.1, mean_gap_s: 0.2 };

/// A recorded jump of 20 s at 120 Hz with rigid bodies that are not tracked at times.
pub(super) fn with_bodies(codec: Settings) -> Vec<u8> {
    let motion = jump(9, 120.0, 20.0);
    let spec =
        JumpSpec { seconds: Some(20.0), occlusion: Some(OCCLUSION), ..JumpSpec::new(9, 120.0) };
    let bodies = RigidBodies::new(&spec, BODIES).unwrap();
    let config = PipelineConfig { bodies: bodies.infos(), ..config(&motion, codec) };
    let (mut intake, recording) = start(&config, Vec::new());
    let mut poses = Vec::new();
    for frame in 0..motion.n_frames() {
        while intake.is_full() {
            std::thread::yield_now();
        }
        feed(&mut intake, &motion, frame);
        bodies.poses(frame as u64, 120.0, &mut poses);
        let (seq, device_ticks) = (frame as u32, frame as u64 * TICK_HZ / 120);
        if frame % 100 != 99 {
            intake.poses(&PoseFrame { seq, number: seq, device_ticks, poses: &poses });
        }
    }
    drop(intake);
    recording.finish().unwrap().1
}

/// The poses of a take by row.
fn poses_of(take: &[u8]) -> Vec<Vec<Pose>> {
    let map = TakeMap::scan(&mut Cursor::new(take)).unwrap();
    let index = PosesByRow::read(Cursor::new(take), &map).unwrap().unwrap();
    let (mut read, mut poses, mut rows) = (index.rows(0..map.n_rows), Vec::new(), Vec::new());
    while read.next(&mut Cursor::new(take), 256, &mut poses).unwrap().is_some() {
        rows.extend(poses.chunks_exact(index.bodies().len()).map(<[Pose]>::to_vec));
    }
    rows
}

/// Where a body has a point of it that is 200 mm away.
fn tip(pose: &Pose, axis: usize) -> Position {
    let [w, x, y, z] = pose.quaternion.map(f64::from);
    let length = 200.0 / (w * w + x * x + y * y + z * z);
    let column = [
        [w * w + x * x - y * y - z * z, 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)],
        [2.0 * (x * y - w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z + w * x)],
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), w * w - x * x - y * y + z * z],
    ][axis];
    column.map(|v| (v * length) as f32)
}

#[test]
fn rigid_bodies_on_a_page_are_within_the_bounds_that_are_stated() {
    for (codec, name) in [(dense(0.5), "dense"), (lossless(), "lossless")] {
        let take = with_bodies(codec);
        let folder = Folder::new();
        folder.write("wand.take", &take);
        let ran = folder.run(&["export", "wand.take", "-o", "wand.html", "--json"]).with_code(0);
        let page = Page::parse(&folder.text("wand.html"));
        let angles = page.overview["page"]["angles"].clone();
        assert_eq!(ran.json()["page"]["angles"], angles);
        assert_eq!(ran.json()["not_supported"], json!([]), "nothing is left out");
        let [all, added, most] = ["tolerance_degrees", "added_degrees", "max_added_degrees"]
            .map(|name| angles[name].as_f64().unwrap());
        assert!(most > 0.0 && most <= added && added <= all, "{angles}");
        let given = poses_of(&take);
        let frames: Vec<_> = page.decoded().into_iter().flatten().collect();
        assert_eq!((frames.len(), given.len()), (2400, 2400));
        let bound_mm = page.number("max_added_mm");
        // The chord of the largest angle, and the rounding of both points.
        let tip_mm = 400.0 * (most.to_radians() / 2.0).sin() + 1e-4;
        let mut tracked = 0;
        for (row, (frame, given)) in frames.iter().zip(&given).enumerate() {
            for (body, (found, given)) in page.poses(frame).iter().zip(given).enumerate() {
                assert_eq!(found.state, given.state, "frame {row}, body {body}");
                if !given.is_tracked() {
                    continue;
                }
                tracked += 1;
                assert!(distance_mm(found.position_mm, given.position_mm) <= bound_mm);
                for axis in 0..3 {
                    let apart = distance_mm(tip(found, axis), tip(given, axis));
                    assert!(apart <= tip_mm, "frame {row}, body {body}: {apart} mm");
                }
            }
        }
        assert!(tracked > 8000, "{tracked}");
        let (bytes, of_take) = (folder.read("wand.html").len(), take.len());
        assert!(bytes <= 3 * of_take + 150_000, "{name}: {bytes} of {of_take}");
        println!("{name}: a page of {bytes} bytes of a take of {of_take}");
    }
}

#[test]
fn rigid_bodies_follow_the_part_of_a_page() {
    let take = with_bodies(dense(0.5));
    let folder = Folder::new();
    folder.write("wand.take", &take);
    folder
        .run(&["export", "wand.take", "-o", "part.html", "--from", "5s", "--to", "6s"])
        .with_code(0);
    let page = Page::parse(&folder.text("part.html"));
    let given = &poses_of(&take)[600..720];
    let frames: Vec<_> = page.decoded().into_iter().flatten().collect();
    assert_eq!(frames.len(), 120);
    for (frame, given) in frames.iter().zip(given) {
        for (found, given) in page.poses(frame).iter().zip(given) {
            assert_eq!(found.state, given.state);
            assert!(
                !given.is_tracked() || distance_mm(found.position_mm, given.position_mm) <= 0.5
            );
        }
    }
    let names = ["trunk", "l_thigh"].map(Value::from);
    let bodies = page.overview["page"]["bodies"].as_array().unwrap();
    assert!(names.iter().all(|name| bodies.contains(name)), "{bodies:?}");
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
    let mut pages = Vec::new();
    for (motion, options) in
        [(&jump(4, 240.0, 15.0), &["--tolerance", "0.5mm"][..]), (&far, &["--lossless"])]
    {
        pages.push(folder(motion, options));
    }
    for codec in [dense(0.5), lossless()] {
        pages.push(Folder::new());
        pages.last().unwrap().write("jump.take", with_bodies(codec));
    }
    for folder in pages {
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
        let expected: Vec<u32> = page.values().into_iter().map(bits).collect();
        let found: Vec<u32> = found.into_iter().map(|v| bits(f32::from_bits(v))).collect();
        assert_eq!(found.len(), expected.len());
        let differ = found.iter().zip(&expected).position(|(a, b)| a != b);
        assert_eq!(differ, None);
    }
}
