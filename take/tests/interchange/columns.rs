//! Parquet and MCAP files, read back by their own libraries: content, absent samples, and memory.

#![expect(clippy::unwrap_used, reason = "a test stops there")]

use std::collections::HashSet;

use mocapd_take::{
    interchange::{Format, SampledKind},
    motion::{GAP, Marker, Motion, MotionFrames, MotionInfo, Source, UpAxis, is_gap},
};
use parquet::{
    file::reader::{FileReader, SerializedFileReader},
    record::Field,
};

use crate::forces::loaded_and_not;

/// Markers with gaps: two share a label, and one is never visible.
fn motion(n_frames: usize, n_markers: usize) -> Motion {
    let mut positions_mm = Vec::new();
    for frame in 0..n_frames {
        for marker in 0..n_markers {
            let (t, m) = (frame as f32 / 100.0, marker as f32);
            let hidden = (frame / 7 + marker) % 5 == 0 || marker + 1 == n_markers;
            positions_mm.push(if hidden { GAP } else { [100.0 * (t + m).sin(), t, -m] });
        }
    }
    let marker = |column: usize| Marker {
        label: if column == 1 { "M0".to_owned() } else { format!("M{column}") },
        labelled: true,
    };
    let info = MotionInfo {
        rate_hz: 100.0,
        n_frames: n_frames as u64,
        markers: (0..n_markers).map(marker).collect(),
        up: UpAxis::Y,
        source: Source { first_frame: 17, ..Source::default() },
        foreign: Vec::new(),
        events: Vec::new(),
        subject: None,
        recording: None,
    };
    Motion { info, positions_mm }
}

fn written(motion: &Motion, format: Format) -> Vec<u8> {
    let mut out = Vec::new();
    format.write(&mut MotionFrames::new(motion), &mut out).unwrap();
    out
}

fn reader(file: Vec<u8>) -> SerializedFileReader<bytes::Bytes> {
    SerializedFileReader::new(bytes::Bytes::from(file)).unwrap()
}

#[test]
fn one_row_per_sample_and_none_for_a_missing_one() {
    let motion = motion(300, 5);
    let file = reader(written(&motion, Format::Parquet));
    let mut seen = HashSet::new();
    for row in file.get_row_iter(None).unwrap() {
        let fields: Vec<Field> = row.unwrap().into_columns().into_iter().map(|(_, f)| f).collect();
        let [Field::Long(frame), Field::Double(time_s), Field::Str(label), axes @ ..] = &fields[..]
        else {
            panic!("{fields:?}")
        };
        let index = (*frame - 17) as usize;
        assert!((time_s - index as f64 / 100.0).abs() < 1e-12);
        let column = ["M0", "M0#2", "M2", "M3", "M4"].iter().position(|l| l == label).unwrap();
        let position = motion.frame(index)[column];
        let found: Vec<Field> = position.iter().map(|&axis| Field::Float(axis)).collect();
        assert_eq!(axes, found);
        assert!(!is_gap(position) && seen.insert((index, column)));
    }
    assert_eq!(seen.len(), motion.positions_mm.iter().filter(|&&p| !is_gap(p)).count());
}

#[test]
fn one_row_per_frame_and_null_for_a_missing_sample() {
    let motion = motion(300, 5);
    let file = reader(written(&motion, Format::ParquetWide));
    let mut n_rows = 0;
    for (index, row) in file.get_row_iter(None).unwrap().enumerate() {
        let columns = row.unwrap().into_columns();
        assert_eq!(columns.len(), 2 + 3 * 5);
        assert_eq!(columns[0], ("frame".to_owned(), Field::Long(index as i64 + 17)));
        assert_eq!(columns[5].0, "M0#2.x");
        for (column, &position) in motion.frame(index).iter().enumerate() {
            for (axis, value) in position.into_iter().enumerate() {
                let expected = if is_gap(position) { Field::Null } else { Field::Float(value) };
                assert_eq!(columns[2 + 3 * column + axis].1, expected);
            }
        }
        n_rows += 1;
    }
    assert_eq!(n_rows, 300);
}

