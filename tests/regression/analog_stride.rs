//! A C3D whose figures disagree about its frames is read by its bytes, or refused.

use mocapd_take::{
    interchange::{Format, InterchangeError},
    motion::{Ambiguity, Motion},
};

use crate::{
    cli::Folder,
    support::c3d_file::{C3dFile, Order},
};

const POINTS: usize = 5;
const CHANNELS: usize = 3;
const RATIO: usize = 10;
const FRAMES: usize = 60;

/// Offsets of the header's words.
const HEADER_POINTS: usize = 2;
const HEADER_ANALOG: usize = 4;
const HEADER_RATIO: usize = 18;

/// Position of a marker: all move on from frame to frame, each along its own path.
fn position(frame: usize, point: usize) -> [f32; 3] {
    let (t, p) = (frame as f32 / 100.0, point as f32);
    [
        300.0 * p + 200.0 * (3.0 * t + p).sin(),
        900.0 - 150.0 * p + 80.0 * (5.0 * t).cos(),
        400.0 * (p - 2.0) + 500.0 * t,
    ]
}

/// Analog samples that are not motion.
fn analog(frame: usize, sample: usize) -> f32 {
    ((frame * 31 + sample * 17) % 97) as f32 * 20.0 - 900.0
}

/// The parameters of a file.
#[derive(Clone, Copy)]
struct Figures {
    points_used: usize,
    channels_used: usize,
    analog_hz: f32,
}

const TRUE: Figures = Figures { points_used: POINTS, channels_used: CHANNELS, analog_hz: 1000.0 };

fn file(order: Order, scale: f32, n_channels: usize, figures: Figures) -> Vec<u8> {
    let frames = (0..FRAMES)
        .map(|frame| {
            let mut words = Vec::new();
            for point in 0..POINTS {
                let at = position(frame, point);
                words.extend(at.map(|v| if scale > 0.0 { (v / scale).round() } else { v }));
                words.push(0.0);
            }
            words.extend((0..n_channels * RATIO).map(|sample| analog(frame, sample)));
            words
        })
        .collect();
    let mut file = C3dFile {
        order,
        scale,
        analog: (n_channels, RATIO),
        ..C3dFile::new(figures.points_used, frames)
    };
    file.texts(1, "LABELS", &["A", "B", "C", "D", "E"]);
    file.words(1, "FRAMES", &[FRAMES as u16]);
    file.records.extend(file.group(2, "ANALOG"));
    file.words(2, "USED", &[figures.channels_used as u16]);
    file.floats(2, "RATE", &[figures.analog_hz]);
    let mut bytes = file.bytes();
    put(&mut bytes, order, HEADER_POINTS, POINTS);
    bytes
}

fn put(bytes: &mut [u8], order: Order, at: usize, word: usize) {
    bytes[at..at + 2].copy_from_slice(&order.word(word as u16));
}

fn read(bytes: &[u8]) -> Motion {
    Format::C3d.read(bytes).unwrap()
}

/// Asserts that every marker is at its position in every frame.
fn assert_true(motion: &Motion, scale: f32, what: &str) {
    assert_eq!((motion.info.markers.len(), motion.n_frames()), (POINTS, FRAMES), "{what}");
    let apart = if scale > 0.0 { scale } else { 1e-3 };
    for frame in 0..FRAMES {
        for (point, found) in motion.frame(frame).iter().enumerate() {
            let is_there =
                position(frame, point).iter().zip(found).all(|(a, b)| (a - b).abs() <= apart);
            assert!(is_there, "{what}: frame {frame}, marker {point}: {found:?}");
        }
    }
}

fn is_noted(motion: &Motion) -> bool {
    motion.info.source.ambiguities.iter().any(|a| matches!(a, Ambiguity::FrameLayout { .. }))
}

#[test]
fn analog_samples_are_counted_by_what_accounts_for_the_bytes() {
    for order in [Order::Intel, Order::Dec, Order::Mips] {
        for scale in [-1.0, 0.1] {
            let agreed = read(&file(order, scale, CHANNELS, TRUE));
            assert_true(&agreed, scale, "all agree");
            assert!(!is_noted(&agreed), "{:?}", agreed.info.source.warnings);
            // The header is wrong: 0, the number of channels, half of the true number, all samples of one channel.
            for (words, ratio) in [(0, 0), (CHANNELS, 1), (CHANNELS, RATIO), (15, 5), (31, RATIO)] {
                let mut bytes = file(order, scale, CHANNELS, TRUE);
                put(&mut bytes, order, HEADER_ANALOG, words);
                put(&mut bytes, order, HEADER_RATIO, ratio);
                let motion = read(&bytes);
                let what = format!("{order:?} {scale}: header {words} and {ratio}");
                assert_true(&motion, scale, &what);
                assert!(is_noted(&motion), "{what}: {:?}", motion.info.source.warnings);
            }
            // The parameters are wrong: the channels, and the rate.
            for figures in [
                Figures { channels_used: 8, ..TRUE },
                Figures { channels_used: 0, ..TRUE },
                Figures { analog_hz: 2000.0, ..TRUE },
            ] {
                let motion = read(&file(order, scale, CHANNELS, figures));
                let what =
                    format!("{order:?} {scale}: {} {}", figures.channels_used, figures.analog_hz);
                assert_true(&motion, scale, &what);
                assert!(is_noted(&motion), "{what}: {:?}", motion.info.source.warnings);
            }
        }
    }
}

