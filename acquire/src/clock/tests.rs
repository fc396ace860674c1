//! Tests of the clock model in virtual time: a simulated device, line and host against the truth.

use mocapd_take::record::{Clock, ClockPoint, ClockProbe};
use mocapd_testkit::random::Random;
use proptest::prelude::*;

use super::*;

/// A random delay with this mean and a long tail.
fn delay_ns(random: &mut Random, mean_ns: f64) -> f64 {
    -mean_ns * (1.0 - random.unit()).max(1e-12).ln()
}

/// A simulated device, line and host.
#[derive(Debug, Clone, Copy)]
struct World {
    seed: u64,
    rate_hz: f64,
    tick_hz: u64,
    drift_ppm: f64,
    batch_ms: f64,
    /// The shortest delay of the line in each direction, and the mean delay that a scheduler adds.
    line_us: f64,
    jitter_us: f64,
    /// Fraction of arrivals that a busy machine notices up to 3 ms late.
    stalled: f64,
    /// Additional delay of frames: exposure, a long message.
    frame_us: f64,
    lost: f64,
    pongs: Pongs,
    /// When the device's clock jumps, and how far ahead, in seconds.
    jump: Option<(f64, f64)>,
    /// Width of the device's tick counter in bits.
    bits: u32,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Pongs {
    Prompt,
    /// Half of the pongs are late by this many milliseconds.
    Late(f64),
    None,
}

const USUAL: World = World {
    seed: 1,
    rate_hz: 60.0,
    tick_hz: 1_000_000,
    drift_ppm: 0.0,
    batch_ms: 0.0,
    line_us: 40.0,
    jitter_us: 30.0,
    stalled: 0.0,
    frame_us: 20.0,
    lost: 0.0,
    pongs: Pongs::Prompt,
    jump: None,
    bits: 64,
};

/// The host's clock at the start: one day of uptime.
const START_NS: f64 = 86_400e9;

/// The results of a simulated run.
struct Run {
    model: ClockModel,
    items: Vec<ClockItem>,
    events: Vec<(f64, ClockEvent)>,
    /// Every tenth of a second: time, error of the line in microseconds, and its bound.
    errors: Vec<(f64, f64, Option<f64>)>,
    /// After each stored item: the number of items so far, and the line.
    lines: Vec<(usize, ClockStatus)>,
}

impl Run {
    /// After each stored item, how far the line was from the line refitted to the stored items.
    fn apart(&self) -> Vec<LineDeviation> {
        let (mut refit, mut n) = (LineRefit::default(), 0);
        let each = self.lines.iter().filter_map(|(stored, status)| {
            let &ClockStatus { segment, tick_hz, line, .. } = status;
            let mut clock = Clock { segment, tick_hz, line, ..Clock::default() };
            for item in &self.items[std::mem::replace(&mut n, *stored)..*stored] {
                match *item {
                    ClockItem::Point(_, point) => clock.points.push(point),
                    ClockItem::Probe(_, probe) => clock.probes.push(probe),
                    ClockItem::Line(..) => {}
                }
            }
            refit.add(&clock);
            refit.deviation()
        });
        each.collect()
    }

    fn worst_us(&self, from_s: f64) -> f64 {
        let off = self.errors.iter().filter(|error| error.0 >= from_s).map(|error| error.1.abs());
        off.fold(0.0, f64::max)
    }
}

impl World {
    /// The ticks that the device's clock shows at a host time.
    fn ticks(&self, host_ns: f64) -> u64 {
        let passed_s = (host_ns - START_NS) * 1e-9;
        let jumped_s = self.jump.filter(|jump| passed_s >= jump.0).map_or(0.0, |jump| jump.1);
        let device_s = 1_000.0 + passed_s / (1.0 + self.drift_ppm * 1e-6) + jumped_s;
        let ticks = (device_s * self.tick_hz as f64).floor() as u64;
        if self.bits == 64 { ticks } else { ticks % (1 << self.bits) }
    }

