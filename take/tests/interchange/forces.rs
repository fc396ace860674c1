//! Analog samples and force plates of C3D files whose physical values are known.

use mocapd_take::{
    TakeError,
    foreign::{
        analog::AnalogSamples,
        content::Content,
        force_plates::{Baseline, ForcePlates, LOADED_N, PlateLoad, PlateLoads},
    },
    interchange::{Format, RotatedFrames, mot},
    motion::{Motion, MotionFrames, UpAxis},
};
use mocapd_testkit::random::Random;

use crate::c3d_file::{C3dFile, Order};

type Vector = [f64; 3];

/// A file with a still point and these analog samples, frame by frame: first those of the first instant, then of the
/// next.
fn file(order: Order, scale: f32, (n_channels, ratio): (usize, usize), analog: &[f32]) -> C3dFile {
    let frames = analog
        .chunks(n_channels * ratio)
        .enumerate()
        .map(|(frame, samples)| [&[100.0, 200.0 + frame as f32, 300.0, 0.0], samples].concat());
    let mut file =
        C3dFile { order, scale, analog: (n_channels, ratio), ..C3dFile::new(1, frames.collect()) };
    file.texts(1, "LABELS", &["head"]);
    file.records.extend(file.group(2, "ANALOG"));
    file.words(2, "USED", &[n_channels as u16]);
    file.floats(2, "RATE", &[100.0 * ratio as f32]);
    file
}

fn read(file: &C3dFile) -> Motion {
    Format::C3d.read(&file.bytes()).expect("a usable file")
}

/// All values, channel by channel within each instant.
fn values(motion: &Motion) -> Vec<f64> {
    let mut samples = AnalogSamples::open(&motion.info).expect("memory").expect("samples");
    let (mut all, mut block, mut n_frames) = (Vec::new(), Vec::new(), 0);
    loop {
        match samples.next_block(&mut block).expect("memory") {
            0 => break,
            n => n_frames += n as u64,
        }
        all.extend_from_slice(&block);
    }
    assert_eq!(n_frames, motion.info.n_frames);
    all
}

#[test]
fn samples_are_converted_to_physical_units() {
    // Two frames of two instants of three channels.
    let stored = [0, 100, -100, 1, 101, -101, 2, 102, -102, 3, 103, -103];
    let floats: Vec<f32> = stored.iter().map(|&v: &i16| f32::from(v)).collect();
    let scales = [2.0, 0.5, -0.25_f32];
    let offsets = [10, -20, 5_i16];
    for order in [Order::Intel, Order::Dec, Order::Mips] {
        for scale in [-1.0, 0.5] {
            let mut file = file(order, scale, (3, 2), &floats);
            file.floats(2, "GEN_SCALE", &[0.125]);
            file.floats(2, "SCALE", &scales);
            file.words(2, "OFFSET", &offsets.map(|v| v as u16));
            file.texts(2, "LABELS", &["Fz1", "", "EMG left"]);
            file.texts(2, "UNITS", &["N", "V", "mV"]);
            file.texts(2, "DESCRIPTIONS", &["plate", "", "soleus"]);
            let motion = read(&file);
            let samples = AnalogSamples::open(&motion.info).expect("memory").expect("samples");
            assert_eq!((samples.rate_hz(), samples.samples_per_frame()), (200.0, 2));
            assert_eq!(samples.warnings(), [""; 0]);
            let channels: Vec<_> = samples
                .channels()
                .iter()
                .map(|c| (c.name.as_str(), c.unit.as_str(), c.description.as_str()))
                .collect();
            assert_eq!(
                channels,
                [("Fz1", "N", "plate"), ("A2", "V", ""), ("EMG left", "mV", "soleus")]
            );
            let expected: Vec<f64> = (0..stored.len())
                .map(|i| {
                    let from_zero = f64::from(stored[i]) - f64::from(offsets[i % 3]);
                    from_zero * f64::from(scales[i % 3]) * 0.125
                })
                .collect();
            assert_eq!(values(&motion), expected, "{order:?} {scale}");
        }
    }
}

#[test]
fn unsigned_integers_exceed_half_of_their_range() {
    // 40 000 and 60 000 as 16-bit words.
    let mut file = file(Order::Intel, 0.5, (1, 1), &[-25_536.0, -5536.0, 3.0]);
    file.texts(2, "FORMAT", &["UNSIGNED"]);
    file.floats(2, "SCALE", &[0.5]);
    file.words(2, "OFFSET", &[50_000]);
    assert_eq!(values(&read(&file)), [-5000.0, 5000.0, -24_998.5]);
}

