//! Sampled channels and force plates of recordings: where samples are on the time line of the frames, and what C3D has.

use std::io::{self, Cursor};

use mocapd_codec::{Settings, Tolerance, sampled::SampledEncoder};
use mocapd_take::{
    TakeFrames, TakeWriter,
    foreign::force_plates::Baseline,
    interchange::{Format, SampledKind, SampledTable, mot::write as write_mot, write_c3d},
    motion::{FrameSource, MotionInfo, Position},
    record::{Channel, Device, Header, Ledger, SampledChannel, SampledGroup, StatedPlate},
    sampled::{SampleAnchor, SampleContent, SampleSpan, SampleTimeLine},
    statistics::StretchTally,
    stretch::{Span, StretchHeaderWriter},
    timeline::{RowTime, Timeline, TimelineEncoder},
};

const TICK_HZ: u64 = 100_000;
/// Ticks from a row to the next, at 100 Hz, and from a sample to the next, at 1000 Hz.
const ROW: u64 = 1000;
const SAMPLE: u64 = 100;

/// Consecutive samples of a group, with the times of the first and of the sample at which a batch begins.
struct Block {
    group: u32,
    first: u64,
    run_start: u64,
    ticks: u64,
    /// By channel.
    samples: Vec<Vec<f32>>,
}

fn block(first: u64, run_start: u64, ticks: u64, samples: Vec<Vec<f32>>) -> Block {
    Block { group: 0, first, run_start, ticks, samples }
}

/// A recording of one marker at 100 Hz whose rows have these ticks, and of a group at 1000 Hz; what is written after each
/// stretch of 50 rows.
fn take(
    rows: &[u64],
    channels: &[(&str, &str)],
    plates: &[StatedPlate],
    blocks: impl FnMut(usize) -> Vec<Block>,
) -> Vec<u8> {
    take_of_groups(rows, &[(1000.0, channels)], plates, blocks)
}

/// The same with several groups, of which each has a rate.
fn take_of_groups(
    rows: &[u64],
    groups: &[(f64, &[(&str, &str)])],
    plates: &[StatedPlate],
    mut blocks: impl FnMut(usize) -> Vec<Block>,
) -> Vec<u8> {
    let device = Some(Device { tick_hz: TICK_HZ, ..Device::default() });
    let mut header = Header { rate_hz: 100.0, device, stretch_rows: 50, ..Header::default() };
    header.channels = vec![Channel { label: "a".to_owned(), labelled: true, marker_id: 0 }];
    header.settings = plates.iter().map(StatedPlate::setting).collect();
    let tolerance = Tolerance::from_mm(1.0).unwrap();
    header.set_codec(&Settings { kind: "dense".parse().unwrap(), tolerance });
    let mut take = TakeWriter::new(Vec::new(), &header).unwrap();
    let channel = |(name, unit): &(&str, &str)| SampledChannel {
        name: (*name).to_owned(),
        unit: (*unit).to_owned(),
        scale: 0.5,
        ..SampledChannel::default()
    };
    for (number, (rate_hz, channels)) in (0..).zip(groups) {
        let channels: Vec<SampledChannel> = channels.iter().map(channel).collect();
        take.sampled_group(&SampledGroup {
            number,
            rate_hz: *rate_hz,
            part_channels: channels.len() as u32,
            channels,
            ..SampledGroup::default()
        })
        .unwrap();
    }
    let mut front = StretchHeaderWriter::with_times(50, TimelineEncoder::new(TICK_HZ, 100.0));
    let mut encoders: Vec<SampledEncoder> = groups.iter().map(|_| SampledEncoder::new()).collect();
    for (i, part) in rows.chunks(50).enumerate() {
        let mut timeline = Timeline::default();
        let first_row = i as u64 * 50;
        timeline.restart(first_row);
        for &device_ticks in part {
            timeline.push(RowTime { device_ticks, arrival_10us: first_row, timecode: None });
        }
        let (n_rows, number) = (part.len() as u32, (i % 32) as u8);
        let span = Span { first_row, n_rows, key: true, number };
        let mut payload = Vec::new();
        front.put(span, &timeline, &[], true, &mut payload);
        take.stretch(span, &payload, &StretchTally::default()).unwrap();
        for Block { group, first, run_start, ticks, samples } in blocks(i) {
            let n = samples[0].len() as u64;
            let anchor = SampleAnchor { number: first, run_start, device_ticks: ticks, segment: 0 };
            let period = TICK_HZ / groups[group as usize].0 as u64;
            let later = (n > 10).then_some((first + n - 10, ticks + (n - 10) * period));
            take.sample_time(group, &anchor, later).unwrap();
            let mut coded = Vec::new();
            let columns: Vec<&[f32]> = samples.iter().map(Vec::as_slice).collect();
            encoders[group as usize].encode(&columns, true, &mut coded).unwrap();
            let span = SampleSpan { group, first, n, content: SampleContent::Key };
            take.samples(&span, &coded).unwrap();
        }
    }
    take.finish(&Ledger::default()).unwrap().0
}

