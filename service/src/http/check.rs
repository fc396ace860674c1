//! A take read to its end: whether it is what it says.

use std::{
    io::{self, BufReader, Read, Seek, SeekFrom},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use axum::{
    Json,
    extract::{Path, State, rejection::PathRejection},
    http::StatusCode,
};
use mocapd_acquire::{
    files::SparseFile, health::TakeHealth, inspect::Summary, ledger::LedgerDocument,
};
use mocapd_take::TakeError;
use serde::{Deserialize, Serialize};
use tokio::sync::watch;
use utoipa::ToSchema;

use super::{
    body::Asked,
    download::take_name,
    problem::{Problem, ProblemKind},
    state::Shared,
    takes::{self, unreadable},
};
use crate::control::Request;

/// Problems and contradictions that are told each: a badly damaged take has one a stretch.
const TOLD_MAX: usize = 100;

/// What was found in a take.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct TakeCheck {
    /// Without `.take`.
    pub name: String,
    /// How it is, as the list has it, and `damaged` where what lies between its ends is.
    pub health: TakeHealth,
    /// Why it ended, as `stop` tells it; empty where the take does not say.
    #[serde(default)]
    pub ending: String,
    /// Bytes of the file.
    pub bytes: u64,
    /// Frames: rows, lost ones included.
    pub frames: u64,
    /// Seconds that they make.
    pub seconds: f64,
    /// Frames a second.
    pub rate_hz: f64,
    /// Markers.
    pub markers: usize,
    /// Samples present.
    pub samples: u64,
    /// What no sample may be off by more than, in millimetres; 0 where every bit is kept.
    pub tolerance_mm: f64,
    /// Largest error that the take states, in millimetres.
    pub max_error_mm: f64,
    /// What is missing or damaged: the first hundred.
    pub problems: Vec<String>,
    /// What the take says of itself and is not so: the first hundred.
    pub contradictions: Vec<String>,
    /// Its last ledger.
    pub ledger: Option<LedgerDocument>,
}

/// Read a take to its end and check it
///
/// Checksums, every block, the ledger. One take at a time; a client that goes away ends it.
#[utoipa::path(post, path = "/v1/takes/{name}/verify", tag = "takes", request_body = Request,
    params(("name" = String, Path, description = "The take's name, without `.take`")),
    responses((status = 200, body = TakeCheck)))]
pub(super) async fn verify(
    State(app): State<Shared>,
    name: Result<Path<String>, PathRejection>,
    Asked(_): Asked<Request>,
) -> Result<Json<TakeCheck>, Problem> {
    let name = take_name(name)?;
    let gone = Gone(Arc::new(AtomicBool::new(false)));
    let (control, asked) = (Arc::clone(&app.control), name);
    let (flag, stopping) = (Arc::clone(&gone.0), app.stopping.clone());
    let work = move || {
        let take = takes::open(control.as_ref(), &asked)?;
        if take.is_growing {
            let words = format!("{asked} is being recorded: stop it first");
            return Err(Problem::new(StatusCode::CONFLICT, ProblemKind::Conflict, words));
        }
        let input = While { input: SparseFile::of(take.file), gone: flag, stopping };
        check(asked, take.len, Summary::read(BufReader::new(input)))
    };
    let checked = app.lanes.checks.run(work).await?;
    drop(gone);
    Ok(Json(checked?))
}

/// Says that the client is gone when it is dropped, which is when the request is.
struct Gone(Arc<AtomicBool>);

impl Drop for Gone {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Reads while somebody wants to know.
struct While<R> {
    input: R,
    gone: Arc<AtomicBool>,
    stopping: watch::Receiver<bool>,
}

impl<R: Read> Read for While<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.gone.load(Ordering::Relaxed) || *self.stopping.borrow() {
            return Err(io::Error::other("nobody waits for the check any more"));
        }
        self.input.read(buffer)
    }
}

impl<R: Seek> Seek for While<R> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.input.seek(to)
    }
}

fn check(name: String, bytes: u64, read: Result<Summary, TakeError>) -> Result<TakeCheck, Problem> {
    let summary = match read {
        Ok(summary) => summary,
        Err(TakeError::Io(error)) => return Err(unreadable(&error)),
        Err(error) => {
            let problems = vec![error.to_string()];
            return Ok(TakeCheck { problems, ..empty(name, bytes, TakeHealth::Unreadable) });
        }
    };
    let mut contradictions = summary.contradictions().to_vec();
    let ledger = summary.take.ledger.as_ref();
    if let Some(apart) = summary.clock_apart().filter(|apart| !apart.agrees) {
        contradictions.push(format!(
            "the clocks' line lies {:.1} us off the one that its observations give",
            apart.offset_us
        ));
    }
    // Before the end it need not close.
    if summary.take.finished && ledger.is_some_and(|ledger| !ledger.closes()) {
        contradictions.push("the ledger does not close".to_owned());
    }
    contradictions.truncate(TOLD_MAX);
    let header = &summary.take.header;
    let ending = summary.take.ending.as_ref().map_or("", |ending| ending.kind.word());
    Ok(TakeCheck {
        ending: ending.to_owned(),
        frames: summary.take.n_rows,
        seconds: summary.take.n_rows as f64 / header.rate_hz,
        rate_hz: header.rate_hz,
        markers: summary.take.channels.len(),
        samples: summary.samples(),
        tolerance_mm: header.tolerance_mm,
        max_error_mm: summary.max_error_mm(),
        problems: summary.take.problems.iter().take(TOLD_MAX).map(ToString::to_string).collect(),
        contradictions,
        ledger: ledger.map(LedgerDocument::from),
        ..empty(name, bytes, summary.health())
    })
}

fn empty(name: String, bytes: u64, health: TakeHealth) -> TakeCheck {
    TakeCheck {
        name,
        health,
        ending: String::new(),
        bytes,
        frames: 0,
        seconds: 0.0,
        rate_hz: 0.0,
        markers: 0,
        samples: 0,
        tolerance_mm: 0.0,
        max_error_mm: 0.0,
        problems: Vec::new(),
        contradictions: Vec::new(),
        ledger: None,
    }
}