#[test]
fn missing_and_unusable_numbers_are_defaults_with_a_warning() {
    let mut file = file(Order::Intel, -1.0, (3, 1), &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    file.floats(2, "SCALE", &[2.0, f32::NAN, 3.0]);
    file.words(2, "OFFSET", &[1]);
    file.floats(2, "GEN_SCALE", &[0.0]);
    let motion = read(&file);
    assert_eq!(values(&motion), [0.0, 2.0, 9.0, 6.0, 5.0, 18.0]);
    let samples = AnalogSamples::open(&motion.info).expect("memory").expect("samples");
    let warnings = samples.warnings().join("\n");
    for what in [
        "GEN_SCALE is 0",
        "SCALE has no number for 1 channel of 3",
        "OFFSET has no number for 2 channels of 3",
    ] {
        assert!(warnings.contains(what), "{warnings}");
    }
}

#[test]
fn more_channels_than_a_parameter_holds_continue_in_the_next() {
    let n = 300;
    let mut file = file(Order::Intel, -1.0, (n, 1), &vec![1.0; n]);
    let scales: Vec<f32> = (0..n).map(|i| i as f32).collect();
    file.floats(2, "SCALE", &scales[..255]);
    file.floats(2, "SCALE2", &scales[255..]);
    file.words(2, "OFFSET", &[0; 255]);
    file.words(2, "OFFSET2", &[0; 45]);
    assert_eq!(values(&read(&file)), (0..n).map(|i| i as f64).collect::<Vec<_>>());
}

#[test]
fn a_part_of_a_take_has_the_samples_of_its_frames() {
    let analog: Vec<f32> = (0..40).map(|i| i as f32).collect();
    let mut motion = read(&file(Order::Intel, -1.0, (2, 2), &analog));
    motion.info.cut(3, 7);
    assert_eq!(values(&motion), (12..28).map(f64::from).collect::<Vec<_>>());
    // Frames that the kept part lacks, before and after those that it has.
    motion.info.source.first_frame = 1;
    let mut late = motion.clone();
    late.info.source.first_frame = 9;
    let found = values(&late);
    assert_eq!(found[..8], (32..40).map(f64::from).collect::<Vec<_>>());
    assert!(found.len() == 16 && found[8..].iter().all(|value| value.is_nan()));
}

#[test]
fn long_takes_come_in_blocks() {
    let analog: Vec<f32> = (0..96_000).map(|i| (i % 1000) as f32).collect();
    let motion = read(&file(Order::Intel, -1.0, (16, 30), &analog));
    let mut samples = AnalogSamples::open(&motion.info).expect("memory").expect("samples");
    let mut block = Vec::new();
    let mut all = Vec::new();
    while samples.next_block(&mut block).expect("memory") > 0 {
        assert!(block.len() <= 1 << 16 && block.len().is_multiple_of(480));
        all.extend_from_slice(&block);
    }
    assert_eq!(all, analog.iter().map(|&v| f64::from(v)).collect::<Vec<_>>());
}

#[test]
fn unread_parts_are_an_error_and_missing_parts_are_none() {
    let mut motion = read(&file(Order::Intel, -1.0, (1, 1), &[1.0, 2.0]));
    for kind in ["c3d/analog", "c3d/parameters"] {
        let mut unread = motion.clone();
        let parts = unread.info.foreign.iter_mut();
        parts.filter(|part| part.kind == kind).for_each(|part| part.data = Content::default());
        let error = AnalogSamples::open(&unread.info).expect_err("nothing to read");
        assert!(matches!(error, TakeError::InvalidArgument(_)), "{error:?}");
        assert!(error.to_string().contains(kind), "{error}");
    }
    motion.info.foreign.clear();
    assert!(AnalogSamples::open(&motion.info).expect("no parts").is_none());
    assert!(ForcePlates::of(&motion.info).expect("no parts").is_none());
}

/// A plate of 400 x 500 mm: its x axis is the laboratory's y, its y axis the laboratory's x, its z axis points down.
const CENTRE_MM: Vector = [1000.0, 2000.0, 5.0];
const CORNERS_MM: [f32; 12] =
    [1200.0, 2250.0, 5.0, 1200.0, 1750.0, 5.0, 800.0, 1750.0, 5.0, 800.0, 2250.0, 5.0];

fn turned([x, y, z]: Vector) -> Vector {
    [y, x, -z]
}

fn cross([a, b, c]: Vector, [x, y, z]: Vector) -> Vector {
    [b * z - c * y, c * x - a * z, a * y - b * x]
}

fn sum(vectors: &[Vector]) -> Vector {
    std::array::from_fn(|i| vectors.iter().map(|vector| vector[i]).sum())
}

fn less(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|i| a[i] - b[i])
}