/// Half a second of samples after each stretch, from the first row on.
fn half_seconds(value: impl Fn(u64) -> Vec<f32>) -> impl FnMut(usize) -> Vec<Block> {
    move |stretch| {
        let first = stretch as u64 * 500;
        let rows: Vec<Vec<f32>> = (first..first + 500).map(&value).collect();
        let samples =
            (0..rows[0].len()).map(|channel| rows.iter().map(|row| row[channel]).collect());
        vec![block(first, 0, first * SAMPLE, samples.collect())]
    }
}

fn open(take: Vec<u8>) -> TakeFrames<Cursor<Vec<u8>>> {
    let mut frames = TakeFrames::open(Cursor::new(take.clone())).unwrap();
    frames.open_recording(Cursor::new(take), false).unwrap();
    frames
}

/// The time of a line, and its other cells.
type MotRow = (f64, Vec<f64>);

/// The table of a `.mot`: its times and the other columns of each line, with the names of these; and what was said of it.
fn mot(frames: &mut dyn FrameSource) -> (Vec<String>, Vec<MotRow>, Vec<String>) {
    let mut file = Vec::new();
    let remarks = write_mot(frames, &mut file, Baseline::AsStored).unwrap();
    let text = String::from_utf8(file).unwrap();
    let (head, table) = text.split_once("endheader\n").unwrap();
    let mut lines = table.lines();
    let names: Vec<String> = lines.next().unwrap().split('\t').map(str::to_owned).collect();
    let rows: Vec<MotRow> = lines
        .map(|line| {
            let mut cells = line.split('\t').map(|cell| cell.parse::<f64>().unwrap());
            (cells.next().unwrap(), cells.collect())
        })
        .collect();
    assert!(head.contains(&format!("nRows={}\nnColumns={}\n", rows.len(), names.len())), "{head}");
    assert!(rows.iter().all(|(_, cells)| cells.len() + 1 == names.len()));
    assert!(rows.is_sorted_by(|a, b| a.0 < b.0));
    (names, rows, remarks)
}

