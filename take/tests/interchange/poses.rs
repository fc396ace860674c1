//! Poses of rigid bodies in exports: each in the row of its frame.

use std::{io::Cursor, ops::Range};

use mocapd_codec::{Settings, Tolerance, poses::without_pose, sampled::SampledEncoder};
use mocapd_take::{
    TakeFrames, TakeWriter,
    interchange::{Format, SampledKind, SampledTable},
    motion::FrameSource,
    poses::{CHANNEL_NAMES, PoseState},
    record::{Channel, Device, Header, Ledger, SampledChannel, SampledGroup},
    sampled::{POSES, SampleAnchor, SampleContent, SampleSpan},
    statistics::StretchTally,
    stretch::{Span, StretchHeaderWriter},
    timeline::{RowTime, Timeline, TimelineEncoder},
};

const TICK_HZ: u64 = 100_000;
const BODIES: [&str; 3] = ["pelvis", "", "pelvis"];
/// Rows of a stretch, and of a block of poses.
const STRETCH: u64 = 50;
/// Rows for which the device sent no poses.
const WITHOUT: Range<u64> = 120..130;

/// The time of a row: no line leads through those of three rows.
fn ticks(row: u64) -> u64 {
    7_000 + row * 1000 + (row * row) % 400
}

/// A quarter turn about z times a rotation about x, in the numbers of a body in a row; `None` if it is lost.
fn numbers(body: usize, row: u64) -> Option<[f32; 8]> {
    let half = 0.01 * row as f64 + body as f64;
    let (sin, cos) = half.sin_cos();
    let quarter = std::f64::consts::FRAC_1_SQRT_2;
    let [w, x, y, z] = [quarter * cos, quarter * sin, quarter * sin, quarter * cos];
    let at = [row as f32 + 0.5, -(body as f32), 900.0];
    let residual = if body == 2 { f32::NAN } else { 0.25 };
    let pose = [at[0], at[1], at[2], w as f32, x as f32, y as f32, z as f32, residual];
    ((row + body as u64) % 9 != 4).then_some(pose)
}

/// A recording of one marker and the bodies, with `n_rows` rows.
fn take(n_rows: u64) -> Vec<u8> {
    let device = Some(Device { tick_hz: TICK_HZ, ..Device::default() });
    let mut header = Header { rate_hz: 100.0, device, stretch_rows: 50, ..Header::default() };
    header.channels = vec![Channel { label: "a".to_owned(), labelled: true, marker_id: 0 }];
    let tolerance = Tolerance::from_mm(1.0).unwrap();
    header.set_codec(&Settings { kind: "dense".parse().unwrap(), tolerance });
    let mut take = TakeWriter::new(Vec::new(), &header).unwrap();
    let channel = |(index, body): (usize, &&str)| {
        CHANNEL_NAMES.map(|name| SampledChannel {
            name: format!("{body}.{name}"),
            index: 40 + index as u32,
            scale: 1.0,
            ..SampledChannel::default()
        })
    };
    let channels: Vec<SampledChannel> = BODIES.iter().enumerate().flat_map(channel).collect();
    let part_channels = channels.len() as u32;
    let (kind, number) = (POSES.to_owned(), 16);
    let group = SampledGroup {
        kind,
        number,
        rate_hz: 100.0,
        channels,
        part_channels,
        ..SampledGroup::default()
    };
    take.sampled_group(&group).unwrap();
    let mut front = StretchHeaderWriter::with_times(50, TimelineEncoder::new(TICK_HZ, 100.0));
    let mut encoder = SampledEncoder::new();
    for (i, first_row) in (0..n_rows).step_by(STRETCH as usize).enumerate() {
        let rows = first_row..(first_row + STRETCH).min(n_rows);
        let mut timeline = Timeline::default();
        timeline.restart(first_row);
        for row in rows.clone() {
            let time =
                RowTime { device_ticks: ticks(row), arrival_10us: ticks(row), timecode: None };
            timeline.push(time);
        }
        let span = Span {
            first_row,
            n_rows: (rows.end - rows.start) as u32,
            key: true,
            number: (i % 32) as u8,
        };
        let mut payload = Vec::new();
        front.put(span, &timeline, &[], true, &mut payload);
        take.stretch(span, &payload, &StretchTally::default()).unwrap();
        let own: Vec<u64> = rows.filter(|row| !WITHOUT.contains(row)).collect();
        for run in own.chunk_by(|a, b| a + 1 == *b) {
            let (first, n) = (run[0], run.len() as u64);
            let anchor = |number: u64| SampleAnchor {
                number,
                run_start: if first < WITHOUT.end { 0 } else { WITHOUT.end },
                device_ticks: ticks(number),
                segment: 0,
            };
            let last = first + n - 1;
            take.sample_time(16, &anchor(first), Some((last, ticks(last)))).unwrap();
            let mut columns = vec![Vec::new(); 8 * BODIES.len()];
            for &row in run {
                for body in 0..BODIES.len() {
                    let found = numbers(body, row).unwrap_or(without_pose(&[0.0; 8], 1));
                    for (channel, number) in found.into_iter().enumerate() {
                        columns[8 * body + channel].push(number);
                    }
                }
            }
            let columns: Vec<&[f32]> = columns.iter().map(Vec::as_slice).collect();
            let mut block = Vec::new();
            encoder.encode(&columns, true, &mut block).unwrap();
            let span = SampleSpan { group: 16, first, n, content: SampleContent::Key };
            take.samples(&span, &block).unwrap();
        }
    }
    take.finish(&Ledger::default()).unwrap().0
}

