//! Finished takes for a player: an overview, windows of frames, and where samples are missing.

use std::{
    collections::VecDeque,
    fs::File,
    io::BufReader,
    sync::{Arc, Mutex, PoisonError, Weak},
};

use axum::{
    Json,
    extract::{
        Path, Query, State,
        rejection::{PathRejection, QueryRejection},
    },
    http::{HeaderValue, header},
    response::{IntoResponse, Response},
};
use mocapd_acquire::files::SparseFile;
use mocapd_take::{TakeError, TakeMap};
use serde::Deserialize;
use tokio::sync::watch;

use super::{
    Shared,
    problem::{Problem, ProblemKind},
    takes::{CancellableReader, OpenedTake, open, take_name, unreadable},
};
use crate::{
    control::Control,
    playback::{
        EVERY_MAX, FrameWindow, GapBins, SECONDS_MAX, TakeOverview, WINDOW_BYTES_MAX, WindowError,
        WindowRequest, map_of_end, read_gaps,
    },
};

/// Latest beginning of a window in seconds: years.
const FROM_S_MAX: f64 = 1e9;

/// Length of a window in seconds if none is requested.
const SECONDS: f64 = 4.0;

/// A take that a request reads; reading fails when the client has disconnected or the server stops.
type Input = BufReader<CancellableReader<SparseFile>>;

/// Describe a finished take for playback
///
/// Markers, events, marks, and what the take states about its gaps, without its frames.
#[utoipa::path(get, path = "/v1/takes/{name}/overview", tag = "takes",
    params(("name" = String, Path, description = "The take's name, without `.take`")),
    responses((status = 200, body = TakeOverview)))]
pub(super) async fn overview(
    State(app): State<Shared>,
    name: Result<Path<String>, PathRejection>,
) -> Result<Response, Problem> {
    read_take(app, name, Whole::Yes, |name, _, map| {
        let overview = TakeOverview::of(name, map);
        // Not written piece by piece: a take of many markers with long labels may not fit.
        let body = serde_json::to_vec(&overview)
            .map_err(|error| Problem::internal(format!("cannot write the overview: {error}")))?;
        if body.len() as u64 > WINDOW_BYTES_MAX {
            let message = format!(
                "the labels of the {} markers of {name} are more than a page can show: use `mocapd info`",
                overview.markers
            );
            return Err(Problem::of(ProblemKind::TooLarge, message));
        }
        Ok(([(header::CONTENT_TYPE, "application/json")], body).into_response())
    })
    .await
}

#[derive(Debug, Deserialize)]
pub(super) struct WindowQuery {
    from: Option<f64>,
    seconds: Option<f64>,
    every: Option<u32>,
}

/// The frames of a part of a finished take
///
/// Little endian: the bytes `MPW1`, u32 number of markers, u64 first frame, u32 number of frames that follow, u32 distance
/// from one to the next, u32 flags (bit 0: ends before the requested end; bit 1: something here is damaged, and its frames
/// are gaps), u32 zero; then for each frame three f32 per marker in millimetres, NaN where the sample is missing. A
/// response has at most a megabyte: a longer window ends earlier.
#[utoipa::path(get, path = "/v1/takes/{name}/window", tag = "takes",
    params(("name" = String, Path, description = "The take's name, without `.take`"),
        ("from" = Option<f64>, Query, minimum = 0, maximum = 1e9,
            description = "The first frame is the one at or after this time in seconds; 0 by default"),
        ("seconds" = Option<f64>, Query, exclusive_minimum = 0, maximum = 3600,
            description = "The length in seconds; 4 by default"),
        ("every" = Option<u32>, Query, minimum = 1, maximum = 10000,
            description = "Only every n-th frame; 1 by default")),
    responses((status = 200, description = "The frames", body = Vec<u8>,
            content_type = "application/octet-stream"),
        (status = 416, description = "The take ends before the window begins", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn window(
    State(app): State<Shared>,
    name: Result<Path<String>, PathRejection>,
    query: Result<Query<WindowQuery>, QueryRejection>,
) -> Result<Response, Problem> {
    let request = window_request(query)?;
    read_take(app, name, Whole::No, move |name, input, map| {
        let window = FrameWindow::read(input, map, &request).map_err(|error| match error {
            WindowError::BehindEnd { .. } => Problem::of(ProblemKind::Range, error.to_string()),
            WindowError::TooManyMarkers { .. } => {
                Problem::of(ProblemKind::TooLarge, error.to_string())
            }
            WindowError::Take(error) => problem(name, error),
        })?;
        let kind = HeaderValue::from_static("application/octet-stream");
        Ok(([(header::CONTENT_TYPE, kind)], window.to_bytes()).into_response())
    })
    .await
}

#[derive(Debug, Deserialize)]
pub(super) struct GapsQuery {
    from: Option<f64>,
}

/// Where samples of a finished take are missing
///
/// Counts in at most 1024 bins of the whole take. A response covers as much of it as a tenth of a second of work decodes; request the
/// rest from the end of that part on.
#[utoipa::path(get, path = "/v1/takes/{name}/gaps", tag = "takes",
    params(("name" = String, Path, description = "The take's name, without `.take`"),
        ("from" = Option<f64>, Query, minimum = 0, maximum = 1e9,
            description = "Counts from this time in seconds on; 0 by default")),
    responses((status = 200, body = GapBins)))]
