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
mod group;
mod intake;
mod messages;
pub mod offline;
mod plan;
mod pool;
mod ring;
mod timeline;
mod writer;

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicI64, AtomicU64},
};

use anyhow::Context;
use crossbeam_channel::bounded;
use mocapd_take::{TakeWriter, record::Header};

pub use counts::Counts;
pub use intake::Intake;
pub use plan::PipelineConfig;
pub(crate) use writer::HELD_MIN_BYTES;
pub use writer::{DiskState, TakeOutput, Written};

use self::{group::Group, plan::Plan, pool::Pool, writer::Writer};
use crate::threads;

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
}

/// The running threads behind an [`Intake`].
#[derive(Debug)]
pub struct Pipeline<W> {
    pool: Pool,
    writer: std::thread::JoinHandle<anyhow::Result<(Written, W)>>,
    progress: Arc<Progress>,
}

impl<W: TakeOutput> Pipeline<W> {
    /// Allocates everything, writes the header and starts the threads.
    ///
    /// # Errors
    /// When the header cannot be written, a thread cannot be started, or the resampler is not a live one.
    pub fn start(
        config: &PipelineConfig,
        header: &Header,
        output: W,
    ) -> anyhow::Result<(Intake, Self)> {
        let plan = Plan::new(config)?;
        let take = TakeWriter::new(output, header).context("cannot write the take's header")?;
        let progress = Arc::new(Progress::default());

        let (parts_in, parts) = bounded(plan.parts_max());
        let (to_writer, from_reader) = messages::reader_to_writer();
        let mut groups = Vec::new();
        let mut producers = Vec::new();
        for index in 0..plan.n_groups() {
            let (group, group_producers) = Group::channels(&plan, index);
            groups.push(group);
            producers.extend(group_producers);
        }
        let (timeline_group, timeline_producer) = Group::timeline(&plan, header);
        groups.push(timeline_group);

        let buffers_back = groups.iter().map(Group::buffers_back).collect();
        let pool = Pool::start(&plan, groups, &parts_in, &progress)?;
        let intake = Intake::new(
            config,
            &plan,
            producers,
            timeline_producer,
            pool.feed(),
            to_writer,
            Arc::clone(&progress),
        );
        let wakes = pool.wakes();
        let writer = Writer::new(take, &plan, parts, from_reader, buffers_back, wakes, &progress);
        let guard = pool::FailOnPanic(Arc::clone(&progress));
        let writer = threads::spawn("mocapd-write", move || {
            let written = writer.run();
            drop(guard);
            written
        })?;
        Ok((intake, Self { pool, writer, progress }))
    }

    /// What can be seen while it runs.
    #[must_use]
    pub fn progress(&self) -> &Arc<Progress> {
        &self.progress
    }

    /// Waits until everything that the finished `Intake` took in is on disk, the ledger included.
    ///
    /// # Errors
    /// The writer's: what was written before stays a readable take.
    pub fn finish(self) -> anyhow::Result<(Written, W)> {
        let written = threads::join(self.writer);
        self.pool.stop();
        written?
    }
}