#[test]
fn points_are_counted_by_what_accounts_for_the_bytes() {
    for (header, used) in [(POINTS, POINTS + 1), (POINTS + 1, POINTS), (POINTS, 2), (255, POINTS)] {
        let figures = Figures { points_used: used, ..TRUE };
        for n_channels in [0, CHANNELS] {
            let figures = Figures { channels_used: n_channels, ..figures };
            let mut bytes = file(Order::Intel, -1.0, n_channels, figures);
            put(&mut bytes, Order::Intel, HEADER_POINTS, header);
            let motion = read(&bytes);
            let what = format!("header {header}, POINT:USED {used}, {n_channels} channels");
            assert_true(&motion, -1.0, &what);
            assert!(is_noted(&motion), "{what}");
        }
    }
}

#[test]
fn if_all_figures_are_wrong_the_size_decides() {
    // Header and parameters agree on analog samples that the file does not have.
    let mut bytes = file(Order::Intel, -1.0, 0, TRUE);
    put(&mut bytes, Order::Intel, HEADER_ANALOG, CHANNELS * RATIO);
    let motion = read(&bytes);
    assert_true(&motion, -1.0, "no analog samples");
    assert!(is_noted(&motion));
}

#[test]
fn unexplained_sizes_are_refused_with_their_figures() {
    let mut bytes = file(Order::Intel, -1.0, CHANNELS, TRUE);
    put(&mut bytes, Order::Intel, HEADER_ANALOG, 77);
    put(&mut bytes, Order::Intel, HEADER_RATIO, 7);
    // The data are noise, of a length that matches none of the figures.
    let start = (usize::from(u16::from_le_bytes([bytes[16], bytes[17]])) - 1) * 512;
    bytes.truncate(bytes.len() - 1000);
    let mut noise = 1u32;
    for word in bytes[start..].as_chunks_mut::<4>().0 {
        noise ^= noise << 13;
        noise ^= noise >> 17;
        noise ^= noise << 5;
        *word = ((noise % 4000) as f32 - 2000.0).to_le_bytes();
    }
    let error = Format::C3d.read(&bytes).unwrap_err();
    let InterchangeError::Malformed { message, .. } = &error else { panic!("{error}") };
    for figure in ["77", "ANALOG:USED 3", "times 7", "or 10", &(bytes.len() - start).to_string()] {
        assert!(message.contains(figure), "{figure}: {message}");
    }
    let folder = Folder::new();
    folder.write("noise.c3d", &bytes);
    folder.refuses(&["import", "noise.c3d", "-o", "noise.take"], 1);
}

#[test]
fn a_truncated_file_is_read_to_its_end_whether_its_figures_agree_or_not() {
    for disagrees in [false, true] {
        let mut bytes = file(Order::Intel, -1.0, CHANNELS, TRUE);
        if disagrees {
            put(&mut bytes, Order::Intel, HEADER_ANALOG, CHANNELS);
            put(&mut bytes, Order::Intel, HEADER_RATIO, 1);
        }
        bytes.truncate(bytes.len() - 20 * 4 * (4 * POINTS + CHANNELS * RATIO));
        let motion = read(&bytes);
        assert_eq!((motion.n_frames(), motion.info.source.frames_missing), (FRAMES - 20, 20));
        assert_eq!(motion.frame(39)[4], position(39, 4));
        assert_eq!(is_noted(&motion), disagrees);
    }
}

#[test]
fn a_truncated_file_with_analog_samples_only_in_its_header_is_read_by_its_motion() {
    let frame = |frame| (0..POINTS).flat_map(move |p| position(frame, p).into_iter().chain([0.0]));
    let frames = (0..FRAMES).map(|i| frame(i).collect()).collect();
    let mut bytes = C3dFile::new(POINTS, frames).bytes();
    put(&mut bytes, Order::Intel, HEADER_ANALOG, 8);
    bytes.truncate(bytes.len() - 20 * 16 * POINTS);
    let motion = read(&bytes);
    assert_eq!((motion.n_frames(), is_noted(&motion)), (FRAMES - 20, true));
    assert_eq!(motion.frame(39)[4], position(39, 4));
}