fn open(take: Vec<u8>) -> TakeFrames<Cursor<Vec<u8>>> {
    let mut frames = TakeFrames::open(Cursor::new(take.clone())).unwrap();
    frames.open_recording(Cursor::new(take), false).unwrap();
    frames
}

fn bits(numbers: &[f32]) -> Vec<u32> {
    // NaN of any bits.
    numbers.iter().map(|x| if x.is_nan() { u32::MAX } else { x.to_bits() }).collect()
}

#[test]
fn a_table_of_poses_has_a_row_for_each_frame() {
    let frames = open(take(333));
    let tables = SampledTable::all(frames.info()).unwrap();
    let mut tables = tables.into_iter().filter(|table| table.kind() == SampledKind::Poses);
    let mut table = tables.next().unwrap();
    let names: Vec<&str> = table.columns().iter().map(|column| &column.name[..]).collect();
    let of = |name: &str| table.columns().iter().find(|column| column.name == name).unwrap();
    assert_eq!((names[0], names[9], names[18]), ("pelvis.x", "body41.x", "pelvis#2.x"));
    assert_eq!((&of("pelvis.residual").unit[..], &of("pelvis.qw").unit[..]), ("mm", ""));
    assert_eq!((table.rate_hz(), table.n_rows(), names.len()), (100.0, 333, 27));
    let mut row = 0;
    while let Some((values, times)) = table.next_any().unwrap() {
        assert_eq!((values.len(), times.len(), times[0].time_s), (27, 1, row as f64 / 100.0));
        for (body, found) in values.chunks_exact(9).enumerate() {
            let missing = WITHOUT.contains(&row);
            let expected = numbers(body, row).filter(|_| !missing);
            let state = match (missing, expected) {
                (true, _) => PoseState::Missing,
                (false, None) => PoseState::Lost,
                (false, Some(_)) => PoseState::Tracked,
            };
            assert_eq!(found[8], f32::from(state.code()), "row {row}");
            assert_eq!(bits(&found[..8]), bits(&expected.unwrap_or([f32::NAN; 8])), "row {row}");
        }
        row += 1;
    }
    assert_eq!(row, 333);
    assert_eq!(SampledKind::from_name("poses"), Some(SampledKind::Poses));
}

#[test]
fn an_export_of_a_part_has_the_poses_of_its_frames() {
    let frames = open(take(333));
    let mut info = frames.info().clone();
    info.cut(115, 140);
    let tables = SampledTable::all(&info).unwrap();
    let mut table = tables.into_iter().find(|table| table.kind() == SampledKind::Poses).unwrap();
    for row in 115..140 {
        let (values, _) = table.next_any().unwrap().unwrap();
        let expected = numbers(0, row).filter(|_| !WITHOUT.contains(&row));
        assert_eq!(bits(&values[..8]), bits(&expected.unwrap_or([f32::NAN; 8])), "row {row}");
    }
    assert!(table.next_any().unwrap().is_none());
}

