//! The dashboard's files: the folder `web/`, compiled into the program.

use std::ffi::OsStr;

use axum::{
    body::Body,
    http::{HeaderMap, HeaderValue, StatusCode, Uri, header},
    response::{IntoResponse, Response},
};
use include_dir::{Dir, File, include_dir};
use sha2::{Digest, Sha256};

use super::problem::Problem;

/// The folder as it was when the program was built.
static WEB: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/../web");

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

/// The page that a browser opens.
const PAGE: &str = "index.html";

/// Serves a file of the dashboard; any other path without a route is "not found".
pub(super) async fn serve(uri: Uri, headers: HeaderMap) -> Result<Response, Problem> {
    let path = uri.path().strip_prefix('/').unwrap_or(uri.path());
    let found = WEB.get_file(if path.is_empty() { PAGE } else { path });
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
        control::{SECONDS_MAX, TEXT_BYTES_MAX},
    };

    #[test]
    fn every_file_of_the_folder_is_served_as_what_it_is() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../web");
        let mut files: Vec<_> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        files.sort();
        let served: Vec<_> = WEB.files().map(|file| file.path().to_str().unwrap()).collect();
        assert_eq!(served, files, "touch service/src/http/assets.rs after a file was added");
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
        ] {
            let field = page.lines().find(|line| line.contains(&format!("<input id=\"{id}\"")));
            let expected = format!(" {attribute}=\"{limit}\"");
            assert!(field.is_some_and(|field| field.contains(&expected)), "{id}: {field:?}");
        }
    }
}