/// The points and analog samples of a consistent file.
#[derive(Debug, Clone, Copy)]
enum Content {
    Moving,
    Still,
    Missing,
    /// Markers that jump at random.
    Restless,
}

/// A file whose figures agree: points, channels, samples a frame and channel, frames.
fn honest(content: Content, shape: [usize; 4], is_slow: bool) -> Vec<u8> {
    let [n_points, n_channels, ratio, n_frames] = shape;
    let frame = |frame: usize| {
        let mut words = Vec::new();
        for point in 0..n_points {
            let jump = (frame * 7919 + point * 104_729) % 1009;
            let [x, y, z] = match content {
                Content::Moving => position(frame, point),
                Content::Still => position(0, point),
                Content::Missing => [0.0; 3],
                Content::Restless => position(frame, point).map(|v| v + 3.0 * jump as f32),
            };
            words.extend([x, y, z, if matches!(content, Content::Missing) { -1.0 } else { 0.0 }]);
        }
        words.extend((0..n_channels * ratio).map(|sample| {
            // A force plate under a standing person, which is smoother than any marker.
            let slow = 400.0 + (frame * n_channels * ratio + sample) as f32 / 10.0;
            if is_slow { slow } else { analog(frame, sample) }
        }));
        words
    };
    let frames = (0..n_frames).map(frame).collect();
    let mut file = C3dFile { analog: (n_channels, ratio), ..C3dFile::new(n_points, frames) };
    file.words(1, "FRAMES", &[n_frames as u16]);
    file.records.extend(file.group(2, "ANALOG"));
    file.words(2, "USED", &[n_channels as u16]);
    file.floats(2, "RATE", &[100.0 * ratio as f32]);
    file.bytes()
}

#[test]
fn an_honest_file_that_was_cut_off_keeps_its_stride() {
    let contents = [Content::Moving, Content::Still, Content::Missing, Content::Restless];
    let shapes = [[1, 1, 1], [1, 6, 10], [2, 1, 100], [5, 3, 10], [9, 0, 0]];
    let data_start =
        |bytes: &[u8]| (usize::from(u16::from_le_bytes([bytes[16], bytes[17]])) - 1) * 512;
    for (content, [points, channels, ratio], n_frames, is_slow) in contents
        .into_iter()
        .flat_map(|content| shapes.map(|shape| (content, shape)))
        .flat_map(|(content, shape)| [3, 40].map(|n_frames| (content, shape, n_frames)))
        .flat_map(|(content, shape, n)| [true, false].map(|is_slow| (content, shape, n, is_slow)))
    {
        let bytes = honest(content, [points, channels, ratio, n_frames], is_slow);
        let whole = read(&bytes);
        assert!(!is_noted(&whole), "{content:?}, {points} points, {channels} times {ratio}");
        let frame_bytes = 4 * (4 * points + channels * ratio);
        for n_present in 1..n_frames {
            for more in [0, frame_bytes / 2] {
                let cut = &bytes[..data_start(&bytes) + n_present * frame_bytes + more];
                let motion = read(cut);
                let what = format!(
                    "{content:?}, {points} points, {channels} times {ratio}, slow {is_slow}, {n_present} of {n_frames}"
                );
                assert_eq!(motion.n_frames(), n_present, "{what}");
                assert!(!is_noted(&motion), "{what}");
                let expected = &whole.positions_mm[..n_present * points];
                let bits = |at: &[f32; 3]| at.map(f32::to_bits);
                assert!(
                    motion.positions_mm.iter().map(bits).eq(expected.iter().map(bits)),
                    "{what}"
                );
            }
        }
    }
}

#[test]
fn verify_reports_ambiguities_of_the_file() {
    let folder = Folder::new();
    let mut bytes = file(Order::Intel, -1.0, CHANNELS, TRUE);
    put(&mut bytes, Order::Intel, HEADER_ANALOG, 0);
    folder.write("odd.c3d", &bytes);
    folder.run(&["import", "odd.c3d", "-o", "odd.take", "--lossless"]).with_code(0);
    let ran = folder.run(&["verify", "odd.take", "--against", "odd.c3d", "--json"]).with_code(0);
    assert_eq!(ran.json()["against"]["ambiguities"][0]["kind"], "frame_layout");
}
