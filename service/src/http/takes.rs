//! The takes in the service's folder: routes that list, download and verify them, and change their rating and notes, their
//! names, and the trash.
//!
//! Changes use the queue of file operations, so that they never hold up a command.

use std::{
    fs::File,
    io::{self, BufReader, Read, Seek, SeekFrom},
    ops::Range,
    os::unix::fs::{FileExt, MetadataExt},
    sync::{Arc, Weak},
};

use axum::{
    Json,
    body::{Body, Bytes},
    extract::{
        Path, Query, State,
        rejection::{PathRejection, QueryRejection},
    },
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use futures_util::stream;
use mocapd_acquire::{
    files::{FileId, SparseFile},
    inspect::{Summary, Verdict},
    ledger::{LedgerDocument, TakeHealth},
};
use mocapd_take::TakeError;
use rustix::{
    fs::{Mode, OFlags},
    io::Errno,
};
use serde::{Deserialize, Serialize};
use tokio::sync::watch;
use utoipa::ToSchema;

use super::{
    Shared, StreamPermit,
    body::{JsonBody, Problem, ProblemKind},
    commands::Answer,
};
use crate::{
    control::{Control, Refusal, Request},
    finished::{EditNotes, MovedTake, Rename, Restore, TakeNotes, Trash, TrashedTake},
    status::TakeSummary,
    take_files::notes,
};

/// Takes listed by default, and the most that can be requested.
const LIMIT: usize = 100;
const LIMIT_MAX: usize = 1000;

/// Longest name in bytes: no file system allows more.
const NAME_BYTES_MAX: usize = 255;

#[derive(Debug, Deserialize)]
pub(super) struct Listing {
    limit: Option<usize>,
}

/// The takes in the service's folder, newest first
#[utoipa::path(get, path = "/v1/takes", tag = "takes", 
    params(("limit" = Option<usize>, Query, minimum = 1, maximum = 1000,
        description = "Maximum number of takes to list; 100 by default")),
    responses((status = 200, body = Vec<TakeSummary>)))]
pub(super) async fn takes(
    State(app): State<Shared>,
    listing: Result<Query<Listing>, QueryRejection>,
) -> Result<Json<Vec<TakeSummary>>, Problem> {
    let limit = limit(listing)?;
    let control = Arc::clone(&app.control);
    Ok(Json(app.queues.files.run(move || control.takes(limit)).await??))
}

/// The number of entries that a request for a list asks for.
pub(super) fn limit(listing: Result<Query<Listing>, QueryRejection>) -> Result<usize, Problem> {
    let refused = || Problem::invalid(format!("`limit` must be a number from 1 to {LIMIT_MAX}"));
    let limit = listing.map_err(|_| refused())?.limit.unwrap_or(LIMIT);
    if (1..=LIMIT_MAX).contains(&limit) { Ok(limit) } else { Err(refused()) }
}

/// An opened take file.
#[derive(Debug)]
pub(super) struct OpenedTake {
    pub(super) file: File,
    /// Its length; for a take that is being written, the bytes that would survive a power cut.
    pub(super) len: u64,
    /// Whether it is being written.
    is_growing: bool,
    /// The entity tag, which changes whenever the file does; `None` while the file grows.
    pub(super) tag: Option<String>,
}

/// Opens a take by its name. May wait for the disk.
///
/// # Errors
/// 404 if it is not a take, or if the name leads elsewhere.
pub(super) fn open(control: &dyn Control, name: &str) -> Result<OpenedTake, Problem> {
    let not_there = || Problem::not_found("no take has this name: see /v1/takes");
    if !is_name(name) {
        return Err(not_there());
    }
    let path = control.take_path(name)?;
    // A link may lead anywhere, and opening a pipe may block: neither is a take.
    let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let file = match rustix::fs::open(&path, flags, Mode::empty()) {
        Ok(descriptor) => File::from(descriptor),
        Err(Errno::NOENT | Errno::LOOP) => return Err(not_there()),
        Err(error) => return Err(unreadable(&error.into())),
    };
    let found = file.metadata().map_err(|error| unreadable(&error))?;
    if !found.is_file() {
        return Err(not_there());
    }
    // Queried after the metadata: if the take ends in between, all of these bytes are on disk.
    let growing = control.live_take(FileId::of(&found));
    let modified_ns = found.mtime_nsec() + found.mtime() * 1_000_000_000;
    let tag = format!("\"{:x}-{modified_ns:x}-{:x}\"", found.len(), found.ino());
    Ok(OpenedTake {
        file,
        len: growing.as_ref().map_or(found.len(), |take| take.durable_bytes.min(found.len())),
        is_growing: growing.is_some(),
        tag: growing.is_none().then_some(tag),
    })
}

