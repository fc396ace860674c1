//! Finished takes for a player: an overview, windows of frames, and where samples are missing.

#![expect(unused_qualifications, reason = "the macro of utoipa qualifies the types of queries")]

use std::{
    collections::VecDeque,
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
use utoipa::IntoParams;

use super::{
    Shared,
    body::{Problem, ProblemKind},
    takes::{CancellableReader, finished, take_name, unreadable},
};
use crate::{
    control::Control,
    playback::{
        BodyList, CompareError, EVERY_MAX, FaceWindow, FrameWindow, GapBins, PlateList,
        SECONDS_MAX, TakeBodies, TakeDifference, TakeForces, TakeOverview, WINDOW_BYTES_MAX,
        WindowError, WindowRequest, map_of_end, map_of_ends, read_difference, read_gaps,
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
    params(("name" = String, Path, description = "The take's name, without `.take`"), OverviewQuery),
    responses((status = 200, body = TakeOverview)))]
pub(super) async fn overview(
    State(app): State<Shared>,
    name: Result<Path<String>, PathRejection>,
    query: Result<Query<OverviewQuery>, QueryRejection>,
) -> Result<Response, Problem> {
    let refused = |_| Problem::invalid("`ends_only` must be `true` or `false`, at most once");
    let Query(OverviewQuery { ends_only }) = query.map_err(refused)?;
    read_takes(app, name, move |reading| {
        let name = &reading.name;
        let (mut input, tag) = reading.file(name)?;
        let known = reading.maps.overview_map(&mut input, tag, ends_only.unwrap_or_default());
        let (map, is_complete) = known.map_err(|error| problem(name, error))?;
        let overview = TakeOverview { is_complete, ..TakeOverview::of(name, &map) };
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

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct OverviewQuery {
    /// Only what the two ends of a closed take state, unless all of it is known: this takes as long for an hour as for a
    /// second, and `is_complete` is false. By default the take is searched for events, marks and problems
    ends_only: Option<bool>,
}

#[derive(Debug, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct WindowQuery {
    /// The first frame is the one at or after this time in seconds; 0 by default
    #[param(minimum = 0, maximum = 1e9)]
    from: Option<f64>,
    /// The length in seconds; 4 by default
    #[param(exclusive_minimum = 0, maximum = 3600)]
    seconds: Option<f64>,
    /// Only every n-th frame; 1 by default
    #[param(minimum = 1, maximum = 10000)]
    every: Option<u32>,
}

/// The frames of a part of a finished take
///
/// Little endian: the bytes `MPW1`, u32 number of markers, u64 first frame, u32 number of frames that follow, u32 distance
/// from one to the next, u32 flags (bit 0: ends before the requested end; bit 1: something here is damaged, and its frames
/// are gaps), u32 zero; then for each frame three f32 per marker in millimetres, NaN where the sample is missing. A
/// response has at most a megabyte: a longer window ends earlier.
#[utoipa::path(get, path = "/v1/takes/{name}/window", tag = "takes",
    params(("name" = String, Path, description = "The take's name, without `.take`"), WindowQuery),
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
        let window = FrameWindow::read(input, map, &request);
        let window = window.map_err(|error| window_problem(name, error))?;
        Ok(binary(window.to_bytes()))
    })
    .await
}

fn window_problem(name: &str, error: WindowError) -> Problem {
    match error {
        WindowError::BehindEnd { .. } => Problem::of(ProblemKind::Range, error.to_string()),
        WindowError::TooManyMarkers { .. } | WindowError::TooMuchWork => {
            Problem::of(ProblemKind::TooLarge, error.to_string())
        }
        WindowError::Take(error) => problem(name, error),
    }
}

fn binary(bytes: Vec<u8>) -> Response {
    let kind = HeaderValue::from_static("application/octet-stream");
    ([(header::CONTENT_TYPE, kind)], bytes).into_response()
}

/// The force plates of a finished take
///
/// Those of an imported C3D file, or those that the device of a recording has announced.
#[utoipa::path(get, path = "/v1/takes/{name}/plates", tag = "takes",
    params(("name" = String, Path, description = "The take's name, without `.take`")),
    responses((status = 200, body = PlateList)))]
pub(super) async fn plates(
    State(app): State<Shared>,
    name: Result<Path<String>, PathRejection>,
) -> Result<Json<PlateList>, Problem> {
    read_forces(app, name, |_, _, forces| Ok(Json(forces.list()))).await
}

