//! C3D files for other readers: they contain what these need (`tests/oracle/check_foreign.py` opens them).

use mocapd_take::{
    interchange::Format,
    motion::{Marker, Motion, MotionFrames, MotionInfo, Source},
};

use crate::support::c3d_file::C3dFile;

/// A parameter of a written file: type, dimensions, data.
type Parameter = (i8, Vec<u8>, Vec<u8>);

fn write(motion: &Motion) -> Vec<u8> {
    let mut bytes = Vec::new();
    Format::C3d.write(&mut MotionFrames::new(motion), &mut bytes).unwrap();
    bytes
}

/// Finds a parameter by group and name.
fn parameter(file: &[u8], group: &str, name: &str) -> Option<Parameter> {
    let mut at = 512 + 4;
    let mut ids = Vec::new();
    loop {
        let (length, id) = (usize::from((file[at] as i8).unsigned_abs()), file[at + 1] as i8);
        if length == 0 {
            return None;
        }
        let found = std::str::from_utf8(&file[at + 2..at + 2 + length]).unwrap();
        let end = at + 2 + length;
        let offset = usize::from(u16::from_le_bytes([file[end], file[end + 1]]));
        if id < 0 && found == group {
            ids.push(-id);
        }
        if ids.contains(&id) && found == name {
            let (kind, n) = (file[end + 2] as i8, usize::from(file[end + 3]));
            let dimensions = file[end + 4..end + 4 + n].to_vec();
            let size = dimensions
                .iter()
                .fold(usize::from(kind.unsigned_abs()), |n, &d| n * usize::from(d));
            return Some((kind, dimensions, file[end + 4 + n..end + 4 + n + size].to_vec()));
        }
        at = end + offset;
    }
}

fn words(data: &[u8]) -> Vec<i16> {
    data.as_chunks().0.iter().map(|&b| i16::from_le_bytes(b)).collect()
}

fn floats(data: &[u8]) -> Vec<f32> {
    data.as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect()
}

/// A point and two analog channels of two samples a frame.
fn with_analog(add: impl FnOnce(&mut C3dFile)) -> Vec<u8> {
    let frame = |i: usize| vec![i as f32, 2.0, 3.0, 0.0, 10.0, -20.0, 11.0, -21.0];
    let mut file = C3dFile { analog: (2, 2), ..C3dFile::new(1, (0..8).map(frame).collect()) };
    file.texts(1, "LABELS", &["A"]);
    file.records.extend(file.group(2, "ANALOG"));
    file.words(2, "USED", &[2]);
    add(&mut file);
    write(&Format::C3d.read(&file.bytes()).unwrap())
}

/// The analog samples of the first frame of a written file.
fn first_analog(file: &[u8]) -> Vec<f32> {
    let start = (usize::from(u16::from_le_bytes([file[16], file[17]])) - 1) * 512;
    floats(&file[start + 16..start + 32])
}

#[test]
fn the_analog_group_is_whole_and_its_offsets_are_words() {
    // No OFFSET at all; OFFSETS instead; floats; too few values.
    let written = with_analog(|_| {});
    let (kind, dimensions, offsets) = parameter(&written, "ANALOG", "OFFSET").unwrap();
    assert_eq!((kind, &dimensions[..], words(&offsets)), (2, &[2][..], vec![0, 0]));
    assert_eq!(floats(&parameter(&written, "ANALOG", "SCALE").unwrap().2), [1.0, 1.0]);
    assert_eq!(floats(&parameter(&written, "ANALOG", "GEN_SCALE").unwrap().2), [1.0]);
    assert_eq!(floats(&parameter(&written, "ANALOG", "RATE").unwrap().2), [200.0]);
    for name in ["LABELS", "UNITS", "DESCRIPTIONS"] {
        assert_eq!(parameter(&written, "ANALOG", name).unwrap().1[1], 2, "{name}");
    }
    let written = with_analog(|file| file.words(2, "OFFSETS", &[5, 0xFFFA]));
    assert_eq!(words(&parameter(&written, "ANALOG", "OFFSET").unwrap().2), [5, -6]);
    let written = with_analog(|file| file.floats(2, "OFFSET", &[5.0, -6.0]));
    let (kind, _, offsets) = parameter(&written, "ANALOG", "OFFSET").unwrap();
    assert_eq!((kind, words(&offsets)), (2, vec![5, -6]));
    assert_eq!(first_analog(&written), [10.0, -20.0, 11.0, -21.0]);
    let written = with_analog(|file| file.words(2, "OFFSET", &[7]));
    assert_eq!(words(&parameter(&written, "ANALOG", "OFFSET").unwrap().2), [7, 0]);
    // An offset that does not fit into a word is subtracted from the samples.
    let written = with_analog(|file| file.floats(2, "OFFSET", &[0.5, 70_000.0]));
    assert_eq!(words(&parameter(&written, "ANALOG", "OFFSET").unwrap().2), [0, 0]);
    assert_eq!(first_analog(&written), [9.5, -70_020.0, 10.5, -70_021.0]);
}

