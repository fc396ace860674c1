//! A take as it is, to whom it is wanted by.

use std::{fs::File, io, ops::Range, os::unix::fs::FileExt, sync::Arc};

use axum::{
    body::{Body, Bytes},
    extract::{Path, State, rejection::PathRejection},
    http::{HeaderMap, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use futures_util::stream;

use super::{
    problem::{Problem, ProblemKind},
    range::{Wanted, wanted},
    state::{Shared, StreamPlace},
    takes::{self, OpenTake},
};

/// Bytes that are read at once: a disk's while, and what a slow client costs in memory.
const PIECE_BYTES: u64 = 128 << 10;

/// The file of a take
///
/// Ranges of bytes are answered with 206. Of a take that is being written it gives what would survive a power cut,
/// which never changes again: ask for the rest later, by a range.
#[utoipa::path(get, path = "/v1/takes/{name}/download", tag = "takes",
    params(("name" = String, Path, description = "The take's name, without `.take`")),
    responses((status = 200, description = "The file", body = Vec<u8>,
            content_type = "application/octet-stream"),
        (status = 206, description = "The bytes of a range", body = Vec<u8>,
            content_type = "application/octet-stream"),
        (status = 304, description = "The client has it"),
        (status = 416, description = "The bytes asked for are not there", body = Problem,
            content_type = "application/problem+json")))]
pub(super) async fn download(
    State(app): State<Shared>,
    name: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let name = take_name(name)?;
    let place = app.stream_place()?;
    let (control, asked) = (Arc::clone(&app.control), name.clone());
    let take = app.lanes.files.run(move || takes::open(control.as_ref(), &asked)).await??;
    answer(app, take, &name, &headers, place)
}

/// The name in a path.
pub(super) fn take_name(name: Result<Path<String>, PathRejection>) -> Result<String, Problem> {
    name.map(|Path(name)| name).map_err(|_| Problem::invalid("the take's name is no UTF-8"))
}

fn answer(
    app: Shared,
    take: OpenTake,
    name: &str,
    headers: &HeaderMap,
    place: StreamPlace,
) -> Result<Response, Problem> {
    let said = |name| headers.get(name).and_then(|value: &HeaderValue| value.to_str().ok());
    let tag = take.tag.as_deref();
    if tag.is_some_and(|tag| said(header::IF_NONE_MATCH) == Some(tag)) {
        return Ok(StatusCode::NOT_MODIFIED.into_response());
    }
    // Bytes that are there never change while a take grows. A date is never the tag: then it is sent whole.
    let same = said(header::IF_RANGE).is_none_or(|known| take.is_growing || Some(known) == tag);
    let (status, bytes) = match wanted(said(header::RANGE).filter(|_| same), take.len) {
        Wanted::Whole => (StatusCode::OK, 0..take.len),
        Wanted::Part(range) => (StatusCode::PARTIAL_CONTENT, range),
        Wanted::Nothing => return not_there(take.len),
    };
    let mut response = Response::new(pieces(app, take.file, bytes.clone(), place));
    *response.status_mut() = status;
    let out = response.headers_mut();
    out.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/octet-stream"));
    out.insert(header::ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    out.insert(header::CONTENT_LENGTH, HeaderValue::from(bytes.end - bytes.start));
    out.insert(header::CONTENT_DISPOSITION, value(&disposition(name))?);
    if let Some(tag) = tag {
        out.insert(header::ETAG, value(tag)?);
    }
    if status == StatusCode::PARTIAL_CONTENT {
        let range = format!("bytes {}-{}/{}", bytes.start, bytes.end - 1, take.len);
        out.insert(header::CONTENT_RANGE, value(&range)?);
    }
    Ok(response)
}

fn not_there(len: u64) -> Result<Response, Problem> {
    let words = format!("there are {len} bytes, and the range lies behind them");
    let problem = Problem::new(StatusCode::RANGE_NOT_SATISFIABLE, ProblemKind::Range, words);
    let mut response = problem.into_response();
    response.headers_mut().insert(header::CONTENT_RANGE, value(&format!("bytes */{len}"))?);
    Ok(response)
}

fn value(text: &str) -> Result<HeaderValue, Problem> {
    HeaderValue::from_str(text).map_err(|error| Problem::internal(error.to_string()))
}

/// The name that a browser saves it under: in ASCII for old ones, and as it is (RFC 6266).
fn disposition(name: &str) -> String {
    let plain: String = name
        .chars()
        .map(|c| if c.is_ascii_graphic() && !"\"\\%;".contains(c) || c == ' ' { c } else { '_' })
        .collect();
    let mut exact = String::with_capacity(name.len());
    for byte in name.bytes() {
        if byte.is_ascii_alphanumeric() || b"-._".contains(&byte) {
            exact.push(char::from(byte));
        } else {
            exact += &format!("%{byte:02X}");
        }
    }
    format!("attachment; filename=\"{plain}.take\"; filename*=UTF-8''{exact}.take")
}

/// Reads a piece when the one before is gone: a slow client costs one piece, and holds no thread.
fn pieces(app: Shared, file: File, bytes: Range<u64>, place: StreamPlace) -> Body {
    let state = (app, Arc::new(file), bytes, place);
    Body::from_stream(stream::unfold(state, |(app, file, bytes, place)| async move {
        if bytes.is_empty() {
            return None;
        }
        let len = PIECE_BYTES.min(bytes.end - bytes.start);
        let (from, source) = (bytes.start, Arc::clone(&file));
        let read = app.lanes.files.run_patiently(move || read(&source, from, len)).await;
        // What was announced and does not come closes the connection: the client sees that it is cut off.
        let piece = read.unwrap_or_else(|problem| Err(io::Error::other(problem.message)));
        let rest = if piece.is_ok() { from + len..bytes.end } else { bytes.end..bytes.end };
        Some((piece, (app, file, rest, place)))
    }))
}

fn read(file: &File, from: u64, len: u64) -> io::Result<Bytes> {
    let mut piece = vec![0; len as usize];
    file.read_exact_at(&mut piece, from)?;
    Ok(piece.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_in_headers() {
        let plain = "attachment; filename=\"jump-1.take\"; filename*=UTF-8''jump-1.take";
        assert_eq!(disposition("jump-1"), plain);
        let odd =
            "attachment; filename=\"a_b _ _.take\"; filename*=UTF-8''a%22b%20%C3%A9%20%3B.take";
        assert_eq!(disposition("a\"b é ;"), odd);
    }
}
