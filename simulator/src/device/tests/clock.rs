//! The device's clock.

use super::super::*;

#[test]
fn the_clock_drifts_as_set() {
    let mut clock = DeviceClock::new(200.0).unwrap();
    assert_eq!(clock.ticks(77), 0, "not started");
    clock.begin(5_000);
    clock.begin(6_000);
    // After 5001 s on the host's clock it shows 5000 s.
    assert_eq!(clock.ticks(5_000 + 5_001 * SECOND_NS), 5_000 * TICK_HZ);
    assert_eq!(clock.caller_ns(5_000 * SECOND_NS), 5_001 * SECOND_NS);
    let gains = DeviceClock::new(-200.0).unwrap();
    assert_eq!(gains.caller_ns(5_000 * SECOND_NS), 4_999 * SECOND_NS);
    for found_ppm in [f64::NAN, f64::INFINITY, -100_001.0] {
        assert!(DeviceClock::new(found_ppm).is_err(), "{found_ppm}");
    }
}