/// The forces of a part of a finished take
///
/// Little endian: the bytes `MPF1`, u32 number of plates, u64 first frame, u32 number of frames that follow, u32 distance
/// from one to the next, u32 flags (bit 0: ends before the requested end; bit 1: samples are missing), u32 zero; then for
/// each frame and plate nine f32: the force along x, y and z in newtons, the centre of pressure in millimetres, the free
/// moment in newton metres, and the least and the largest upward force up to the next frame in newtons. NaN where there is
/// none. A response has at most a megabyte: a longer window ends earlier.
#[utoipa::path(get, path = "/v1/takes/{name}/forces", tag = "takes",
    params(("name" = String, Path, description = "The take's name, without `.take`"), WindowQuery),
    responses((status = 200, description = "The forces", body = Vec<u8>,
            content_type = "application/octet-stream"),
        (status = 416, description = "The take ends before the window begins", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn forces(
    State(app): State<Shared>,
    name: Result<Path<String>, PathRejection>,
    query: Result<Query<WindowQuery>, QueryRejection>,
) -> Result<Response, Problem> {
    let request = window_request(query)?;
    read_forces(app, name, move |name, input, forces| {
        let window = forces.window(input, &request);
        Ok(binary(window.map_err(|error| window_problem(name, error))?.to_bytes()))
    })
    .await
}

/// The rigid bodies of a finished take
///
/// Those that the device of a recording has announced; none in an imported file.
#[utoipa::path(get, path = "/v1/takes/{name}/bodies", tag = "takes",
    params(("name" = String, Path, description = "The take's name, without `.take`")),
    responses((status = 200, body = BodyList)))]
pub(super) async fn bodies(
    State(app): State<Shared>,
    name: Result<Path<String>, PathRejection>,
) -> Result<Json<BodyList>, Problem> {
    read_bodies(app, name, |_, _, bodies| Ok(Json(bodies.list()))).await
}

