//! From frames to a take: reader -> rings -> resampler pool -> writer.
//!
//! ```text
//! reader thread     Intake: frame -> one ring per channel, one for the timeline; closes stretches
//! resampler threads Pool:   rings -> blocks, verified; a group of channels belongs to one worker at a time
//! writer thread     blocks -> stretches -> take file, synced
//! ```
//!
//! Frames pass through lock-free rings. The reader and a worker share a lock only when a stretch is closed
//! and the worker sleeps (inside the channel that wakes it). From frames to blocks nothing is allocated after
//! [`Pipeline::start`], except for new markers. Every queue is bounded; `plan.rs` derives the sizes.

mod counts;
mod disk;
mod intake;
mod messages;
pub mod offline;
mod plan;
mod pool;
mod progress;
mod publish_tap;
mod ring;
mod sampled;
mod writer;

use std::sync::Arc;

use anyhow::anyhow;
use crossbeam_channel::bounded;
use mocapd_take::record::Header;

pub use counts::{Counts, PendingRows};
pub use disk::{DiskSpace, RESERVE_MIN_BYTES, check_disk_space};
pub use intake::Intake;
pub use messages::{
    CommandSender, FirstRow, NewTake, NothingRecorded, TakeAccount, TakeFailed, TakeHandle,
    TakeResult,
};
pub use plan::{PipelineConfig, PreRollConfig, STRETCH_LENGTHS, SYNC_MAX};
pub use pool::{Visibility, VisibilityCounters};
pub use progress::{PipelineProgress, TakeProgress, lock};
pub use publish_tap::{LeftOut, PublishTap, TappedBatch, TappedFrame, TappedMarker};
pub use ring::{PreviewBody, PreviewFrame, PreviewPoses, PreviewReceiver};
pub use sampled::{SampleColumn, SampleRange, SampleTapReceiver};
pub use writer::splitting::{NextTake, Split, SplitAt, TakeSeries};

use self::{
    intake::ReaderEndpoints,
    plan::Plan,
    pool::{Group, Pool},
    sampled::SamplingThreads,
    writer::{LiveTake, SampleQueue, TakePlace, Writer, WriterEndpoints},
};
pub use crate::files::TakeOutput;
use crate::threads::{self, ThreadRole};

/// The threads behind an [`Intake`].
#[derive(Debug)]
pub struct Pipeline {
    pool: Pool,
    sampling: SamplingThreads,
    writer: std::thread::JoinHandle<anyhow::Result<()>>,
    progress: Arc<PipelineProgress>,
    /// Only in a pipeline for a single take.
    take: Option<TakeHandle>,
}

/// Handles of a pipeline whose takes begin and end on command.
#[derive(Debug)]
pub struct ArmedHandles {
    /// Sends commands for takes.
    pub takes: CommandSender,
    /// Frames to preview.
    pub tap: PreviewReceiver,
    /// What the device sends, for each publisher of the configuration.
    pub publish_taps: Vec<PublishTap>,
    /// Sampled channels to preview.
    pub sample_tap: SampleTapReceiver,
    /// The visibility of each marker.
    pub seen: VisibilityCounters,
}

impl Pipeline {
    /// Allocates all memory, writes the header and starts the threads. All frames go into one take.
    ///
    /// # Errors
    /// When the header cannot be written, a thread cannot be started, or the resampler needs whole takes.
    pub fn start(config: &PipelineConfig, take: NewTake) -> anyhow::Result<(Intake, Self)> {
        let (reply, handle) = messages::reply_channel();
        let header = take.header.clone();
        let place = TakePlace::at_start();
        let groups = sampled::records(config);
        let take = LiveTake::begin(take, &reply, place, &groups, config.sync_every)?;
        let (intake, mut pipeline, _) = Self::run(config, &header, Some((take, None)), None)?;
        pipeline.take = Some(handle);
        Ok((intake, pipeline))
    }

    /// Starts a pipeline whose frames go into takes that follow each other. Their results go where each
    /// [`NextTake::ended`] leads; [`join`](Self::join) waits for the last.
    ///
    /// # Errors
    /// As for [`start`](Self::start). [`NothingRecorded`] when the first header cannot be written: the take's result
    /// says why.
    pub fn start_series(
        config: &PipelineConfig,
        mut split: Split,
    ) -> anyhow::Result<(Intake, Self)> {
        let NextTake { take, ended, .. } = split.takes.next_take(0)?;
        let (header, reply) = (take.header.clone(), messages::Reply::of_series(ended));
        let place = TakePlace::at_start();
        let groups = sampled::records(config);
        let begun = LiveTake::begin(take, &reply, place, &groups, config.sync_every);
        let take = begun.map_err(|error| {
            reply.ended.try_send(Err(TakeFailed::without_output(error))).ok();
            NothingRecorded
        })?;
        let at = split.at;
        let (mut intake, pipeline, _) =
            Self::run(config, &header, Some((take, Some(split))), None)?;
        intake.split_at(at);
        Ok((intake, pipeline))
    }