/// The 16-bit integer of a parameter with one value.
fn parameter(file: &[u8], name: &str) -> u16 {
    let at = file.windows(name.len()).rposition(|found| found == name.as_bytes()).unwrap();
    // The offset of the next one, the type 2, no dimensions.
    let value = &file[at + name.len() + 2..];
    assert_eq!(value[..2], [2, 0], "{name}");
    u16::from_le_bytes([value[2], value[3]])
}

/// Where the section of poses is: behind the points, or before them if readers count frames by the length of the file.
#[test]
fn c3d_has_a_matrix_for_each_body_in_each_frame() {
    for (n_rows, is_behind) in [(333, true), (65_540, false)] {
        let mut frames = open(take(n_rows));
        let mut file = Vec::new();
        Format::C3d.write(&mut frames, &mut file).unwrap();
        assert_eq!(parameter(&file, "RATIO"), 1);
        let rotations = usize::from(parameter(&file, "DATA_START") - 1) * 512;
        let points = usize::from(u16::from_le_bytes([file[16], file[17]]) - 1) * 512;
        assert_eq!(rotations > points, is_behind);
        let n_bytes = n_rows as usize * 3 * 17 * 4;
        if is_behind {
            assert_eq!(file.len(), (rotations + n_bytes).next_multiple_of(512));
        } else {
            assert_eq!(points, (rotations + n_bytes).next_multiple_of(512));
            assert_eq!(file.len(), points + 16 * n_rows as usize);
        }
        let words: Vec<f32> = file[rotations..rotations + n_bytes]
            .as_chunks::<4>()
            .0
            .iter()
            .map(|word| f32::from_le_bytes(*word))
            .collect();
        for (index, found) in words.chunks_exact(17).enumerate() {
            let (row, body) = ((index / 3) as u64, index % 3);
            let Some(pose) = numbers(body, row).filter(|_| !WITHOUT.contains(&row)) else {
                assert!(found[..16].iter().all(|x| x.is_nan()) && found[16] == -1.0);
                continue;
            };
            // The columns are where the axes go: x to y, and y and z turned by the angle about it.
            let half = 0.01 * row as f64 + body as f64;
            let (sin, cos) = ((2.0 * half).sin() as f32, (2.0 * half).cos() as f32);
            let [x, y, z] = [pose[0], pose[1], pose[2]];
            let columns =
                [[0.0, 1.0, 0.0, 0.0], [-cos, 0.0, sin, 0.0], [sin, 0.0, cos, 0.0], [x, y, z, 1.0]];
            for (a, b) in found.iter().zip(columns.as_flattened()) {
                assert!((a - b).abs() < 1e-5, "row {row}: {found:?} {columns:?}");
            }
            assert_eq!(found[16], if body == 2 { 0.0 } else { 0.25 });
        }
        let read = Format::C3d.read(&file).unwrap().info;
        assert_eq!((read.n_frames, read.markers.len()), (n_rows, 1));
        assert!(read.source.warnings.iter().any(|text| text.contains("poses of 3 rigid bodies")));
    }
}

#[test]
fn formats_say_what_they_leave_out() {
    let frames = open(take(60));
    let mut info = frames.info().clone();
    for format in [Format::Trc, Format::Tsv, Format::Mot] {
        let left_out = format.leaves_out(&info, true);
        assert!(left_out.contains(&"the poses of 3 rigid bodies".to_owned()), "{left_out:?}");
    }
    let with_poses =
        [Format::C3d, Format::Csv, Format::Npz, Format::Xdf, Format::Bids, Format::Html];
    for format in with_poses {
        assert_eq!(format.leaves_out(&info, true), [""; 0]);
    }
    // Neither points nor poses end within the first 16 MiB.
    info.n_frames = 2_200_000;
    let left_out = Format::C3d.leaves_out(&info, true);
    assert!(left_out.len() == 1 && left_out[0].contains("up to 655 s"), "{left_out:?}");
}
