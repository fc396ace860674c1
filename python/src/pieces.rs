//! A part of a take in pieces that begin at keys, for threads to decode.

use std::{ops::Range, sync::Mutex, thread};

use mocapd_codec::{DecodedRows, GROUP_CHANNELS};
use mocapd_take::{TakeMap, TakeStretches, stretch::Span};

use crate::{
    errors::Failure,
    source::{Reader, Source},
};

/// Pieces a thread, where there are as many keys: enough that none waits long for another at the end.
const PIECES_A_THREAD: usize = 8;

/// Most sentences that are kept of what could not be decoded; every piece of a ruined take has its own.
const PROBLEMS_MAX: usize = 1000;

/// The rows `rows` in order, cut at keys.
pub(crate) fn cut(map: &TakeMap, rows: &Range<u64>, threads: usize) -> Vec<Range<u64>> {
    let inside = map.keys.iter().map(|key| key.first_row);
    let keys: Vec<u64> = inside.filter(|row| rows.start < *row && *row < rows.end).collect();
    let n = (threads.max(1) * PIECES_A_THREAD).min(keys.len() + 1);
    let starts = (1..n).map(|i| keys[i * keys.len() / n]);
    let mut pieces = Vec::new();
    let mut at = rows.start;
    for row in starts.chain([rows.end]) {
        if row > at {
            pieces.push(at..row);
            at = row;
        }
    }
    pieces
}

/// The groups in which `columns` are.
pub(crate) fn groups(columns: impl IntoIterator<Item = usize>) -> Vec<usize> {
    let mut groups: Vec<usize> =
        columns.into_iter().map(|column| column / GROUP_CHANNELS).collect();
    groups.sort_unstable();
    groups.dedup();
    groups
}

/// Decodes pieces in order, each from the key before it.
pub(crate) struct Walk {
    stretches: TakeStretches<Reader>,
    /// Decoded, and reaching into what comes next.
    current: Option<Span>,
    told: usize,
    source: Source,
}

impl Walk {
    pub(crate) fn new(source: &Source, map: &TakeMap, groups: Vec<usize>) -> Result<Self, Failure> {
        let stretches = TakeStretches::new(source.reader(), map)?.with_groups(groups)?;
        Ok(Self { stretches, current: None, told: 0, source: source.clone() })
    }

    /// Gives every stretch that has some of the rows to `each`: those of them that it has, and where the first
    /// of these lies in its own rows.
    pub(crate) fn piece(
        &mut self,
        rows: &Range<u64>,
        mut each: impl FnMut(&TakeStretches<Reader>, Range<u64>, usize),
    ) -> Result<Vec<String>, Failure> {
        self.stretches.seek(rows.start)?;
        loop {
            if let Some(span) = self.current {
                let held = span.first_row.max(rows.start)..span.end_row().min(rows.end);
                if held.start < held.end {
                    each(&self.stretches, held.clone(), (held.start - span.first_row) as usize);
                }
                if span.end_row() >= rows.end {
                    break;
                }
            }
            self.source.check()?;
            match self.stretches.next_stretch()? {
                Some(span) => self.current = Some(span),
                None => {
                    self.current = None;
                    break;
                }
            }
        }
        let told = self.stretches.problems().get(self.told..).unwrap_or_default().to_vec();
        self.told += told.len();
        Ok(told)
    }

    /// What the last stretch has of `column`.
    pub(crate) fn column(stretches: &TakeStretches<Reader>, column: usize) -> Option<&DecodedRows> {
        stretches.rows().nth(column).flatten()
    }
}

/// Runs `work` over pieces on some threads, each with a [`Walk`] of its own. Gives what came of every piece, in
/// order, and what could not be decoded, a sentence once.
pub(crate) fn on_threads<P: Send, T: Send>(
    pieces: Vec<P>,
    threads: usize,
    walk: impl Fn() -> Result<Walk, Failure> + Sync,
    work: impl Fn(&mut Walk, P) -> Result<(T, Vec<String>), Failure> + Sync,
) -> Result<(Vec<T>, Vec<String>), Failure> {
    let n = pieces.len();
    let line = Mutex::new(pieces.into_iter().enumerate());
    let next = || line.lock().ok().and_then(|mut line| line.next());
    let worker = || {
        let mut walk = walk()?;
        let mut done = Vec::new();
        while let Some((number, piece)) = next() {
            done.push((number, work(&mut walk, piece)?));
        }
        Ok::<_, Failure>(done)
    };
    let mut all = if threads <= 1 || n <= 1 {
        worker()?
    } else {
        thread::scope(|scope| {
            let threads: Vec<_> = (0..threads.min(n))
                .map(|_| thread::Builder::new().spawn_scoped(scope, worker))
                .collect::<Result<_, _>>()?;
            let mut all = Vec::new();
            for thread in threads {
                all.extend(thread.join().map_err(|_| Failure::Internal)??);
            }
            Ok::<_, Failure>(all)
        })?
    };
    all.sort_by_key(|(number, _)| *number);
    let (mut results, mut problems) = (Vec::new(), Vec::<String>::new());
    for (_, (result, told)) in all {
        results.push(result);
        for problem in told {
            if problems.len() < PROBLEMS_MAX && !problems.contains(&problem) {
                problems.push(problem);
            }
        }
    }
    Ok((results, problems))
}
