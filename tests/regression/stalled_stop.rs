//! A take that is stopped in a stall does not contradict itself: its clock line, the observations that it stores and
//! its ledger are of one moment, however late the writer comes to it. Ten stalls in real time:
//!
//! ```text
//! cargo test --release --features fault-hooks --test integration -- --ignored --nocapture
//! regression::stalled_stop::ten
//! ```

mod real;
mod world;

use mocapd_acquire::{clock::LineDeviation, inspect::Summary};

use self::world::{Ended, Stalled, World};
use crate::support::chunks;

/// Number of seeds, each of which sets the time of a stall.
const INSTANTS: u64 = 100;

/// The contradictions in a take.
fn contradictions(ended: &Ended) -> Vec<String> {
    let Ended { take, written, until_ns, .. } = ended;
    let summary = Summary::read(&take[..]).unwrap();
    let mut found = summary.contradictions().to_vec();
    found.extend(summary.take.problems.iter().map(ToString::to_string));
    let ledger = summary.take.ledger.as_ref().unwrap();
    if !ledger.closes() || !ledger.finished {
        found.push(format!("{ledger:?}"));
    }
    // Not merely within the limits for earlier versions: the same line.
    let is_same =
        |apart: &LineDeviation| apart.offset_us.abs() < 0.1 && apart.drift_ppm.abs() < 0.01;
    let apart = summary.clock_deviation().filter(|apart| !apart.agrees || !is_same(apart));
    found.extend(apart.map(|apart| format!("{apart:?}")));

    // The stored observations are from before the end of the take, and the line is the one known then.
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
    let mut lines = 0;
    for seed in 0..INSTANTS {
        let world = World::of(seed);
        for ended in world.run() {
            let contradicted = contradictions(&ended);
            lines += usize::from(ended.written.clock.line.is_some());
            if !contradicted.is_empty() {
                found.push(format!("{} of {world:?}: {contradicted:?}", ended.name));
            }
        }
    }
    assert!(found.is_empty(), "{} takes:\n{}", found.len(), found.join("\n"));
    assert!(lines > INSTANTS as usize, "{lines}");
}

/// The simplest case: the disk stalls when the take is stopped, while round trips continue.
#[test]
fn observations_after_the_stop_are_left_out_when_the_disk_stalls() {
    let world =
        World { stalled: Stalled::Disk, save_s: None, splits: false, jump_s: None, ..World::of(1) };
    let world = World { start_s: 2.0, stall_s: (12.0, 30.0), stop_s: 12.5, ..world };
    let [ended] = &world.run()[..] else { panic!("{world:?}") };
    assert_eq!(contradictions(ended), [] as [String; 0]);
}

/// A disk that stalls for minutes, with more round trips than the queue holds: the line is fitted to the stored ones.
#[test]
fn observations_that_do_not_fit_are_left_out_of_the_line_as_well() {
    let (take, written) = world::flooded();
    let summary = Summary::read(&take[..]).unwrap();
    let apart = summary.clock_deviation().unwrap();
    assert!(apart.agrees && apart.offset_us.abs() < 0.1, "{apart:?}");
    let ledger = summary.take.ledger.as_ref().unwrap();
    assert_eq!(ledger.contradictions, [] as [String; 0]);
    assert_eq!(summary.clock.probes, written.clock.probes);
    assert!((1_000..world::FLOOD).contains(&summary.clock.probes), "{}", summary.clock.probes);
    assert_eq!(summary.take.events.len(), 1, "{:?}", summary.take.events);
}

#[test]
#[ignore = "minutes: see the command above"]
fn ten_stalls_in_real_time_leave_no_contradiction() {
    let (mut n_takes, mut wrong) = (0, 0);
    for seed in 0..10 {
        let (story, takes) = real::stall(seed);
        println!("{story}");
        for (take, ran) in takes {
            let verified = ran.json();
            let apart_us = verified["clock"]["apart_us"].as_f64();
            let contradictions = verified["contradictions"].as_array().unwrap();
            println!("  {take}: verify {:?}, {apart_us:?} us apart, {contradictions:?}", ran.code);
            wrong += usize::from(!contradictions.is_empty() || ran.code == Some(1));
            n_takes += 1;
        }
    }
    println!("{wrong} of {n_takes} takes contradict themselves");
    assert!(n_takes >= 10 && wrong == 0, "{n_takes} {wrong}");
}