/// A load in the plate's axes, about the centre of its surface, as the reader must give it in laboratory axes.
fn expected(force: Vector, moment: Vector, point_m: Vector, free_nm: f64) -> PlateLoad {
    let point = turned(point_m);
    PlateLoad {
        force_n: turned(force),
        moment_nm: turned(moment),
        cop_mm: std::array::from_fn(|i| CENTRE_MM[i] + point[i] * 1000.0),
        free_moment_nm: turned([0.0, 0.0, free_nm]),
    }
}

fn assert_close(found: &PlateLoad, expected: &PlateLoad) {
    let flat = |load: &PlateLoad| {
        [load.force_n, load.moment_nm, load.cop_mm, load.free_moment_nm].concat()
    };
    for (a, b) in flat(found).iter().zip(flat(expected)) {
        // Samples are f32.
        assert!((a - b).abs() <= 1e-4 * b.abs().max(1.0), "{found:?}\nfor {expected:?}");
    }
}

/// Adds the group of one plate, whose channels are the first ones.
fn add_plate(file: &mut C3dFile, kind: u16, origin: [f32; 3], zero: [u16; 2]) {
    let n_channels = if kind == 3 { 8 } else { 6 };
    file.records.extend(file.group(3, "FORCE_PLATFORM"));
    file.words(3, "USED", &[1]);
    file.words(3, "TYPE", &[kind]);
    file.words(3, "ZERO", &zero);
    let per_mm = if file.unit == "m" { 1e-3 } else { 1.0 };
    file.floats(3, "CORNERS", &CORNERS_MM.map(|v| v * per_mm));
    file.floats(3, "ORIGIN", &origin.map(|v| v * per_mm));
    file.words(3, "CHANNEL", &(1..=n_channels).collect::<Vec<u16>>());
}

fn loads(motion: &Motion, baseline: Baseline) -> Vec<PlateLoad> {
    let mut loads = PlateLoads::open(&motion.info, baseline).expect("readable").expect("a plate");
    assert!(loads.plates().unusable.is_empty(), "{:?}", loads.plates().unusable);
    let (mut all, mut block) = (Vec::new(), Vec::new());
    while loads.next_block(&mut block).expect("memory") > 0 {
        all.extend_from_slice(&block);
    }
    all
}

/// In the plate's axes: a reaction of 800 N upward, a little forward and to the side, 100 mm from the centre both ways.
const FORCE_N: Vector = [-20.0, 30.0, -800.0];
const POINT_M: Vector = [0.1, -0.08, 0.0];
const FREE_NM: f64 = -4.0;
const ORIGIN_MM: [f32; 3] = [3.0, -2.0, -40.0];

fn about_centre() -> Vector {
    sum(&[cross(POINT_M, FORCE_N), [0.0, 0.0, FREE_NM]])
}

/// What the sensors of a plate of type 2 measure about their own origin, N m.
fn about_sensors() -> Vector {
    let lever = sum(&[ORIGIN_MM.map(|v| f64::from(v) / 1000.0), POINT_M]);
    sum(&[cross(lever, FORCE_N), [0.0, 0.0, FREE_NM]])
}

fn as_f32<const N: usize>(values: [f64; N]) -> [f32; N] {
    values.map(|value| value as f32)
}

