//! Damaged answers: each counted, none recorded.

use std::cell::Cell;
use std::rc::Rc;

use mocapd_drivers::device::Protocol;
use mocapd_simulator::ndi::NdiSettings;

use super::bench::{Bench, MS, assert_is_row, jump, settings};

/// Numbers from a seed: xorshift64*.
pub(super) struct Dice(pub(super) u64);

impl Dice {
    pub(super) fn below(&mut self, n: usize) -> usize {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        ((self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 33) % n.max(1) as u64) as usize
    }
}

/// Does to an answer what lines do.
fn corrupt(answer: &mut Vec<u8>, dice: &mut Dice) {
    let at = dice.below(answer.len());
    match dice.below(6) {
        0 | 1 => answer[at] ^= 1 << dice.below(8),
        // A burst of up to 16 bits.
        2 => {
            answer[at] ^= 1 << dice.below(8);
            if let Some(next) = answer.get_mut(at + 1) {
                *next ^= dice.below(256) as u8;
            }
        }
        3 => drop(answer.remove(at)),
        // Inside: a byte after the end belongs to no answer.
        4 => answer.insert(at, dice.below(256) as u8),
        _ => answer.truncate(at.max(1)),
    }
}

/// A bench whose binary answers are corrupted, a third of them, and how many were so far. Never five in
/// a row: after those the device counts as lost.
fn noisy(bx2: bool, seed: u64) -> (Bench, Rc<Cell<u64>>) {
    let settings = NdiSettings { looping: true, ..settings(&["head", "pelvis"], bx2) };
    let mut bench = Bench::new(jump(52, 60.0, 3.0), settings, 921_600);
    let corrupted = Rc::new(Cell::new(0));
    let count = Rc::clone(&corrupted);
    let (mut dice, mut in_a_row) = (Dice(seed), 0);
    bench.damage = Box::new(move |answer| {
        if !answer.starts_with(&[0xC4]) || dice.below(3) > 0 || in_a_row == 4 {
            in_a_row = 0;
            return;
        }
        let whole = answer.clone();
        corrupt(answer, &mut dice);
        if *answer != whole {
            in_a_row += 1;
            count.set(count.get() + 1);
        }
    });
    (bench, corrupted)
}

#[test]
fn of_ten_thousand_corrupted_answers_each_is_counted_and_none_recorded() {
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
        for heard in &bench.frames {
            assert_is_row(heard, motion.frame(heard.seq as usize % n_frames), &tools);
        }
        assert!(bench.frames.is_sorted_by(|a, b| b.seq > a.seq));
        // Damage costs the frames of 20 ms of silence, and of the wait for what was cut off.
        let heard = bench.frames.len() as u64;
        assert!(heard > N, "{heard} frames");
        println!("bx2 {bx2}: {heard} frames between {N} corrupted answers, {counters:?}");
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
        let mut dice = Dice(seed);
        let done = Rc::new(Cell::new(false));
        let flag = Rc::clone(&done);
        bench.damage = Box::new(move |answer| {
            if !flag.replace(true) {
                corrupt(answer, &mut dice);
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
fn damaged_answers_of_the_bring_up_are_asked_for_again() {
    for seed in 1..=50 {
        let mut bench = Bench::new(jump(20, 60.0, 1.0), settings(&["head"], true), 115_200);
        let mut dice = Dice(seed);
        bench.damage = Box::new(move |answer| {
            if dice.below(5) == 0 && !answer.is_empty() {
                corrupt(answer, &mut dice);
            }
        });
        bench.identify();
        assert_eq!(bench.markers.len(), 1, "seed {seed}");
        assert_eq!(bench.markers[0].label, "head");
    }
}
