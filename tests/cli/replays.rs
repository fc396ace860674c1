//! A recorded take with force plates, electrodes and rigid bodies, played as a device and recorded again.

use std::{fs::File, io::BufReader, path::Path, sync::Arc};

use mocapd_simulator::{
    device::{Device, DeviceSettings},
    sampled::SampledSource,
    source::{self, read_signals},
};
use mocapd_take::{
    TakeMap,
    poses::{PosesByRow, RowPoses},
    sampled::GroupSamples,
};

use super::{
    Folder,
    faults::played::{bodies, record_from, sources},
};
use crate::support::{assert_mentions, jump};

const RATE_HZ: f64 = 240.0;

/// Records a device at its own pace, without losses on the way.
fn record(folder: &Folder, device: Device, name: &str) {
    let (ran, _) = record_from(folder, device, [None, None], &["-o", name]);
    ran.with_code(0);
}

fn open(path: &Path) -> (BufReader<File>, TakeMap) {
    let mut input = BufReader::new(File::open(path).unwrap());
    let map = TakeMap::scan(&mut input).unwrap();
    (input, map)
}

/// The samples of a group, channel after channel as bits; `None` where they are lost.
fn samples(input: &mut BufReader<File>, group: &GroupSamples) -> Vec<Option<Vec<u32>>> {
    let mut all = Vec::new();
    let n_channels = group.group.channels.len();
    group
        .read(input, |_, n, found| {
            for row in 0..n as usize {
                let of_row = |found: &[f32]| {
                    (0..n_channels).map(|c| found[c * n as usize + row].to_bits()).collect()
                };
                all.push(found.map(of_row));
            }
            Ok(())
        })
        .unwrap();
    all
}

/// The poses of all rows as texts, in which every NaN is alike.
fn poses(input: &mut BufReader<File>, map: &TakeMap) -> (Vec<String>, Vec<String>) {
    let index = PosesByRow::read(&mut *input, map).unwrap().unwrap();
    let names = index.bodies().iter().map(|body| format!("{body:?}")).collect();
    let (mut rows, mut found, mut all) = (index.rows(0..map.n_rows), Vec::new(), Vec::new());
    while rows.next(input, RowPoses::ROWS_AT_ONCE, &mut found).unwrap().is_some() {
        all.extend(found.iter().map(|pose| format!("{pose:?}")));
    }
    (names, all)
}

#[test]
fn a_take_that_is_played_is_recorded_again_bit_for_bit() {
    let folder = Folder::new();
    let queue_bytes = Some(64 << 20);
    let settings = DeviceSettings {
        queue_bytes,
        sampled: sources(),
        bodies: Some(Arc::new(bodies())),
        ..DeviceSettings::default()
    };
    record(&folder, Device::new(jump(1, RATE_HZ, 2.0), settings).unwrap(), "first.take");

    let signals = read_signals(&folder.path("first.take"), None).unwrap();
    assert!(signals.left_out.is_empty(), "{:?}", signals.left_out);
    assert!(!signals.sampled.iter().any(SampledSource::has_losses));
    assert_eq!(signals.sampled[0].force_plates(), sources()[0].force_plates());
    let (motion, warnings) = source::read(&folder.path("first.take")).unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    let played = DeviceSettings {
        queue_bytes,
        sampled: signals.sampled,
        bodies: signals.bodies,
        ..DeviceSettings::default()
    };
    record(&folder, Device::new(motion.clone(), played).unwrap(), "second.take");

    let (again, _) = source::read(&folder.path("second.take")).unwrap();
    assert_eq!(again.positions_mm.len(), motion.positions_mm.len());
    let bits = |position: &[f32; 3]| position.map(f32::to_bits);
    assert!(again.positions_mm.iter().map(bits).eq(motion.positions_mm.iter().map(bits)));
    let ((mut first, of_first), (mut second, of_second)) =
        (open(&folder.path("first.take")), open(&folder.path("second.take")));
    let groups = |map: &TakeMap| map.recorded_groups().cloned().collect::<Vec<_>>();
    let (a, b) = (groups(&of_first), groups(&of_second));
    assert_eq!((a.len(), b.len()), (2, 2));
    for (a, b) in a.iter().zip(&b) {
        assert_eq!((&a.group.channels, a.group.form), (&b.group.channels, b.group.form));
        assert_eq!((a.group.number, a.group.rate_hz), (b.group.number, b.group.rate_hz));
        let (found, expected) = (samples(&mut second, b), samples(&mut first, a));
        assert!(expected.len() > 1900 && expected.iter().all(Option::is_some));
        assert_eq!(found.len(), expected.len(), "group {}", a.group.number);
        assert!(found == expected, "group {}", a.group.number);
    }
    assert_eq!(of_first.header.force_plates(), of_second.header.force_plates());
    let (expected, found) = (poses(&mut first, &of_first), poses(&mut second, &of_second));
    assert_eq!(found.0, expected.0);
    assert!(found.0.len() == 10 && found.1 == expected.1);
    let missing = expected.1.iter().filter(|pose| !pose.contains("Tracked")).count();
    assert!(missing > 100, "{missing}");

    let verify = ["verify", "second.take", "--against", "first.take", "--json"];
    let report = folder.run(&verify).with_code(0).json();
    let (sampled, poses) = (&report["against"]["sampled"], &report["against"]["poses"]);
    assert_eq!([&sampled["samples_differing"], &sampled["groups_missing"]], [0, 0], "{sampled}");
    assert!(sampled["samples"].as_u64().unwrap() > 30_000, "{sampled}");
    let n_tracked = expected.1.len() - missing;
    assert_eq!(poses["poses"], n_tracked as u64, "{poses}");
    for what in ["poses_differing", "beyond_stated", "states_differing", "poses_missing"] {
        assert_eq!(poses[what], 0, "{poses}");
    }
    assert_eq!(poses["bodies"].as_array().unwrap().len(), 10);
    let text = folder.run(&verify[..4]).with_code(0).stdout;
    assert_mentions(&text, &["sampled channels, all exact", "rigid bodies, all exact"]);
}

#[test]
fn the_first_seconds_of_a_take_are_played_with_their_samples() {
    let folder = Folder::new();
    let settings = DeviceSettings {
        queue_bytes: Some(64 << 20),
        sampled: sources(),
        bodies: Some(Arc::new(bodies())),
        ..DeviceSettings::default()
    };
    record(&folder, Device::new(jump(1, RATE_HZ, 2.0), settings).unwrap(), "first.take");
    let signals = read_signals(&folder.path("first.take"), Some(0.5)).unwrap();
    let mut values = Vec::new();
    signals.sampled[0].samples(0, 10_000, &mut values);
    assert_eq!(values.len(), 500 * 12);
    let mut expected = Vec::new();
    sources()[0].samples(0, 500, &mut expected);
    assert_eq!(values, expected);
    let bodies = signals.bodies.unwrap();
    let mut poses = Vec::new();
    assert!(bodies.poses(119, RATE_HZ, &mut poses) && !bodies.poses(120, RATE_HZ, &mut poses));
}