#[test]
fn six_components_are_force_and_moment_of_the_sensors() {
    let moment = about_sensors();
    // Moments in N mm with lengths in mm, in N m with m, in N m with mm as stated, and without a unit.
    for (unit, of_moments, factor) in [
        ("mm", Some("Nmm"), 1000.0),
        ("m", Some("N m"), 1.0),
        ("mm", Some("Nm"), 1.0),
        ("mm", None, 1000.0),
    ] {
        let channels = [as_f32(FORCE_N), as_f32(moment.map(|m| m * factor))].concat();
        let mut file = C3dFile { unit, ..file(Order::Intel, -1.0, (6, 1), &channels.repeat(3)) };
        if let Some(moments) = of_moments {
            file.texts(2, "UNITS", &["N", "N", "N", moments, moments, moments]);
        }
        add_plate(&mut file, 2, ORIGIN_MM, [0, 0]);
        let wanted = expected(FORCE_N, about_centre(), POINT_M, FREE_NM);
        let found = loads(&read(&file), Baseline::AsStored);
        assert_eq!(found.len(), 3);
        found.iter().for_each(|load| assert_close(load, &wanted));
        // The reaction to a person who stands points up.
        assert!(found[0].force_n[2] > 0.0);
    }
}

#[test]
fn processed_plates_state_their_centre_of_pressure() {
    let point_mm = POINT_M.map(|v| v * 1000.0);
    let channels = [as_f32(FORCE_N), as_f32([point_mm[0], point_mm[1], FREE_NM * 1000.0])].concat();
    let mut file = file(Order::Intel, -1.0, (6, 1), &channels.repeat(2));
    add_plate(&mut file, 1, [0.0, 0.0, -10.0], [1, 0]);
    let wanted = expected(FORCE_N, about_centre(), POINT_M, FREE_NM);
    loads(&read(&file), Baseline::AsStored).iter().for_each(|load| assert_close(load, &wanted));
}

#[test]
fn eight_components_are_forces_at_four_sensors() {
    let (a, b, height) = (0.12, 0.2, -0.045);
    let sensors = [[a, b, 0.0], [-a, b, 0.0], [-a, -b, 0.0], [a, -b, 0.0]];
    let forces: [Vector; 4] =
        [[5.0, 9.0, -300.0], [-8.0, 4.0, -150.0], [2.0, -7.0, -90.0], [11.0, 3.0, -210.0]];
    let moments: Vec<Vector> = sensors
        .iter()
        .zip(&forces)
        .map(|(&at, &force)| cross(less(at, [0.0, 0.0, height]), force))
        .collect();
    let (force, moment) = (sum(&forces), sum(&moments));
    let point = [-moment[1] / force[2], moment[0] / force[2], 0.0];
    let free = less(moment, cross(point, force));
    assert!(free[0].abs() < 1e-9 && free[1].abs() < 1e-9, "no moment along the surface remains");
    let [f1, f2, f3, f4] = forces;
    let channels = as_f32([
        f1[0] + f2[0],
        f3[0] + f4[0],
        f1[1] + f4[1],
        f2[1] + f3[1],
        f1[2],
        f2[2],
        f3[2],
        f4[2],
    ]);
    let mut file = file(Order::Mips, -1.0, (8, 2), &channels.repeat(4));
    // The height with the wrong sign, as some software stores it.
    add_plate(&mut file, 3, as_f32([a * 1000.0, b * 1000.0, -height * 1000.0]), [0, 0]);
    let motion = read(&file);
    let wanted = expected(force, moment, point, free[2]);
    loads(&motion, Baseline::AsStored).iter().for_each(|load| assert_close(load, &wanted));
    let plates = ForcePlates::of(&motion.info).expect("readable").expect("a plate");
    assert!(plates.warnings.iter().any(|w| w.contains("opposite sign")), "{:?}", plates.warnings);
}

#[test]
fn a_calibration_matrix_removes_crosstalk() {
    // Columns one after another; N/V in the first three rows, N mm/V in the others.
    let mut matrix = [0.0_f32; 36];
    for (i, diagonal) in [100.0, 101.0, 210.0, 5000.0, 5100.0, 3000.0].into_iter().enumerate() {
        matrix[6 * i + i] = diagonal;
    }
    matrix[6 * 2] = 1.5; // Fz on Fx
    matrix[6 * 2 + 3] = -40.0; // Fz on Mx
    matrix[4] = 12.0; // Fx on My
    let volts = [-0.2, 0.3, -3.8, 11.0, 13.0, -0.7_f32];
    let corrected: [f64; 6] = std::array::from_fn(|row| {
        (0..6).map(|column| f64::from(matrix[6 * column + row]) * f64::from(volts[column])).sum()
    });
    let load = |kind: u16, channels: [f32; 6], matrix: Option<&[f32; 36]>| {
        let mut file = file(Order::Intel, -1.0, (6, 1), &channels.repeat(2));
        file.texts(2, "UNITS", &[if kind == 4 { "V" } else { "" }; 6]);
        add_plate(&mut file, kind, ORIGIN_MM, [0, 0]);
        if let Some(matrix) = matrix {
            let data: Vec<u8> = matrix.iter().flat_map(|v| v.to_le_bytes()).collect();
            let record = file.record(3, "CAL_MATRIX", 4, &[6, 6, 1], &data);
            file.records.extend(record);
        }
        loads(&read(&file), Baseline::AsStored)[0]
    };
    let calibrated = load(4, volts, Some(&matrix));
    assert_close(&calibrated, &load(2, as_f32(corrected), None));
    assert!(calibrated.cop_mm.iter().all(|v| v.is_finite()));
    // Without a matrix, channels are forces and moments themselves.
    assert_close(&load(4, as_f32(corrected), None), &load(2, as_f32(corrected), None));
}

