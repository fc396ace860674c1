//! A part of a take in pieces that begin at keys, for threads to decode.

use std::{sync::Mutex, thread};

use mocapd_codec::GROUP_CHANNELS;
use mocapd_take::{TakeMap, TakeTraversal, traversal::Decode};

use crate::{
    errors::Failure,
    source::{Reader, Source},
};

/// Pieces a thread, where there are as many keys: enough that none waits long for another at the end.
pub(crate) const PIECES_A_THREAD: usize = 8;

/// Most sentences that are kept of what could not be decoded; every piece of a ruined take has its own.
const PROBLEMS_MAX: usize = 1000;

/// The groups in which `columns` are.
pub(crate) fn groups(columns: &[usize]) -> Vec<usize> {
    let mut groups: Vec<usize> = columns.iter().map(|column| column / GROUP_CHANNELS).collect();
    groups.sort_unstable();
    groups.dedup();
    groups
}

/// Some columns of a take, and the threads that decode them.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wanted<'a> {
    pub(crate) source: &'a Source,
    pub(crate) map: &'a TakeMap,
    pub(crate) columns: &'a [usize],
    pub(crate) threads: usize,
}

impl Wanted<'_> {
    /// Runs `work` over pieces on the threads, each with a traversal of its own. Gives what came of every piece, in
    /// order, and what could not be decoded, a sentence once.
    pub(crate) fn decode<P: Send, T: Send>(
        &self,
        pieces: Vec<P>,
        work: impl Fn(&mut TakeTraversal<Reader>, P) -> Result<T, Failure> + Sync,
    ) -> Result<(Vec<T>, Vec<String>), Failure> {
        let n = pieces.len();
        let line = Mutex::new(pieces.into_iter().enumerate());
        let next = || line.lock().ok().and_then(|mut line| line.next());
        let worker = || {
            let decode = Decode::Groups(groups(self.columns));
            let mut take = TakeTraversal::of_map(self.source.reader(), self.map, decode)?;
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