/// The poses of the rigid bodies in a part of a finished take
///
/// Little endian: the bytes `MPB1`, u32 number of bodies, u64 first frame, u32 number of frames that follow, u32 distance from
/// one to the next, u32 flags (bit 0: ends before the requested end; bit 1: poses are missing), u32 zero; then for each frame
/// and body nine f32: the state, the residual in millimetres, the position in millimetres, and the rotation as a quaternion
/// w, x, y, z. The states are 0 tracked, 1 lost, 2 rejected, 3 any other of the device, 253 missing, 254 refused by the
/// recorder, and 255 not listed. NaN where there is nothing. A response has at most a megabyte: a longer window ends earlier.
#[utoipa::path(get, path = "/v1/takes/{name}/poses", tag = "takes",
    params(("name" = String, Path, description = "The take's name, without `.take`"), WindowQuery),
    responses((status = 200, description = "The poses", body = Vec<u8>,
            content_type = "application/octet-stream"),
        (status = 416, description = "The take ends before the window begins", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn poses(
    State(app): State<Shared>,
    name: Result<Path<String>, PathRejection>,
    query: Result<Query<WindowQuery>, QueryRejection>,
) -> Result<Response, Problem> {
    let request = window_request(query)?;
    read_bodies(app, name, move |name, input, bodies| {
        let window = bodies.window(input, &request);
        Ok(binary(window.map_err(|error| window_problem(name, error))?.to_bytes()))
    })
    .await
}

/// The poses of the subject's face in a part of a finished take
///
/// Little endian: the bytes `MPP1`, u32 1, u64 first frame, u32 number of frames that follow, u32 distance from one to the next,
/// u32 flags (as of `window`), u32 zero; then for each frame twelve f32 as in the live stream, NaN where the pose is not known.
/// No frames follow if the take has no face whose markers are mapped.
#[utoipa::path(get, path = "/v1/takes/{name}/face", tag = "takes",
    params(("name" = String, Path, description = "The take's name, without `.take`"), WindowQuery),
    responses((status = 200, description = "The poses", body = Vec<u8>,
            content_type = "application/octet-stream"),
        (status = 416, description = "The take ends before the window begins", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn face(
    State(app): State<Shared>,
    name: Result<Path<String>, PathRejection>,
    query: Result<Query<WindowQuery>, QueryRejection>,
) -> Result<Response, Problem> {
    let request = window_request(query)?;
    read_take(app, name, Whole::No, move |name, input, map| {
        let window = FaceWindow::read(input, map, &request);
        Ok(binary(window.map_err(|error| window_problem(name, error))?.to_bytes()))
    })
    .await
}

#[derive(Debug, Deserialize)]
pub(super) struct DifferenceQuery {
    against: Option<String>,
    from: Option<f64>,
}

/// How far apart the samples of two finished takes are
///
/// The largest distance in at most 1024 bins of the whole take. Markers are matched by their labels, and frames by their
/// numbers. A response covers as much of the take as a tenth of a second of work decodes; request the rest from the end of
/// that part on.
#[utoipa::path(get, path = "/v1/takes/{name}/difference", tag = "takes",
    params(("name" = String, Path, description = "The take's name, without `.take`"),
        ("against" = String, Query, description = "The other take's name, without `.take`"),
        ("from" = Option<f64>, Query, minimum = 0, maximum = 1e9,
            description = "Compares from this time in seconds on; 0 by default")),
    responses((status = 200, body = TakeDifference)))]
pub(super) async fn difference(
    State(app): State<Shared>,
    name: Result<Path<String>, PathRejection>,
    query: Result<Query<DifferenceQuery>, QueryRejection>,
) -> Result<Json<TakeDifference>, Problem> {
    let refused = |_| Problem::invalid(DIFFERENCE_REFUSED);
    let Query(DifferenceQuery { against, from }) = query.map_err(refused)?;
    let from_s = seconds_from(from)?;
    read_takes(app, name, move |reading| {
        let ours = reading.name.clone();
        let (mut input, map) = reading.open(&ours, Whole::No)?;
        let theirs = against.ok_or_else(|| Problem::invalid(DIFFERENCE_REFUSED))?;
        let (mut other, other_map) = reading.open(&theirs, Whole::No)?;
        let found = read_difference((&mut input, &map), (&mut other, &other_map), from_s);
        let found = found.map_err(|error| match error {
            CompareError::Take(error) => problem(&ours, error),
            error => {
                let message = format!("{ours} and {theirs} cannot be compared: {error}");
                Problem::of(ProblemKind::Conflict, message)
            }
        })?;
        Ok(Json(TakeDifference { against: theirs, ..found }))
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

const DIFFERENCE_REFUSED: &str =
    "`against` must be the name of a take, and `from` a time in seconds, each at most once";

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

/// What a request needs to read takes on a thread that may wait.
struct Reading {
    /// The name of the take in the request's path.
    name: String,
    control: Arc<dyn Control>,
    maps: Arc<KnownMaps>,
    client_alive: Weak<()>,
    stopping: watch::Receiver<bool>,
}

impl Reading {
    /// Opens a take that is not being written.
    fn file(&self, name: &str) -> Result<(Input, Option<String>), Problem> {
        let take = finished(self.control.as_ref(), name)?;
        let client_alive = Weak::clone(&self.client_alive);
        let stopping = self.stopping.clone();
        let input = SparseFile::of(take.file);
        Ok((BufReader::new(CancellableReader { input, client_alive, stopping }), take.tag))
    }

    /// Opens a take, with its map.
    fn open(&self, name: &str, whole: Whole) -> Result<(Input, Arc<TakeMap>), Problem> {
        let (mut input, tag) = self.file(name)?;
        let map = self.maps.map(&mut input, tag, whole).map_err(|error| problem(name, error))?;
        Ok((input, map))
    }
}

/// Reads takes on a thread that may wait, in its turn.
async fn read_takes<T: Send + 'static>(
    app: Shared,
    name: Result<Path<String>, PathRejection>,
    read: impl FnOnce(&Reading) -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    let name = take_name(name)?;
    // Dropped with the request, which ends when the client disconnects.
    let client = Arc::new(());
    let (control, maps) = (Arc::clone(&app.control), Arc::clone(&app.maps));
    let (client_alive, stopping) = (Arc::downgrade(&client), app.stopping.clone());
    let reading = Reading { name, control, maps, client_alive, stopping };
    let done = app.queues.decodes.run(move || read(&reading)).await?;
    drop(client);
    done
}

/// Reads a take that is not being written, with its map.
async fn read_take<T: Send + 'static>(
    app: Shared,
    name: Result<Path<String>, PathRejection>,
    whole: Whole,
    read: impl FnOnce(&str, &mut Input, &TakeMap) -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    read_takes(app, name, move |reading| {
        let (mut input, map) = reading.open(&reading.name, whole)?;
        read(&reading.name, &mut input, &map)
    })
    .await
}

/// Reads a take that is not being written, with its force plates.
async fn read_forces<T: Send + 'static>(
    app: Shared,
    name: Result<Path<String>, PathRejection>,
    read: impl FnOnce(&str, &mut Input, &TakeForces) -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    read_takes(app, name, move |reading| {
        let name = &reading.name;
        let (mut input, tag) = reading.file(name)?;
        let forces = reading.maps.forces(&mut input, tag).map_err(|error| problem(name, error))?;
        read(name, &mut input, &forces)
    })
    .await
}

/// Reads a take that is not being written, with its rigid bodies.
async fn read_bodies<T: Send + 'static>(
    app: Shared,
    name: Result<Path<String>, PathRejection>,
    read: impl FnOnce(&str, &mut Input, &TakeBodies) -> Result<T, Problem> + Send + 'static,
) -> Result<T, Problem> {
    read_takes(app, name, move |reading| {
        let name = &reading.name;
        let (mut input, tag) = reading.file(name)?;
        let bodies = reading.maps.bodies(&mut input, tag).map_err(|error| problem(name, error))?;
        read(name, &mut input, &bodies)
    })
    .await
}

/// Whether a request needs all of a map, or only what the end of a take states.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Whole {
    Yes,
    No,
}

