//! A sampling thread: takes samples from the rings of its groups and encodes them into blocks.

use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};
use mocapd_codec::{
    GROUP_CHANNELS,
    poses::{POSE_CHANNELS, PoseErrors, PoseQuantiser},
    sampled::SampledEncoder,
};

use super::{FreeBuffers, GroupPlan, ItemContent, RingEnds, SampleItem};
use crate::pipeline::messages::{PartContent, SamplePart, WriterInput};

/// How often a thread looks for work without being woken: only if a wake-up came between its last look and its sleep.
const IDLE: Duration = Duration::from_secs(1);

/// A group, with all its memory.
#[derive(Debug)]
pub(super) struct SampledGroupCoder {
    index: usize,
    plan: GroupPlan,
    rings: RingEnds,
    /// Free buffers; the writer returns them.
    buffers: FreeBuffers,
    /// The next item, for which no buffer was free.
    waiting: Option<SampleItem>,
    encoder: SampledEncoder,
    /// By body, if the group is one of poses that are stored within bounds.
    quantisers: Vec<PoseQuantiser>,
    /// The samples of a block, one after another, and channel after channel.
    rows: Vec<f32>,
    columns: Vec<f32>,
    /// Whether a block was refused, so that the next one has to be a key.
    is_out_of_step: bool,
}

impl SampledGroupCoder {
    pub(super) fn new(
        index: usize,
        plan: GroupPlan,
        rings: RingEnds,
        buffers: FreeBuffers,
        quantisers: Vec<PoseQuantiser>,
    ) -> Self {
        let mut encoder = SampledEncoder::new();
        encoder.prepare(plan.n_channels, plan.rows_max as usize);
        let values = plan.n_channels * plan.rows_max as usize;
        let (rows, columns) = (vec![0.0; values], vec![0.0; values]);
        let (waiting, is_out_of_step) = (None, false);
        Self {
            index,
            plan,
            rings,
            buffers,
            waiting,
            encoder,
            quantisers,
            rows,
            columns,
            is_out_of_step,
        }
    }

    /// Encodes the samples in the rings while there are free buffers. Returns `false` when no more will come, or the
    /// writer is gone.
    fn run(&mut self, parts: &Sender<WriterInput>) -> bool {
        loop {
            let Some(item) = self.waiting.take().or_else(|| self.rings.1.pop()) else {
                return !self.rings.1.is_over();
            };
            let content = match item.content {
                ItemContent::Boundary => PartContent::Boundary,
                ItemContent::Block { .. } | ItemContent::Lost { .. } => {
                    let Ok(buffer) = self.buffers.try_recv() else {
                        self.waiting = Some(item);
                        return true;
                    };
                    self.content(item.content, buffer)
                }
            };
            let SampleItem { stretch, first, duplicates, jumps, .. } = item;
            let part = SamplePart { group: self.index, stretch, first, duplicates, jumps, content };
            // There is a place for every buffer. Without one for a boundary, the writer waits in vain for a time.
            if parts
                .try_send(WriterInput::Samples(part))
                .is_err_and(|error| error.is_disconnected())
            {
                return false;
            }
        }
    }

    fn content(&mut self, content: ItemContent, mut buffer: Vec<u8>) -> PartContent {
        buffer.clear();
        match content {
            ItemContent::Block { n, key, time } => {
                let key = key || self.is_out_of_step;
                if self.encode(n as usize, key, &mut buffer) {
                    let mut errors = PoseErrors::default();
                    let measured = self.quantisers.iter_mut().map(PoseQuantiser::take_errors);
                    measured.for_each(|of_body| errors.add(&of_body));
                    PartContent::Block { n, key, time, errors, block: buffer }
                } else {
                    // A bug in this program: a cause without a name.
                    let causes = Default::default();
                    PartContent::Lost { n: n.into(), causes, buffer }
                }
            }
            ItemContent::Lost { n, causes } => PartContent::Lost { n, causes, buffer },
            ItemContent::Boundary => PartContent::Boundary,
        }
    }

    fn encode(&mut self, n_rows: usize, key: bool, out: &mut Vec<u8>) -> bool {
        let n_channels = self.plan.n_channels;
        let values = n_rows * n_channels;
        let n = self.rings.0.pop_slice(&mut self.rows[..values]);
        debug_assert_eq!(n, values, "an ended block is in the ring");
        for row in self.rows[..values].chunks_exact_mut(n_channels) {
            let (poses, _) = row.as_chunks_mut::<POSE_CHANNELS>();
            let quantisers = self.quantisers.iter_mut();
            quantisers.zip(poses).for_each(|(quantiser, pose)| quantiser.round(pose));
        }
        let rows = self.rows[..values].chunks_exact(n_channels);
        for (row, samples) in rows.enumerate() {
            for (channel, &sample) in samples.iter().enumerate() {
                self.columns[channel * n_rows + row] = sample;
            }
        }
        let mut channels: [&[f32]; GROUP_CHANNELS] = [&[]; GROUP_CHANNELS];
        for (slot, column) in channels.iter_mut().zip(self.columns[..values].chunks_exact(n_rows)) {
            *slot = column;
        }
        let encoded = self.encoder.encode(&channels[..n_channels], key, out);
        self.is_out_of_step = encoded.is_err();
        !self.is_out_of_step
    }
}

/// Runs until the intake is gone and everything is encoded.
pub(super) fn run(
    mut groups: Vec<SampledGroupCoder>,
    woken: &Receiver<()>,
    parts: &Sender<WriterInput>,
) {
    loop {
        groups.retain_mut(|group| group.run(parts));
        if groups.is_empty() {
            return;
        }
        if woken.recv_timeout(IDLE) == Err(RecvTimeoutError::Disconnected) {
            // The writer and the intake are gone: what waits for a buffer is not written.
            groups.retain_mut(|group| group.run(parts) && group.waiting.is_none());
            return;
        }
    }
}
