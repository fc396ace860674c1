//! Repacked takes: what they keep, and which differences the comparison finds.

use std::time::Duration;

use super::*;

fn to(kind: &str) -> RepackSettings {
    let effort = Effort::new(if kind == "dense" { 2 } else { 1 }).unwrap();
    RepackSettings { codec: settings(kind), effort, keys: None }
}

/// The take in fewer bytes, which was compared with the old one.
fn repacked(take: &[u8], settings: Option<&RepackSettings>) -> Result<Vec<u8>, TakeError> {
    let source = source(take);
    let mut out = Vec::new();
    let report = repack(&source, Cursor::new(take), settings, &mut out, &context())?;
    assert_eq!(report.bytes, out.len() as u64);
    let old = Cursor::new(take);
    let found = check_repacked(&source, old, Cursor::new(&out), settings, &context())?;
    assert_eq!(found, None);
    check_statistics(&out);
    Ok(out)
}

#[test]
fn recordings_are_repacked_with_their_times_and_losses() {
    for kind in ["dense", "fast"] {
        let take = recording(kind, 900);
        assert!(repacked(&take, None).unwrap().len() <= take.len(), "{kind}");
        let refused = repacked(&take, Some(&to(kind))).unwrap_err();
        assert!(refused.to_string().contains("the source or a lossless take"), "{refused}");
    }
    let take = recording("lossless", 900);
    let smaller = repacked(&take, Some(&to("lossless:predictive"))).unwrap();
    assert!(smaller.len() < take.len(), "{} of {} bytes", smaller.len(), take.len());
    let dense = repacked(&smaller, Some(&to("dense"))).unwrap();
    assert!(dense.len() < smaller.len());
    let keys = Some(KeyDistance::FirstOnly);
    let refused = repacked(&take, Some(&RepackSettings { keys, ..to("dense") }));
    assert!(refused.unwrap_err().to_string().contains("hold its clocks"));
}

#[test]
fn frames_that_a_recovery_of_an_import_lost_stay_lost() {
    for kind in ["lossless", "dense"] {
        let mut damaged = import(kind, 2300);
        let stretches = chunks(&damaged, types::STRETCH);
        damaged[stretches[1].start + stretches[1].len() / 2] ^= 1;
        let take = recovered(&damaged);
        let predictive = to("lossless:predictive");
        let settings = (kind == "lossless").then_some(&predictive);
        let new = repacked(&take, settings).unwrap();
        assert!(rows_of(&new) == rows_of(&take), "{kind}");
        assert_eq!(source(&new).map().damage, source(&take).map().damage);
        assert!(!RecoveryScan::read(&new).unwrap().lost_anything(), "the ledger agrees with it");
        if settings.is_none() {
            continue;
        }
        assert!(new.len() < take.len());
        let dense = repacked(&take, Some(&to("dense"))).unwrap();
        assert!(dense.len() < new.len());
        assert_eq!(source(&dense).map().damage, source(&take).map().damage);
        let keys = Some(KeyDistance::FirstOnly);
        let refused = repacked(&take, Some(&RepackSettings { keys, ..predictive })).unwrap_err();
        assert!(refused.to_string().contains("which frames are lost"), "{refused}");
    }
}

#[test]
fn samples_that_a_recovery_lost_stay_lost() {
    let mut damaged = import_with("dense", 2300, vec![analog(2300)]);
    let samples = chunks(&damaged, types::SAMPLES);
    damaged[samples[1].start + samples[1].len() / 2] ^= 1;
    let take = recovered(&damaged);
    let new = repacked(&take, None).unwrap();
    assert_eq!(samples_of(&new), samples_of(&take));
    assert_eq!(samples_of(&new).2.len(), 1);
}

#[test]
fn channels_that_are_announced_after_the_last_stretch_are_kept_by_every_edit() {
    for kind in ["dense", "lossless"] {
        let take = recording(kind, 900);
        let announced = chunks(&take, types::CHANNELS)[0].clone();
        // Cut off in the first stretch that could have samples of it.
        let take = recovered(&take[..announced.end + 5]);
        let (n_channels, n_rows) = (source(&take).map().channels.len(), source(&take).map().n_rows);
        assert_eq!(n_channels, EARLY + 1);
        let predictive = to("lossless:predictive");
        let new = repacked(&take, (kind == "lossless").then_some(&predictive)).unwrap();
        let (whole, _) = part_of(&take, 0..n_rows);
        let parts = [part_of(&take, 0..100).0, part_of(&take, 100..n_rows).0];
        assert_eq!(source(&parts[0]).map().channels.len(), EARLY);
        for edited in [new, whole, joined(&parts).0] {
            assert_eq!(source(&edited).map().channels, source(&take).map().channels, "{kind}");
            assert!(rows_of(&edited) == rows_of(&take), "{kind}");
        }
    }
}

fn every(seconds: u64) -> Option<KeyDistance> {
    Some(KeyDistance::Every(Duration::from_secs(seconds)))
}