/// What was found in the takes that were played last. Without it every window of a take that was cut off, and every window
/// of forces, would read the whole file.
#[derive(Debug, Default)]
pub(super) struct KnownMaps {
    maps: LastUsed<TakeMap>,
    forces: LastUsed<TakeForces>,
    bodies: LastUsed<TakeBodies>,
}

/// Maximum number of takes of which something is kept: a few players.
const KEPT_MAX: usize = 4;

/// Maximum number of key stretches, channels and parts of a take that is kept: together some megabytes. A take of days at one
/// key stretch per second has as many.
const MAP_ENTRIES_MAX: usize = 1 << 18;

/// Maximum number of entries of a take's forces that is kept, some ten of each second: a day, in at most 32 MiB. Without them
/// each window would read the times of the whole take.
const FORCES_ENTRIES_MAX: usize = 1 << 20;

/// The same of a take's rigid bodies, some ten of each second and eight bodies: the seven hours of 128 bodies, in at most
/// 128 MiB.
const BODIES_ENTRIES_MAX: usize = 1 << 22;

/// What was found in some takes, by their entity tags, which change with the files; the last one first.
#[derive(Debug)]
struct LastUsed<T>(Mutex<VecDeque<(String, Arc<T>)>>);

impl<T> Default for LastUsed<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<T> LastUsed<T> {
    fn get(&self, tag: Option<&String>) -> Option<Arc<T>> {
        let known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let found = known.iter().find(|(known, _)| Some(known) == tag);
        found.map(|(_, found)| Arc::clone(found))
    }

    fn put(&self, tag: Option<String>, found: &Arc<T>) {
        let Some(tag) = tag else { return };
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.retain(|(other, _)| *other != tag);
        known.truncate(KEPT_MAX - 1);
        known.push_front((tag, Arc::clone(found)));
    }
}

impl KnownMaps {
    /// The map of a take with this entity tag.
    fn map(
        &self,
        input: &mut Input,
        tag: Option<String>,
        whole: Whole,
    ) -> Result<Arc<TakeMap>, TakeError> {
        if let Some(known) = self.maps.get(tag.as_ref()) {
            return Ok(known);
        }
        if whole == Whole::No
            && let Some(map) = map_of_end(input)?
        {
            return Ok(Arc::new(map));
        }
        let map = Arc::new(TakeMap::open(input)?);
        let is_small = map.keys.len() + map.channels.len() <= MAP_ENTRIES_MAX;
        self.maps.put(tag.filter(|_| is_small), &map);
        Ok(map)
    }

    /// The map of a take for its overview, and whether that is complete: with `ends_only` it may have only what the ends of
    /// the take state.
    fn overview_map(
        &self,
        input: &mut Input,
        tag: Option<String>,
        ends_only: bool,
    ) -> Result<(Arc<TakeMap>, bool), TakeError> {
        if ends_only
            && self.maps.get(tag.as_ref()).is_none()
            && let Some(map) = map_of_ends(input)?
        {
            return Ok((Arc::new(map), false));
        }
        Ok((self.map(input, tag, Whole::Yes)?, true))
    }

    /// The force plates of a take with this entity tag.
    fn forces(&self, input: &mut Input, tag: Option<String>) -> Result<Arc<TakeForces>, TakeError> {
        if let Some(known) = self.forces.get(tag.as_ref()) {
            return Ok(known);
        }
        let forces = Arc::new(TakeForces::open(input)?);
        self.forces.put(tag.filter(|_| forces.n_entries() <= FORCES_ENTRIES_MAX), &forces);
        Ok(forces)
    }

    /// The rigid bodies of a take with this entity tag.
    fn bodies(&self, input: &mut Input, tag: Option<String>) -> Result<Arc<TakeBodies>, TakeError> {
        if let Some(known) = self.bodies.get(tag.as_ref()) {
            return Ok(known);
        }
        let bodies = Arc::new(TakeBodies::open(input)?);
        self.bodies.put(tag.filter(|_| bodies.n_entries() <= BODIES_ENTRIES_MAX), &bodies);
        Ok(bodies)
    }
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