#[test]
fn the_rates_give_the_samples_a_frame_however_they_are_divided() {
    for (point_hz, ratio) in [(119.88f32, 10usize), (59.94, 20), (1000.0 / 3.0, 3), (100.0, 20)] {
        let frames = vec![vec![1.0; 4 + ratio]; 3];
        let mut file = C3dFile { analog: (1, ratio), ..C3dFile::new(1, frames) };
        file.records.extend(file.group(2, "ANALOG"));
        file.words(2, "USED", &[1]);
        let mut bytes = file.bytes();
        bytes[20..24].copy_from_slice(&point_hz.to_le_bytes());
        let at = bytes.windows(4).position(|w| w == b"RATE").unwrap() + 4 + 2 + 2;
        bytes[at..at + 4].copy_from_slice(&point_hz.to_le_bytes());
        let written = write(&Format::C3d.read(&bytes).unwrap());
        let rate =
            |group: &str| f64::from(floats(&parameter(&written, group, "RATE").unwrap().2)[0]);
        assert_eq!((rate("ANALOG") / rate("POINT")) as usize, ratio, "{point_hz} Hz");
    }
}

#[test]
fn descriptions_survive_when_there_are_fewer_than_points() {
    let mut file = C3dFile::new(3, vec![vec![1.0; 12]; 2]);
    file.texts(1, "LABELS", &["A", "B", "C"]);
    file.texts(1, "DESCRIPTIONS", &["left hip", "right hip"]);
    let written = write(&Format::C3d.read(&file.bytes()).unwrap());
    let (_, dimensions, data) = parameter(&written, "POINT", "DESCRIPTIONS").unwrap();
    assert_eq!(dimensions, [9, 3]);
    assert_eq!(std::str::from_utf8(&data).unwrap(), "left hip right hip         ");
}

#[test]
fn nothing_follows_the_frames_where_others_count_them_by_the_length() {
    for (n_frames, first_frame, is_padded) in [
        (65_534, 1, true),
        (65_535, 1, false),
        (70_001, 1, false),
        (10, 65_535, true),
        (10, 65_536, false),
    ] {
        let info = MotionInfo {
            rate_hz: 100.0,
            n_frames,
            markers: vec![Marker { label: "a".to_owned(), labelled: true }],
            source: Source { factor: 1.0, first_frame, ..Source::default() },
            ..MotionInfo::default()
        };
        let motion = Motion { info, positions_mm: vec![[1.0, 2.0, 3.0]; n_frames as usize] };
        let written = write(&motion);
        let start = (usize::from(u16::from_le_bytes([written[16], written[17]])) - 1) * 512;
        let left = written.len() - start - 16 * n_frames as usize;
        assert_eq!(left > 0, is_padded, "{n_frames} from {first_frame}");
        let back = Format::C3d.read(&written).unwrap();
        assert_eq!((back.info.n_frames, back.info.source.first_frame), (n_frames, first_frame));
    }
}
