//! The framing overhead of a live take.

use mocapd_drivers::device::Frame;
use mocapd_simulator::generator::JumpSpec;
use mocapd_take::{
    TakeError,
    record::{Header, Record},
};
use mocapd_testkit::random::Random;

use crate::support::{TICK_HZ, chunks, config, dense, samples, start};

/// Length of the recording.
const SECONDS: f64 = 60.0;

/// Lateness of frames: some tens of microseconds, and up to four milliseconds for half a percent of them.
struct Lateness(Random);

impl Lateness {
    fn next_ns(&mut self) -> u64 {
        let random = &mut self.0;
        let jitter = (0..4).map(|_| random.below(30_000)).sum::<usize>();
        let stall = if random.one_in(200) { random.below(4_000_000) } else { 0 };
        (jitter + stall) as u64
    }
}

/// A take of a minute with `n_markers`, recorded faster than real time.
fn a_minute(n_markers: usize, rate_hz: f64) -> Vec<u8> {
    let spec = JumpSpec { seconds: Some(SECONDS), n_markers, ..JumpSpec::new(1, rate_hz) };
    let motion = spec.generate().unwrap().motion;
    let (mut intake, pipeline) = start(&config(&motion, dense(1.0)), Vec::new());
    let mut lateness = Lateness(Random::new(1));
    for seq in 0..motion.n_frames() {
        while intake.is_full() {
            std::thread::yield_now();
        }
        // The counter started before the recording, and the clocks differ by 20 ppm.
        let seconds = (seq + 9_999) as f64 / rate_hz;
        let markers = samples(motion.frame(seq));
        let frame = Frame {
            seq: seq as u32,
            device_ticks: (seconds * TICK_HZ as f64).round() as u64,
            timecode: None,
            markers: &markers,
        };
        let arrival_ns = 86_400_000_000_000 + (seconds * 1.000_02e9) as u64 + lateness.next_ns();
        intake.frame(&frame, arrival_ns);
    }
    intake.finish();
    pipeline.finish().unwrap().1
}

/// The limits are absolute: a tenth of the file at 1 mm.
#[test]
fn the_timeline_and_the_framing_of_a_minute_are_small() {
    for (n_markers, rate_hz, most) in [(15, 60.0, 12.0), (64, 240.0, 25.0)] {
        let take = a_minute(n_markers, rate_hz);
        let found = chunks(&take);
        let (bytes, n_stretches) = (found.bytes, found.keys.len());
        assert_eq!(bytes.sum(), take.len() as u64);
        let each = (bytes.framing + bytes.time_line) as f64 / n_stretches as f64;
        println!(
            "{n_markers} at {rate_hz} Hz: {each:.2} bytes a stretch: {bytes:?}, {n_stretches}"
        );
        assert!(each <= most, "{n_markers} at {rate_hz} Hz: {each} bytes a stretch");

        // The ledgers of a real minute: at 0, 5, 10, 20 and 40 s, and the last one.
        let ledger = found.ledgers.last().unwrap().to_payload().unwrap().len() as u64 + 7;
        let labels: usize = found.labels.iter().map(String::len).sum();
        let rest = bytes.header + bytes.index + 6 * ledger - labels as u64;
        assert!(rest <= 2048, "{rest} bytes of header, index and ledgers");
    }
}

#[test]
fn a_take_of_an_older_development_version_is_refused() {
    let mut header = mocapd_acquire::header::new(&dense(1.0), 60.0).unwrap();
    header.codec_version = 1;
    let mut take = mocapd_take::chunk::MAGIC.to_vec();
    mocapd_take::chunk::put(&mut take, Header::KIND, &header.to_payload().unwrap()).unwrap();
    let frames = mocapd_take::TakeFrames::open(std::io::Cursor::new(take));
    let error = frames.unwrap_err();
    assert!(matches!(error, TakeError::Unsupported { found: 1, supported: 2.., .. }), "{error}");
}
