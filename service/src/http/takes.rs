//! The takes of the service's folder: which there are, and one of them opened.

use std::{fs::File, os::unix::fs::MetadataExt, sync::Arc};

use axum::{
    Json,
    extract::{Query, State, rejection::QueryRejection},
    http::StatusCode,
};
use mocapd_acquire::files::FileId;
use rustix::{
    fs::{Mode, OFlags},
    io::Errno,
};
use serde::Deserialize;

use super::{
    problem::{Problem, ProblemKind},
    state::Shared,
};
use crate::{control::Control, status::TakeSummary};

/// Takes that are listed where nobody says how many, and at most.
const LIMIT: usize = 100;
const LIMIT_MAX: usize = 1000;

/// Bytes of a name at most: more no file system takes.
const NAME_BYTES_MAX: usize = 255;

#[derive(Debug, Deserialize)]
pub(super) struct Listing {
    limit: Option<usize>,
}

/// The takes in the service's folder, newest first
#[utoipa::path(get, path = "/v1/takes", tag = "takes", 
    params(("limit" = Option<usize>, Query, minimum = 1, maximum = 1000,
        description = "How many at most; 100 where it is not said")),
    responses((status = 200, body = Vec<TakeSummary>)))]
pub(super) async fn takes(
    State(app): State<Shared>,
    listing: Result<Query<Listing>, QueryRejection>,
) -> Result<Json<Vec<TakeSummary>>, Problem> {
    let refused = || Problem::invalid(format!("`limit` is a number of takes: 1 to {LIMIT_MAX}"));
    let Query(listing) = listing.map_err(|_| refused())?;
    let limit = listing.limit.unwrap_or(LIMIT);
    if !(1..=LIMIT_MAX).contains(&limit) {
        return Err(refused());
    }
    let control = Arc::clone(&app.control);
    Ok(Json(app.lanes.files.run(move || control.takes(limit)).await??))
}

/// A take's file.
#[derive(Debug)]
pub(super) struct OpenTake {
    pub(super) file: File,
    /// Its bytes; of a take that is being written, those that would survive a power cut.
    pub(super) len: u64,
    /// Whether it is being written.
    pub(super) is_growing: bool,
    /// Changes whenever the file does. `None` while it grows.
    pub(super) tag: Option<String>,
}

/// Opens a take by its name. Waits for the disk.
///
/// # Errors
/// 404 for what is no take, and for what leads anywhere else.
pub(super) fn open(control: &dyn Control, name: &str) -> Result<OpenTake, Problem> {
    let not_there = || Problem::not_found("there is no take of that name: see /v1/takes");
    if !is_name(name) {
        return Err(not_there());
    }
    let path = control.take_path(name)?;
    // A link may lead anywhere, and a pipe would be waited for: neither is a take.
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
    // Asked behind the metadata: a take that ends in between has all of these bytes on disk.
    let growing = control.live_take(FileId::of(&found));
    let tag = format!(
        "\"{:x}-{:x}-{:x}\"",
        found.len(),
        found.mtime_nsec() + found.mtime() * 1_000_000_000,
        found.ino()
    );
    Ok(OpenTake {
        file,
        len: growing.as_ref().map_or(found.len(), |take| take.durable_bytes.min(found.len())),
        is_growing: growing.is_some(),
        tag: growing.is_none().then_some(tag),
    })
}

pub(super) fn unreadable(error: &std::io::Error) -> Problem {
    let words = format!("the take cannot be read: {error}");
    Problem::new(StatusCode::INSUFFICIENT_STORAGE, ProblemKind::Disk, words)
}

/// Whether that can be a name in a folder. The service looks as well; a path is read here only.
fn is_name(name: &str) -> bool {
    !name.is_empty()
        && name.len() <= NAME_BYTES_MAX
        && !name.starts_with('.')
        && !name.contains(['/', '\\'])
        && !name.contains(char::is_control)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_leads_elsewhere_is_no_name() {
        for name in ["jump-001", "a b", "knie é", "x.y", "a..b"] {
            assert!(is_name(name), "{name}");
        }
        for name in ["", ".", "..", "../x", "a/b", "a\\b", "/etc/passwd", ".hidden", "a\0b", "a\nb"]
        {
            assert!(!is_name(name), "{name:?}");
        }
        assert!(!is_name(&"x".repeat(256)));
    }
}