#[test]
fn a_baseline_is_subtracted_if_wanted() {
    let drift = [3.0, -2.0, 15.0, 500.0, -700.0, 90.0_f32];
    let load = [as_f32(FORCE_N), as_f32(about_sensors().map(|m| m * 1000.0))].concat();
    let loaded: Vec<f32> = load.iter().zip(drift).map(|(a, b)| a + b).collect();
    // Frames 1 to 4 are empty: the mean of two drifts that differ by as much up as down.
    let mut analog: Vec<f32> = Vec::new();
    for frame in 0..4 {
        let sign = if frame % 2 == 0 { 1.0 } else { -1.0 };
        analog.extend(drift.map(|v| v + 0.5 * sign));
    }
    analog.extend(loaded.repeat(4));
    let with_zero = |zero: [u16; 2]| {
        let mut file = file(Order::Intel, -1.0, (6, 1), &analog);
        add_plate(&mut file, 2, ORIGIN_MM, zero);
        read(&file)
    };
    let motion = with_zero([0, 4]);
    let wanted = expected(FORCE_N, about_centre(), POINT_M, FREE_NM);
    let subtracted = loads(&motion, Baseline::Subtracted);
    assert_close(&subtracted[5], &wanted);
    let stored = loads(&motion, Baseline::AsStored);
    assert!((stored[5].force_n[2] - wanted.force_n[2]).abs() > 10.0);
    // In a part of the take, too.
    let mut part = motion.clone();
    part.info.cut(5, 8);
    assert_close(&loads(&part, Baseline::Subtracted)[0], &wanted);
    for zero in [[0, 0], [1, 0], [400, 410]] {
        let motion = with_zero(zero);
        let error = PlateLoads::open(&motion.info, Baseline::Subtracted).expect_err("no frames");
        assert!(error.to_string().contains("FORCE_PLATFORM:ZERO"), "{error}");
    }
}

#[test]
fn an_unloaded_plate_has_no_centre_of_pressure() {
    for (normal, is_loaded) in
        [(-LOADED_N, true), (LOADED_N, true), (-LOADED_N + 0.01, false), (0.0, false)]
    {
        let channels = as_f32([1.0, 2.0, normal, 300.0, 200.0, 100.0]);
        let mut file = file(Order::Intel, -1.0, (6, 1), &channels.repeat(2));
        add_plate(&mut file, 2, ORIGIN_MM, [0, 0]);
        let load = loads(&read(&file), Baseline::AsStored)[0];
        let has = |vector: Vector| vector.iter().all(|v| v.is_finite());
        assert!(has(load.force_n) && has(load.moment_nm));
        assert_eq!(
            (has(load.cop_mm), has(load.free_moment_nm)),
            (is_loaded, is_loaded),
            "{normal}"
        );
    }
}

