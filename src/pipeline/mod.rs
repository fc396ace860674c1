//! From frames to a take: reader -> rings -> resampler pool -> writer.
//!
//! ```text
//! reader thread     Intake: frame -> one ring per channel, one for the time line; closes stretches
//! resampler threads Pool:   rings -> blocks, proven; a group of channels belongs to one worker at a time
//! writer thread     blocks -> stretches -> take file, synced
//! ```
//!
//! Frames go through lock-free rings: the reader and a worker meet at a lock only when a stretch is closed
//! and a worker sleeps (inside the channel that wakes it). From frames to blocks nothing allocates after
//! [`Pipeline::start`]. Every queue is bounded; `plan.rs` holds the arithmetic.

mod counts;
mod desk;
mod group;
mod intake;
mod messages;
pub mod offline;
mod plan;
mod pool;
mod ring;
mod seen;
mod takes;
mod tap;
mod timeline;
mod writer;

use std::sync::{
    Arc, Mutex, MutexGuard, PoisonError,
    atomic::{AtomicBool, AtomicI64, AtomicU64},
};

use anyhow::anyhow;
use crossbeam_channel::{Receiver, bounded};
use mocapd_take::record::{Channel, Header, Ledger};

pub use counts::{Counts, PendingRows};
pub use intake::Intake;
pub use plan::{PipelineConfig, PreRollConfig};
pub use seen::{Seen, SeenCounters};
pub use takes::{Begun, FirstRow, NewTake, TakeEnd, Takes};
pub use tap::{TapHead, TapOut};
pub(crate) use writer::HELD_MIN_BYTES;
pub use writer::{DiskState, TakeOutput, Written};

use self::{
    group::Group,
    plan::Plan,
    pool::Pool,
    writer::{LiveTake, Sources, Writer},
};
use crate::{heartbeat::Who, threads};

/// What other threads may look at while it runs. Counters only: the truth is in the ledger.
#[derive(Debug, Default)]
pub struct Progress {
    /// Frames taken in.
    pub frames: AtomicU64,
    /// Frames lost so far, for whatever reason.
    pub lost: AtomicU64,
    /// How much faster the host's clock runs than the device's, in parts per billion, as an `i64` has it.
    pub drift_ppb: AtomicI64,
    /// What 99 of 100 frames were no later than after the clock's line, in microseconds; 0 while unknown.
    pub jitter_p99_us: AtomicU64,
    /// Bytes written.
    pub file_bytes: AtomicU64,
    /// Samples in the stretches written.
    pub samples: AtomicU64,
    /// How long the disk will do, in seconds; `u64::MAX` while unknown.
    pub disk_left_s: AtomicU64,
    /// So little is left of the disk that the take has to end: stop feeding, and it is closed.
    pub disk_full: AtomicBool,
    /// The writer met an error and writes no more, or a worker is gone: stop feeding.
    pub failed: AtomicBool,
    /// How full the fullest ring was at the last end of a stretch, of a thousand.
    pub ring_fill_permille: AtomicU64,
    /// What 99 of 100 frames took at most from their last byte into every ring, in nanoseconds; told every second.
    pub ring_latency_p99_ns: AtomicU64,
    /// Times that the device went away and came back.
    pub outages: AtomicU64,
    /// It is away now.
    pub is_away: AtomicBool,
    /// All channels so far, by slot: those that appeared, too.
    pub channels: Mutex<Vec<Channel>>,
    /// Bytes of the pre-roll.
    pub held_bytes: AtomicU64,
    /// Its length, in milliseconds.
    pub held_ms: AtomicU64,
    /// Some of it went because of the bytes that it took.
    pub held_cut: AtomicBool,
    /// The take that is being written. The writer and whoever watches meet here, and nobody else.
    pub take: Mutex<Option<TakeNow>>,
}

/// A take that grows.
#[derive(Debug, Clone, Default)]
pub struct TakeNow {
    /// Rows, lost ones included.
    pub rows: u64,
    /// Bytes of the file.
    pub bytes: u64,
    /// Of these, bytes that were synced.
    pub durable_bytes: u64,
    /// Samples in it.
    pub samples: u64,
    /// The largest error that an encoder measured, in millimetres.
    pub max_error_mm: f64,
    /// The ledger so far.
    pub ledger: Ledger,
}

/// The running threads behind an [`Intake`].
#[derive(Debug)]
pub struct Pipeline<W> {
    pool: Pool,
    writer: std::thread::JoinHandle<anyhow::Result<()>>,
    progress: Arc<Progress>,
    /// Of a pipeline for one take.
    ended: Option<Receiver<TakeEnd<W>>>,
}

