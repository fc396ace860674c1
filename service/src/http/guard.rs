//! Checks every request: its host name, its origin, and its authorization.
//!
//! A page on another site can make a browser send requests here, and a host name of its owner can be pointed here (DNS
//! rebinding). The first shows in `Origin` and `Sec-Fetch-Site`, the second in `Host`.

use std::{
    net::{IpAddr, Ipv6Addr},
    sync::Arc,
};

use axum::{
    extract::{Request, State},
    http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, Uri, header, uri::Authority},
    middleware::Next,
    response::{IntoResponse, Redirect, Response},
};

use super::{
    Counts, Shared, Via,
    auth::{self, LOGIN_PATH},
    body::{PROBLEM_JSON, Problem, ProblemKind},
    connection::ConnectionSlot,
};
use crate::page;

/// Longest path and query in bytes: the longest useful one has a percent-encoded take name.
const URI_BYTES_MAX: usize = 4096;

const SEC_FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");

/// Nothing from other origins, no inline code, no embedding in frames.
const CONTENT_SECURITY_POLICY: HeaderValue = HeaderValue::from_static(
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; font-src 'self'; \
     connect-src 'self'; worker-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'self'; \
     frame-ancestors 'none'",
);

/// Passes a request to its route, or refuses it.
pub(super) async fn guard(State(app): State<Shared>, request: Request, next: Next) -> Response {
    match check(&app, &request) {
        Ok(()) => next.run(request).await,
        Err(refused) => *refused,
    }
}

fn check(app: &Shared, request: &Request) -> Result<(), Box<Response>> {
    let refuse = |problem: Problem| Err(Box::new(problem.into_response()));
    let (uri, headers) = (request.uri(), request.headers());
    let value = uri.path_and_query().map_or(0, |value| value.as_str().len());
    if value > URI_BYTES_MAX {
        let message = format!("the path has {value} bytes; at most {URI_BYTES_MAX} are allowed");
        return refuse(Problem::new(StatusCode::URI_TOO_LONG, ProblemKind::TooLarge, message));
    }
    let via = request.extensions().get::<Via>().copied();
    let host = host(uri, headers);
    // Browsers cannot reach a Unix socket themselves; a proxy does, under its own name.
    if !matches!(via, Some(Via::Unix)) {
        match &host {
            Some(host) if is_known_host(host, via, &app.allowed_hosts.borrow()) => {}
            Some(host) => {
                let message = format!(
                    "unknown host name '{}'; add it to http.allowed_hosts if it is this service's",
                    host.host()
                );
                let (status, kind) = (StatusCode::MISDIRECTED_REQUEST, ProblemKind::Forbidden);
                return refuse(Problem::new(status, kind, message));
            }
            None => return refuse(Problem::invalid("the Host header is missing or invalid")),
        }
    }
    if changes(request.method())
        && let Err(problem) = same_site(headers, host.as_ref())
    {
        return refuse(problem);
    }
    let is_authorized = matches!(via, Some(Via::Unix)) || app.auth.is_authorized(headers);
    if is_authorized && let Some(slot) = request.extensions().get::<Arc<ConnectionSlot>>() {
        slot.authorize();
    }
    if is_authorized || is_open(uri.path()) || (app.is_viewer && page::is_file(uri.path())) {
        return Ok(());
    }
    if request.method() == Method::GET && auth::wants_html(headers) {
        return Err(Box::new(Redirect::to(LOGIN_PATH).into_response()));
    }
    let message = "a token is required: send `Authorization: Bearer …`, or log in at /login";
    refuse(Problem::of(ProblemKind::Unauthorized, message))
}

/// Paths that need no token: the login page with its files, and the health check.
fn is_open(path: &str) -> bool {
    matches!(path, "/login" | "/style.css" | "/icon.svg" | "/healthz")
}

fn changes(method: &Method) -> bool {
    !matches!(*method, Method::GET | Method::HEAD | Method::OPTIONS)
}

/// The host that the client addresses; `None` if it is missing, repeated or invalid.
fn host(uri: &Uri, headers: &HeaderMap) -> Option<Authority> {
    let mut hosts = headers.get_all(header::HOST).iter();
    let host = hosts.next()?;
    if hosts.next().is_some() || host.as_bytes().contains(&b'@') {
        return None;
    }
    let host: Authority = host.to_str().ok()?.parse().ok()?;
    match uri.authority() {
        // `GET http://host/ HTTP/1.1`, as sent to a proxy, must name the same host.
        Some(other) if !other.as_str().eq_ignore_ascii_case(host.as_str()) => None,
        _ => Some(host),
    }
}

/// Whether this is a host name of the service. Ports are ignored, because `ssh -L` changes them.
fn is_known_host(host: &Authority, via: Option<Via>, allowed: &[String]) -> bool {
    let name = host.host().trim_start_matches('[').trim_end_matches(']');
    let is_name = |known: &str| known.eq_ignore_ascii_case(name);
    if is_name("localhost") || allowed.iter().any(|allowed| is_name(allowed)) {
        return true;
    }
    let Ok(address) = name.parse::<IpAddr>() else { return false };
    let address = address.to_canonical();
    address == IpAddr::from([127, 0, 0, 1])
        || address == IpAddr::from(Ipv6Addr::LOCALHOST)
        || matches!(via, Some(Via::Tcp(local)) if local.ip().to_canonical() == address)
}