#[test]
fn memory_is_bounded_by_row_groups() {
    let motion = motion(40_000, 64);
    for (format, rows_max) in [(Format::Parquet, 1 << 17), (Format::ParquetWide, 21_845)] {
        let file = reader(written(&motion, format));
        let groups = file.metadata().row_groups();
        assert!(groups.len() > 1);
        assert!(groups.iter().all(|group| group.num_rows() <= rows_max));
    }
}

/// A value of a file's metadata.
fn about(file: &SerializedFileReader<bytes::Bytes>, name: &str) -> Option<String> {
    let pairs = file.metadata().file_metadata().key_value_metadata().unwrap();
    pairs.iter().find(|pair| pair.key == name).and_then(|pair| pair.value.clone())
}

#[test]
fn metadata_describes_the_columns() {
    let file = reader(written(&motion(3, 2), Format::Parquet));
    let value = |name: &str| about(&file, name);
    assert_eq!(value("mocapd.labels").unwrap(), r#"["M0","M0"]"#);
    assert_eq!(value("mocapd.rate_hz").unwrap(), "100");
    assert_eq!(value("mocapd.layout").unwrap(), "long");
    assert_eq!(value("mocapd.up_axis").unwrap(), "y");
    assert_eq!(value("mocapd.tolerance_mm"), None, "it is no take");
}

/// The tables of a motion with a force plate, and their rows as the table itself gives them.
fn sampled(motion: &Motion, format: Format) -> Vec<(SampledKind, Vec<u8>, Vec<Vec<f32>>)> {
    let frames = MotionFrames::new(motion);
    let rows = |mut table: mocapd_take::interchange::SampledTable<'_>| {
        let mut rows = Vec::new();
        let put = |_, row: &[f32]| {
            rows.push(row.to_vec());
            Ok(())
        };
        table.for_each_row(&frames, put).unwrap();
        rows
    };
    let tables = || format.sampled_tables(&motion.info).unwrap();
    let files = tables().into_iter().zip(tables()).map(|(mut table, again)| {
        let mut out = Vec::new();
        format.write_sampled(&mut table, &frames, &mut out).unwrap();
        (table.kind(), out, rows(again))
    });
    files.collect()
}

#[test]
fn analog_channels_and_force_plates_are_files_with_one_row_per_sample() {
    let motion = loaded_and_not();
    for format in [Format::Parquet, Format::ParquetWide] {
        let files = sampled(&motion, format);
        let kinds: Vec<SampledKind> = files.iter().map(|(kind, ..)| *kind).collect();
        assert_eq!(kinds, [SampledKind::Analog, SampledKind::ForcePlates(None)]);
        for (kind, file, expected) in files {
            let file = reader(file);
            assert_eq!(about(&file, "mocapd.layout").unwrap(), kind.name());
            assert_eq!(about(&file, "mocapd.sampled_rate_hz").unwrap(), "200");
            assert_eq!(about(&file, "mocapd.units"), None);
            let described = about(&file, "mocapd.columns").unwrap();
            let is_plates = kind == SampledKind::ForcePlates(None);
            let one = if is_plates {
                r#""name":"force_plate_1.cop_y_mm","unit":"mm""#
            } else {
                r#""name":"A6","unit":"""#
            };
            assert!(described.contains(one), "{described}");
            let mut n_missing = 0;
            let mut n_rows = 0;
            for (index, row) in file.get_row_iter(None).unwrap().enumerate() {
                let columns = row.unwrap().into_columns();
                assert_eq!(columns[0], ("time_s".to_owned(), Field::Double(index as f64 / 200.0)));
                assert_eq!(columns.len(), 1 + expected[index].len());
                for ((_, found), value) in columns[1..].iter().zip(&expected[index]) {
                    let wanted = if value.is_nan() { Field::Null } else { Field::Float(*value) };
                    assert_eq!(*found, wanted);
                    n_missing += usize::from(value.is_nan());
                }
                n_rows += 1;
            }
            assert_eq!((n_rows, expected.len()), (6, 6));
            // Without a load there is neither a centre of pressure nor a free moment, in two samples.
            assert_eq!(n_missing, if is_plates { 12 } else { 0 });
        }
    }
    // Without such channels there is no such file.
    assert!(sampled(&self::motion(5, 2), Format::Parquet).is_empty());
}

