//! Shared test utilities: generated motion, a pipeline in memory, and reading takes back.

use std::{
    any::Any,
    io::{self, Cursor},
    marker::PhantomData,
    ops::Range,
};

use mocapd_acquire::{
    header,
    inspect::Summary,
    pipeline::{
        Counts, Intake, NewTake, Pipeline, PipelineConfig, TakeAccount, TakeFailed, TakeOutput,
    },
};
use mocapd_codec::{ResamplerKind, Settings, Tolerance};
use mocapd_drivers::device::{Frame, MarkerSample};
use mocapd_simulator::generator::{JumpSpec, Occlusion};
use mocapd_take::{
    TakeError, TakeEvent, TakeFrames, chunk,
    damage::Problem,
    motion::{FrameSource, GAP, Motion, Position, is_gap},
    reader::{TakeBytes, read_events},
    record::{Clock, Ledger},
    timeline::Timeline,
};

/// C3D files built byte by byte, independently of the project's writer.
#[path = "../../take/tests/interchange/c3d_file.rs"]
pub(crate) mod c3d_file;

/// Clock ticks per second of the test devices.
pub(crate) const TICK_HZ: u64 = 1_000_000;

/// Whether a message mentions a fact (a name, number, option or command) as a whole, not as part of another word.
pub(crate) fn mentions(message: &str, fact: &str) -> bool {
    let is_inner = |c: char| c.is_alphanumeric() || c == '_';
    let is_digit = |c: char| c.is_ascii_digit();
    message.match_indices(fact).any(|(at, _)| {
        let (before, after) = (&message[..at], &message[at + fact.len()..]);
        let begins_earlier = before.ends_with(is_inner)
            || before.strip_suffix('.').is_some_and(|before| before.ends_with(is_digit));
        let goes_on = after.starts_with(is_inner)
            || after.strip_prefix('.').is_some_and(|after| after.starts_with(is_digit));
        let is_part =
            fact.starts_with(is_inner) && begins_earlier || fact.ends_with(is_inner) && goes_on;
        !is_part
    })
}

/// Asserts that a message mentions all facts that its reader needs, in any wording.
#[track_caller]
pub(crate) fn assert_mentions(message: &str, facts: &[&str]) {
    for fact in facts {
        assert!(mentions(message, fact), "'{fact}' is not in: {message}");
    }
}

/// The I/O error that ended a take early.
pub(crate) fn io_error_of(failed: &TakeFailed) -> Option<io::ErrorKind> {
    match failed.error.downcast_ref() {
        Some(TakeError::Io(error)) => Some(error.kind()),
        _ => failed.error.downcast_ref::<io::Error>().map(io::Error::kind),
    }
}

/// A generated jump with gaps.
pub(crate) fn jump(seed: u64, rate_hz: f64, seconds: f64) -> Motion {
    let occlusion = Some(Occlusion { fraction: 0.05, mean_gap_s: 0.1 });
    let spec = JumpSpec { seconds: Some(seconds), occlusion, ..JumpSpec::new(seed, rate_hz) };
    spec.generate().unwrap().motion
}

/// A generated jump with gaps and more markers than fit into a block.
pub(crate) fn crowd(seed: u64, rate_hz: f64, seconds: f64) -> Motion {
    let occlusion = Some(Occlusion { fraction: 0.05, mean_gap_s: 0.1 });
    let spec = JumpSpec {
        seconds: Some(seconds),
        occlusion,
        n_markers: 150,
        ..JumpSpec::new(seed, rate_hz)
    };
    spec.generate().unwrap().motion
}

pub(crate) fn dense(tolerance_mm: f64) -> Settings {
    Settings { kind: ResamplerKind::Dense, tolerance: Tolerance::from_mm(tolerance_mm).unwrap() }
}

pub(crate) fn fast(tolerance_mm: f64) -> Settings {
    Settings { kind: ResamplerKind::Fast, ..dense(tolerance_mm) }
}

pub(crate) fn lossless() -> Settings {
    Settings { kind: ResamplerKind::Lossless, ..dense(1.0) }
}

/// The samples of one frame as a device sends them.
pub(crate) fn samples(frame: &[Position]) -> Vec<MarkerSample> {
    let sample = |(id, &position_mm): (usize, &Position)| MarkerSample {
        id: id as u16,
        occluded: is_gap(position_mm),
        position_mm,
        ..MarkerSample::default()
    };
    frame.iter().enumerate().map(sample).collect()
}

/// Feeds frame `seq` of `motion` to the pipeline.
pub(crate) fn feed(intake: &mut Intake, motion: &Motion, seq: usize) {
    feed_samples(intake, motion.info.rate_hz, seq, &samples(motion.frame(seq)));
}

pub(crate) fn feed_samples(
    intake: &mut Intake,
    rate_hz: f64,
    seq: usize,
    markers: &[MarkerSample],
) {
    let device_ticks = (seq as f64 * TICK_HZ as f64 / rate_hz).round() as u64;
    let frame = Frame { seq: seq as u32, device_ticks, timecode: None, markers };
    intake.frame(&frame, 5_000_000 + device_ticks * 1000);
}

pub(crate) fn config(motion: &Motion, codec: Settings) -> PipelineConfig {
    let channels = header::channels(&motion.info.markers);
    PipelineConfig::new(codec, motion.info.rate_hz, TICK_HZ, channels)
}

/// A pipeline that writes one take to an output of type `W`.
pub(crate) struct Recording<W>(Pipeline, PhantomData<W>);

