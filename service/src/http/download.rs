//! Downloads of takes: as they are, or as a file of another format, which is written while it is sent.

use std::{
    fs::File,
    io::{self, BufReader, BufWriter, Write},
    sync::{Arc, Weak},
};

use axum::{
    body::{Body, Bytes},
    extract::{
        Path, Query, State,
        rejection::{PathRejection, QueryRejection},
    },
    http::{HeaderMap, HeaderValue, header},
    response::Response,
};
use futures_util::stream;
use mocapd_acquire::files::{self, SparseFile};
use mocapd_take::{
    TakeError, TakeFrames,
    damage::Problem as Damage,
    interchange::{Format, InterchangeError},
};
use serde::Deserialize;
use tokio::sync::{
    mpsc::{Sender, channel},
    watch,
};
use utoipa::ToSchema;

use super::{
    Shared, StreamPermit,
    body::{Problem, ProblemKind},
    takes::{CancellableReader, answer, disposition, finished, open, take_name, unreadable, value},
};

/// Size of a piece of the file: as the chunks of a plain download.
const PIECE_BYTES: usize = 128 << 10;

/// Pieces that wait for a client, besides the one that is being written: the writer continues while one is sent.
const PIECES_MAX: usize = 2;

/// A format of downloads: those that the field's programs read. `mocapd export` writes others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(super) enum DownloadFormat {
    /// The take itself.
    Take,
    /// C3D.
    C3d,
    /// Track Row Column.
    Trc,
    /// CSV with a row for each frame.
    Csv,
}

impl DownloadFormat {
    /// The writer, the extension and the media type; `None` for a take, which is sent as it is.
    fn export(self) -> Option<ExportKind> {
        let (format, extension, media_type) = match self {
            Self::Take => return None,
            Self::C3d => (Format::C3d, "c3d", "application/octet-stream"),
            Self::Trc => (Format::Trc, "trc", "text/tab-separated-values; charset=utf-8"),
            Self::Csv => (Format::Csv, "csv", "text/csv; charset=utf-8"),
        };
        Some(ExportKind { format, extension, media_type })
    }
}

#[derive(Debug, Deserialize)]
pub(super) struct DownloadQuery {
    format: Option<DownloadFormat>,
}

