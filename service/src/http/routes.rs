//! The routes, and their OpenAPI description.

use std::sync::Arc;

use axum::{
    Router,
    body::Bytes,
    extract::State,
    http::{HeaderName, StatusCode, header},
    middleware,
    routing::get,
};
use utoipa::{
    Modify, OpenApi,
    openapi::{
        self, ContentBuilder, Ref, RefOr, ResponseBuilder,
        path::Operation,
        security::{ApiKey, ApiKeyValue, HttpAuthScheme, HttpBuilder, SecurityScheme},
    },
};
use utoipa_axum::{router::OpenApiRouter, routes};

use super::{
    Shared, assets,
    auth::COOKIE,
    commands, guard, login, metrics,
    problem::{PROBLEM_JSON, Problem},
    streams, takes,
};

/// The described routes. Route and description are one item: neither exists without the other.
fn described() -> OpenApiRouter<Shared> {
    OpenApiRouter::with_openapi(Document::openapi())
        .routes(routes!(commands::status))
        .routes(routes!(commands::quality))
        .routes(routes!(commands::devices))
        .routes(routes!(commands::arm))
        .routes(routes!(commands::disarm))
        .routes(routes!(commands::start))
        .routes(routes!(commands::stop))
        .routes(routes!(commands::mark))
        .routes(routes!(commands::save_last))
        .routes(routes!(takes::takes))
        .routes(routes!(takes::download))
        .routes(routes!(takes::verify))
        .routes(routes!(streams::events))
        .routes(routes!(streams::live))
        .routes(routes!(commands::healthz))
        .routes(routes!(metrics::metrics))
        .routes(routes!(document))
        .routes(routes!(login::page, login::login))
        .routes(routes!(login::logout))
}

/// The API as `OpenAPI` 3.1, in JSON.
///
/// # Errors
/// The description cannot be written as JSON, which would be a bug.
pub fn openapi() -> serde_json::Result<String> {
    finish(described().into_openapi()).to_pretty_json()
}

/// All routes.
pub(super) fn router(app: &Shared) -> Router {
    let (mut router, _) = described().split_for_parts();
    for path in assets::paths() {
        router = router.route(&path, get(assets::serve));
    }
    let router = router
        .fallback(|| async { Problem::of_status(StatusCode::NOT_FOUND) })
        .layer(middleware::from_fn_with_state(Arc::clone(app), guard::guard))
        .layer(middleware::from_fn_with_state(Arc::clone(app), guard::finish));
    router.with_state(Arc::clone(app))
}

/// The parts of the description that concern all routes.
#[derive(Debug, OpenApi)]
#[openapi(
    info(
        title = "mocapd",
        description = "A recorder for optical motion capture, as a service. docs/api.md explains it.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0")
    ),
    components(schemas(Problem)),
    security((), ("token" = []), ("session" = [])),
    modifiers(&Security),
    tags(
        (name = "status", description = "The status of the service and its device"),
        (name = "commands", description = "Commands that change something. Each waits for its effect. A request with the \
            `request_id`, or the header `Idempotency-Key`, of an earlier one is not executed again: it gets the \
            reply to the first."),
        (name = "takes", description = "The takes in the service's folder"),
        (name = "streams", description = "Replies that continue until the client closes the connection"),
        (name = "login", description = "For browsers, if a token is required")
    )
)]
pub(super) struct Document;

#[derive(Debug)]
struct Security;

impl Modify for Security {
    fn modify(&self, openapi: &mut openapi::OpenApi) {
        let components = openapi.components.get_or_insert_default();
        let bearer = HttpBuilder::new().scheme(HttpAuthScheme::Bearer).build();
        components.add_security_scheme("token", SecurityScheme::Http(bearer));
        let cookie = SecurityScheme::ApiKey(ApiKey::Cookie(ApiKeyValue::new(COOKIE)));
        components.add_security_scheme("session", cookie);
    }
}

/// This description
#[utoipa::path(get, path = "/openapi.json", tag = "status",
    responses((status = 200, description = "`OpenAPI` 3.1", body = Object)))]
pub(super) async fn document(app: State<Shared>) -> ([(HeaderName, &'static str); 1], Bytes) {
    ([(header::CONTENT_TYPE, "application/json")], app.document.clone())
}

/// Adds what applies to every route: any other response is a problem.
pub(super) fn finish(mut document: openapi::OpenApi) -> openapi::OpenApi {
    for item in document.paths.paths.values_mut() {
        for operation in [&mut item.get, &mut item.post].into_iter().flatten() {
            add_problem(operation);
            // OpenAPI requires a description for every response.
            for response in operation.responses.responses.values_mut() {
                if let RefOr::T(response) = response
                    && response.description.is_empty()
                {
                    response.description = "Done".to_owned();
                }
            }
        }
    }
    document
}

fn add_problem(operation: &mut Operation) {
    let content = ContentBuilder::new().schema(Some(Ref::from_schema_name("Problem"))).build();
    let problem = ResponseBuilder::new()
        .description("Not executed: the reason, and what to do")
        .content(PROBLEM_JSON, content)
        .build();
    operation.responses.responses.entry("default".to_owned()).or_insert_with(|| problem.into());
}
