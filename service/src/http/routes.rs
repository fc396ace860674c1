//! The routes, their OpenAPI description, and the files of the dashboard, which are compiled into the program.

use std::{ffi::OsStr, sync::Arc};

use axum::{
    Router,
    body::{Body, Bytes},
    extract::State,
    http::{HeaderMap, HeaderName, HeaderValue, StatusCode, Uri, header},
    middleware,
    response::{IntoResponse, Response},
    routing::get,
};
use include_dir::File;
use sha2::{Digest, Sha256};
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
    Shared,
    auth::{self, COOKIE},
    body::{PROBLEM_JSON, Problem},
    broadcast, commands, download, guard, metrics, playback, takes,
};
use crate::page::{PLAYER, WEB};

/// The described routes. Route and description are one item: neither exists without the other.
fn described() -> OpenApiRouter<Shared> {
    OpenApiRouter::with_openapi(Document::openapi())
        .routes(routes!(commands::status))
        .routes(routes!(commands::quality))
        .routes(routes!(commands::devices))
        .routes(routes!(commands::arm))
        .routes(routes!(commands::disarm))
        .routes(routes!(commands::start))
        .routes(routes!(commands::cancel))
        .routes(routes!(commands::stop))
        .routes(routes!(commands::mark))
        .routes(routes!(commands::save_last))
        .routes(routes!(takes::takes))
        .routes(routes!(download::download))
        .routes(routes!(takes::verify))
        .routes(routes!(playback::overview))
        .routes(routes!(playback::window))
        .routes(routes!(playback::gaps))
        .routes(routes!(playback::face))
        .routes(routes!(playback::plates))
        .routes(routes!(playback::forces))
        .routes(routes!(playback::bodies))
        .routes(routes!(playback::poses))
        .routes(routes!(playback::difference))
        .routes(routes!(takes::notes_file, takes::edit_notes))
        .routes(routes!(takes::rename))
        .routes(routes!(takes::trash))
        .routes(routes!(takes::trashed))
        .routes(routes!(takes::restore))
        .routes(routes!(broadcast::events))
        .routes(routes!(broadcast::live))
        .routes(routes!(commands::healthz))
        .routes(routes!(metrics::metrics))
        .routes(routes!(document))
        .routes(routes!(auth::page, auth::login))
        .routes(routes!(auth::logout))
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
    for path in paths() {
        router = router.route(&path, get(serve));
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

/// The media type of a file by its extension; `application/octet-stream` for any other extension, so that no browser
/// guesses.
fn content_type(file: &File<'_>) -> &'static str {
    match file.path().extension().and_then(OsStr::to_str).unwrap_or_default() {
        "html" => "text/html; charset=utf-8",
        "js" => "text/javascript; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "svg" => "image/svg+xml",
        "png" => "image/png",
        "json" | "webmanifest" => "application/json",
        _ => BYTES,
    }
}

const BYTES: &str = "application/octet-stream";

/// The page of the dashboard.
const PAGE: &str = "index.html";

/// Serves a file of the dashboard or the player; any other path without a route is "not found".
pub(super) async fn serve(
    State(app): State<Shared>,
    uri: Uri,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let path = uri.path().strip_prefix('/').unwrap_or(uri.path());
    let first = if app.is_viewer { PLAYER } else { PAGE };
    let found = WEB.get_file(if path.is_empty() { first } else { path });
    let asset = found.ok_or_else(|| Problem::of_status(StatusCode::NOT_FOUND))?;
    let digest = Sha256::digest(asset.contents());
    let tag: String = digest.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    let tag = format!("\"{tag}\"");
    let known = headers.get_all(header::IF_NONE_MATCH).iter().filter_map(|tags| tags.to_str().ok());
    let is_known = known.flat_map(|tags| tags.split(',')).any(|known| {
        let known = known.trim();
        known == "*" || known.strip_prefix("W/").unwrap_or(known) == tag
    });
    let mut response = if is_known {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        Response::new(Body::from(asset.contents()))
    };
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(content_type(asset)));
    // Browsers revalidate at every use; the reply is 304 until the program changes.
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    let tag = HeaderValue::try_from(tag).map_err(|error| Problem::internal(error.to_string()))?;
    headers.insert(header::ETAG, tag);
    Ok(response)
}

/// The paths that are served.
pub(super) fn paths() -> impl Iterator<Item = String> {
    WEB.files().map(|file| match file.path().to_string_lossy() {
        page if page == PAGE => "/".to_owned(),
        path => format!("/{path}"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        config::NAME_BYTES_MAX,
        control::{LENGTH_SECONDS_MAX, NAME_PART_BYTES_MAX, SECONDS_MAX, TEXT_BYTES_MAX},
        finished::NOTES_BYTES_MAX,
    };

    #[test]
    fn every_file_is_served_with_its_media_type() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../web");
        let mut files: Vec<_> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        files.sort();
        let served: Vec<_> = WEB.files().map(|file| file.path().to_str().unwrap()).collect();
        assert_eq!(served, files, "touch service/src/page.rs after a file was added");
        assert!(WEB.dirs().next().is_none() && WEB.files().all(|file| content_type(file) != BYTES));
        assert!(paths().any(|path| path == "/") && !paths().any(|path| path.contains("index")));
    }

    #[test]
    fn the_limits_of_the_page_are_those_of_the_service() {
        let page = WEB.get_file(PAGE).unwrap().contents_utf8().unwrap();
        for (id, attribute, limit) in [
            ("name", "data-bytes-max", NAME_BYTES_MAX),
            ("notes", "data-bytes-max", TEXT_BYTES_MAX),
            ("mark-text", "data-bytes-max", TEXT_BYTES_MAX),
            ("save-seconds", "max", SECONDS_MAX as usize),
            ("subject", "data-bytes-max", NAME_PART_BYTES_MAX),
            ("session", "data-bytes-max", NAME_PART_BYTES_MAX),
            ("trial", "data-bytes-max", NAME_PART_BYTES_MAX),
            ("length", "max", LENGTH_SECONDS_MAX as usize),
        ] {
            let field = page.lines().find(|line| line.contains(&format!("<input id=\"{id}\"")));
            let expected = format!(" {attribute}=\"{limit}\"");
            assert!(field.is_some_and(|field| field.contains(&expected)), "{id}: {field:?}");
        }
        let script = WEB.get_file("finished.js").unwrap().contents_utf8().unwrap();
        for (id, limit) in [("take-notes", NOTES_BYTES_MAX), ("take-name", NAME_BYTES_MAX)] {
            let field = script.lines().find(|line| line.contains(&format!("{{ id: \"{id}\"")));
            let expected = format!("\"data-bytes-max\": \"{limit}\"");
            assert!(field.is_some_and(|field| field.contains(&expected)), "{id}: {field:?}");
        }
    }
}