#[test]
fn plates_that_cannot_be_used_are_listed_with_the_reason() {
    type Change = fn(&mut C3dFile);
    let cases: [(&str, Change); 7] = [
        ("type 5", |file| file.words(3, "TYPE", &[5])),
        ("TYPE", |file| file.words(3, "USED", &[2])),
        ("CORNERS", |file| file.floats(3, "CORNERS", &CORNERS_MM[..9])),
        ("do not span", |file| file.floats(3, "CORNERS", &[7.0; 12])),
        ("not finite", |file| file.floats(3, "CORNERS", &[f32::NAN; 12])),
        ("number 9, but there are 6", |file| file.words(3, "CHANNEL", &[1, 2, 3, 4, 5, 9])),
        ("6 channels", |file| file.words(3, "CHANNEL", &[1, 2, 3])),
    ];
    for (reason, change) in cases {
        let mut file = file(Order::Intel, -1.0, (6, 1), &[1.0; 12]);
        file.records.extend(file.group(3, "FORCE_PLATFORM"));
        // The first of two parameters of a name is the one that counts.
        change(&mut file);
        add_plate(&mut file, 2, ORIGIN_MM, [0, 0]);
        let plates = ForcePlates::of(&read(&file).info).expect("readable").expect("plates");
        let reasons: Vec<_> = plates.unusable.iter().map(|plate| plate.reason.as_str()).collect();
        assert!(reasons.len() == 1 && reasons[0].contains(reason), "{reason}: {reasons:?}");
    }
    let mut none = file(Order::Intel, -1.0, (6, 1), &[1.0; 12]);
    none.records.extend(none.group(3, "FORCE_PLATFORM"));
    none.words(3, "USED", &[0]);
    assert!(ForcePlates::of(&read(&none).info).expect("readable").is_none());
}

#[test]
fn arbitrary_parameters_are_never_a_panic() {
    let mut random = Random::new(7);
    for _ in 0..300 {
        let mut file = file(Order::Intel, -1.0, (6, 2), &[5.0; 48]);
        file.records.extend(file.group(3, "FORCE_PLATFORM"));
        for name in ["USED", "TYPE", "ZERO", "CORNERS", "ORIGIN", "CHANNEL", "CAL_MATRIX"] {
            let n_dimensions = random.below(4);
            let dimensions: Vec<u8> = (0..n_dimensions).map(|_| random.below(9) as u8).collect();
            let n: usize = dimensions.iter().map(|&d| usize::from(d)).product();
            let kind = [1, 2, 4][random.below(3)];
            let data: Vec<u8> = (0..n * kind)
                .map(|_| {
                    if random.below(3) == 0 {
                        random.below(256) as u8
                    } else {
                        random.below(5) as u8
                    }
                })
                .collect();
            let record = file.record(3, name, kind as i8, &dimensions, &data);
            file.records.extend(record);
        }
        let motion = read(&file);
        for baseline in [Baseline::AsStored, Baseline::Subtracted] {
            let Ok(Some(mut loads)) = PlateLoads::open(&motion.info, baseline) else { continue };
            let mut block = Vec::new();
            while loads.next_block(&mut block).expect("memory") > 0 {}
        }
    }
}

/// The cells of a motion file for `OpenSim`, after its header: the names, and the numbers of each row.
fn table(text: &str) -> (Vec<&str>, Vec<Vec<f64>>) {
    let (_, table) = text.split_once("\nendheader\n").expect("a header");
    let mut lines = table.lines();
    let names = lines.next().expect("names").split('\t').collect();
    let numbers =
        |line: &str| line.split('\t').map(|cell| cell.parse().expect("a number")).collect();
    (names, lines.map(numbers).collect())
}

/// Three frames of two instants: loaded, and unloaded in the last frame. z is up.
pub(crate) fn loaded_and_not() -> Motion {
    let channels = [as_f32(FORCE_N), as_f32(about_sensors().map(|m| m * 1000.0))].concat();
    let mut analog = channels.repeat(4);
    analog.extend(channels.iter().map(|v| v / 100.0).collect::<Vec<_>>().repeat(2));
    let mut file = file(Order::Intel, -1.0, (6, 2), &analog);
    file.floats(2, "SCALE", &[1.0; 6]);
    file.words(2, "OFFSET", &[0; 6]);
    add_plate(&mut file, 2, ORIGIN_MM, [0, 0]);
    file.texts(1, "Y_SCREEN", &["+Z"]);
    let motion = read(&file);
    assert_eq!(motion.info.up, UpAxis::Z);
    motion
}

