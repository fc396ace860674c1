//! Bodies of requests: JSON, small, and received within a time limit; and the errors of requests as
//! `application/problem+json` (RFC 9457).

use axum::{
    body::{Body, Bytes, to_bytes},
    extract::{FromRequest, Request},
    http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use utoipa::ToSchema;

use super::Shared;
pub use crate::control::RefusalKind as ProblemKind;
use crate::{
    control::{self, Mark, Refusal, SaveLast, Start},
    finished::{EditNotes, Rename, Restore, Trash},
};

/// Largest body in bytes: many times the longest note that anybody types.
const BODY_BYTES_MAX: usize = 64 << 10;

/// Longest request id, in bytes.
const ID_BYTES_MAX: usize = 64;

const IDEMPOTENCY_KEY: HeaderName = HeaderName::from_static("idempotency-key");

/// A request with an id, which identifies repetitions.
pub(super) trait Identified: DeserializeOwned {
    fn request_id(&mut self) -> &mut Option<String>;
}

macro_rules! identified {
    ($($request:ty),*) => {$(
        impl Identified for $request {
            fn request_id(&mut self) -> &mut Option<String> {
                &mut self.request_id
            }
        }
    )*};
}

identified!(control::Request, Start, Mark, SaveLast, EditNotes, Rename, Restore, Trash);

/// A JSON object as the body; an empty body counts as an empty object.
#[derive(Debug)]
pub(super) struct JsonBody<T>(pub(super) T);

impl<T: Identified> FromRequest<Shared> for JsonBody<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, app: &Shared) -> Result<Self, Problem> {
        let (parts, body) = request.into_parts();
        // HTML forms of other sites cannot send this type.
        if !is_type(&parts.headers, "application/json") {
            let message = "send `content-type: application/json`, with or without a body";
            return Err(Problem::of(ProblemKind::UnsupportedMediaType, message));
        }
        let bytes = read(body, &parts.headers, app).await?;
        // serde would accept a list in place of an object.
        let mut request: T = match bytes.trim_ascii().first() {
            None if bytes.is_empty() => parse(b"{}")?,
            Some(b'{') => parse(&bytes)?,
            _ => return Err(Problem::invalid("the body is not a JSON object")),
        };
        let id = request.request_id();
        let key = parts.headers.get(IDEMPOTENCY_KEY).map(idempotency_key).transpose()?;
        match (key, id.as_deref()) {
            (Some(key), Some(id)) if key != id => {
                return Err(Problem::invalid("Idempotency-Key and request_id differ: send one"));
            }
            (Some(key), _) => *id = Some(key),
            (None, _) => {}
        }
        if id.as_deref().is_some_and(|id| !is_request_id(id)) {
            let message =
                format!("a request id has 1 to {ID_BYTES_MAX} printable ASCII characters");
            return Err(Problem::invalid(message));
        }
        Ok(Self(request))
    }
}

fn parse<T: DeserializeOwned>(text: &[u8]) -> Result<T, Problem> {
    serde_json::from_slice(text)
        .map_err(|error| Problem::invalid(format!("unexpected request body: {error}")))
}

/// The key in the header, with or without the quotes of the draft standard.
fn idempotency_key(value: &HeaderValue) -> Result<String, Problem> {
    let text = value.to_str().unwrap_or_default();
    let key = text.strip_prefix('"').and_then(|text| text.strip_suffix('"')).unwrap_or(text);
    if key.is_empty() {
        return Err(Problem::invalid("Idempotency-Key is empty or not ASCII"));
    }
    Ok(key.to_owned())
}

fn is_request_id(id: &str) -> bool {
    (1..=ID_BYTES_MAX).contains(&id.len()) && id.bytes().all(|byte| (b' '..=b'~').contains(&byte))
}

/// Whether the body is declared to be of this type, ignoring parameters.
pub(super) fn is_type(headers: &HeaderMap, media_type: &str) -> bool {
    let value = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok());
    value.is_some_and(|value| {
        value.split(';').next().unwrap_or_default().trim().eq_ignore_ascii_case(media_type)
    })
}

/// Reads the whole body, within its size and time limits.
pub(super) async fn read(body: Body, headers: &HeaderMap, app: &Shared) -> Result<Bytes, Problem> {
    let too_large = || {
        let message = format!("the body is larger than {BODY_BYTES_MAX} bytes");
        Problem::of(ProblemKind::TooLarge, message)
    };
    let value =
        headers.get(header::CONTENT_LENGTH).and_then(|value| value.to_str().ok()?.parse().ok());
    if value.is_some_and(|value: u64| value > BODY_BYTES_MAX as u64) {
        return Err(too_large());
    }
    match tokio::time::timeout(app.limits.body, to_bytes(body, BODY_BYTES_MAX)).await {
        Ok(Ok(bytes)) => Ok(bytes),
        Ok(Err(error)) if is_over_limit(&error) => Err(too_large()),
        Ok(Err(_)) => Err(Problem::invalid("the body ended early or is badly chunked")),
        Err(_) => Err(Problem::of(
            ProblemKind::Timeout,
            format!("the body did not arrive within {} s", app.limits.body.as_secs_f64()),
        )),
    }
}

fn is_over_limit(error: &axum::Error) -> bool {
    std::error::Error::source(error)
        .is_some_and(<dyn std::error::Error>::is::<http_body_util::LengthLimitError>)
}

pub(super) const PROBLEM_JSON: &str = "application/problem+json";

