//! Everything that a C3D file holds besides markers returns on export.

use mocapd_take::interchange::{Format, InterchangeError};
use mocapd_take::motion::{
    Ambiguity, Foreign, FrameSource, Motion, MotionFrames, MotionInfo, Position,
};

use crate::c3d_file::{C3dFile, Order};

fn write(motion: &Motion) -> Vec<u8> {
    let mut bytes = Vec::new();
    Format::C3d.write(&mut MotionFrames::new(motion), &mut bytes).expect("memory");
    bytes
}

fn kept<'a>(motion: &'a Motion, kind: &str) -> Option<&'a Foreign> {
    motion.info.foreign.iter().find(|f| f.kind == kind)
}

/// Three points, the middle one a model output, and two analog channels with two samples per frame.
fn full(order: Order, scale: f32) -> C3dFile {
    let frames = (1..41)
        .map(|i| {
            let i = i as f32;
            let missing = if i == 8.0 { -1.0 } else { 258.0 };
            let mut frame =
                vec![i, 2.0 * i, -i, missing, 90.0 - i, 3.0, 0.0, 0.0, 5.0, i, 6.0, 3.0];
            frame.extend([100.0 + i, -200.0, 101.0 + i, -i]);
            frame
        })
        .collect();
    let mut file = C3dFile { order, scale, analog: (2, 2), ..C3dFile::new(3, frames) };
    file.texts(1, "LABELS", &["HEAD", "Knee", "*2"]);
    file.texts(1, "ANGLES", &["Knee"]);
    file.records.extend(file.group(2, "ANALOG"));
    file.words(2, "USED", &[2]);
    file.floats(2, "RATE", &[200.0]);
    file.texts(2, "LABELS", &["Fz", "EMG"]);
    file.records.extend(file.group(3, "FORCE_PLATFORM"));
    file.floats(3, "CORNERS", &[0.5, -1.0, 0.0]);
    file.records.extend(file.group(9, "SUBJECTS"));
    file.texts(9, "NAMES", &["Anne"]);
    file
}

#[test]
fn foreign_parts_are_restored_for_floats_and_integers_of_every_processor() {
    for order in [Order::Intel, Order::Dec, Order::Mips] {
        for scale in [-0.5f32, 0.25] {
            let source = Format::C3d.read(&full(order, scale).bytes()).expect("a usable file");
            let back = Format::C3d.read(&write(&source)).expect("a usable file");
            crate::assert_same_samples(&back, &source);
            assert_eq!(back.info.markers, source.info.markers);
            assert_eq!(back.info.source.warnings.len(), 1, "{order:?} {scale}");
            let under_gap = Ambiguity::CoordinatesUnderGaps { samples: 1 };
            assert_eq!(back.info.source.ambiguities, [under_gap], "{order:?} {scale}");
            // After the conversion to floats, nothing changes any more.
            let again = Format::C3d.read(&write(&back)).expect("a usable file");
            assert!(again.info == back.info && write(&again) == write(&back), "{order:?} {scale}");
            for kind in ["c3d/analog", "c3d/residuals", "c3d/model-outputs", "c3d/parameters"] {
                assert!(kept(&source, kind).is_some() && kept(&back, kind).is_some(), "{kind}");
            }
            if scale < 0.0 {
                for kind in ["c3d/analog", "c3d/residuals", "c3d/model-outputs"] {
                    assert_eq!(kept(&back, kind), kept(&source, kind), "{order:?}: {kind}");
                }
            }
        }
    }
}

#[test]
fn words_keep_their_positions() {
    let file = full(Order::Intel, -0.5);
    let written = write(&Format::C3d.read(&file.bytes()).expect("a usable file"));
    let start = (usize::from(u16::from_le_bytes([written[16], written[17]])) - 1) * 512;
    let words: Vec<f32> =
        written[start..].as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect();
    for (index, frame) in file.frames.iter().enumerate() {
        // Including the coordinates of the eighth frame, which is marked as missing.
        assert_eq!(words[index * 16..][..16], frame[..], "frame {index}");
    }
    assert!(written.len().is_multiple_of(512));
}