/// The state behind a lock, whatever became of who held it last: a count or a name is never half written.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What a pipeline that takes are begun and ended in has beside its threads.
#[derive(Debug)]
pub struct Armed<W> {
    /// Asks for takes.
    pub takes: Takes<W>,
    /// Frames to look at.
    pub tap: TapOut,
    /// How well each marker is seen.
    pub seen: SeenCounters,
}

impl<W: TakeOutput> Pipeline<W> {
    /// Allocates everything, writes the header and starts the threads: all frames go into one take.
    ///
    /// # Errors
    /// When the header cannot be written, a thread cannot be started, or the resampler is not a live one.
    pub fn start(
        config: &PipelineConfig,
        header: &Header,
        output: W,
    ) -> anyhow::Result<(Intake, Self)> {
        let (answers, begun) = takes::answers();
        let times = (config.sync_every, config.keep_free_bytes);
        let take = LiveTake::begin(output, header, answers, (Counts::default(), 0), times);
        let take = take.map_err(|(error, _)| error)?;
        let (intake, mut pipeline, _) = Self::run(config, header, Some(take), None)?;
        pipeline.ended = Some(begun.ended);
        Ok((intake, pipeline))
    }

    /// The same without a take: frames wait in the pre-roll, and takes are asked for. `header` is that of the takes, but
    /// for what is each one's own.
    ///
    /// # Errors
    /// As [`start`](Self::start).
    pub fn arm(
        config: &PipelineConfig,
        header: &Header,
    ) -> anyhow::Result<(Intake, Self, Armed<W>)> {
        let seen = SeenCounters::new(config.channels.len() + config.reserve);
        Self::run(config, header, None, Some(seen))
    }

    fn run(
        config: &PipelineConfig,
        header: &Header,
        take: Option<LiveTake<W>>,
        seen: Option<SeenCounters>,
    ) -> anyhow::Result<(Intake, Self, Armed<W>)> {
        let plan = Plan::new(config)?;
        let channels = Mutex::new(config.channels.clone());
        let progress = Arc::new(Progress { channels, ..Progress::default() });
        let writer_beat = config.heartbeat.beat(Who::Writer)?;

        let (parts_in, parts) = bounded(plan.parts_max());
        let (to_writer, from_reader) = messages::reader_to_writer();
        let mut groups = Vec::new();
        let mut producers = Vec::new();
        for index in 0..plan.n_groups() {
            let (group, group_producers) = Group::channels(&plan, index, seen.clone());
            groups.push(group);
            producers.extend(group_producers);
        }
        let (timeline_group, timeline_producer) = Group::timeline(&plan, header);
        groups.push(timeline_group);

        let buffers_back = groups.iter().map(Group::buffers_back).collect();
        let pool = Pool::start(&plan, groups, &parts_in, &progress, &config.heartbeat)?;
        let (desk, desk_in) = desk::desk();
        let (tap_in, tap) = tap::tap(plan.n_slots);
        let (takes, orders) = takes::takes(desk);
        let intake = Intake::new(
            config,
            &plan,
            (producers, timeline_producer),
            pool.feed(),
            to_writer,
            Arc::clone(&progress),
            (desk_in, tap_in),
        )?;
        let sources = Sources { parts, from_reader, orders };
        let (wakes, channels) = (pool.wakes(), &config.channels);
        let mut writer = Writer::new(&plan, channels, sources, buffers_back, wakes, &progress);
        if let Some(take) = take {
            writer.for_take(take);
        }
        let guard = pool::FailOnPanic(Arc::clone(&progress));
        let writer = threads::spawn("mocapd-write", move || {
            let written = writer.run(&writer_beat);
            drop(guard);
            written
        })?;
        let armed = Armed { takes, tap, seen: seen.unwrap_or_default() };
        Ok((intake, Self { pool, writer, progress, ended: None }, armed))
    }

    /// What can be seen while it runs.
    #[must_use]
    pub fn progress(&self) -> &Arc<Progress> {
        &self.progress
    }

    /// Waits until everything that the finished `Intake` took in is on disk, the ledger included.
    ///
    /// # Errors
    /// The writer's: what was written before stays a readable take. A pipeline that was armed has nothing to give.
    pub fn finish(mut self) -> anyhow::Result<(Written, W)> {
        let ended = self.ended.take();
        let ran = self.join();
        // The take's own account comes first: it says what went wrong with it.
        match ended.and_then(|ended| ended.try_recv().ok()) {
            Some(end) => end,
            None => Err(ran.err().unwrap_or_else(|| anyhow!("no take was written"))),
        }
    }

    /// Waits until everything that the finished `Intake` took in is where it belongs.
    ///
    /// # Errors
    /// A thread failed: this is a bug in mocapd.
    pub fn join(self) -> anyhow::Result<()> {
        let ran = threads::join(self.writer);
        self.pool.stop();
        ran?
    }
}