/// Plates of two amplifiers, of which the second one is at `rate_hz`, and took its samples `late` ticks after the others.
fn two_amplifiers(rate_hz: u64, late: u64, loses: bool) -> Vec<u8> {
    let plate = |number: u8, group: u32| StatedPlate {
        number,
        code: 2,
        group,
        channels: (0..6).collect(),
        corners_mm: [
            [300.0, 200.0, 0.0],
            [-300.0, 200.0, 0.0],
            [-300.0, -200.0, 0.0],
            [300.0, -200.0, 0.0],
        ],
        origin_mm: [0.0; 3],
    };
    let newtons = ["N", "N", "N", "N m", "N m", "N m"].map(|unit| ("c", unit));
    let groups = [(rate_hz as f64, &newtons[..]), (1000.0, &newtons[..])];
    // The force rises by 1 N in each millisecond; the plates differ by their shear force.
    let column = |group: u32, first: u64, n: u64| {
        let period = if group == 0 { TICK_HZ / rate_hz } else { SAMPLE };
        let late = if group == 0 { late } else { 0 };
        let force = |number: u64| {
            let ms = (number * period + late) as f32 / SAMPLE as f32;
            2.0 * (100.0 + ms)
        };
        let mut samples = vec![vec![0.0; n as usize]; 6];
        samples[0] = vec![if group == 0 { 20.0 } else { 60.0 }; n as usize];
        samples[2] = (first..first + n).map(force).collect();
        Block { group, first, run_start: 0, ticks: first * period + late, samples }
    };
    take_of_groups(&even_rows(200), &groups, &[plate(2, 0), plate(1, 1)], move |stretch| {
        let n = rate_hz / 2;
        let slow = column(0, stretch as u64 * n, n);
        let fast = column(1, stretch as u64 * 500, 500);
        if loses && stretch == 2 { vec![fast] } else { vec![slow, fast] }
    })
}

#[test]
fn plates_of_several_groups_are_in_one_mot_at_the_times_of_the_fastest() {
    // The same rate, 0.3 ms later.
    let mut frames = open(two_amplifiers(1000, 30, false));
    let (names, rows, remarks) = mot(&mut frames);
    assert_eq!((&names[1][..], &names[10][..]), ("ground_force_1_vx", "ground_force_2_vx"));
    assert_eq!(remarks.len(), 1, "{remarks:?}");
    assert!(remarks[0].contains("group 1") && remarks[0].contains("0.300 ms"), "{remarks:?}");
    for (i, (time_s, cells)) in rows.iter().enumerate() {
        let ms = time_s * 1000.0;
        // The fastest is the first of equals.
        assert!((ms - (i as f64 + 0.3)).abs() < 1e-6, "{time_s}");
        assert!((cells[11] - (100.0 + ms)).abs() < 1e-3, "{i}: {cells:?}");
        let is_last = i + 1 == rows.len();
        assert!(is_last || (cells[2] - (100.0 + i as f64)).abs() < 1e-3, "{i}: {cells:?}");
        assert_eq!((cells[9], cells[0]), (10.0, 30.0), "{i}");
    }
    assert_eq!(rows.len(), 2000);
    // Another rate needs resampling.
    let take = two_amplifiers(250, 0, false);
    let mut frames = open(take.clone());
    let error = write_mot(&mut frames, &mut Vec::new(), Baseline::AsStored).unwrap_err();
    assert!(error.to_string().contains("--resample"), "{error}");
    let mut frames = TakeFrames::open(Cursor::new(take.clone())).unwrap();
    frames.open_recording(Cursor::new(take), true).unwrap();
    let (_, rows, remarks) = mot(&mut frames);
    assert!(
        remarks.iter().any(|said| said.contains("group 0") && said.contains("sinc")),
        "{remarks:?}"
    );
    assert_eq!(rows.len(), 2000);
    for (i, (_, cells)) in rows.iter().enumerate().filter(|(i, _)| (200..1700).contains(i)) {
        let force = 100.0 + i as f64;
        assert!((cells[2] - force).abs() < 1e-3, "{i}: {cells:?}");
        assert!((cells[11] - force).abs() < 0.05, "{i}: {cells:?}");
    }
}

/// A part of the frames of a take.
struct Part {
    frames: TakeFrames<Cursor<Vec<u8>>>,
    info: MotionInfo,
}

impl FrameSource for Part {
    fn info(&self) -> &MotionInfo {
        &self.info
    }

    fn next_frame(&mut self, row: &mut [Position]) -> io::Result<bool> {
        self.frames.next_frame(row)
    }
}

