//! Routes for finished takes: their rating and notes, their names, and the trash.
//!
//! They use the queue of file operations, so that they never hold up a command.

use std::sync::Arc;

use axum::{
    Json,
    extract::{
        Path, Query, State,
        rejection::{PathRejection, QueryRejection},
    },
    http::{HeaderValue, header},
    response::{IntoResponse, Response},
};

use super::{
    Shared,
    body::JsonBody,
    commands::Answer,
    problem::{Problem, ProblemKind},
    takes::{self, Listing},
};
use crate::{
    control::{Control, Refusal},
    finished::{EditNotes, MovedTake, Rename, Restore, TakeNotes, Trash, TrashedTake},
    take_files::notes,
};

/// Executes a change of files on a thread that may wait.
async fn change<T: Send + 'static>(
    app: &Shared,
    name: Result<Path<String>, PathRejection>,
    what: impl FnOnce(&dyn Control, &str) -> Result<T, Refusal> + Send + 'static,
) -> Answer<T> {
    let name = takes::take_name(name)?;
    if !takes::is_name(&name) {
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
    let name = takes::take_name(name)?;
    let not_there = || Problem::not_found("the take has no notes, or there is no such take");
    if !takes::is_name(&name) {
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
    let limit = takes::limit(listing)?;
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