#[test]
fn a_mot_has_the_loads_in_newtons_and_metres() {
    let motion = loaded_and_not();
    let mut out = Vec::new();
    let remarks = mot::write(&mut MotionFrames::new(&motion), &mut out, Baseline::AsStored);
    assert_eq!(remarks.expect("plates"), [""; 0]);
    let text = String::from_utf8(out).expect("text");
    let header =
        "ground_reaction_forces\nversion=1\nnRows=6\nnColumns=10\ninDegrees=no\nendheader\n";
    assert!(text.starts_with(header), "{text}");
    let (names, rows) = table(&text);
    let expected_names = "time ground_force_1_vx ground_force_1_vy ground_force_1_vz ground_force_1_px ground_force_1_py \
        ground_force_1_pz ground_torque_1_x ground_torque_1_y ground_torque_1_z";
    assert_eq!(names, expected_names.split_whitespace().collect::<Vec<_>>());
    let wanted = expected(FORCE_N, about_centre(), POINT_M, FREE_NM);
    let metres = wanted.cop_mm.map(|v| v / 1000.0);
    let wanted = [wanted.force_n, metres, wanted.free_moment_nm].concat();
    for (i, row) in rows.iter().enumerate() {
        assert_eq!(row[0], i as f64 / 200.0);
        let is_loaded = i < 4;
        for (found, wanted) in row[1..].iter().zip(&wanted) {
            let wanted = if is_loaded { *wanted } else { 0.0 };
            assert!((found - wanted).abs() <= 1e-4 * wanted.abs().max(1.0), "{i}: {row:?}");
        }
    }
    assert_eq!(rows.len(), 6);
    assert!(!text.contains("-0\t") && !text.contains("NaN"), "{text}");
}

#[test]
fn a_mot_is_rotated_with_the_markers() {
    let motion = loaded_and_not();
    let mut frames = MotionFrames::new(&motion);
    let mut turned =
        RotatedFrames::new(&mut frames, UpAxis::Y).expect("memory").expect("a known axis");
    let mut out = Vec::new();
    mot::write(&mut turned, &mut out, Baseline::AsStored).expect("plates");
    let (_, rows) = table(std::str::from_utf8(&out).expect("text"));
    let wanted = expected(FORCE_N, about_centre(), POINT_M, FREE_NM);
    // z up to y up: (x, y, z) becomes (x, z, -y).
    for (from, vector, unit) in
        [(1, wanted.force_n, 1.0), (4, wanted.cop_mm, 1e-3), (7, wanted.free_moment_nm, 1.0)]
    {
        let [x, y, z] = vector.map(|v| v * unit);
        for (found, wanted) in rows[0][from..from + 3].iter().zip([x, z, -y]) {
            assert!((found - wanted).abs() <= 1e-4 * wanted.abs().max(1.0), "{:?}", rows[0]);
        }
    }
    assert!(rows[0][2] > 700.0, "a person who stands is pushed up");
}

#[test]
fn a_mot_states_its_assumptions() {
    // The action on the plate instead of the reaction.
    let reversed = as_f32(FORCE_N.map(|v| -v));
    let channels = [reversed, as_f32(about_sensors().map(|m| -m * 1000.0))].concat();
    let mut file = file(Order::Intel, -1.0, (6, 1), &channels.repeat(3));
    add_plate(&mut file, 2, ORIGIN_MM, [0, 0]);
    file.texts(1, "Y_SCREEN", &["+Z"]);
    let write = |motion: &Motion| {
        mot::write(&mut MotionFrames::new(motion), &mut Vec::new(), Baseline::AsStored)
            .expect("plates")
            .join("\n")
    };
    assert!(write(&read(&file)).contains("force plate 1 point down"));
    // Frames without analog samples.
    let mut longer = loaded_and_not();
    longer.info.n_frames += 2;
    let last = longer.positions_mm.clone();
    longer.positions_mm.extend_from_slice(&last[..2 * longer.info.markers.len()]);
    assert!(write(&longer).contains("no values in 4 samples"));
}

#[test]
fn a_mot_of_a_take_without_plates_is_refused() {
    let bare = read(&file(Order::Intel, -1.0, (6, 1), &[1.0; 12]));
    let mut unusable = file(Order::Intel, -1.0, (6, 1), &[1.0; 12]);
    unusable.records.extend(unusable.group(3, "FORCE_PLATFORM"));
    unusable.words(3, "TYPE", &[7]);
    for (motion, reason) in [(bare, "no force plates"), (read(&unusable), "type 7")] {
        let error = Format::Mot.write(&mut MotionFrames::new(&motion), &mut Vec::new());
        let message = error.expect_err("no plates").to_string();
        assert!(message.contains(reason), "{message}");
    }
    let left_out = Format::Mot.leaves_out(&loaded_and_not().info, true).join(", ");
    assert_eq!(left_out, "1 marker");
}