/// Opens a take that is not being written.
pub(super) fn finished(control: &dyn Control, name: &str) -> Result<OpenedTake, Problem> {
    let take = open(control, name)?;
    if take.is_growing {
        let message = format!("{name} is being recorded: stop it first");
        return Err(Problem::of(ProblemKind::Conflict, message));
    }
    Ok(take)
}

pub(super) fn unreadable(error: &io::Error) -> Problem {
    Problem::of(ProblemKind::Disk, format!("cannot read the take: {error}"))
}

/// Whether the name is a plain file name. The service checks it as well, but a path must not get that far.
pub(super) fn is_name(name: &str) -> bool {
    !name.is_empty()
        && name.len() <= NAME_BYTES_MAX
        && !name.starts_with('.')
        && !name.contains(['/', '\\'])
        && !name.contains(char::is_control)
}

/// Size of a chunk: read quickly by a disk, and the memory that a slow client costs.
const CHUNK_BYTES: u64 = 128 << 10;

/// The take name in a request's path.
pub(super) fn take_name(name: Result<Path<String>, PathRejection>) -> Result<String, Problem> {
    name.map(|Path(name)| name).map_err(|_| Problem::invalid("the take name is not UTF-8"))
}

/// Sends a take as it is, or a range of it.
pub(super) fn answer(
    app: Shared,
    take: OpenedTake,
    name: &str,
    headers: &HeaderMap,
    permit: StreamPermit,
) -> Result<Response, Problem> {
    let header_text = |name| headers.get(name).and_then(|value: &HeaderValue| value.to_str().ok());
    let tag = take.tag.as_deref();
    if tag.is_some_and(|tag| header_text(header::IF_NONE_MATCH) == Some(tag)) {
        return Ok(StatusCode::NOT_MODIFIED.into_response());
    }
    // The bytes of a growing take never change. A date is never equal to the tag: the whole file is sent then.
    let if_range = header_text(header::IF_RANGE);
    let same = if_range.is_none_or(|known| take.is_growing || Some(known) == tag);
    let range = header_text(header::RANGE).filter(|_| same);
    let (status, bytes) = match requested_range(range, take.len) {
        RequestedRange::Whole => (StatusCode::OK, 0..take.len),
        RequestedRange::Partial(range) => (StatusCode::PARTIAL_CONTENT, range),
        RequestedRange::Unsatisfiable => return unsatisfiable(take.len),
    };
    let mut response = Response::new(chunks(app, take.file, bytes.clone(), permit));
    *response.status_mut() = status;
    let out = response.headers_mut();
    out.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/octet-stream"));
    out.insert(header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    out.insert(header::CONTENT_LENGTH, HeaderValue::from(bytes.end - bytes.start));
    out.insert(header::CONTENT_DISPOSITION, value(&disposition(name, "take"))?);
    if let Some(tag) = tag {
        out.insert(header::ETAG, value(tag)?);
    }
    if status == StatusCode::PARTIAL_CONTENT {
        let range = format!("bytes {}-{}/{}", bytes.start, bytes.end - 1, take.len);
        out.insert(header::CONTENT_RANGE, value(&range)?);
    }
    Ok(response)
}

fn unsatisfiable(len: u64) -> Result<Response, Problem> {
    let message = format!("the range is outside of the file, which has {len} bytes");
    let problem = Problem::of(ProblemKind::Range, message);
    let mut response = problem.into_response();
    response.headers_mut().insert(header::CONTENT_RANGE, value(&format!("bytes */{len}"))?);
    Ok(response)
}

pub(super) fn value(text: &str) -> Result<HeaderValue, Problem> {
    HeaderValue::from_str(text).map_err(|error| Problem::internal(error.to_string()))
}

/// The file name for browsers: in ASCII for old ones, and in UTF-8 (RFC 6266).
pub(super) fn disposition(name: &str, extension: &str) -> String {
    let is_plain = |c: char| c.is_ascii_graphic() && !"\"\\%;".contains(c) || c == ' ';
    let plain: String = name.chars().map(|c| if is_plain(c) { c } else { '_' }).collect();
    let mut exact = String::with_capacity(name.len());
    for byte in name.bytes() {
        if byte.is_ascii_alphanumeric() || b"-._".contains(&byte) {
            exact.push(char::from(byte));
        } else {
            exact += &format!("%{byte:02X}");
        }
    }
    format!("attachment; filename=\"{plain}.{extension}\"; filename*=UTF-8''{exact}.{extension}")
}

/// Reads each chunk after the previous one was sent: a slow client costs the memory of one chunk and no thread.
fn chunks(app: Shared, file: File, bytes: Range<u64>, permit: StreamPermit) -> Body {
    let state = (app, Arc::new(file), bytes, permit);
    Body::from_stream(stream::unfold(state, |(app, file, bytes, permit)| async move {
        if bytes.is_empty() {
            return None;
        }
        let len = CHUNK_BYTES.min(bytes.end - bytes.start);
        let (from, source) = (bytes.start, Arc::clone(&file));
        let read = app.queues.files.run_when_free(move || read(&source, from, len)).await;
        // A failed read closes the connection, so that the client notices the incomplete download.
        let piece = read.unwrap_or_else(|problem| Err(io::Error::other(problem.message)));
        let rest = if piece.is_ok() { from + len..bytes.end } else { bytes.end..bytes.end };
        Some((piece, (app, file, rest, permit)))
    }))
}

fn read(file: &File, from: u64, len: u64) -> io::Result<Bytes> {
    let mut piece = vec![0; len as usize];
    file.read_exact_at(&mut piece, from)?;
    Ok(piece.into())
}

/// The part of a file selected by a `Range` header.
#[derive(Debug, PartialEq, Eq)]
enum RequestedRange {
    /// The whole file: no range was requested, or one that is not supported, which a server may ignore.
    Whole,
    /// These bytes.
    Partial(Range<u64>),
    /// No byte of the file.
    Unsatisfiable,
}

fn requested_range(header: Option<&str>, len: u64) -> RequestedRange {
    let Some((unit, spec)) = header.and_then(|header| header.split_once('=')) else {
        return RequestedRange::Whole;
    };
    if !unit.trim().eq_ignore_ascii_case("bytes") {
        return RequestedRange::Whole;
    }
    let Some((first, last)) = spec.trim().split_once('-') else { return RequestedRange::Whole };
    let range = match (number(first), number(last)) {
        (Some(first), Some(last)) if first <= last => first..last.saturating_add(1).min(len),
        (Some(first), None) if last.is_empty() => first..len,
        (None, Some(last)) if first.is_empty() => len.saturating_sub(last)..len,
        // Several ranges, or an invalid one.
        _ => return RequestedRange::Whole,
    };
    if range.is_empty() { RequestedRange::Unsatisfiable } else { RequestedRange::Partial(range) }
}

/// Parses digits only, because `parse` would accept a sign. Numbers that do not fit exceed any file.
fn number(text: &str) -> Option<u64> {
    let digits = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    digits.then(|| text.parse().unwrap_or(u64::MAX))
}

/// Maximum number of problems and contradictions listed each: a badly damaged take has one per stretch.
const LISTED_MAX: usize = 100;

/// The result of verifying a take.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct TakeCheck {
    /// Name without `.take`.
    pub name: String,
    /// Health as in the list, or `damaged` if there is damage between header and end.
    pub health: TakeHealth,
    /// Why it ended, as in the reply to `stop`; empty if the take does not say.
    #[serde(default)]
    pub ending: String,
    /// Size of the file in bytes.
    pub bytes: u64,
    /// Number of frames: rows, including lost frames.
    pub frames: u64,
    /// Length in seconds.
    pub seconds: f64,
    /// Frame rate in Hz.
    pub rate_hz: f64,
    /// Number of markers.
    pub markers: usize,
    /// Number of present samples.
    pub samples: u64,
    /// Largest error allowed for any sample, in millimetres; 0 for a lossless take.
    pub tolerance_mm: f64,
    /// Largest error stated in the take, in millimetres.
    pub max_error_mm: f64,
    /// The first hundred problems: a ledger that does not close or disagrees with the samples, and what is missing or
    /// damaged.
    pub problems: Vec<String>,
    /// The first hundred contradictions: what the take states about itself and its data disproves.
    pub contradictions: Vec<String>,
    /// Its last ledger.
    pub ledger: Option<LedgerDocument>,
}