/// More frames than are read at a time, and more data besides the trajectories than fits in memory. All fourth words
/// are zero up to the middle of the file, and coordinates under gaps are where one block of frames follows another.
#[test]
fn a_file_of_several_blocks_is_restored() {
    const N_FRAMES: usize = 45_000;
    let frame = |frame: usize| {
        let mut words = Vec::with_capacity(140);
        for point in 0..30 {
            let at = [(frame + point) as f32, 40.5, -(frame as f32) / 3.0];
            let is_missing = (frame + 13 * point) % 97 < 5;
            words.extend(match (is_missing, point % 3) {
                (true, 0) => [at[0], at[1], at[2], -1.0],
                (true, _) => [0.0, 0.0, 0.0, -1.0],
                _ if frame < 20_000 + point => [at[0], at[1], at[2], 0.0],
                _ => [at[0], at[1], at[2], (frame % 7) as f32 / 4.0],
            });
        }
        words.extend((0..20).map(|sample| (frame * sample % 251) as f32));
        words
    };
    let frames = (0..N_FRAMES).map(frame).collect();
    let mut file = C3dFile { analog: (10, 2), ..C3dFile::new(30, frames) };
    file.texts(1, "LABELS", &["A", "B", "Knee"]);
    file.texts(1, "ANGLES", &["Knee"]);
    file.records.extend(file.group(2, "ANALOG"));
    file.words(2, "USED", &[10]);
    file.floats(2, "RATE", &[200.0]);
    let source = Format::C3d.read(&file.bytes()).expect("a usable file");
    let kept: u64 = source.info.foreign.iter().map(|part| part.data.len()).sum();
    assert!(kept > 8 << 20, "{kept} bytes beside the trajectories");
    let written = write(&source);
    let start = (usize::from(u16::from_le_bytes([written[16], written[17]])) - 1) * 512;
    let words: Vec<u32> =
        written[start..].as_chunks().0.iter().map(|&bytes| u32::from_le_bytes(bytes)).collect();
    for (index, frame) in file.frames.iter().enumerate() {
        let expected: Vec<u32> = frame.iter().map(|word| word.to_bits()).collect();
        assert_eq!(words[index * 140..][..140], expected, "frame {index}");
    }
}

#[test]
fn all_lengths_are_converted_to_millimetres() {
    let file = C3dFile { unit: "m", ..full(Order::Intel, -1.0) };
    let written = write(&Format::C3d.read(&file.bytes()).expect("a usable file"));
    let at =
        written.windows(7).position(|w| w == b"CORNERS").expect("the parameter") + 7 + 2 + 2 + 1;
    let corners: Vec<f32> =
        written[at..at + 12].as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect();
    assert_eq!(corners, [500.0, -1000.0, 0.0]);
}

/// The last frames of a motion.
struct Tail<'a> {
    info: MotionInfo,
    motion: &'a Motion,
    next: usize,
}

impl FrameSource for Tail<'_> {
    fn info(&self) -> &MotionInfo {
        &self.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> std::io::Result<bool> {
        let frame = self.motion.frame(self.next);
        self.next += 1;
        if !frame.is_empty() {
            row.copy_from_slice(frame);
        }
        Ok(!frame.is_empty())
    }
}

#[test]
fn a_part_of_a_take_gets_the_samples_of_its_own_frames() {
    let source = Format::C3d.read(&full(Order::Intel, -0.5).bytes()).expect("a usable file");
    let mut info = source.info.clone();
    info.n_frames = 10;
    info.source.first_frame += 30;
    let mut bytes = Vec::new();
    Format::C3d.write(&mut Tail { info, motion: &source, next: 30 }, &mut bytes).expect("memory");
    let start = (usize::from(u16::from_le_bytes([bytes[16], bytes[17]])) - 1) * 512;
    let words: Vec<f32> =
        bytes[start..].as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect();
    assert_eq!(words[..16], full(Order::Intel, -0.5).frames[30][..]);
}

#[test]
fn a_source_that_ends_early_is_an_error() {
    let source = Format::C3d.read(&full(Order::Intel, -0.5).bytes()).expect("a usable file");
    let mut info = source.info.clone();
    info.n_frames = 11;
    for format in [Format::C3d, Format::Trc] {
        let mut tail = Tail { info: info.clone(), motion: &source, next: 30 };
        let error = format.write(&mut tail, &mut Vec::new()).expect_err("10 of 11 frames");
        assert!(matches!(error, InterchangeError::Io(_)), "{error:?}");
        let message = error.to_string();
        assert!(message.contains("11 frames") && message.contains("10"), "{message}");
    }
}