pub(super) async fn gaps(
    State(app): State<Shared>,
    name: Result<Path<String>, PathRejection>,
    query: Result<Query<GapsQuery>, QueryRejection>,
) -> Result<Json<GapBins>, Problem> {
    let refused = || Problem::invalid(FROM_REFUSED);
    let Query(query) = query.map_err(|_| refused())?;
    let from_s = seconds_from(query.from)?;
    read_take(app, name, Whole::No, move |name, input, map| {
        Ok(Json(read_gaps(input, map, from_s).map_err(|error| problem(name, error))?))
    })
    .await
}

const FROM_REFUSED: &str = "`from` must be a time in seconds, from 0 to 1e9";

fn seconds_from(from: Option<f64>) -> Result<f64, Problem> {
    let from = from.unwrap_or_default();
    if (0.0..=FROM_S_MAX).contains(&from) {
        return Ok(from);
    }
    Err(Problem::invalid(FROM_REFUSED))
}

fn window_request(
    query: Result<Query<WindowQuery>, QueryRejection>,
) -> Result<WindowRequest, Problem> {
    let Query(WindowQuery { from, seconds, every }) = query.map_err(|_| {
        Problem::invalid(
            "`from` and `seconds` must be times in seconds, and `every` a whole number, each at most once",
        )
    })?;
    let from_s = seconds_from(from)?;
    let seconds = seconds.unwrap_or(SECONDS);
    if !(seconds > 0.0 && seconds <= SECONDS_MAX) {
        let message = format!("`seconds` must be more than 0 and at most {SECONDS_MAX}");
        return Err(Problem::invalid(message));
    }
    let every = every.unwrap_or(1);
    if !(1..=EVERY_MAX).contains(&every) {
        return Err(Problem::invalid(format!("`every` must be from 1 to {EVERY_MAX}")));
    }
    Ok(WindowRequest { from_s, length_s: seconds, every })
}

/// Opens a take that is not being written, and reads it on a thread that may wait, in its turn.
async fn read_take<T: Send + 'static>(
    app: Shared,
    name: Result<Path<String>, PathRejection>,
    whole: Whole,
    read: impl FnOnce(&str, &mut Input, &TakeMap) -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    let name = take_name(name)?;
    // Dropped with the request, which ends when the client disconnects.
    let client = Arc::new(());
    let (control, maps) = (Arc::clone(&app.control), Arc::clone(&app.maps));
    let (client_alive, stopping) = (Arc::downgrade(&client), app.stopping.clone());
    let work = move || {
        let take = finished(control.as_ref(), &name)?;
        let mut input = input(take.file, client_alive, stopping);
        let map = maps.map(&mut input, take.tag, whole).map_err(|error| problem(&name, error))?;
        read(&name, &mut input, &map)
    };
    let done = app.queues.decodes.run(work).await?;
    drop(client);
    done
}

/// Whether a request needs all of a map, or only what the end of a take states.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Whole {
    Yes,
    No,
}

/// The maps of the takes that were played last. Without them every window of a take that was cut off would read the whole
/// file.
#[derive(Debug, Default)]
pub(super) struct KnownMaps(Mutex<VecDeque<(String, Arc<TakeMap>)>>);

/// Maximum number of maps that are kept: a few players.
const MAPS_MAX: usize = 4;

/// Maximum number of key stretches and channels of a map that is kept: together some megabytes. A take of days at one key
/// stretch per second has as many.
const MAP_ENTRIES_MAX: usize = 1 << 18;

impl KnownMaps {
    /// The map of a take with this entity tag, which changes with the file.
    fn map(
        &self,
        input: &mut Input,
        tag: Option<String>,
        whole: Whole,
    ) -> Result<Arc<TakeMap>, TakeError> {
        let lock = || self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, known)) = lock().iter().find(|(known, _)| Some(known) == tag.as_ref()) {
            return Ok(Arc::clone(known));
        }
        if whole == Whole::No
            && let Some(map) = map_of_end(input)?
        {
            return Ok(Arc::new(map));
        }
        let map = Arc::new(TakeMap::open(input)?);
        if let Some(tag) = tag.filter(|_| map.keys.len() + map.channels.len() <= MAP_ENTRIES_MAX) {
            let mut known = lock();
            known.retain(|(other, _)| *other != tag);
            known.truncate(MAPS_MAX - 1);
            known.push_front((tag, Arc::clone(&map)));
        }
        Ok(map)
    }
}

/// Opens a take that is not being written.
fn finished(control: &dyn Control, name: &str) -> Result<OpenedTake, Problem> {
    let take = open(control, name)?;
    if take.is_growing {
        let message = format!("{name} is being recorded: stop it first");
        return Err(Problem::of(ProblemKind::Conflict, message));
    }
    Ok(take)
}

fn input(file: File, client_alive: Weak<()>, stopping: watch::Receiver<bool>) -> Input {
    BufReader::new(CancellableReader { input: SparseFile::of(file), client_alive, stopping })
}

fn problem(name: &str, error: TakeError) -> Problem {
    match error {
        TakeError::Io(error) => unreadable(&error),
        error => {
            let message = format!("{name} cannot be played: {error}; see `mocapd verify`");
            Problem::of(ProblemKind::Conflict, message)
        }
    }
}