/// Verify a take by reading all of it
///
/// Checks checksums, every block and the ledger. One take at a time; verification stops if the client disconnects.
#[utoipa::path(post, path = "/v1/takes/{name}/verify", tag = "takes", request_body = Request,
    params(("name" = String, Path, description = "The take's name, without `.take`")),
    responses((status = 200, body = TakeCheck)))]
pub(super) async fn verify(
    State(app): State<Shared>,
    name: Result<Path<String>, PathRejection>,
    JsonBody(_): JsonBody<Request>,
) -> Result<Json<TakeCheck>, Problem> {
    let name = take_name(name)?;
    // Dropped with the request, which ends when the client disconnects.
    let client = Arc::new(());
    let control = Arc::clone(&app.control);
    let (client_alive, stopping) = (Arc::downgrade(&client), app.stopping.clone());
    let work = move || {
        let take = finished(control.as_ref(), &name)?;
        let input = CancellableReader { input: SparseFile::of(take.file), client_alive, stopping };
        check(name, take.len, Summary::read(BufReader::new(input)))
    };
    let checked = app.queues.checks.run(work).await?;
    drop(client);
    Ok(Json(checked?))
}

/// A reader that fails once the client has disconnected or the server stops.
pub(super) struct CancellableReader<R> {
    pub(super) input: R,
    pub(super) client_alive: Weak<()>,
    pub(super) stopping: watch::Receiver<bool>,
}

