//! Routes for the status and for commands.

use std::sync::Arc;

use axum::{
    Extension, Json,
    extract::State,
    http::{HeaderMap, StatusCode},
    response::{IntoResponse, Response},
};
use mocapd_acquire::rig::{self, ListedDevice};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    Shared, Via,
    body::{JsonBody, Problem},
};
use crate::{
    control::{Control, Mark, Marked, Refusal, Request, SaveLast, Start, Started, Stopped},
    status::{MarkerQuality, PendingStart, State as ServiceState, Status},
};

/// The whole status at one moment
#[utoipa::path(get, path = "/v1/status", tag = "status", responses((status = 200, body = Status)))]
pub(super) async fn status(State(app): State<Shared>) -> Json<Status> {
    Json(app.control.status())
}

/// How well each marker is seen
#[utoipa::path(get, path = "/v1/quality", tag = "status",
    responses((status = 200, body = Vec<MarkerQuality>)))]
pub(super) async fn quality(State(app): State<Shared>) -> Json<Vec<MarkerQuality>> {
    Json(app.control.quality())
}

/// The health of the service.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub(super) struct Health {
    /// What the service is doing.
    state: ServiceState,
}

/// Whether the service is working
///
/// 503 with the reason if it has failed; the reason is omitted for clients that have not sent a required token.
#[utoipa::path(get, path = "/healthz", tag = "status", responses((status = 200, body = Health)),
    security(()))]
pub(super) async fn healthz(
    State(app): State<Shared>,
    Extension(via): Extension<Via>,
    headers: HeaderMap,
) -> Result<Json<Health>, Problem> {
    let status = app.control.status();
    if status.state != ServiceState::Failed {
        return Ok(Json(Health { state: status.state }));
    }
    let knows = matches!(via, Via::Unix) || app.auth.is_authorized(&headers);
    let reason = status.failure.filter(|_| knows);
    let message = reason.unwrap_or_else(|| "the service has failed: see /v1/status".to_owned());
    let mut problem = Problem::internal(message);
    problem.status = StatusCode::SERVICE_UNAVAILABLE.as_u16();
    Err(problem)
}

/// Attached devices, with the driver that recognises each, or why it cannot be opened
///
/// No device is opened.
#[utoipa::path(get, path = "/v1/devices", tag = "status",
    responses((status = 200, body = Vec<ListedDevice>)))]
pub(super) async fn devices(State(app): State<Shared>) -> Result<Json<Vec<ListedDevice>>, Problem> {
    let listed = app.queues.files.run(rig::devices).await?;
    Ok(Json(listed.map_err(|error| Problem::internal(error.to_string()))?))
}

pub(super) type Answer<T> = Result<Json<T>, Problem>;

/// Executes a command on a thread that may wait.
async fn execute<T: Send + 'static>(
    app: &Shared,
    what: impl FnOnce(&dyn Control) -> Result<T, Refusal> + Send + 'static,
) -> Answer<T> {
    let control = Arc::clone(&app.control);
    let done = app.queues.commands.run(move || what(control.as_ref())).await?;
    Ok(Json(done?))
}

/// Start the device and keep its frames for the pre-roll
///
/// Does nothing if armed already.
#[utoipa::path(post, path = "/v1/arm", tag = "commands", request_body = Request,
    responses((status = 200, body = Status)))]
pub(super) async fn arm(app: State<Shared>, request: JsonBody<Request>) -> Answer<Status> {
    execute(&app, move |control| control.arm(&request.0)).await
}

/// Stop the device and discard the pre-roll
#[utoipa::path(post, path = "/v1/disarm", tag = "commands", request_body = Request,
    responses((status = 200, body = Status)))]
pub(super) async fn disarm(app: State<Shared>, request: JsonBody<Request>) -> Answer<Status> {
    execute(&app, move |control| control.disarm(&request.0)).await
}

/// Start a take
///
/// Replies when the first frame would survive a power cut. An idle service is armed first. With `at`, replies that the
/// start waits for its time; whether it took place is an event, and in the status.
#[utoipa::path(post, path = "/v1/start", tag = "commands", request_body = Start,
    responses((status = 200, description = "The take has begun", body = Started),
        (status = 202, description = "The start waits for its time", body = PendingStart)))]
pub(super) async fn start(
    app: State<Shared>,
    request: JsonBody<Start>,
) -> Result<Response, Problem> {
    if request.0.at.is_some() {
        let pending = execute(&app, move |control| control.schedule(&request.0)).await?;
        return Ok((StatusCode::ACCEPTED, pending).into_response());
    }
    let started = execute(&app, move |control| control.start(&request.0)).await?;
    Ok(started.into_response())
}

/// Cancel the start that waits for its time
#[utoipa::path(post, path = "/v1/cancel", tag = "commands", request_body = Request,
    responses((status = 200, body = PendingStart)))]
pub(super) async fn cancel(app: State<Shared>, request: JsonBody<Request>) -> Answer<PendingStart> {
    // Not queued behind other commands: it changes no file and waits for nothing.
    Ok(Json(app.control.cancel(&request.0)?))
}

/// Stop the take
///
/// Replies when the ledger would survive a power cut.
#[utoipa::path(post, path = "/v1/stop", tag = "commands", request_body = Request,
    responses((status = 200, body = Stopped)))]
pub(super) async fn stop(app: State<Shared>, request: JsonBody<Request>) -> Answer<Stopped> {
    execute(&app, move |control| control.stop(&request.0)).await
}

/// Put a mark into the take at the next frame
#[utoipa::path(post, path = "/v1/mark", tag = "commands", request_body = Mark,
    responses((status = 200, body = Marked)))]
pub(super) async fn mark(app: State<Shared>, request: JsonBody<Mark>) -> Answer<Marked> {
    execute(&app, move |control| control.mark(&request.0)).await
}

/// Write the pre-roll as a take, and continue
#[utoipa::path(post, path = "/v1/save-last", tag = "commands", request_body = SaveLast,
    responses((status = 200, body = Stopped)))]
pub(super) async fn save_last(app: State<Shared>, request: JsonBody<SaveLast>) -> Answer<Stopped> {
    execute(&app, move |control| control.save_last(&request.0)).await
}