#[test]
fn a_mot_of_a_part_has_the_nearest_samples_outside_of_it() {
    // The fastest group is 0.7 ms later, so the samples that are nearest to its last one come after the part.
    let frames = open(two_amplifiers(1000, 70, false));
    let mut info = frames.info().clone();
    info.cut(10, 20);
    let (_, rows, remarks) = mot(&mut Part { frames, info });
    assert_eq!(rows.len(), 100);
    assert!(remarks.iter().all(|said| !said.contains("Force plate")), "{remarks:?}");
    for (i, (_, cells)) in rows.iter().enumerate() {
        assert!((cells[2] - (201.0 + i as f64)).abs() < 1e-3, "{i}: {cells:?}");
    }
}

#[test]
fn a_mot_of_several_groups_has_zeros_where_one_of_them_lost_samples() {
    let mut frames = open(two_amplifiers(1000, 0, true));
    let (_, rows, remarks) = mot(&mut frames);
    assert_eq!(rows.len(), 2000);
    assert!(rows.iter().all(|(_, cells)| cells[2] > 0.0));
    let n_without = rows.iter().filter(|(_, cells)| cells[11] == 0.0).count();
    assert_eq!(n_without, 500);
    let said = remarks.iter().find(|said| said.contains("500 samples"));
    assert!(said.is_some_and(|said| said.contains("Force plate 2")), "{remarks:?}");
}

/// The rows of a table, and their times in seconds.
fn rows(info: &MotionInfo, kind: SampledKind) -> (Vec<Vec<f32>>, Vec<f64>) {
    let tables = SampledTable::all(info).unwrap();
    let mut table = tables.into_iter().find(|table| table.kind() == kind).unwrap();
    let width = table.columns().len();
    let (mut rows, mut times) = (Vec::new(), Vec::new());
    while let Some((values, at)) = table.next_any().unwrap() {
        rows.extend(values.chunks_exact(width).map(<[f32]>::to_vec));
        times.extend(at.iter().map(|time| time.time_s));
    }
    assert_eq!(table.n_rows(), rows.len() as u64);
    assert!(table.times_s().eq(times.iter().copied()));
    (rows, times)
}

/// The C3D file, read again, and what was said of it.
fn c3d(frames: &mut TakeFrames<Cursor<Vec<u8>>>) -> (MotionInfo, Vec<String>) {
    let mut file = Vec::new();
    let remarks = write_c3d(frames, &mut file).unwrap();
    (Format::C3d.read(&file).unwrap().info, remarks)
}

fn even_rows(n: u64) -> Vec<u64> {
    (0..n).map(|row| row * ROW).collect()
}

const PLATE: [(&str, &str); 6] =
    [("Fx", "N"), ("Fy", "N"), ("Fz", "kN"), ("Mx", "Nm"), ("My", "N m"), ("Mz", "Nmm")];

/// A plate with a shear force and sensors above or below its surface, whose axes point up or down, has the same loads in
/// C3D, which turns the axes where readers would reverse the origin.
#[test]
fn a_plate_has_the_same_loads_in_c3d_whichever_way_its_axes_point() {
    let (x, y) = (300.0, 200.0);
    let up = [[x, y, 5.0], [-x, y, 5.0], [-x, -y, 5.0], [x, -y, 5.0]];
    let down = [[x, -y, 5.0], [-x, -y, 5.0], [-x, y, 5.0], [x, y, 5.0]];
    for corners_mm in [up, down] {
        for z in [41.5, 0.0, -41.5] {
            let plate = StatedPlate {
                number: 1,
                code: 2,
                group: 0,
                channels: (0..6).collect(),
                corners_mm,
                origin_mm: [3.0, -2.0, z],
            };
            // Stored with a scale of a half: 200 N, -30 N, 0.7 kN, 12 N m, -20 N m, 3000 N mm.
            let value = |_| vec![400.0, -60.0, 1.4, 24.0, -40.0, 6000.0];
            let take = take(&even_rows(100), &PLATE, &[plate], half_seconds(value));
            let mut frames = open(take);
            let (of_take, _) = rows(frames.info(), SampledKind::ForcePlates(None));
            let (read, remarks) = c3d(&mut frames);
            assert_eq!(remarks, Vec::<String>::new());
            let (of_file, _) = rows(&read, SampledKind::ForcePlates(None));
            for (found, expected) in of_file[500].iter().zip(&of_take[500]) {
                assert!(
                    (found - expected).abs() <= 1e-4 * expected.abs().max(1.0),
                    "{z}: {found} {expected}"
                );
            }
            // By hand: the moment about the centre is M + F x origin.
            let sign = if corners_mm == up { 1.0 } else { -1.0 };
            let moment_x = 12.0 + (-30.0 * z - 700.0 * -2.0) / 1000.0;
            assert!(
                (f64::from(of_take[500][3]) - moment_x).abs() < 1e-3,
                "{z}: {:?}",
                of_take[500]
            );
            assert!((f64::from(of_take[500][2]) - sign * 700.0).abs() < 1e-3);
        }
    }
}