impl<R: Read> Read for CancellableReader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.client_alive.strong_count() == 0 || *self.stopping.borrow() {
            return Err(io::Error::other("reading cancelled: the client has disconnected"));
        }
        self.input.read(buffer)
    }
}

impl<R: Seek> Seek for CancellableReader<R> {
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
            let health = TakeHealth::Unreadable;
            return Ok(TakeCheck { name, health, bytes, problems, ..TakeCheck::default() });
        }
    };
    let Verdict { problems, mut contradictions, .. } = Verdict::of(&summary);
    contradictions.truncate(LISTED_MAX);
    let header = &summary.take.header;
    let ending = summary.take.ending.as_ref().map_or("", |ending| ending.kind.name());
    Ok(TakeCheck {
        name,
        health: summary.health(),
        ending: ending.to_owned(),
        bytes,
        frames: summary.take.n_rows,
        seconds: summary.take.n_rows as f64 / header.rate_hz,
        rate_hz: header.rate_hz,
        markers: summary.take.channels.len(),
        samples: summary.samples(),
        tolerance_mm: header.tolerance_mm,
        max_error_mm: summary.max_error_mm(),
        problems: problems.iter().take(LISTED_MAX).map(ToString::to_string).collect(),
        contradictions,
        ledger: summary.take.ledger.as_ref().map(LedgerDocument::from),
    })
}

/// Executes a change of files on a thread that may wait.
async fn change<T: Send + 'static>(
    app: &Shared,
    name: Result<Path<String>, PathRejection>,
    what: impl FnOnce(&dyn Control, &str) -> Result<T, Refusal> + Send + 'static,
) -> Answer<T> {
    let name = take_name(name)?;
    if !is_name(&name) {
        return Err(Problem::not_found("no take has this name: see /v1/takes"));
    }
    let control = Arc::clone(&app.control);
    let done = app.queues.files.run(move || what(control.as_ref(), &name)).await?;
    Ok(Json(done?))
}

/// Rate a finished take, or change its notes
///
/// They are stored in a file beside the take, which stays as it is. Fields that are absent stay unchanged.
#[utoipa::path(post, path = "/v1/takes/{name}/notes", tag = "takes", request_body = EditNotes,
    params(("name" = String, Path, description = "The take's name, without `.take`")),
    responses((status = 200, body = TakeNotes)))]
pub(super) async fn edit_notes(
    app: State<Shared>,
    name: Result<Path<String>, PathRejection>,
    edit: JsonBody<EditNotes>,
) -> Answer<TakeNotes> {
    change(&app, name, move |control, name| control.edit_notes(name, &edit.0)).await
}

/// Download the file of a take's rating and notes
#[utoipa::path(get, path = "/v1/takes/{name}/notes", tag = "takes",
    params(("name" = String, Path, description = "The take's name, without `.take`")),
    responses((status = 200, description = "The file `NAME.notes.json`, as it is", body = Object)))]
pub(super) async fn notes_file(
    app: State<Shared>,
    name: Result<Path<String>, PathRejection>,
) -> Result<Response, Problem> {
    let name = take_name(name)?;
    let not_there = || Problem::not_found("the take has no notes, or there is no such take");
    if !is_name(&name) {
        return Err(not_there());
    }
    let control = Arc::clone(&app.control);
    let read = move || -> Result<Vec<u8>, Problem> {
        let path = notes::notes_path(&control.take_path(&name)?);
        if path.symlink_metadata().is_err() {
            return Err(not_there());
        }
        notes::read_file(&path)
            .map_err(|error| Problem::of(ProblemKind::Disk, format!("{error:#}")))
    };
    let bytes = app.queues.files.run(read).await??;
    let mut response = bytes.into_response();
    let media_type = HeaderValue::from_static("application/json");
    response.headers_mut().insert(header::CONTENT_TYPE, media_type);
    Ok(response)
}

