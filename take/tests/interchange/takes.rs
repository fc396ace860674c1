//! Real takes, if the machine has them.

use mocapd_take::interchange::Format;
use mocapd_take::motion::{Motion, MotionFrames, is_gap};
use mocapd_testkit::recorded::RecordedData;

use crate::assert_same_samples;

/// File, markers, frames, hertz, missing samples, number of the first frame, from ezc3d 1.7.2 (rolling: its 65535.0 is
/// -1) and plain text tools.
const TAKES: [(&str, usize, u64, f64, usize, u64); 13] = [
    ("baseball_pitch_48m_360hz_metres.c3d", 48, 592, 360.0, 0, 1),
    ("cmu_13_39_jump_15joints_60hz.csv", 15, 176, 60.0002, 0, 1),
    ("dance_28m_60hz_qtm.tsv", 28, 1500, 60.0, 0, 1),
    ("face_singing_38m_100hz_malformed_header.c3d", 38, 3000, 100.0, 3716, 1),
    ("free_motion_63p_60hz_67s_cm.c3d", 63, 4007, 60.00328826904297, 0, 1),
    ("gait_active_22m_200hz_gaps.c3d", 23, 2001, 200.0, 12620, 1),
    ("hand_gesture_83m_120hz.c3d", 83, 388, 120.0, 0, 995),
    ("rolling_68m_175hz_gaps.c3d", 68, 2305, 175.0, 35965, 1368),
    ("squat_jump_47m_120hz.trc", 47, 1200, 120.0, 0, 1),
    ("treadmill_run_44m_200hz.trc", 44, 2105, 200.0, 0, 1),
    ("unlabelled_cloud_400hz.trc", 37, 1313, 400.0, 33670, 1),
    ("walk_159p_unlabelled_120hz.c3d", 159, 323, 120.0, 1055, 695),
    ("walk_in_out_of_volume_44m_250hz.c3d", 44, 1249, 250.0, 27567, 1),
];

fn take(name: &str) -> Option<Motion> {
    let folder = RecordedData::Takes.folder()?;
    let path = folder.join(name);
    let bytes = std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    Some(
        Format::from_extension(&path).expect("a known ending").read(&bytes).expect("a usable file"),
    )
}

#[test]
fn real_takes_are_read_as_other_readers_read_them() {
    for (name, n_markers, n_frames, rate_hz, n_gaps, first_frame) in TAKES {
        let Some(motion) = take(name) else { return };
        assert_eq!(motion.info.markers.len(), n_markers, "{name}");
        assert_eq!(
            (motion.info.n_frames, motion.n_frames() as u64),
            (n_frames, n_frames),
            "{name}"
        );
        assert_eq!(motion.info.rate_hz, rate_hz, "{name}");
        assert_eq!(motion.positions_mm.iter().filter(|&&p| is_gap(p)).count(), n_gaps, "{name}");
        assert_eq!(motion.info.source.first_frame, first_frame, "{name}");
    }
}

#[test]
fn real_takes_come_back_from_every_format() {
    for (name, ..) in TAKES {
        let Some(motion) = take(name) else { return };
        for format in [Format::C3d, Format::Csv, Format::Trc, Format::Tsv] {
            let mut bytes = Vec::new();
            format.write(&mut MotionFrames::new(&motion), &mut bytes).expect("memory");
            let back = format.read(&bytes).expect("what was written");
            assert_same_samples(&back, &as_written(&motion, format));
        }
    }
}

/// Three zeros are a gap in QTM's files and may be one in TRC, so a sample exactly at the origin is written one
/// nanometre away from it.
fn as_written(motion: &Motion, format: Format) -> Motion {
    let mut motion = motion.clone();
    if matches!(format, Format::Tsv | Format::Trc) {
        for position in motion.positions_mm.iter_mut().filter(|position| **position == [0.0; 3]) {
            *position = [1e-6, 0.0, 0.0];
        }
    }
    motion
}

#[test]
fn real_c3d_files_that_were_cut_off_keep_their_stride() {
    let Some(folder) = RecordedData::Takes.folder() else { return };
    for (name, n_markers, n_frames, ..) in TAKES.into_iter().filter(|t| t.0.ends_with("c3d")) {
        let Some(whole) = take(name) else { return };
        let path = folder.join(name);
        let bytes = std::fs::read(path).expect("read a moment ago");
        let word = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let start = (usize::from(word(16)) - 1) * 512;
        // As many bytes per frame as leave less than a block after the whole frames.
        let frame_bytes = (bytes.len() - start) / n_frames as usize / 2 * 2;
        let few = (1..=24).chain((25..n_frames as usize).step_by(n_frames as usize / 12));
        for n_present in few {
            let cut = Format::C3d.read(&bytes[..start + n_present * frame_bytes + frame_bytes / 2]);
            let cut = cut.expect("a usable file");
            assert_eq!(cut.info.markers.len(), n_markers, "{name}, {n_present} frames");
            assert_eq!(cut.n_frames(), n_present, "{name}");
            for (found, expected) in cut.positions_mm.iter().zip(&whole.positions_mm) {
                let same = found.map(f32::to_bits) == expected.map(f32::to_bits);
                assert!(same || is_gap(*found) && is_gap(*expected), "{name}, {n_present} frames");
            }
        }
    }
}

#[test]
fn unlabelled_points_and_model_outputs_of_a_vicon_file() {
    let Some(motion) = take("walk_159p_unlabelled_120hz.c3d") else { return };
    assert_eq!(motion.info.markers.iter().filter(|m| !m.labelled).count(), 42);
    assert!(motion.info.markers.iter().any(|m| m.label == "*115"));
    assert!(motion.info.markers.iter().any(|m| m.label == "CentreOfMass"));
    assert!(motion.info.markers.iter().all(|m| !m.label.ends_with("Angles")));
}