/// The same of a plate of type 3, whose sensors change places when its axes are turned, and of type 1, which has no origin.
/// Expected by hand: force, moment about the centre and centre of pressure in the plate's own axes, for sensors `z` mm from
/// the surface.
#[test]
fn plates_of_types_1_and_3_have_the_same_loads_in_c3d_whichever_way_their_axes_point() {
    let (x, y) = (300.0, 200.0);
    let up = [[x, y, 5.0], [-x, y, 5.0], [-x, -y, 5.0], [x, -y, 5.0]];
    let down = [[x, -y, 5.0], [-x, -y, 5.0], [-x, y, 5.0], [x, y, 5.0]];
    let units = ["N", "N", "N", "mm", "mm", "N m"].map(|unit| ("", unit));
    // Twice the values, for the scale of a half.
    let of_centre = [400.0_f32, -60.0, 1400.0, 80.0, -50.0, 6.0];
    let at_sensors = [300.0_f32, 100.0, -20.0, -40.0, 600.0, 200.0, 300.0, 300.0];
    for (corners_mm, sign) in [(up, 1.0), (down, -1.0)] {
        for z in [50.0, 0.0, -50.0] {
            for code in [1, 3] {
                let names: Vec<(String, &str)> = match code {
                    1 => (0..6).map(|i| (format!("c{i}"), units[i].1)).collect(),
                    _ => (0..8).map(|i| (format!("c{i}"), "N")).collect(),
                };
                let channels: Vec<(&str, &str)> =
                    names.iter().map(|(name, unit)| (&name[..], *unit)).collect();
                let origin_mm = if code == 1 { [0.0, 0.0, z] } else { [120.0, 80.0, z] };
                let plate = StatedPlate {
                    number: 1,
                    code,
                    group: 0,
                    channels: (0..channels.len()).collect(),
                    corners_mm,
                    origin_mm,
                };
                let value = |_| if code == 1 { of_centre.to_vec() } else { at_sensors.to_vec() };
                let take = take(&even_rows(100), &channels, &[plate], half_seconds(value));
                let mut frames = open(take);
                let (of_take, _) = rows(frames.info(), SampledKind::ForcePlates(None));
                let (read, remarks) = c3d(&mut frames);
                assert_eq!(remarks, Vec::<String>::new());
                let (of_file, _) = rows(&read, SampledKind::ForcePlates(None));
                // Type 1: the centre is given, with y fz, -x fz, and x fy - y fx + 3 N m. Type 3: 0.08 m x 100 N and
                // 0.12 m x -200 N, with -30 N and 200 N at the distance of the sensors; 0.08 m x -100 N + 0.12 m x 10 N.
                let [mx, my, mz] = match code {
                    1 => [-17.5, -28.0, 6.8],
                    _ => [8.0 - 0.03 * z, -24.0 - 0.2 * z, -6.8],
                };
                let (cop_x, cop_y) = (-my / 0.7, mx / 0.7);
                let expected = [
                    [200.0, sign * -30.0, sign * 700.0],
                    [mx, sign * my, sign * mz],
                    [cop_x, sign * cop_y, 5.0],
                ];
                for (found, expected) in of_take[500].iter().zip(expected.as_flattened()) {
                    assert!((f64::from(*found) - expected).abs() < 1e-3, "{code} {z}: {found}");
                }
                assert!(of_take[500].len() >= 9);
                for (found, expected) in of_file[500].iter().zip(&of_take[500]) {
                    let close = 1e-4 * expected.abs().max(1.0);
                    assert!((found - expected).abs() <= close, "{code} {z}: {found} {expected}");
                }
                assert_eq!(of_file[500].len(), of_take[500].len());
            }
        }
    }
}