/// The floats of a message whose first field is its time.
fn values(message: &[u8]) -> Vec<f32> {
    let mut rest = &message[2 + usize::from(message[1])..];
    let mut values = Vec::new();
    while !rest.is_empty() {
        // A key of one or two bytes, of the wire type of 32 bits.
        assert_eq!(rest[0] & 7, 5);
        let key_bytes = if rest[0] & 0x80 == 0 { 1 } else { 2 };
        values.push(f32::from_le_bytes(rest[key_bytes..key_bytes + 4].try_into().unwrap()));
        rest = &rest[key_bytes + 4..];
    }
    values
}

#[test]
fn mcap_has_one_message_per_sample_of_analog_channels_and_force_plates() {
    let motion = loaded_and_not();
    let expected = sampled(&motion, Format::Parquet);
    let file = written(&motion, Format::Mcap);
    for ((kind, _, rows), topic) in expected.iter().zip(["/analog", "/force_plates"]) {
        let mut n_found = 0;
        for message in mcap::MessageStream::new(&file).unwrap().map(Result::unwrap) {
            if message.channel.topic != topic {
                continue;
            }
            assert_eq!(message.log_time, n_found as u64 * 5_000_000);
            let bits = |row: &[f32]| row.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(&values(&message.data)), bits(&rows[n_found]), "{topic} {n_found}");
            let described = &message.channel.metadata;
            assert_eq!(described.len(), rows[0].len());
            if *kind == SampledKind::ForcePlates(None) {
                let name = "force_plate_1.force_z_n (N)";
                assert_eq!(described["force_plate_1_force_z_n"], name);
            }
            n_found += 1;
        }
        assert_eq!(n_found, rows.len());
    }
}

#[test]
fn mcap_has_one_cloud_per_frame_and_names_ten_times_a_second() {
    let motion = motion(300, 5);
    let file = written(&motion, Format::Mcap);
    let (mut clouds, mut names, mut transforms) = (0_u64, 0, 0);
    for message in mcap::MessageStream::new(&file).unwrap() {
        let message = message.unwrap();
        let schema = message.channel.schema.clone().unwrap();
        assert_eq!(schema.encoding, "protobuf");
        match (&*message.channel.topic, &*schema.name) {
            ("/markers", "foxglove.PointCloud") => {
                assert_eq!(message.log_time, clouds * 10_000_000);
                clouds += 1;
            }
            ("/names", "foxglove.SceneUpdate") => names += 1,
            ("/tf", "foxglove.FrameTransform") => transforms += 1,
            other => panic!("{other:?}"),
        }
    }
    assert_eq!((clouds, names, transforms), (300, 30, 1));
    assert!(mcap::Summary::read(&file).unwrap().unwrap().chunk_indexes.len() == 1);
}

#[test]
fn an_empty_motion_is_exported() {
    for (n_frames, n_markers) in [(0, 3), (4, 0), (0, 0)] {
        let mut motion = motion(n_frames, n_markers);
        motion.info.n_frames = n_frames as u64;
        for format in [Format::Parquet, Format::ParquetWide] {
            reader(written(&motion, format));
        }
        assert!(mcap::Summary::read(&written(&motion, Format::Mcap)).unwrap().is_some());
    }
}

/// Accepts a few bytes and then fails.
struct Full(usize);

impl std::io::Write for Full {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0 = self.0.checked_sub(bytes.len()).ok_or(std::io::ErrorKind::StorageFull)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_full_disk_is_an_error() {
    let motion = motion(2000, 9);
    for format in [Format::Parquet, Format::ParquetWide, Format::Mcap] {
        for room in [0, 100, 20_000] {
            assert!(format.write(&mut MotionFrames::new(&motion), &mut Full(room)).is_err());
        }
    }
    let motion = loaded_and_not();
    for mut table in Format::Parquet.sampled_tables(&motion.info).unwrap() {
        let frames = MotionFrames::new(&motion);
        let written = Format::Parquet.write_sampled(&mut table, &frames, &mut Full(100));
        assert!(written.is_err(), "{:?}", table.kind());
    }
}