    /// When data that is ready at `ready_ns` reaches the host.
    fn arrival(&self, ready_ns: f64, random: &mut Random) -> f64 {
        let batch_ns = self.batch_ms * 1e6;
        let phase_ns = (self.seed % 97) as f64 / 97.0 * batch_ns;
        let sent_ns = if batch_ns > 0.0 {
            ((ready_ns - phase_ns) / batch_ns).ceil() * batch_ns + phase_ns
        } else {
            ready_ns
        };
        let stall = self.stalled > 0.0 && random.unit() < self.stalled;
        let stall_ns = if stall { 3e6 * random.unit() } else { 0.0 };
        sent_ns + self.line_us * 1e3 + delay_ns(random, self.jitter_us * 1e3) + stall_ns
    }

    fn run(&self, seconds: f64) -> Run {
        let mut random = Random::new(self.seed);
        let mut model = ClockModel::new(self.tick_hz);
        let mut prober = Prober::new();
        let (mut items, mut events, mut errors) = (Vec::new(), Vec::new(), Vec::new());
        let mut lines: Vec<(usize, ClockStatus)> = Vec::new();
        let period_ns = 1e9 / self.rate_hz * (1.0 + self.drift_ppm * 1e-6);
        let mut in_order_ns = 0.0_f64;
        let mut frames = 0_u32;
        // Messages in transit: arrival, ticks, and for a pong the time of its ping.
        let mut in_transit: Vec<(f64, u64, Option<u64>)> = Vec::new();
        let mut now_ns = START_NS;
        let mut next_check_s = 0.1;
        while now_ns < START_NS + seconds * 1e9 {
            while let frame_ns = START_NS + f64::from(frames) * period_ns
                && frame_ns < now_ns + 40e6
            {
                frames += 1;
                if random.unit() >= self.lost {
                    // Frames stay in order on the line.
                    let arrival =
                        self.arrival(frame_ns + self.frame_us * 1e3, &mut random).max(in_order_ns);
                    in_order_ns = arrival;
                    in_transit.push((arrival, self.ticks(frame_ns), None));
                }
            }
            in_transit.sort_by(|a, b| a.0.total_cmp(&b.0));
            // A read waits up to 20 ms for data.
            let next = in_transit.first().map_or(f64::INFINITY, |next| next.0);
            now_ns = now_ns.max(next.min(now_ns + 20e6));
            let here = in_transit.partition_point(|thing| thing.0 <= now_ns);
            for (_, ticks, ping) in in_transit.drain(..here) {
                let now = now_ns as u64;
                let mut store = |item| {
                    items.push(item);
                    true
                };
                let event = match ping {
                    Some(sent) if prober.answered(sent, now) => {
                        model.probe(ticks, sent, now, &mut store)
                    }
                    Some(_) => None,
                    None => model.frame(ticks, now, &mut store),
                };
                let at_s = (now_ns - START_NS) * 1e-9;
                events.extend(event.map(|event| (at_s, event)));
                if model.wants_probes() {
                    prober.restart_schedule();
                }
            }
            if let Some(at) = prober.due(now_ns as u64) {
                if at as f64 > now_ns {
                    // Sleeps end late.
                    now_ns = at as f64 + 50e3 + delay_ns(&mut random, self.jitter_us * 1e3);
                }
                prober.sent(now_ns as u64);
                let received_ns =
                    now_ns + self.line_us * 1e3 + delay_ns(&mut random, self.jitter_us * 1e3);
                let extra_ns = match self.pongs {
                    Pongs::Late(ms) if random.unit() < 0.5 => Some(ms * 1e6),
                    Pongs::None => None,
                    _ => Some(0.0),
                };
                if let Some(extra_ns) = extra_ns {
                    let arrival = self.arrival(received_ns + extra_ns, &mut random);
                    in_transit.push((arrival, self.ticks(received_ns), Some(now_ns as u64)));
                }
            }
            if lines.last().is_none_or(|last| items.len() > last.0) {
                lines.push((items.len(), model.status()));
            }
            let at_s = (now_ns - START_NS) * 1e-9;
            if at_s >= next_check_s {
                next_check_s += 0.1;
                if let Some(line) = model.line() {
                    let tick_us = 0.5e6 / self.tick_hz as f64;
                    let (ticks, tick_hz) = (self.ticks(now_ns), self.tick_hz as f64);
                    let off_us = line.lateness_us(ticks, now_ns as u64, tick_hz) - tick_us;
                    errors.push((at_s, off_us, line.bound.map(|bound| bound.offset_us)));
                }
            }
        }
        model.close(&mut |item| {
            items.push(item);
            true
        });
        Run { model, items, events, errors, lines }
    }
}

const DRIFTS_PPM: [f64; 4] = [-200.0, -37.0, 0.0, 200.0];
const RATES_HZ: [f64; 7] = [5.0, 60.0, 62.5, 100.0, 120.0, 240.0, 1000.0];

/// All drifts, rates and batch intervals, with four seeds.
fn worlds(usual: World) -> impl Iterator<Item = World> {
    let all = move |drift_ppm: f64, batch_ms: f64, rate_hz: f64, seed: u64| World {
        seed,
        rate_hz,
        drift_ppm,
        batch_ms,
        ..usual
    };
    DRIFTS_PPM.into_iter().flat_map(move |drift_ppm| {
        [0.0, 1.0, 16.0].into_iter().flat_map(move |batch_ms| {
            RATES_HZ.into_iter().flat_map(move |rate_hz| {
                (1..=4).map(move |seed| all(drift_ppm, batch_ms, rate_hz, seed))
            })
        })
    })
}

/// The largest error after ten seconds in any of these worlds.
fn worst_us(worlds: impl Iterator<Item = World>, seconds: f64) -> f64 {
    let mut worst = (0.0, USUAL);
    for world in worlds {
        let run = world.run(seconds);
        assert!(run.events.is_empty(), "{world:?}: {:?}", run.events);
        let off_us = run.worst_us(10.0);
        if off_us > worst.0 {
            worst = (off_us, world);
        }
    }
    println!("worst {:.1} us: {:?}", worst.0, worst.1);
    worst.0
}

/// The guarantee of docs/clock.md, at any drift, frame rate and batch interval.
#[test]
fn with_round_trips_the_line_is_within_100_us_after_ten_seconds() {
    assert!(worst_us(worlds(USUAL), 60.0) < 100.0);
}

#[test]
fn lost_frames_and_late_pongs_do_no_harm() {
    let lossy = World { lost: 0.3, pongs: Pongs::Late(120.0), ..USUAL };
    assert!(worst_us(worlds(lossy), 35.0) < 250.0);
    // Later than the prober waits: such an answer still counts.
    let slow = World { pongs: Pongs::Late(800.0), ..USUAL };
    let worlds = [0.0, 16.0].map(|batch_ms| World { batch_ms, ..slow });
    assert!(worst_us(worlds.into_iter(), 60.0) < 500.0);
}

/// A pong noticed late gives a wrong send time, and a wrong interval between two.
#[test]
fn occasional_late_wake_ups_do_no_harm() {
    for (stalled, most_us) in [(0.1, 120.0), (0.3, 500.0)] {
        let busy = World { stalled, ..USUAL };
        assert!(worst_us(worlds(busy), 35.0) < most_us, "{stalled}");
    }
}

/// Frames are late by their length and their exposure, but round trips are not.
#[test]
fn frames_that_are_always_late_do_not_move_the_line() {
    let late = worlds(USUAL).map(|world| World { frame_us: 9_000.0, ..world });
    assert!(worst_us(late, 35.0) < 100.0);
}

/// Five times the jitter and five times the delay, as on a busy machine.
#[test]
fn the_error_grows_with_the_jitter_and_stays_within_the_bound() {
    for world in worlds(World { line_us: 200.0, jitter_us: 150.0, ..USUAL }) {
        let run = world.run(35.0);
        for (at_s, off_us, bound_us) in &run.errors {
            // The bound holds at the last observation; five seconds at a few ppm may have passed since.
            let bound_us = bound_us.map_or(f64::INFINITY, |bound_us| bound_us * 1.5 + 50.0);
            assert!(
                *at_s < 10.0 || off_us.abs() < bound_us,
                "{world:?}: {at_s} {off_us} {bound_us}"
            );
        }
        assert!(run.worst_us(10.0) < 500.0, "{world:?}: {}", run.worst_us(10.0));
        let line = run.model.line().unwrap();
        let off_ppm = (line.drift_ppm - world.drift_ppm).abs();
        // A tick of 1 us limits the resolution.
        assert!(off_ppm < line.bound.unwrap().drift_ppm + 0.1, "{world:?}: {line:?}");
    }
}

/// Without round trips the line is late by the shortest delay of any frame. On a line that sends at once, that is all;
/// on one that sends in batches it can be several batches, if the estimated rate follows the batches.
#[test]
fn without_round_trips_the_line_is_late_by_the_least_delay() {
    let silent = World { pongs: Pongs::None, ..USUAL };
    let least_us = USUAL.line_us + USUAL.frame_us;
    for world in worlds(silent) {
        let run = world.run(35.0);
        let status = run.model.status();
        assert_eq!((status.probes, status.line.unwrap().bound), (0, None));
        let off_us = run.worst_us(10.0);
        let most_us = least_us + 20.0 + 3.0e3 * world.batch_ms;
        assert!(off_us < most_us, "{world:?}: {off_us}");
    }
}

#[test]
fn a_clock_that_jumps_begins_a_segment_and_is_followed() {
    for by_s in [3600.0, 0.5, -0.5, -900.0] {
        for batch_ms in [0.0, 16.0] {
            for pongs in [Pongs::Prompt, Pongs::None] {
                let jump = Some((20.0, by_s));
                let world = World { jump, batch_ms, pongs, drift_ppm: 150.0, ..USUAL };
                let run = world.run(40.0);
                let [(at_s, event)] = run.events[..] else { panic!("{world:?}: {:?}", run.events) };
                assert!((20.0..20.3).contains(&at_s), "{world:?}: {at_s}");
                match event {
                    ClockEvent::Jumped(found_s) => {
                        assert!((found_s - by_s).abs() < 0.05 + by_s.abs() * 1e-3, "{found_s}");
                    }
                    ClockEvent::WentBack(found_s) => {
                        assert!((found_s + by_s).abs() < 0.6, "{found_s}");
                    }
                    ClockEvent::Wrapped => panic!("{world:?}"),
                }
                assert_eq!(run.model.status().segment, 1);
                let most_us = if pongs == Pongs::None { 16_000.0 } else { 100.0 };
                assert!(run.worst_us(31.0) < most_us, "{world:?}: {}", run.worst_us(31.0));
            }
        }
    }
}

/// Ticks continue from an earlier time: only round trips distinguish that from frames that are held up.
#[test]
fn a_clock_that_fell_behind_is_detected_by_round_trips() {
    let stalls = World { jump: Some((20.0, -0.3)), rate_hz: 2.0, ..USUAL };
    let run = stalls.run(60.0);
    let [(at_s, ClockEvent::Jumped(by_s))] = run.events[..] else { panic!("{:?}", run.events) };
    assert!(at_s < 25.0 && (by_s + 0.3).abs() < 0.01, "{at_s} {by_s}");
    assert!(run.worst_us(50.0) < 100.0, "{}", run.worst_us(50.0));
}

#[test]
fn a_32_bit_clock_wraps_without_an_error() {
    // 1000 s at 4.29 MHz: it wraps after 2^32 ticks, 1.2 s into the run.
    let world = World { bits: 32, tick_hz: 4_289_800, drift_ppm: 80.0, ..USUAL };
    let run = world.run(30.0);
    let [(at_s, ClockEvent::Wrapped)] = run.events[..] else { panic!("{:?}", run.events) };
    assert!((0.5..2.0).contains(&at_s), "{at_s}");
    assert!(run.worst_us(13.0) < 100.0, "{}", run.worst_us(13.0));
}

/// A damaged frame whose checksum still matches is one in billions, and must not end a segment.
#[test]
fn a_single_wrong_time_is_left_out() {
    let mut model = ClockModel::new(1_000_000);
    for i in 0..1000_u64 {
        let wrong = if i == 700 { 5_000_000_000 } else { 0 };
        let event = model.frame(i * 10_000 + wrong, i * 10_000_000, &mut |_| true);
        assert_eq!(event, None, "{i}");
    }
    let line = model.line().unwrap();
    assert!(line.lateness_us(9_990_000, 9_990_000_000, 1e6).abs() < 1.0, "{line:?}");
}

/// A take stores the observations that its line was fitted to: refitted at any time, the line is the same.
#[test]
fn the_line_can_be_refitted_from_the_stored_observations_at_any_time() {
    let busy = World { jitter_us: 300.0, stalled: 0.1, ..USUAL };
    let slow = World { pongs: Pongs::Late(400.0), ..busy };
    let swaying = World { jitter_us: 3_000.0, pongs: Pongs::Late(5_000.0), ..USUAL };
    let mut worst = (0.0_f64, 0.0_f64);
    let mut n_lines = 0;
    for usual in [USUAL, busy, slow, swaying] {
        for world in worlds(usual).step_by(13) {
            for apart in world.run(45.0).apart() {
                assert!(apart.agrees, "{world:?}: {apart:?}");
                let LineDeviation { offset_us, drift_ppm, .. } = apart;
                worst = (worst.0.max(offset_us.abs()), worst.1.max(drift_ppm.abs()));
                n_lines += 1;
            }
        }
    }
    assert!(n_lines > 3_000 && worst.0 < 0.1 && worst.1 < 0.01, "{n_lines} {worst:?}");
}

/// Pongs stamped by another clock than the frames: the line follows the frames and has no bound.
#[test]
fn pongs_of_another_clock_do_not_move_the_line() {
    for wrong in [0, 1 << 40, u64::MAX / 2] {
        let mut model = ClockModel::new(1_000_000);
        for i in 1..3000_u64 {
            let now_ns = 50_000_000_000 + i * 10_000_000;
            model.frame(7_000_000 + i * 10_000, now_ns + 100_000, &mut |_| true);
            if i % 100 < 8 {
                model.probe(wrong, now_ns, now_ns + 80_000, &mut |_| true);
            }
        }
        let line = model.line().unwrap();
        let late_us = line.lateness_us(7_000_000 + 29_000_000, 79_000_100_000, 1e6);
        assert!(late_us.abs() < 5.0, "{wrong}: {late_us} {line:?} {:?}", model.status());
    }
}

#[test]
fn a_device_that_does_not_answer_is_not_pinged_again() {
    let mut prober = Prober::new();
    let (mut now_ns, mut sent) = (0, 0);
    while now_ns < 600_000_000_000 {
        if let Some(at_ns) = prober.due(now_ns) {
            assert!(at_ns >= now_ns);
            prober.sent(at_ns);
            sent += 1;
        }
        now_ns += 5_000_000;
    }
    assert_eq!(sent, 16);
}

/// The device was switched off and on, or stalled: an answer to any of the last pings resumes probing.
#[test]
fn a_device_that_answers_late_is_pinged_again() {
    let mut prober = Prober::new();
    let mut sent = Vec::new();
    for now_ns in (0..40_000_000_000).step_by(5_000_000) {
        sent.extend(prober.due(now_ns).inspect(|&at_ns| prober.sent(at_ns)));
        if now_ns == 30_000_000_000 {
            assert_eq!(sent.len(), 16);
            assert!(prober.answered(sent[12], now_ns));
        }
    }
    assert!(sent.len() > 16, "{sent:?}");
}

#[test]
fn at_most_ten_pings_a_second_are_sent() {
    for world in worlds(USUAL).step_by(5) {
        let mut sent_us: Vec<u64> = Vec::new();
        for item in &world.run(60.0).items {
            if let ClockItem::Probe(_, probe) = item {
                sent_us.push(probe.sent_us);
            }
        }
        for window in sent_us.windows(11) {
            assert!(window[10] - window[0] >= 1_000_000, "{world:?}: {window:?}");
        }
        // Bursts of eight at 0, 1, 4, 9, 20 and 40 s.
        assert_eq!(sent_us.len(), 48, "{world:?}");
    }
}

/// Arbitrary ticks and times, most of them close together.
fn times() -> impl Strategy<Value = Vec<(bool, u64, u64, u64)>> {
    let number = prop_oneof![0..1000_u64, 0..10_000_000_000_u64, any::<u64>()];
    let step = (any::<bool>(), number.clone(), number.clone(), number);
    prop::collection::vec(step, 0..300)
}

fn is_finite(bound: Bound) -> bool {
    bound.offset_us.is_finite() && bound.drift_ppm.is_finite()
}

proptest! {
    /// No panic, memory bounded by construction, and numbers that a take can store.
    #[test]
    fn any_times_give_a_finite_line(
        tick_hz in prop_oneof![Just(0_u64), 1..100_000_000_u64, any::<u64>()],
        steps in times(),
        sums in any::<bool>(),
    ) {
        let mut model = ClockModel::new(tick_hz);
        let mut prober = Prober::new();
        let (mut ticks, mut now_ns) = (0_u64, 0_u64);
        for (is_probe, by_ticks, by_ns, trip_ns) in steps {
            (ticks, now_ns) = if sums {
                (ticks.wrapping_add(by_ticks), now_ns.saturating_add(by_ns))
            } else {
                (by_ticks, by_ns)
            };
            let later_ns = now_ns.saturating_add(trip_ns);
            if is_probe {
                model.probe(ticks, now_ns, later_ns, &mut |_| true);
                if prober.due(now_ns).is_some() {
                    prober.sent(now_ns);
                }
                prober.answered(now_ns, later_ns);
            } else {
                model.frame(ticks, now_ns, &mut |_| true);
            }
            if let Some(line) = model.line() {
                prop_assert!(line.late_us.is_finite() && line.drift_ppm.abs() <= 20_000.0);
                prop_assert!(line.bound.is_none_or(is_finite), "{line:?}");
            }
            let status = model.status();
            let fit = status.ledger();
            prop_assert!(status.residual_us.is_finite());
            prop_assert!(fit.is_none_or(|fit| fit.drift_ppm.is_finite() && fit.residual_us.is_finite()));
        }
        model.close(&mut |_| true);
    }

    #[test]
    fn any_points_and_bursts_give_a_line_or_none(
        points in prop::collection::vec((any::<u64>(), any::<u64>()), 0..60),
        probes in prop::collection::vec((any::<u64>(), any::<u64>(), any::<u64>()), 0..60),
    ) {
        let point = |(device_ticks, host_us)| ClockPoint { device_ticks, host_us };
        let points: Vec<_> = points.into_iter().map(point).collect();
        let mut bursts = observations::Bursts::new();
        for (sent_us, device_ticks, round_trip_us) in probes {
            bursts.add(ClockProbe { sent_us, device_ticks, round_trip_us });
        }
        if let Some((line, _)) = fit(&points, bursts.best(3.0, 1e6).all(), 1e6) {
            prop_assert!(line.late_us.is_finite() && line.drift_ppm.is_finite(), "{line:?}");
            prop_assert!(line.bound.is_none_or(is_finite), "{line:?}");
        }
    }
}