/// Refuses a changing request unless it comes from our own pages or from no page at all.
fn same_site(headers: &HeaderMap, host: Option<&Authority>) -> Result<(), Problem> {
    let forbidden = |message: String| Problem::of(ProblemKind::Forbidden, message);
    let mut origins = headers.get_all(header::ORIGIN).iter();
    if let Some(origin) = origins.next() {
        let value = origin.to_str().unwrap_or_default();
        let from = value.strip_prefix("http://").or_else(|| value.strip_prefix("https://"));
        let same = from
            .is_some_and(|from| host.is_some_and(|host| host.as_str().eq_ignore_ascii_case(from)));
        if !same || origins.next().is_some() {
            let origin = value.escape_default();
            return Err(forbidden(format!("pages of '{origin}' may not send commands")));
        }
    }
    match headers.get(SEC_FETCH_SITE).map(HeaderValue::as_bytes) {
        None | Some(b"same-origin" | b"none") => Ok(()),
        Some(_) => Err(forbidden("pages of other sites may not send commands".to_owned())),
    }
}

/// Turns every error response into a problem in JSON, or into a page for a browser, and adds security headers.
pub(super) async fn finish(State(app): State<Shared>, request: Request, next: Next) -> Response {
    let path = request.uri().path().to_owned();
    let is_api = path.starts_with("/v1/");
    let is_page = !is_api && auth::wants_html(request.headers());
    Counts::add(&app.counts.requests, 1);
    let mut response = next.run(request).await;
    let status = response.status();
    if status.is_client_error() || status.is_server_error() {
        Counts::add(&app.counts.requests_refused, 1);
        let kind = response.headers().get(header::CONTENT_TYPE);
        if kind.is_none_or(|kind| kind != PROBLEM_JSON) {
            let allow = response.headers().get(header::ALLOW).cloned();
            response = Problem::of_status(status).into_response();
            if let Some(allow) = allow {
                response.headers_mut().insert(header::ALLOW, allow);
            }
        }
        if is_page && let Some(problem) = response.extensions().get::<Problem>() {
            let page = auth::refusal(&path, problem).into_response();
            let headers = response.headers_mut();
            headers.remove(header::CONTENT_LENGTH);
            headers.extend(page.headers().clone());
            *response.body_mut() = page.into_body();
        }
    }
    let headers = response.headers_mut();
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    // Not `no-referrer`: with that, browsers send the form of /login with `Origin: null`, which would be refused.
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("same-origin"));
    headers.insert(header::CONTENT_SECURITY_POLICY, CONTENT_SECURITY_POLICY);
    let resource_policy = HeaderName::from_static("cross-origin-resource-policy");
    headers.insert(resource_policy, HeaderValue::from_static("same-origin"));
    if is_api {
        headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ours(host: &str, local: &str) -> bool {
        let via = Some(Via::Tcp(local.parse().unwrap()));
        is_known_host(&host.parse().unwrap(), via, &["rig.lab".to_owned()])
    }

    #[test]
    fn only_names_of_this_service_are_accepted() {
        for host in
            ["localhost", "LOCALHOST:1", "127.0.0.1:7060", "[::1]", "[::1]:80", "rig.lab:7060"]
        {
            assert!(ours(host, "127.0.0.1:7060"), "{host}");
        }
        for host in ["evil.example", "localhost.evil.example", "127.0.0.2", "10.0.0.5", "rig.lab.x"]
        {
            assert!(!ours(host, "127.0.0.1:7060"), "{host}");
        }
        assert!(ours("10.0.0.5:7060", "10.0.0.5:7060") && !ours("10.0.0.6", "10.0.0.5:7060"));
        assert!(ours("10.0.0.5", "[::ffff:10.0.0.5]:7060"), "a socket for both families");
    }

    #[test]
    fn host_and_uri_must_name_the_same_host() {
        let host_of = |uri: &str, hosts: &[&'static str]| {
            let headers =
                hosts.iter().map(|host| (header::HOST, HeaderValue::from_static(host))).collect();
            host(&uri.parse().unwrap(), &headers).map(|host| host.to_string())
        };
        assert_eq!(host_of("/", &["a:1"]).as_deref(), Some("a:1"));
        assert_eq!(host_of("http://a:1/", &["a:1"]).as_deref(), Some("a:1"));
        for (uri, hosts) in [
            ("/", &[][..]),
            ("/", &["a", "a"]),
            ("/", &["a b"]),
            ("/", &["u@a"]),
            ("/", &[""]),
            ("http://b/", &["a"]),
        ] {
            assert_eq!(host_of(uri, hosts), None, "{uri} {hosts:?}");
        }
    }

    #[test]
    fn pages_of_other_sites_change_nothing() {
        let host: Authority = "localhost:7060".parse().unwrap();
        let allowed = |headers: &[(HeaderName, &'static str)]| {
            let headers = headers
                .iter()
                .map(|(name, value)| (name.clone(), HeaderValue::from_static(value)))
                .collect();
            same_site(&headers, Some(&host)).is_ok()
        };
        assert!(allowed(&[]));
        assert!(allowed(&[(header::ORIGIN, "http://localhost:7060")]));
        assert!(allowed(&[
            (header::ORIGIN, "http://LOCALHOST:7060"),
            (SEC_FETCH_SITE, "same-origin")
        ]));
        for origin in [
            "null",
            "",
            "http://localhost",
            "http://evil.example",
            "http://localhost:7061",
            "file://localhost:7060",
            "http://localhost:7060.evil.example",
        ] {
            assert!(!allowed(&[(header::ORIGIN, origin)]), "{origin}");
        }
        for site in ["cross-site", "same-site", "what"] {
            assert!(!allowed(&[(SEC_FETCH_SITE, site)]), "{site}");
        }
        let twice = [(header::ORIGIN, "http://localhost:7060"), (header::ORIGIN, "http://evil")];
        assert!(!allowed(&twice));
    }
}