/// Why a request was not executed, and what to do. Every reply with a status of 400 or above is one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Problem {
    /// The HTTP status.
    pub status: u16,
    /// The kind of the reason.
    pub kind: ProblemKind,
    /// One line for people: what was found, and what to do.
    pub message: String,
}

impl Problem {
    pub(super) fn new(status: StatusCode, kind: ProblemKind, message: impl Into<String>) -> Self {
        Self { status: status.as_u16(), kind, message: message.into() }
    }

    /// A problem with the usual status of its kind.
    pub(super) fn of(kind: ProblemKind, message: impl Into<String>) -> Self {
        Refusal::new(kind, message).into()
    }

    pub(super) fn invalid(message: impl Into<String>) -> Self {
        Self::of(ProblemKind::Invalid, message)
    }

    pub(super) fn not_found(message: impl Into<String>) -> Self {
        Self::of(ProblemKind::NotFound, message)
    }

    pub(super) fn unavailable(message: impl Into<String>) -> Self {
        Self::of(ProblemKind::Unavailable, message)
    }

    pub(super) fn internal(message: impl Into<String>) -> Self {
        Self::of(ProblemKind::Internal, message)
    }

    /// The problem for an error response of axum or hyper, which has only a status.
    pub(super) fn of_status(status: StatusCode) -> Self {
        let (kind, message) = match status {
            StatusCode::NOT_FOUND => {
                (ProblemKind::NotFound, "not found: see /openapi.json for the routes")
            }
            StatusCode::METHOD_NOT_ALLOWED => {
                (ProblemKind::MethodNotAllowed, "method not allowed: see the Allow header")
            }
            StatusCode::PAYLOAD_TOO_LARGE => (ProblemKind::TooLarge, "the body is too large"),
            StatusCode::UNSUPPORTED_MEDIA_TYPE => {
                (ProblemKind::UnsupportedMediaType, "send application/json")
            }
            status if status.is_server_error() => {
                (ProblemKind::Internal, "internal error: please report this bug")
            }
            _ => (ProblemKind::Invalid, "invalid request"),
        };
        Self::new(status, kind, message)
    }

    fn status_code(&self) -> StatusCode {
        StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR)
    }
}

impl From<Refusal> for Problem {
    fn from(refusal: Refusal) -> Self {
        let status = match refusal.kind {
            ProblemKind::Invalid => StatusCode::BAD_REQUEST,
            ProblemKind::NotFound => StatusCode::NOT_FOUND,
            ProblemKind::Conflict | ProblemKind::Exists | ProblemKind::DataLost => {
                StatusCode::CONFLICT
            }
            // For the client, the service is a gateway to the device.
            ProblemKind::Device => StatusCode::BAD_GATEWAY,
            ProblemKind::Disk => StatusCode::INSUFFICIENT_STORAGE,
            ProblemKind::Vanished => StatusCode::GONE,
            ProblemKind::Unavailable => StatusCode::SERVICE_UNAVAILABLE,
            ProblemKind::Internal => StatusCode::INTERNAL_SERVER_ERROR,
            ProblemKind::Unauthorized => StatusCode::UNAUTHORIZED,
            ProblemKind::Forbidden => StatusCode::FORBIDDEN,
            ProblemKind::MethodNotAllowed => StatusCode::METHOD_NOT_ALLOWED,
            ProblemKind::Timeout => StatusCode::REQUEST_TIMEOUT,
            ProblemKind::TooLarge => StatusCode::PAYLOAD_TOO_LARGE,
            ProblemKind::UnsupportedMediaType => StatusCode::UNSUPPORTED_MEDIA_TYPE,
            ProblemKind::Range => StatusCode::RANGE_NOT_SATISFIABLE,
        };
        Self::new(status, refusal.kind, refusal.message)
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        // Strings and numbers can always be written as JSON.
        let body = serde_json::to_vec(&self).unwrap_or_default();
        let mut response = Response::new(Body::from(body));
        *response.status_mut() = self.status_code();
        response.extensions_mut().insert(self.clone());
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(PROBLEM_JSON));
        if self.status == StatusCode::SERVICE_UNAVAILABLE.as_u16() {
            headers.insert(header::RETRY_AFTER, HeaderValue::from_static("1"));
        }
        if self.status == StatusCode::UNAUTHORIZED.as_u16() {
            headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        response
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGE: &str = include_str!("../../../docs/api.md");

    #[test]
    fn the_page_has_every_kind_with_its_status() {
        let kinds = [
            ProblemKind::Invalid,
            ProblemKind::NotFound,
            ProblemKind::Conflict,
            ProblemKind::Exists,
            ProblemKind::Device,
            ProblemKind::Disk,
            ProblemKind::Vanished,
            ProblemKind::DataLost,
            ProblemKind::Unavailable,
            ProblemKind::Internal,
            ProblemKind::Unauthorized,
            ProblemKind::Forbidden,
            ProblemKind::MethodNotAllowed,
            ProblemKind::Timeout,
            ProblemKind::TooLarge,
            ProblemKind::UnsupportedMediaType,
            ProblemKind::Range,
        ];
        for kind in kinds {
            let problem = Problem::of(kind, "a message");
            let code = serde_json::to_value(problem.kind).unwrap();
            let row = format!("| `{}` | {}", code.as_str().unwrap(), problem.status);
            assert!(PAGE.contains(&row), "docs/api.md has no row {row}");
        }
    }
}