impl<W: TakeOutput> Recording<W> {
    pub(crate) fn finish(self) -> Result<(TakeAccount, W), TakeFailed> {
        self.0.finish().map(|(written, output)| (written, output_of(output)))
    }
}

pub(crate) fn output_of<W: TakeOutput>(output: Box<dyn TakeOutput>) -> W {
    *(output as Box<dyn Any>).downcast().unwrap()
}

pub(crate) fn start<W: TakeOutput>(config: &PipelineConfig, output: W) -> (Intake, Recording<W>) {
    start_with(config, output, |_| {})
}

/// The same with a header that `changed` changes.
pub(crate) fn start_with<W: TakeOutput>(
    config: &PipelineConfig,
    output: W,
    changed: impl FnOnce(&mut mocapd_take::record::Header),
) -> (Intake, Recording<W>) {
    let mut header = header::new(&config.codec, config.rate_hz).unwrap();
    header.channels.clone_from(&config.channels);
    header.stretch_rows = config.stretch_rows();
    header.device =
        Some(mocapd_take::record::Device { tick_hz: config.tick_hz, ..Default::default() });
    changed(&mut header);
    let (intake, pipeline) = Pipeline::start(config, NewTake::new(output, header)).unwrap();
    (intake, Recording(pipeline, PhantomData))
}

/// Records the frames `wanted` of `motion`, in that order, and waits while the rings are full.
pub(crate) fn record(
    motion: &Motion,
    config: &PipelineConfig,
    wanted: impl IntoIterator<Item = usize>,
) -> (TakeAccount, Vec<u8>, Counts) {
    let (mut intake, pipeline) = start(config, Vec::new());
    for seq in wanted {
        while intake.is_full() {
            std::thread::yield_now();
        }
        feed(&mut intake, motion, seq);
    }
    let counts = intake.finish();
    let (written, take) = pipeline.finish().unwrap();
    let summary = Summary::read(&take[..]).unwrap();
    assert_eq!((summary.take.problems.as_slice(), summary.contradictions()), (&[][..], &[][..]));
    assert_eq!(summary.take.statistics.as_ref(), Some(&summary.statistics));
    (written, take, counts)
}

/// The rows of a take, and its problems.
pub(crate) fn rows(take: &[u8]) -> (Vec<Vec<Position>>, Vec<Problem>) {
    let mut frames = TakeFrames::open(Cursor::new(take)).unwrap();
    let mut row = vec![GAP; frames.info().markers.len()];
    let mut rows = Vec::new();
    while frames.next_frame(&mut row).unwrap() {
        rows.push(row.clone());
    }
    (rows, frames.problems().to_vec())
}

/// The contents of a take's chunks that tests check.
#[derive(Debug, Default)]
pub(crate) struct Chunks {
    pub(crate) labels: Vec<String>,
    pub(crate) timelines: Vec<Timeline>,
    pub(crate) ledgers: Vec<Ledger>,
    pub(crate) clocks: Vec<Clock>,
    pub(crate) keys: Vec<(u64, bool)>,
    pub(crate) blocks: Vec<Vec<u8>>,
    pub(crate) finished: bool,
    pub(crate) bytes: TakeBytes,
}

pub(crate) fn chunks(take: &[u8]) -> Chunks {
    let mut found = Chunks::default();
    read_events(take, |event| {
        match event {
            TakeEvent::Header(header) => {
                found.labels.extend(header.channels.iter().map(|c| c.label.clone()));
            }
            TakeEvent::Channels(more) => found.labels.extend(more.iter().map(|c| c.label.clone())),
            TakeEvent::Ledger(ledger) => found.ledgers.push(*ledger),
            TakeEvent::Clock(clock) => found.clocks.push(*clock),
            TakeEvent::Stretch(stretch) => {
                if stretch.span.n_rows > 0 {
                    found.keys.push((stretch.span.first_row, stretch.span.key));
                }
                found.blocks.extend(stretch.blocks.iter().map(|block| block.to_vec()));
                found.timelines.extend(stretch.timeline);
            }
            TakeEvent::End { finished, bytes } => {
                found.finished = finished;
                found.bytes = bytes;
            }
            TakeEvent::Damaged { message, offset, .. } => panic!("damaged at {offset}: {message}"),
            _ => {}
        }
        Ok(())
    })
    .unwrap();
    found
}

/// Type and byte range of every chunk after a take's magic.
pub(crate) fn places(take: &[u8]) -> Vec<(u8, Range<usize>)> {
    let mut at = chunk::MAGIC.len();
    let mut places = Vec::new();
    while let chunk::ChunkParse::Whole { kind, len, .. } = chunk::parse(&take[at..]) {
        places.push((kind, at..at + len));
        at += len;
    }
    places
}

pub(crate) fn distance_mm(a: Position, b: Position) -> f64 {
    a.iter().zip(b).map(|(&a, b)| (f64::from(a) - f64::from(b)).powi(2)).sum::<f64>().sqrt()
}

/// A seeded stream of random numbers (`SplitMix64`, Steele et al. 2014).
#[derive(Debug)]
pub(crate) struct Seeded(u64);

impl Seeded {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15))
    }

    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// From 0 to `n - 1`; 0 if `n` is 0.
    pub(crate) fn below(&mut self, n: usize) -> usize {
        if n == 0 { 0 } else { (self.next() % n as u64) as usize }
    }
}
