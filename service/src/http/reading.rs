//! How things stand.

use axum::{Extension, Json, extract::State, http::HeaderMap, http::StatusCode};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{connection::Via, problem::Problem, state::Shared};
use crate::status::{MarkerQuality, State as ServiceState, Status};

/// Everything at one time
#[utoipa::path(get, path = "/v1/status", tag = "status", responses((status = 200, body = Status)))]
pub(super) async fn status(State(app): State<Shared>) -> Json<Status> {
    Json(app.control.status())
}

/// By marker, how well it is seen
#[utoipa::path(get, path = "/v1/quality", tag = "status",
    responses((status = 200, body = Vec<MarkerQuality>)))]
pub(super) async fn quality(State(app): State<Shared>) -> Json<Vec<MarkerQuality>> {
    Json(app.control.quality())
}

/// That the service lives.
#[derive(Debug, Serialize, Deserialize, ToSchema)]
pub(super) struct Health {
    /// What the service is doing.
    state: ServiceState,
}

/// Whether the service does what it is for
///
/// 503 with the reason when it has failed; without a token, where one is needed, without the reason.
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
    let knows = matches!(via, Via::Unix) || app.auth.lets_in(&headers);
    let reason = status.failure.filter(|_| knows);
    let words = reason.unwrap_or_else(|| "the service has failed: see /v1/status".to_owned());
    let mut problem = Problem::internal(words);
    problem.status = StatusCode::SERVICE_UNAVAILABLE.as_u16();
    Err(problem)
}