/// Rename a finished take, and its notes
///
/// Nothing is replaced.
#[utoipa::path(post, path = "/v1/takes/{name}/rename", tag = "takes", request_body = Rename,
    params(("name" = String, Path, description = "The take's name, without `.take`")),
    responses((status = 200, body = MovedTake)))]
pub(super) async fn rename(
    app: State<Shared>,
    name: Result<Path<String>, PathRejection>,
    request: JsonBody<Rename>,
) -> Answer<MovedTake> {
    change(&app, name, move |control, name| control.rename(name, &request.0)).await
}

/// Move a finished take, and its notes, to the trash
///
/// They are removed after `take.trash_keep`, and count as used space until then.
#[utoipa::path(post, path = "/v1/takes/{name}/trash", tag = "takes", request_body = Trash,
    params(("name" = String, Path, description = "The take's name, without `.take`")),
    responses((status = 200, body = TrashedTake)))]
pub(super) async fn trash(
    app: State<Shared>,
    name: Result<Path<String>, PathRejection>,
    request: JsonBody<Trash>,
) -> Answer<TrashedTake> {
    change(&app, name, move |control, name| control.trash(name, &request.0)).await
}

/// The takes in the trash, newest first
#[utoipa::path(get, path = "/v1/trash", tag = "takes",
    params(("limit" = Option<usize>, Query, minimum = 1, maximum = 1000,
        description = "Maximum number of takes to list; 100 by default")),
    responses((status = 200, body = Vec<TrashedTake>)))]
pub(super) async fn trashed(
    State(app): State<Shared>,
    listing: Result<Query<Listing>, QueryRejection>,
) -> Answer<Vec<TrashedTake>> {
    let limit = limit(listing)?;
    let control = Arc::clone(&app.control);
    Ok(Json(app.queues.files.run(move || control.trashed(limit)).await?))
}

/// Restore a take, and its notes, from the trash
#[utoipa::path(post, path = "/v1/trash/{id}/restore", tag = "takes", request_body = Restore,
    params(("id" = String, Path, description = "The take's id in the trash, or its name: then the newest of that name")),
    responses((status = 200, body = MovedTake)))]
pub(super) async fn restore(
    app: State<Shared>,
    id: Result<Path<String>, PathRejection>,
    request: JsonBody<Restore>,
) -> Answer<MovedTake> {
    change(&app, id, move |control, id| control.restore(id, &request.0)).await
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_lead_elsewhere_are_refused() {
        for name in ["jump-001", "a b", "knie é", "x.y", "a..b"] {
            assert!(is_name(name), "{name}");
        }
        for name in ["", ".", "..", "../x", "a/b", "a\\b", "/etc/passwd", ".hidden", "a\0b", "a\nb"]
        {
            assert!(!is_name(name), "{name:?}");
        }
        assert!(!is_name(&"x".repeat(256)));
    }

    #[test]
    fn names_in_headers() {
        let plain = "attachment; filename=\"jump-1.take\"; filename*=UTF-8''jump-1.take";
        assert_eq!(disposition("jump-1", "take"), plain);
        let odd =
            "attachment; filename=\"a_b _ _.take\"; filename*=UTF-8''a%22b%20%C3%A9%20%3B.take";
        assert_eq!(disposition("a\"b é ;", "take"), odd);
    }

    #[test]
    fn valid_and_invalid_ranges() {
        let of_ten = |header| requested_range(Some(header), 10);
        assert_eq!(requested_range(None, 10), RequestedRange::Whole);
        for (header, range) in [
            ("bytes=0-0", 0..1),
            ("bytes=2-5", 2..6),
            ("Bytes=9-", 9..10),
            ("bytes=0-99999999999999999999999", 0..10),
            ("bytes=-3", 7..10),
            ("bytes=-99", 0..10),
            ("bytes=0-9", 0..10),
        ] {
            assert_eq!(of_ten(header), RequestedRange::Partial(range), "{header}");
        }
        for header in ["bytes=10-", "bytes=10-12", "bytes=-0", "bytes=99999999999999999999-"] {
            assert_eq!(of_ten(header), RequestedRange::Unsatisfiable, "{header}");
        }
        for header in [
            "",
            "bytes",
            "bytes=",
            "bytes=-",
            "bytes=5-2",
            "bytes=a-b",
            "bytes=1-2,4-5",
            "rows=1-2",
            "bytes=+1-2",
        ] {
            assert_eq!(of_ten(header), RequestedRange::Whole, "{header}");
        }
        assert_eq!(requested_range(Some("bytes=0-"), 0), RequestedRange::Unsatisfiable);
    }
}