#[test]
fn a_channel_that_is_no_number_does_not_cost_the_others() {
    let value = |number: u64| vec![number as f32, f32::NAN];
    let mut frames =
        open(take(&even_rows(100), &[("a", "V"), ("b", "V")], &[], half_seconds(value)));
    let (read, remarks) = c3d(&mut frames);
    let (found, times) = rows(&read, SampledKind::Analog);
    assert!(found.iter().enumerate().all(|(i, row)| row[..] == [i as f32 * 0.5, 0.0]));
    assert_eq!((times.len(), times[999]), (1000, 0.999));
    assert_eq!(remarks.len(), 1, "{remarks:?}");
    assert!(
        remarks[0].contains("no numbers") && remarks[0].contains("1000 samples of b"),
        "{remarks:?}"
    );
}

#[test]
fn years_of_lost_samples_are_left_out_and_counted() {
    let blocks = |stretch: usize| {
        let first = [0, 1 << 49][stretch];
        vec![block(first, 0, first * SAMPLE, vec![vec![1.0; 100]])]
    };
    let frames = open(take(&even_rows(100), &[("a", "V")], &[], blocks));
    let (found, times) = rows(frames.info(), SampledKind::Group(0));
    assert_eq!((found.len(), times[99], times[100]), (200, 0.099, (1_u64 << 49) as f64 / 1000.0));
    let recording = frames.info().recording.as_ref().unwrap();
    assert_eq!(recording.n_without_time(0).unwrap(), (1 << 49) - 100);
}

/// The device's clock goes back by a second between two stretches, or begins again at 0.
#[test]
fn samples_stay_with_their_rows_where_the_clock_goes_back() {
    for (back, restart) in [(100_000, false), (0, true)] {
        let ticks = |at: u64| match at {
            0..200_000 => at,
            _ if restart => at - 200_000,
            _ => at - back,
        };
        let ticks_of: Vec<u64> = (0..400).map(|row| ticks(row * ROW)).collect();
        let blocks = |stretch: usize| {
            let first = stretch as u64 * 500;
            let run_start = if stretch < 4 { 0 } else { 2000 };
            let samples = (first..first + 500).map(|number| number as f32).collect();
            vec![block(first, run_start, ticks(first * SAMPLE), vec![samples])]
        };
        let file = take(&ticks_of, &[("a", "V")], &[], blocks);
        windows_are_those_of_exports(&file, 2000);
        let frames = open(file);
        let (found, times) = rows(frames.info(), SampledKind::Group(0));
        assert_eq!(found.len(), 4000, "{restart}");
        for (row, time) in found.iter().zip(&times) {
            let expected = f64::from(row[0]) * 2.0 / 1000.0;
            assert!((time - expected).abs() < 1e-6, "{restart}: {time} for {expected}");
        }
    }
}

