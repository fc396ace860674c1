//! A take that is stopped in a stall does not contradict itself: its clock line, the observations that it stores and its
//! ledger are of one moment, however late the writer comes to it.

mod world;

use mocapd::inspect::Summary;

use self::world::{Ended, Near, Stalled, World};
use crate::support::chunks;

/// Seeded instants that a stall is tried at.
const INSTANTS: u64 = 100;

/// What the take says that something else in it denies.
fn contradictions(ended: &Ended) -> Vec<String> {
    let Ended { take, written, until_ns, .. } = ended;
    let summary = Summary::read(&take[..]).unwrap();
    let mut found = [&summary.problems[..], summary.contradictions()].concat();
    let ledger = summary.ledger.as_ref().unwrap();
    if !ledger.closes() || !ledger.finished {
        found.push(format!("{ledger:?}"));
    }
    found.extend(summary.clock_apart().filter(|apart| !apart.agrees).map(|a| format!("{a:?}")));

    // What is stored was seen before the take ended, and the line is the one that was known then.
    let clocks = chunks(take).clocks;
    let answered = clocks.iter().flat_map(|clock| &clock.probes);
    let answered_us = answered.map(|probe| probe.sent_us + probe.round_trip_us);
    let arrived_us = clocks.iter().flat_map(|clock| &clock.points).map(|point| point.host_us);
    let late_us = answered_us.chain(arrived_us).filter(|&us| us > until_ns.div_ceil(1000));
    let late = late_us.count();
    if late > 0 {
        found.push(format!("{late} observations are younger than the take's end"));
    }
    if ledger.clock != written.clock.ledger() {
        found.push(format!("{:?}, reported as {:?}", ledger.clock, written.clock));
    }
    let line = clocks.last().and_then(|clock| clock.line);
    if written.clock.line.is_some() && line != written.clock.line {
        found.push(format!("{line:?}, reported as {:?}", written.clock.line));
    }
    found
}

#[test]
fn no_take_around_a_stall_contradicts_itself() {
    let mut found = Vec::new();
    for seed in 0..INSTANTS {
        let world = World::of(seed);
        for ended in world.run() {
            let said = contradictions(&ended);
            if !said.is_empty() {
                found.push(format!("{} of {world:?}: {said:?}", ended.name));
            }
        }
    }
    assert!(found.is_empty(), "{} takes:\n{}", found.len(), found.join("\n"));
}

/// The shortest way to it: the disk stalls when the take is stopped, and round trips go on meanwhile.
#[test]
fn a_disk_that_stalls_at_the_stop_leaves_out_what_came_after_it() {
    let world = World { stalled: Stalled::Disk, near: Near::Stop, ..World::of(1) };
    let world = World { start_s: 2.0, stall_s: (12.0, 30.0), stop_s: 12.5, ..world };
    let [ended] = &world.run()[..] else { panic!("{world:?}") };
    assert_eq!(contradictions(ended), [] as [String; 0]);
}
