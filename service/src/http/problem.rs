//! Errors as `application/problem+json` (RFC 9457).

use axum::{
    body::Body,
    http::{HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::control::Refusal;
pub use crate::control::RefusalKind as ProblemKind;

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

    pub(super) fn status_code(&self) -> StatusCode {
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