/// An import of markers that move, or lie still.
fn moving(
    kind: &str,
    (n_markers, n_rows): (usize, usize),
    is_moving: bool,
    keys: Option<KeyDistance>,
) -> Vec<u8> {
    let columns: Vec<_> = (0..n_markers).map(|marker| column(marker, n_rows).0).collect();
    let at = |row: usize, marker: usize| columns[marker][if is_moving { row } else { 0 }];
    let rows = (0..n_rows).flat_map(|row| (0..n_markers).map(move |marker| (row, marker)));
    let positions_mm = rows.map(|(row, marker)| at(row, marker)).collect();
    let marker = |i| Marker { label: format!("m{i}"), labelled: true };
    let info = MotionInfo {
        rate_hz: RATE_HZ,
        n_frames: n_rows as u64,
        markers: (0..n_markers).map(marker).collect(),
        ..MotionInfo::default()
    };
    imported(kind, &Motion { info, positions_mm }, keys)
}

/// The first rows of the key stretches, the version, and the stated distance of keys.
fn keys_of(take: &[u8]) -> (Vec<u64>, u16, Option<String>) {
    let source = source(take);
    let map = source.map();
    let keys = map.keys.iter().map(|key| key.first_row).collect();
    (keys, map.header.codec_version, map.header.key_distance().map(str::to_owned))
}

#[test]
fn a_chosen_distance_of_keys_is_kept() {
    let predictive = to("lossless:predictive");
    for keys in [every(1), every(20), Some(KeyDistance::FirstOnly)] {
        let take = moving("lossless", (3, 2_500), true, keys);
        let new = repacked(&take, Some(&predictive)).unwrap();
        assert_eq!(keys_of(&new), keys_of(&take));
        assert!(new.len() < take.len());
        let asked = RepackSettings { keys: every(5), ..predictive };
        let (found, version, stated) = keys_of(&repacked(&take, Some(&asked)).unwrap());
        assert_eq!((found, version), (vec![0, 500, 1_000, 1_500, 2_000], CODEC_VERSION));
        assert_eq!(stated.as_deref(), Some("5s"));
    }
    // Nothing moves: the stretches become one, unless keys were chosen.
    let still = moving("dense", (3, 2_500), false, every(5));
    assert_eq!(keys_of(&repacked(&still, None).unwrap()), keys_of(&still));
    let still = moving("dense", (3, 2_500), false, None);
    assert_eq!(keys_of(&still).0, [0, 1_000, 2_000]);
    assert_eq!(keys_of(&repacked(&still, None).unwrap()).0, [0]);
    // The ends of cuts are joined up to the distance.
    let take = moving("dense", (3, 400), true, every(2));
    let parts = [0..40, 40..90, 90..400].map(|rows| part_of(&take, rows).0);
    let (all, _) = joined(&parts);
    assert_eq!(keys_of(&all).0, [0, 40, 90, 200]);
    assert_eq!(keys_of(&repacked(&all, None).unwrap()).0, [0, 200]);
    // Each of the joined takes has one key, and is of the version in which keys are close.
    let part = moving("lossless", (3, 900), true, Some(KeyDistance::FirstOnly));
    let (all, _) = joined(&[part.clone(), part]);
    assert_eq!(keys_of(&repacked(&all, Some(&predictive)).unwrap()).1, CODEC_VERSION);
}

#[test]
fn an_import_whose_channel_table_grows_keeps_its_keys_and_version() {
    let parts = [3, 4].map(|n_markers| moving("lossless", (n_markers, 2_500), true, every(20)));
    let (take, _) = joined(&parts);
    assert_eq!((&keys_of(&take).0[..], keys_of(&take).1), (&[0, 2_000, 2_500, 4_500][..], 7));
    let predictive = to("lossless:predictive");
    let new = repacked(&take, Some(&predictive)).unwrap();
    assert!(new.len() < take.len());
    assert_eq!(keys_of(&new), keys_of(&take));
    let refused = repacked(&take, Some(&RepackSettings { keys: every(1), ..predictive }));
    let refused = refused.unwrap_err().to_string();
    assert!(refused.contains("further markers") && refused.contains("omit --keys"), "{refused}");
}

type Change = fn(&mut SourceTake);

#[test]
fn the_comparison_finds_every_difference() {
    let take = recording("dense", 300);
    let check = |source: &SourceTake, new: &[u8]| {
        let (old, new) = (Cursor::new(&take), Cursor::new(new));
        check_repacked(source, old, new, None, &context()).unwrap()
    };
    assert_eq!(check(&source(&take), &take), None);
    let changes: [(Change, &str); 6] = [
        (|source| drop(source.clocks.pop()), "clocks"),
        (|source| source.map.channels[3].label.push('x'), "channel table"),
        (|source| source.map.channels[3].marker_id = 99, "channel table"),
        (|source| source.map.channels[3].labelled = false, "channel table"),
        (|source| drop(source.map.events.pop()), "an event"),
        (|source| source.has_time_lines = false, "times"),
    ];
    for (change, fact) in changes {
        let mut changed = source(&take);
        change(&mut changed);
        let found = check(&changed, &take);
        assert!(found.as_ref().is_some_and(|found| found.contains(fact)), "{fact}: {found:?}");
    }
    let found = check(&source(&take), &recording("dense", 275));
    assert!(found.is_some(), "another length");
    // The bounds of a part, and the samples that it lost.
    let take = import_with("dense", 300, vec![analog(300)]);
    let mut other = analog(300);
    other.bounds = vec![1.0; 3];
    let other = import_with("dense", 300, vec![other]);
    let found =
        check_repacked(&source(&take), Cursor::new(&take), Cursor::new(&other), None, &context());
    assert!(found.unwrap().is_some_and(|found| found.contains("bound")));
}
