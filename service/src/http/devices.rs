//! What is attached.

use axum::{Json, extract::State};
use mocapd_acquire::listing::{self, ListedDevice};

use super::{problem::Problem, state::Shared};

/// What is attached, which driver claims it, or why it cannot be opened
///
/// No device is opened for it.
#[utoipa::path(get, path = "/v1/devices", tag = "status",
    responses((status = 200, body = Vec<ListedDevice>)))]
pub(super) async fn devices(State(app): State<Shared>) -> Result<Json<Vec<ListedDevice>>, Problem> {
    let listed = app.lanes.files.run(listing::devices).await?;
    Ok(Json(listed.map_err(|error| Problem::internal(error.to_string()))?))
}