#[test]
fn a_clock_that_drifts_away_and_comes_back_is_not_in_step() {
    // Up to 3 ms late in the middle of 8 s.
    let late = |at: u64| if at < 400_000 { at / 1333 } else { (800_000 - at) / 1333 };
    let blocks = |stretch: usize| {
        let first = stretch as u64 * 500;
        let samples = (first..first + 500).map(|number| number as f32).collect();
        vec![block(first, 0, first * SAMPLE + late(first * SAMPLE), vec![samples])]
    };
    let mut frames = open(take(&even_rows(800), &[("a", "V")], &[], blocks));
    let left_out = Format::C3d.leaves_out(frames.info(), true);
    assert!(
        left_out
            .iter()
            .any(|what| what.contains("drift apart by 1.9") && what.contains("--resample")),
        "{left_out:?}"
    );
    let (read, _) = c3d(&mut frames);
    assert_eq!(SampledTable::all(&read).unwrap().len(), 0);
}

#[test]
fn what_comes_before_the_first_frame_is_in_tables_and_not_in_c3d() {
    // A camera that waits for its trigger for three seconds.
    let rows_from = 300_000;
    let ticks_of: Vec<u64> = (0..100).map(|row| rows_from + row * ROW).collect();
    let blocks = |stretch: usize| {
        let first = stretch as u64 * 2000;
        let samples = (first..first + 2000).map(|number| number as f32).collect();
        vec![block(first, 0, first * SAMPLE, vec![samples])]
    };
    let mut frames = open(take(&ticks_of, &[("a", "V")], &[], blocks));
    let (found, times) = rows(frames.info(), SampledKind::Group(0));
    assert_eq!((found.len(), times[0], times[3000]), (4000, -3.0, 0.0));
    let (read, remarks) = c3d(&mut frames);
    let (found, _) = rows(&read, SampledKind::Analog);
    assert_eq!((found.len(), found[0][0], found[999][0]), (1000, 1500.0, 1999.5));
    assert!(remarks.is_empty(), "{remarks:?}");
}

/// Windows of a few rows, by an index, have the samples that exports place there.
fn windows_are_those_of_exports(file: &[u8], n_seen_max: u64) {
    let frames = open(file.to_vec());
    let recording = frames.info().recording.as_ref().unwrap();
    let line = SampleTimeLine::read(Cursor::new(file), frames.map()).unwrap();
    let (index, clock) = (line.index(0).unwrap(), line.clock(0).unwrap());
    let mut n_found = 0;
    for first in (1..392).step_by(7) {
        let rows = first..first + 7;
        let (mut found, mut n_seen) = (Vec::new(), 0);
        index.in_rows(clock, &rows, |number, row| {
            n_seen += 1;
            found.extend(row.map(|row| (number, row)));
            true
        });
        // Times of rows and samples are the same to a tick.
        let expected = recording.numbers(0, &rows).unwrap();
        let expected: Vec<u64> = expected.iter().cloned().flatten().collect();
        let numbers: Vec<u64> = found.iter().map(|(number, _)| *number).collect();
        assert_eq!(numbers, expected, "{rows:?}");
        for (number, row) in &found {
            let place = clock.position(*number).unwrap();
            assert!((*row as f64 - place.floor()).abs() < 1e-9, "{number}: {row} for {place}");
        }
        assert!(n_seen <= n_seen_max, "{n_seen} samples were looked at for {}", found.len());
        n_found += found.len();
    }
    assert!(n_found > 0);
}

/// While no frames come, samples have no place, and no row has them.
#[test]
fn windows_around_an_outage_have_the_samples_of_exports() {
    let ticks = |row: u64| row * ROW + if row < 200 { 0 } else { 300_000 };
    let ticks_of: Vec<u64> = (0..400).map(ticks).collect();
    let blocks = |stretch: usize| {
        let first = stretch as u64 * 900;
        let samples = (first..first + 900).map(|number| number as f32).collect();
        vec![block(first, 0, first * SAMPLE, vec![samples])]
    };
    let file = take(&ticks_of, &[("a", "V")], &[], blocks);
    // Those of the outage are looked at by the windows at its ends.
    windows_are_those_of_exports(&file, 5000);
    let frames = open(file);
    let recording = frames.info().recording.as_ref().unwrap();
    assert!(recording.n_without_time(0).unwrap() > 2900);
}
