//! Damaged answers: all are counted, and none is recorded.

use std::cell::Cell;
use std::rc::Rc;

use mocapd_drivers::device::Protocol;
use mocapd_simulator::ndi::NdiSettings;
use mocapd_testkit::random::Random;

use super::bench::{Bench, MS, assert_is_row, jump, settings};

/// Damages an answer as lines do.
fn corrupt(answer: &mut Vec<u8>, random: &mut Random) {
    let at = random.below(answer.len());
    match random.below(6) {
        0 | 1 => answer[at] ^= 1 << random.below(8),
        // A burst of up to 16 bits.
        2 => {
            answer[at] ^= 1 << random.below(8);
            if let Some(next) = answer.get_mut(at + 1) {
                *next ^= random.byte();
            }
        }
        3 => drop(answer.remove(at)),
        // Inside: a byte after the end belongs to no answer.
        4 => answer.insert(at, random.byte()),
        _ => answer.truncate(at.max(1)),
    }
}

/// A bench that corrupts a third of the binary answers, and the number corrupted so far. Never five in a row, after
/// which the device counts as lost.
fn noisy(bx2: bool, seed: u64) -> (Bench, Rc<Cell<u64>>) {
    let settings = NdiSettings { looping: true, ..settings(&["head", "pelvis"], bx2) };
    let mut bench = Bench::new(jump(52, 60.0, 3.0), settings, 921_600);
    let corrupted = Rc::new(Cell::new(0));
    let count = Rc::clone(&corrupted);
    let (mut random, mut in_a_row) = (Random::new(seed), 0);
    bench.damage = Box::new(move |answer| {
        if !answer.starts_with(&[0xC4]) || !random.one_in(3) || in_a_row == 4 {
            in_a_row = 0;
            return;
        }
        let whole = answer.clone();
        corrupt(answer, &mut random);
        if *answer != whole {
            in_a_row += 1;
            count.set(count.get() + 1);
        }
    });
    (bench, corrupted)
}

#[test]
fn ten_thousand_corrupted_answers_are_counted_and_not_recorded() {
    const N: u64 = 10_000;
    for (bx2, seed) in [(true, 0x1D1), (false, 0x1D2)] {
        let motion = jump(52, 60.0, 3.0);
        let n_frames = motion.n_frames();
        let (mut bench, corrupted) = noisy(bx2, seed);
        bench.identify();
        bench.start();
        let seen = Rc::clone(&corrupted);
        bench.run_until(|bench| seen.get() >= N || bench.hellos.len() > 1);
        bench.damage = Box::new(|_| {});
        bench.run_for(1_000 * MS);
        assert_eq!(bench.hellos.len(), 1, "the device was not lost");
        let counters = bench.host.counters();
        assert_eq!(corrupted.get(), N);
        assert_eq!(counters.messages_damaged, N);
        // The tools are the columns of their labels.
        let column =
            |label: &str| motion.info.markers.iter().position(|m| m.label == label).unwrap();
        let tools = [(1, column("head")), (2, column("pelvis"))];
        for received in &bench.frames {
            assert_is_row(received, motion.frame(received.seq as usize % n_frames), &tools);
        }
        assert!(bench.frames.is_sorted_by(|a, b| b.seq > a.seq));
        // Damage costs the frames during 20 ms of silence, and during the wait for the rest of a truncated answer.
        let received = bench.frames.len() as u64;
        assert!(received > N, "{received} frames");
        println!("bx2 {bx2}: {received} frames between {N} corrupted answers, {counters:?}");
    }
}

#[test]
fn one_corrupted_answer_costs_a_bounded_time() {
    let (mut bench, _) = noisy(true, 1);
    bench.damage = Box::new(|_| {});
    bench.identify();
    bench.start();
    bench.run_for(500 * MS);
    for seed in 1..200 {
        let before = bench.frames.len();
        let mut random = Random::new(seed);
        let done = Rc::new(Cell::new(false));
        let flag = Rc::clone(&done);
        bench.damage = Box::new(move |answer| {
            if !flag.replace(true) {
                corrupt(answer, &mut random);
            }
        });
        let flag = Rc::clone(&done);
        bench.run_until(move |_| flag.get());
        let at_ns = bench.now_ns;
        bench.run_until(|bench| bench.frames.len() > before + 1);
        assert!(bench.now_ns - at_ns < 250 * MS, "seed {seed}: {} ns", bench.now_ns - at_ns);
    }
}

#[test]
fn damaged_answers_during_bring_up_are_requested_again() {
    for seed in 1..=50 {
        let mut bench = Bench::new(jump(20, 60.0, 1.0), settings(&["head"], true), 115_200);
        let mut random = Random::new(seed);
        bench.damage = Box::new(move |answer| {
            if random.one_in(5) && !answer.is_empty() {
                corrupt(answer, &mut random);
            }
        });
        bench.identify();
        assert_eq!(bench.markers.len(), 1, "seed {seed}");
        assert_eq!(bench.markers[0].label, "head");
    }
}
