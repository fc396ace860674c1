//! Receives the results of a series' takes, in order, and finds where their files are now, so that the writer need not.

use std::path::PathBuf;

use crossbeam_channel::Receiver;

use crate::{
    files::{FileId, SettledFile},
    pipeline::{NothingRecorded, TakeAccount, TakeResult},
    record::explain_early_end,
};

/// A take whose file was created.
#[derive(Debug)]
pub(super) struct StartedTake {
    pub(super) path: PathBuf,
    pub(super) id: FileId,
    pub(super) part: u64,
    pub(super) first_row: u64,
    pub(super) result: Receiver<TakeResult>,
}

/// A take of a series that was written to its end.
#[derive(Debug)]
pub struct SeriesTake {
    /// The name under which it was created.
    pub path: PathBuf,
    /// Its number in the series, from 1.
    pub part: u64,
    /// The row of the recording that is its row 0.
    pub first_row: u64,
    /// What is on disk.
    pub written: TakeAccount,
    /// Where its file is now.
    pub file: SettledFile,
}

/// The takes of a series, after all have ended.
#[derive(Debug, Default)]
pub(super) struct CollectedTakes {
    /// Those that were written to their end.
    pub(super) takes: Vec<SeriesTake>,
    /// Why one was not.
    pub(super) failure: Option<anyhow::Error>,
    /// The last one, if its writer ended without a result.
    unanswered: Option<(PathBuf, FileId)>,
    /// A file without a frame that cannot be removed.
    problem: Option<String>,
}

/// Collects until the series has ended.
pub(super) fn collect(started: &Receiver<StartedTake>) -> CollectedTakes {
    let mut collected = CollectedTakes::default();
    for take in started {
        collected.add(take);
    }
    collected
}

impl CollectedTakes {
    fn add(&mut self, take: StartedTake) {
        let StartedTake { path, id, part, first_row, result } = take;
        match result.recv() {
            Ok(Ok((written, mut output))) if written.ledger.recorded > 0 => {
                let file = output.settle();
                self.takes.push(SeriesTake { path, part, first_row, written, file });
            }
            // A take without a frame is useless.
            Ok(Ok(_)) => self.remove((path, id)),
            Ok(Err(failed)) if failed.error.is::<NothingRecorded>() => {
                self.remove((path, id));
                self.failure.get_or_insert(failed.error);
            }
            Ok(Err(mut failed)) => {
                let output = failed.output.as_deref_mut();
                self.failure = Some(explain_early_end(&path, failed.error, output));
            }
            Err(_) => self.unanswered = Some((path, id)),
        }
    }

    fn remove(&mut self, (path, id): (PathBuf, FileId)) {
        if let Err(error) = id.remove(&path) {
            let path = path.display();
            self.problem = Some(format!("cannot remove the empty file {path} ({error})"));
        }
    }

    /// The error of a recording that did not start: the file of its first take is removed.
    pub(super) fn discard(mut self, error: anyhow::Error) -> anyhow::Error {
        if let Some(file) = self.unanswered.take() {
            self.remove(file);
        }
        let error = self.failure.take().unwrap_or(error);
        self.explain(error)
    }

    /// Adds to an error how many takes are complete, and what is left besides.
    pub(super) fn explain(self, error: anyhow::Error) -> anyhow::Error {
        let error = match self.problem {
            Some(problem) => error.context(problem),
            None => error,
        };
        match self.takes.len() {
            0 => error,
            1 => error.context("the recording ends early, after one complete take"),
            n => error.context(format!("the recording ends early, after {n} complete takes")),
        }
    }
}
