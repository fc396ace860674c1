//! The thread that reads, and what it gives the others to do.

use std::fs::File;

use crossbeam_channel::{Receiver, Sender, bounded};
use mocapd_take::{TakeEvent, TakeReader, reader::pull};

use super::lines::{Coded, Decoded, OwnStretch};

/// Coded stretches that wait for a thread: all that one key stretch of a recorded take begins, twenty of half a second,
/// and some more, so that the other threads get theirs while this one is busy.
const CODED_MAX: usize = 32;

/// Samples in them, where stretches are longer: 6 MB if nothing could be compressed.
const CODED_SAMPLES_MAX: u64 = 1 << 19;

/// Pieces of a job that wait for the reader of frames: what follows a key stretch, 20 pieces of half a second or 10 of a
/// long stretch, twice, so that no thread waits while another's are read. They are 8 MB at most.
const PIECES_MAX: usize = 40;

/// Coded stretches of so many samples that wait for a thread: one, at least, while it is busy with another.
pub(super) fn coded_max(samples: u64) -> usize {
    (CODED_SAMPLES_MAX / samples.max(1)).clamp(2, CODED_MAX as u64) as usize
}

/// What lies from one key stretch to the next: for one thread, whichever is the next that has nothing to do. The share of
/// a processor that a thread gets is not known beforehand.
pub(super) struct Job {
    pub(super) coded: Receiver<Coded>,
    pub(super) decoded: Sender<Decoded>,
}

/// Where the reading thread puts its jobs.
pub(super) struct Jobs {
    /// To all decoding threads.
    pub(super) to_do: Sender<Job>,
    /// What comes of them, in order.
    pub(super) in_order: Sender<Receiver<Decoded>>,
    /// Coded stretches that may wait for the thread that does a job.
    pub(super) n_coded: usize,
}

impl Jobs {
    /// `None` when nobody wants any more.
    fn begin(&self) -> Option<Sender<Coded>> {
        let (to_job, coded) = bounded(self.n_coded);
        let (decoded, from_job) = bounded(PIECES_MAX);
        self.in_order.send(from_job).ok()?;
        self.to_do.send(Job { coded, decoded }).ok()?;
        Some(to_job)
    }
}

/// Reads a take to its end, and makes a job of what lies from each key stretch to the next. Ends early when nobody wants
/// it any more.
pub(super) fn read(mut file: File, mut reader: TakeReader, jobs: &Jobs) {
    let Some(mut job) = jobs.begin() else { return };
    let mut begun = false;
    loop {
        let message = match reader.next_event() {
            Ok(Some(TakeEvent::Stretch(stretch))) if stretch.missing_before => Coded::Flaw,
            Ok(Some(TakeEvent::Stretch(stretch))) if stretch.span.n_rows > 0 => {
                if stretch.span.key && begun {
                    let (Ok(()), Some(next)) = (job.send(Coded::Next), jobs.begin()) else {
                        return;
                    };
                    job = next;
                }
                begun = true;
                Coded::Stretch(OwnStretch {
                    span: stretch.span,
                    shared: stretch.shared.to_vec(),
                    blocks: stretch.blocks.iter().map(|block| block.to_vec()).collect(),
                })
            }
            // A file that is shorter than when it was opened has no footer any more.
            Ok(Some(TakeEvent::End { finished, .. })) if finished => Coded::End,
            Ok(Some(
                TakeEvent::End { .. } | TakeEvent::Damaged { .. } | TakeEvent::Unplaced { .. },
            )) => Coded::Flaw,
            Ok(Some(_)) => continue,
            Ok(None) => match pull(&mut file, &mut reader) {
                Ok(()) => continue,
                Err(error) => Coded::Failed(error),
            },
            Err(error) => Coded::Failed(error),
        };
        let last = !matches!(message, Coded::Stretch(_));
        if job.send(message).is_err() || last {
            return;
        }
    }
}
