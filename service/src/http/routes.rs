//! Which path leads where.

use std::sync::Arc;

use axum::{Router, http::StatusCode, middleware, routing::get};
use utoipa::OpenApi;
use utoipa_axum::{router::OpenApiRouter, routes};

use super::{
    assets, check, commands, devices, document, download, events, guard, live, login, metrics,
    problem::Problem, reading, state::Shared, takes,
};

/// The routes that are described. Route and description are one thing: neither is without the other.
fn described() -> OpenApiRouter<Shared> {
    OpenApiRouter::with_openapi(document::Document::openapi())
        .routes(routes!(reading::status))
        .routes(routes!(reading::quality))
        .routes(routes!(devices::devices))
        .routes(routes!(commands::arm))
        .routes(routes!(commands::disarm))
        .routes(routes!(commands::start))
        .routes(routes!(commands::stop))
        .routes(routes!(commands::mark))
        .routes(routes!(commands::save_last))
        .routes(routes!(takes::takes))
        .routes(routes!(download::download))
        .routes(routes!(check::verify))
        .routes(routes!(events::events))
        .routes(routes!(live::live))
        .routes(routes!(reading::healthz))
        .routes(routes!(metrics::metrics))
        .routes(routes!(document::document))
        .routes(routes!(login::page, login::login))
        .routes(routes!(login::logout))
}

/// The API as `OpenAPI` 3.1, in JSON.
///
/// # Errors
/// A bug: it is not JSON.
pub fn openapi() -> serde_json::Result<String> {
    document::finish(described().into_openapi()).to_pretty_json()
}

/// Everything that can be asked for.
pub(super) fn router(app: &Shared) -> Router {
    let (mut router, _) = described().split_for_parts();
    for path in assets::paths() {
        router = router.route(&path, get(assets::serve));
    }
    let router = router
        .fallback(|| async { Problem::of_status(StatusCode::NOT_FOUND, "") })
        .layer(middleware::from_fn_with_state(Arc::clone(app), guard::guard))
        .layer(middleware::from_fn_with_state(Arc::clone(app), guard::finish));
    router.with_state(Arc::clone(app))
}