/// Download a take, as it is or in another format
///
/// Byte ranges get 206. Of a take that is being written, the download contains what would survive a power cut; these
/// bytes never change, and the rest can be requested later by a range. With another format, the file is written while it is
/// sent: it has neither a length nor ranges, and the connection is closed if the take cannot be read to its end.
#[utoipa::path(get, path = "/v1/takes/{name}/download", tag = "takes",
    params(("name" = String, Path, description = "The take's name, without `.take`"),
        ("format" = inline(Option<DownloadFormat>), Query,
            description = "`take` (the default), `c3d`, `trc` or `csv`")),
    responses((status = 200, description = "The file", content(
            (Vec<u8> = "application/octet-stream"),
            (String = "text/tab-separated-values; charset=utf-8"),
            (String = "text/csv; charset=utf-8"))),
        (status = 206, description = "The bytes of a range", body = Vec<u8>,
            content_type = "application/octet-stream"),
        (status = 304, description = "The client's copy is current"),
        (status = 416, description = "The requested range is not satisfiable", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn download(
    State(app): State<Shared>,
    name: Result<Path<String>, PathRejection>,
    query: Result<Query<DownloadQuery>, QueryRejection>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let name = take_name(name)?;
    let query = query.map_err(|_| Problem::invalid("`format` must be take, c3d, trc or csv"))?;
    let permit = app.stream_permit()?;
    if let Some(kind) = query.format.and_then(DownloadFormat::export) {
        return send(app, name, kind, permit).await;
    }
    let (control, requested) = (Arc::clone(&app.control), name.clone());
    let take = app.queues.files.run(move || open(control.as_ref(), &requested)).await??;
    answer(app, take, &name, &headers, permit)
}

/// How a take becomes a file of another format.
#[derive(Debug, Clone, Copy)]
struct ExportKind {
    format: Format,
    extension: &'static str,
    media_type: &'static str,
}

/// Sends a take as a file of another format. Its size is not known before it was written, so there is no range of it.
async fn send(
    app: Shared,
    name: String,
    kind: ExportKind,
    permit: StreamPermit,
) -> Result<Response, Problem> {
    // Dropped with the response, which ends when the client disconnects.
    let client = Arc::new(());
    let (pieces, mut written) = channel(PIECES_MAX);
    let (control, requested) = (Arc::clone(&app.control), name.clone());
    let (client_alive, stopping) = (Arc::downgrade(&client), app.stopping.clone());
    let out = Pieces { pieces: pieces.clone() };
    let work = move || {
        let take = finished(control.as_ref(), &requested)?;
        write(&requested, take.file, kind.format, out, (&client_alive, &stopping))
    };
    tokio::spawn(async move {
        let done = app.queues.exports.run(work).await.and_then(|done| done);
        if let Err(problem) = done {
            // Nobody waits for it if the client has disconnected.
            pieces.send(Err(problem)).await.unwrap_or_default();
        }
    });
    // An error before the first piece is a response of its own; a later one closes the connection, so that the client
    // notices the incomplete download.
    let first = written.recv().await.transpose()?.unwrap_or_default();
    let state = (Some(first), written, permit, client);
    let body = stream::unfold(state, |(first, mut written, permit, client)| async move {
        let piece = match first {
            Some(piece) => Ok(piece),
            None => written.recv().await?.map_err(|problem| io::Error::other(problem.message)),
        };
        Some((piece, (None, written, permit, client)))
    });
    let mut response = Response::new(Body::from_stream(body));
    let out = response.headers_mut();
    out.insert(header::CONTENT_TYPE, HeaderValue::from_static(kind.media_type));
    out.insert(header::ACCEPT_RANGES, HeaderValue::from_static("none"));
    out.insert(header::CONTENT_DISPOSITION, value(&disposition(&name, kind.extension))?);
    Ok(response)
}

/// Writes the frames of a take. Frames that are lost or cannot be read are gaps.
fn write(
    name: &str,
    file: File,
    format: Format,
    out: Pieces,
    (client_alive, stopping): (&Weak<()>, &watch::Receiver<bool>),
) -> Result<(), Problem> {
    let again = file.try_clone().map_err(|error| unreadable(&error))?;
    let reader = |file: File| {
        let (client_alive, stopping) = (client_alive.clone(), stopping.clone());
        BufReader::new(CancellableReader { input: SparseFile::of(file), client_alive, stopping })
    };
    // A CSV file has the markers alone: what would be beside it is not read.
    let is_restored = |kind: &str| format == Format::C3d && format.restores(kind);
    let mut frames = TakeFrames::open_with(reader(file), is_restored, files::scratch)
        .map_err(|error| not_read(name, error))?;
    if format == Format::C3d {
        // As `mocapd export` does.
        frames.open_recording(reader(again), false).map_err(|error| not_read(name, error))?;
    }
    let left_out = frames.problems().iter().find(|problem| {
        matches!(
            problem,
            Damage::ForeignTooLong { .. } | Damage::PartUnreadable { .. } | Damage::ParametersLost
        )
    });
    if let Some(problem) = left_out {
        return Err(refused(name, &format!("{problem}; `mocapd export` writes what there is")));
    }
    let mut out = BufWriter::with_capacity(PIECE_BYTES, out);
    let written = format.write(&mut frames, &mut out);
    written.and_then(|()| Ok(out.flush()?)).map_err(|error| match error {
        InterchangeError::Io(error) => unreadable(&error),
        error => refused(name, &error.to_string()),
    })
}

fn not_read(name: &str, error: TakeError) -> Problem {
    match error {
        TakeError::Io(error) => unreadable(&error),
        error => refused(name, &error.to_string()),
    }
}

fn refused(name: &str, reason: &str) -> Problem {
    let message = format!("{name} cannot be written in this format: {reason}");
    Problem::of(ProblemKind::Conflict, message)
}

/// Passes what is written on to the response, and waits while the client is slower.
struct Pieces {
    pieces: Sender<Result<Bytes, Problem>>,
}

impl Write for Pieces {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let piece = Bytes::copy_from_slice(&bytes[..bytes.len().min(PIECE_BYTES)]);
        let len = piece.len();
        let gone = |_| io::Error::other("the client has disconnected");
        self.pieces.blocking_send(Ok(piece)).map_err(gone)?;
        Ok(len)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
