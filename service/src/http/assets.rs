//! The dashboard: files of `web/`, in the program itself.

use axum::{
    body::Body,
    http::{HeaderMap, HeaderValue, StatusCode, Uri, header},
    response::{IntoResponse, Response},
};
use sha2::{Digest, Sha256};

use super::problem::Problem;

struct Asset {
    file: &'static str,
    bytes: &'static [u8],
}

macro_rules! asset {
    ($file:literal) => {
        Asset { file: $file, bytes: include_bytes!(concat!("../../../web/", $file)) }
    };
}

/// What is served. A test compares it with the folder.
const ASSETS: &[Asset] = &[
    asset!("actions.js"),
    asset!("api.js"),
    asset!("app.js"),
    asset!("camera.js"),
    asset!("dom.js"),
    asset!("events.js"),
    asset!("figures.js"),
    asset!("floor.js"),
    asset!("format.js"),
    asset!("hands.js"),
    asset!("history.js"),
    asset!("icon.svg"),
    asset!("index.html"),
    asset!("keys.js"),
    asset!("live.js"),
    asset!("login.js"),
    asset!("markers.js"),
    asset!("motion.js"),
    asset!("names.js"),
    asset!("panels.css"),
    asset!("scene.js"),
    asset!("state.js"),
    asset!("stream.js"),
    asset!("style.css"),
    asset!("takes.js"),
    asset!("tiles.js"),
    asset!("view.js"),
];

impl Asset {
    /// What it is by its name; `None` for what browsers would have to guess.
    fn content_type(&self) -> Option<&'static str> {
        Some(match self.file.rsplit_once('.')?.1 {
            "html" => "text/html; charset=utf-8",
            "js" => "text/javascript; charset=utf-8",
            "css" => "text/css; charset=utf-8",
            "svg" => "image/svg+xml",
            "png" => "image/png",
            "json" | "webmanifest" => "application/json",
            _ => return None,
        })
    }

    /// Whether it stands at this path: the page itself at the root.
    fn is_at(&self, path: &str) -> bool {
        let file = path.strip_prefix('/').unwrap_or(path);
        self.file == if file.is_empty() { PAGE } else { file }
    }
}

/// The page that a browser opens.
const PAGE: &str = "index.html";

/// A file of the dashboard; everything else that is no route is not there.
pub(super) async fn serve(uri: Uri, headers: HeaderMap) -> Result<Response, Problem> {
    let found = ASSETS.iter().find(|asset| asset.is_at(uri.path()));
    let asset = found.ok_or_else(|| Problem::of_status(StatusCode::NOT_FOUND, ""))?;
    let digest = Sha256::digest(asset.bytes);
    let tag: String = digest.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    let tag = format!("\"{tag}\"");
    let known = headers.get_all(header::IF_NONE_MATCH).iter().filter_map(|said| said.to_str().ok());
    let is_known = known.flat_map(|said| said.split(',')).any(|said| {
        let said = said.trim();
        said == "*" || said.strip_prefix("W/").unwrap_or(said) == tag
    });
    let mut response = if is_known {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        Response::new(Body::from(asset.bytes))
    };
    let headers = response.headers_mut();
    headers.insert(
        header::CONTENT_TYPE,
        HeaderValue::from_static(asset.content_type().unwrap_or("application/octet-stream")),
    );
    // Asked for again each time, and answered with 304 until the program is another.
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    let tag = HeaderValue::try_from(tag).map_err(|error| Problem::internal(error.to_string()))?;
    headers.insert(header::ETAG, tag);
    Ok(response)
}

/// The paths that are served.
pub(super) fn paths() -> impl Iterator<Item = String> {
    let path = |asset: &Asset| {
        if asset.file == PAGE { "/".to_owned() } else { format!("/{}", asset.file) }
    };
    ASSETS.iter().map(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_of_the_folder_is_served_as_what_it_is() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../web");
        let mut files: Vec<_> = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        files.sort();
        let served: Vec<_> = ASSETS.iter().map(|asset| asset.file.to_owned()).collect();
        assert_eq!(served, files, "put it into ASSETS, in order");
        assert!(ASSETS.iter().all(|asset| asset.content_type().is_some()));
        assert!(paths().any(|path| path == "/") && !paths().any(|path| path.contains("index")));
    }
}