    /// Starts a pipeline without a take: frames go into the pre-roll buffer, and takes begin on command. `header` is
    /// the template for their headers.
    ///
    /// # Errors
    /// When a thread cannot be started, or the resampler needs whole takes.
    pub fn arm(
        config: &PipelineConfig,
        header: &Header,
    ) -> anyhow::Result<(Intake, Self, ArmedHandles)> {
        let visibility = VisibilityCounters::new(config.channels.len() + config.reserve);
        Self::run(config, header, None, Some(visibility))
    }

    fn run(
        config: &PipelineConfig,
        header: &Header,
        take: Option<(LiveTake, Option<Split>)>,
        visibility: Option<VisibilityCounters>,
    ) -> anyhow::Result<(Intake, Self, ArmedHandles)> {
        let plan = Plan::new(config)?;
        let progress = Arc::new(PipelineProgress::new(&config.channels));
        let writer_heartbeat = config.heartbeat.register(ThreadRole::Writer)?;

        let sampled_groups = sampled::groups(config);
        let n_parts = plan.parts_max() + sampled::parts_max(&sampled_groups);
        let (parts_in, parts) = bounded(n_parts);
        let (to_writer, from_reader) = messages::reader_to_writer();
        let mut groups = Vec::new();
        let mut rings = Vec::new();
        for index in 0..plan.n_groups() {
            let (group, group_rings) = Group::channels(&plan, index, visibility.clone(), &parts_in);
            groups.push(group);
            rings.extend(group_rings);
        }
        let (timeline_group, timeline) = Group::timeline(&plan, header, &parts_in);
        groups.push(timeline_group);

        let buffers_back = groups.iter().map(|group| group.buffers_back.clone()).collect();
        let (samples, sample_returns, sampling, sample_tap) =
            sampled::start(&sampled_groups, config, &parts_in)?;
        let (pool, feed) = Pool::start(&plan, groups, &progress, &config.heartbeat)?;
        let (takes, commands) = messages::command_channel();
        let (tap_in, tap) = ring::tap(plan.n_slots, config.recorded_bodies().len());
        let publish_taps =
            (0..config.publish_taps).map(|_| publish_tap::publish_tap(config, plan.n_slots));
        let (publish_in, publish_taps) = publish_taps.unzip();
        let ends = ReaderEndpoints {
            rings,
            timeline,
            feed,
            to_writer,
            commands,
            tap: tap_in,
            publish: publish_in,
            samples,
            progress: Arc::clone(&progress),
        };
        let intake = Intake::new(config, &plan, ends)?;
        let samples = SampleQueue::new(sampled::records(config), sample_returns);
        let wakes = pool.wakes();
        let ends = WriterEndpoints { parts, from_reader, samples, buffers_back, wakes };
        let mut writer = Writer::new(&plan, ends, &progress);
        if let Some((take, split)) = take {
            writer.set_single_take(take, split);
        }
        let guard = pool::FailOnPanic(Arc::clone(&progress));
        let writer = threads::spawn("mocapd-write", move || {
            let written = writer.run(&writer_heartbeat);
            drop(guard);
            written
        })?;
        let seen = visibility.unwrap_or_default();
        let armed = ArmedHandles { takes, tap, publish_taps, sample_tap, seen };
        Ok((intake, Self { pool, sampling, writer, progress, take: None }, armed))
    }

    /// Live counters.
    #[must_use]
    pub fn progress(&self) -> &Arc<PipelineProgress> {
        &self.progress
    }

    /// Waits until everything that the finished `Intake` accepted is on disk, including the ledger.
    ///
    /// # Errors
    /// The writer's error, with the output: what was written before it is a readable take. A pipeline that was armed
    /// has no take to return.
    pub fn finish(mut self) -> TakeResult {
        let take = self.take.take();
        let outcome = self.join();
        // The take's own error comes first: it is the more specific one.
        take.and_then(|take| take.ended.try_recv().ok()).unwrap_or_else(|| {
            let error = outcome.err().unwrap_or_else(|| anyhow!("no take was written"));
            Err(TakeFailed::without_output(error))
        })
    }

    /// Waits until everything that the finished `Intake` accepted was written to its take.
    ///
    /// # Errors
    /// When a thread failed: a bug in mocapd.
    pub fn join(self) -> anyhow::Result<()> {
        let outcome = threads::join(self.writer);
        self.pool.stop();
        self.sampling.join();
        outcome?
    }
}
