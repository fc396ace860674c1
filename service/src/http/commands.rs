//! What changes something.

use std::sync::Arc;

use axum::{Json, extract::State};

use super::{body::Asked, problem::Problem, state::Shared};
use crate::{
    control::{Control, Mark, Marked, Refusal, Request, SaveLast, Start, Started, Stopped},
    status::Status,
};

type Answer<T> = Result<Json<T>, Problem>;

/// Carries it out on a thread that may wait.
async fn carry_out<T: Send + 'static>(
    app: &Shared,
    what: impl FnOnce(&dyn Control) -> Result<T, Refusal> + Send + 'static,
) -> Answer<T> {
    let control = Arc::clone(&app.control);
    let done = app.lanes.commands.run(move || what(control.as_ref())).await?;
    Ok(Json(done?))
}

/// Start the device, and keep what it sends for the pre-roll
///
/// Armed already: nothing to do.
#[utoipa::path(post, path = "/v1/arm", tag = "commands", request_body = Request,
    responses((status = 200, body = Status)))]
pub(super) async fn arm(State(app): State<Shared>, Asked(asked): Asked<Request>) -> Answer<Status> {
    carry_out(&app, move |control| control.arm(&asked)).await
}

/// Stop the device and forget the pre-roll
#[utoipa::path(post, path = "/v1/disarm", tag = "commands", request_body = Request,
    responses((status = 200, body = Status)))]
pub(super) async fn disarm(
    State(app): State<Shared>,
    Asked(asked): Asked<Request>,
) -> Answer<Status> {
    carry_out(&app, move |control| control.disarm(&asked)).await
}

/// Begin a take
///
/// Answers when its first frame would survive a power cut. An idle service is armed first.
#[utoipa::path(post, path = "/v1/start", tag = "commands", request_body = Start,
    responses((status = 200, body = Started)))]
pub(super) async fn start(
    State(app): State<Shared>,
    Asked(asked): Asked<Start>,
) -> Answer<Started> {
    carry_out(&app, move |control| control.start(&asked)).await
}

/// End the take
///
/// Answers when its ledger would survive a power cut.
#[utoipa::path(post, path = "/v1/stop", tag = "commands", request_body = Request,
    responses((status = 200, body = Stopped)))]
pub(super) async fn stop(
    State(app): State<Shared>,
    Asked(asked): Asked<Request>,
) -> Answer<Stopped> {
    carry_out(&app, move |control| control.stop(&asked)).await
}

/// Put a mark into the take at the frame that comes next
#[utoipa::path(post, path = "/v1/mark", tag = "commands", request_body = Mark,
    responses((status = 200, body = Marked)))]
pub(super) async fn mark(State(app): State<Shared>, Asked(asked): Asked<Mark>) -> Answer<Marked> {
    carry_out(&app, move |control| control.mark(&asked)).await
}

/// Write a take of what the pre-roll holds, and go on
#[utoipa::path(post, path = "/v1/save-last", tag = "commands", request_body = SaveLast,
    responses((status = 200, body = Stopped)))]
pub(super) async fn save_last(
    State(app): State<Shared>,
    Asked(asked): Asked<SaveLast>,
) -> Answer<Stopped> {
    carry_out(&app, move |control| control.save_last(&asked)).await
}
