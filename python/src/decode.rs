//! Parallel decoding: a part of a take is divided at key stretches into pieces, which threads decode.

use std::{sync::Mutex, thread};

use mocapd_codec::GROUP_CHANNELS;
use mocapd_take::{TakeMap, TakeTraversal, traversal::Decode};

use crate::{
    errors::Failure,
    source::{Reader, Source},
};

/// Pieces for each thread, if there are enough key stretches: enough for all threads to finish at about the same time.
pub(crate) const PIECES_PER_THREAD: usize = 8;

/// Maximum number of problems to report: every piece of a badly damaged take has its own.
const PROBLEMS_MAX: usize = 1000;

/// The groups that contain `columns`, in ascending order.
pub(crate) fn groups(columns: &[usize]) -> Vec<usize> {
    let mut groups: Vec<usize> = columns.iter().map(|column| column / GROUP_CHANNELS).collect();
    groups.sort_unstable();
    groups.dedup();
    groups
}

/// The columns of a take to decode, and the number of threads.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DecodeRequest<'a> {
    pub(crate) source: &'a Source,
    pub(crate) map: &'a TakeMap,
    pub(crate) columns: &'a [usize],
    pub(crate) threads: usize,
}

impl DecodeRequest<'_> {
    /// Runs `work` for each piece on the threads, each of which has a traversal. Returns the results in order of
    /// pieces, and the distinct problems as text.
    pub(crate) fn decode<P: Send, T: Send>(
        &self,
        pieces: Vec<P>,
        work: impl Fn(&mut TakeTraversal<Reader>, P) -> Result<T, Failure> + Sync,
    ) -> Result<(Vec<T>, Vec<String>), Failure> {
        let n = pieces.len();
        let queue = Mutex::new(pieces.into_iter().enumerate());
        let next = || queue.lock().ok().and_then(|mut queue| queue.next());
        let worker = || {
            let decode = Decode::Groups(groups(self.columns));
            let mut take = TakeTraversal::from_map(self.source.reader(), self.map, decode)?;
            let mut done = Vec::new();
            while let Some((number, piece)) = next() {
                let result = work(&mut take, piece)?;
                done.push((number, result, take.take_problems()));
            }
            Ok::<_, Failure>(done)
        };
        let mut all = if self.threads <= 1 || n <= 1 {
            worker()?
        } else {
            thread::scope(|scope| {
                let threads: Vec<_> = (0..self.threads.min(n))
                    .map(|_| thread::Builder::new().spawn_scoped(scope, worker))
                    .collect::<Result<_, _>>()?;
                let mut all = Vec::new();
                for thread in threads {
                    all.extend(thread.join().map_err(|_| Failure::Internal)??);
                }
                Ok::<_, Failure>(all)
            })?
        };
        all.sort_by_key(|(number, ..)| *number);
        let (mut results, mut problems) = (Vec::new(), Vec::<String>::new());
        for (_, result, found) in all {
            results.push(result);
            for problem in found.iter().map(ToString::to_string) {
                if problems.len() < PROBLEMS_MAX && !problems.contains(&problem) {
                    problems.push(problem);
                }
            }
        }
        Ok((results, problems))
    }
}
