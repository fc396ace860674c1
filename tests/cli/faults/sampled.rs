//! The samples of a recording with faults: those of the batches that arrived, and a ledger that says so.

use std::io::Cursor;

use mocapd_simulator::{
    device::TICK_HZ,
    faults::{BatchFate, Fate},
};
use mocapd_take::{TakeMap, sampled::GroupSamples};
use serde_json::Value;

use super::{
    super::Folder,
    played::{Played, sources},
};

/// What the fates of a group's batches say of its ledger.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Expected {
    stored: u64,
    duplicates: u64,
    dropped: u64,
    lost_on_link: u64,
    unknown: u64,
    jumps: u64,
}

impl Expected {
    /// What the ledger of a group says.
    pub(super) fn stated(ledger: &Value) -> Self {
        let count = |key: &str| ledger[key].as_u64().unwrap();
        assert_eq!((count("lost_ring_full"), count("lost_other")), (0, 0));
        Self {
            stored: count("stored"),
            duplicates: count("duplicates"),
            dropped: count("dropped_by_device"),
            lost_on_link: count("lost_on_link"),
            unknown: count("unknown_after_disconnect"),
            jumps: count("jumps"),
        }
    }
}

/// The ledger up to the last batch that arrived, also one without samples.
pub(super) fn expected(batches: &[&BatchFate]) -> Expected {
    let mut expected = Expected::default();
    let mut last: Option<&BatchFate> = None;
    for fate in batches {
        let n = fate.frame.n;
        match fate.fate {
            Fate::Whole => {
                if let Some(before) = last {
                    let (sent, next) = (&before.frame, &fate.frame);
                    let missing = next.first.checked_sub(sent.first + sent.n);
                    match missing {
                        // The device lost its power.
                        None => expected.jumps += 1,
                        Some(missing) if next.run != sent.run => expected.unknown += missing,
                        Some(missing) if next.number == sent.number + 1 => {
                            expected.dropped += missing;
                        }
                        Some(missing) => expected.lost_on_link += missing,
                    }
                }
                last = Some(fate);
                expected.stored += n;
                expected.duplicates += n * u64::from(fate.again);
            }
            Fate::Late => expected.duplicates += n * u64::from(fate.again + 1),
            _ => {}
        }
    }
    expected
}

/// The samples of every group are those of its whole batches, bit for bit and in order, at the times of these.
pub(super) fn take_holds_what_was_sent(folder: &Folder, played: &Played) {
    let take = folder.read("a.take");
    let map = TakeMap::scan(&mut Cursor::new(&take)).unwrap();
    let document = &played.report["sample_ledger"];
    assert_eq!(document["closes"], true, "{document:#}");
    assert_eq!(document, &played.info["sample_ledger"]);
    let sources = sources();
    let is_sent = |group: &&GroupSamples| !group.group.has_residuals();
    assert_eq!(map.recorded_groups().filter(is_sent).count(), sources.len());
    for (index, source) in sources.iter().enumerate() {
        let of_group = |fate: &&BatchFate| usize::from(fate.frame.group) == index;
        let batches: Vec<&BatchFate> = played.batches.iter().filter(of_group).collect();
        let whole = || batches.iter().filter(|fate| fate.fate == Fate::Whole);
        let group = map.recorded_groups().nth(index).unwrap();
        let n_channels = group.group.channels.len();
        let (mut rows, mut numbers) = (Vec::new(), Vec::new());
        group
            .read(&mut Cursor::new(&take), |first, n, decoded| {
                let Some(decoded) = decoded else { return Ok(()) };
                for row in 0..n as usize {
                    numbers.push(first + row as u64);
                    rows.extend((0..n_channels).map(|c| decoded[c * n as usize + row]));
                }
                Ok(())
            })
            .unwrap();
        let mut sent = Vec::new();
        for fate in whole() {
            source.samples(fate.frame.first_in_run, fate.frame.n, &mut sent);
        }
        assert!(rows == sent, "group {index}: {} samples, {} sent", rows.len(), sent.len());
        // The first sample of each batch was taken when the device said, as far as the lines between blocks tell.
        let (clock, mut at) = (group.clock(TICK_HZ), 0);
        for fate in whole().filter(|fate| fate.frame.n > 0) {
            let time = clock.at(numbers[at]).unwrap();
            let off = time.device_ticks.abs_diff(fate.frame.device_ticks);
            assert!(off <= TICK_HZ / 200, "sample {}: {time:?}, {:?}", numbers[at], fate.frame);
            at += fate.frame.n as usize;
        }
        let ledger = &document["groups"][index];
        let found = Expected::stated(ledger);
        assert_eq!(found, expected(&batches), "group {index}: {ledger:#}");
    }
}
