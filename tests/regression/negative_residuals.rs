//! Fourth words that all say "missing" for real coordinates, and coordinates for which only some do.

use mocapd_take::{
    interchange::{Format, RotatedFrames},
    motion::{Ambiguity, Motion, MotionFrames, UpAxis, is_gap},
};

use crate::{
    cli::Folder,
    support::c3d_file::{C3dFile, Order},
};

/// Two markers over ten frames with these fourth words.
fn file(fourth: impl Fn(usize, usize) -> f32) -> C3dFile {
    let frames = (0..10)
        .map(|frame| {
            let at = |marker: usize| {
                [100.25 + frame as f32, 20.0 * marker as f32, 1000.5, fourth(frame, marker)]
            };
            [at(0), at(1)].concat()
        })
        .collect();
    let mut file = C3dFile::new(2, frames);
    file.texts(1, "LABELS", &["A", "B"]);
    file.texts(1, "Y_SCREEN", &["+Z"]);
    file
}

fn write(motion: &Motion) -> Vec<u8> {
    let mut bytes = Vec::new();
    Format::C3d.write(&mut MotionFrames::new(motion), &mut bytes).unwrap();
    bytes
}

/// The words of the data section.
pub(super) fn words(file: &[u8], n: usize) -> Vec<u32> {
    let start = (usize::from(u16::from_le_bytes([file[16], file[17]])) - 1) * 512;
    file[start..].as_chunks().0.iter().take(n).map(|&b| u32::from_le_bytes(b)).collect()
}

#[test]
fn coordinates_are_samples_where_every_fourth_word_is_negative() {
    for missing in [-1.0, 65535.0] {
        let mut file = file(|_, _| missing);
        file.frames[3][..3].copy_from_slice(&[0.0; 3]);
        let motion = Format::C3d.read(&file.bytes()).unwrap();
        let gaps: Vec<usize> = (0..20).filter(|&i| is_gap(motion.positions_mm[i])).collect();
        assert_eq!(gaps, [6], "zeros are a missing sample");
        assert_eq!(motion.frame(9)[1], [109.25, 20.0, 1000.5]);
        assert_eq!(motion.info.source.ambiguities, [Ambiguity::FourthWords { samples: 19 }]);
        // Written again, they are valid samples for other readers as well.
        let back = Format::C3d.read(&write(&motion)).unwrap();
        assert_eq!(back.frame(9), motion.frame(9));
        assert_eq!(back.info.source.ambiguities, []);
    }
    // Without coordinates every sample is missing.
    let nothing = C3dFile::new(1, vec![vec![0.0, 0.0, 0.0, -1.0]; 5]);
    let motion = Format::C3d.read(&nothing.bytes()).unwrap();
    assert!(motion.positions_mm.iter().all(|&at| is_gap(at)));
    assert_eq!(motion.info.source.ambiguities, []);
}

#[test]
fn coordinates_under_gaps_come_back_to_the_bit() {
    let file = file(|frame, marker| match (frame, marker) {
        (2 | 7, 1) => -1.0,
        (4, 1) => -2.5,
        (5, 1) => 65535.0,
        _ => 0.0,
    });
    let bytes = file.bytes();
    let motion = Format::C3d.read(&bytes).unwrap();
    assert!([2, 4, 5, 7].iter().all(|&frame| is_gap(motion.frame(frame)[1])));
    assert_eq!(motion.info.source.ambiguities, [Ambiguity::CoordinatesUnderGaps { samples: 4 }]);
    assert_eq!(words(&write(&motion), 80), words(&bytes, 80));
    // Through a take, whole and cut.
    let folder = Folder::new();
    folder.write("a.c3d", &bytes);
    folder.run(&["import", "a.c3d", "-o", "a.take", "--lossless"]).with_code(0);
    folder.run(&["export", "a.take", "-o", "whole.c3d"]).with_code(0);
    assert_eq!(words(&folder.read("whole.c3d"), 80), words(&bytes, 80));
    folder.run(&["export", "a.take", "-o", "part.c3d", "--from", "0.04s"]).with_code(0);
    assert_eq!(words(&folder.read("part.c3d"), 48), words(&bytes, 80)[32..]);
    let verify = ["verify", "a.take", "--against", "a.c3d", "--json"];
    let against = folder.run(&verify).with_code(0).json()["against"].clone();
    assert_eq!(against["ambiguities"][0]["kind"], "coordinates_under_gaps");
}

#[test]
fn coordinates_under_gaps_are_kept_in_as_many_bytes_as_they_need() {
    // Twenty markers, two runs under gaps in each of them, among two thousand frames.
    let (n_frames, n_markers) = (2000, 20);
    let is_under = |frame: usize, marker: usize| frame % 1000 == 7 * marker || frame == marker;
    let frame = |frame: usize| {
        let marker = |marker: usize| {
            let fourth = if is_under(frame, marker) { -1.0 } else { 0.0 };
            [frame as f32, marker as f32, 1000.5, fourth]
        };
        (0..n_markers).flat_map(marker).collect()
    };
    let bytes = C3dFile::new(n_markers, (0..n_frames).map(frame).collect()).bytes();
    let motion = Format::C3d.read(&bytes).unwrap();
    let n_under: usize =
        (0..n_frames).map(|f| (0..n_markers).filter(|&m| is_under(f, m)).count()).sum();
    let kept = motion.info.foreign.iter().find(|part| part.kind == "c3d/gap-coordinates").unwrap();
    assert!(kept.data.len() <= (40 * n_under + 16 * n_markers) as u64, "{} bytes", kept.data.len());
    let n_words = 4 * n_frames * n_markers;
    assert_eq!(words(&write(&motion), n_words), words(&bytes, n_words));
}

#[test]
fn coordinates_under_gaps_are_scaled_and_turned_with_the_others() {
    for order in [Order::Intel, Order::Dec, Order::Mips] {
        let frames = vec![vec![10.0, 20.0, 30.0, 0.0], vec![11.0, 21.0, 31.0, -1.0]];
        let mut file = C3dFile { order, scale: 0.5, unit: "cm", ..C3dFile::new(1, frames) };
        file.texts(1, "Y_SCREEN", &["+Z"]);
        let motion = Format::C3d.read(&file.bytes()).unwrap();
        let floats =
            |bytes: &[u8]| words(bytes, 8).into_iter().map(f32::from_bits).collect::<Vec<_>>();
        assert_eq!(floats(&write(&motion)), [50.0, 100.0, 150.0, 0.0, 55.0, 105.0, 155.0, -1.0]);
        let mut frames = MotionFrames::new(&motion);
        let mut turned = RotatedFrames::new(&mut frames, UpAxis::Y).unwrap().unwrap();
        let mut bytes = Vec::new();
        Format::C3d.write(&mut turned, &mut bytes).unwrap();
        assert_eq!(floats(&bytes), [50.0, 150.0, -100.0, 0.0, 55.0, 155.0, -105.0, -1.0]);
        assert_eq!(Format::C3d.read(&bytes).unwrap().info.up, UpAxis::Y);
    }
}
