//! What went wrong, as `application/problem+json`.

use axum::{
    body::Body,
    http::{HeaderValue, StatusCode, header},
    response::{IntoResponse, Response},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::control::{Refusal, RefusalKind};

pub(super) const PROBLEM_JSON: &str = "application/problem+json";

/// Why a request was not carried out, and what to do. Every answer of 400 and above is one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct Problem {
    /// The HTTP status once more.
    pub status: u16,
    /// What kind of thing stands in the way.
    pub kind: ProblemKind,
    /// One line for people: what was found, and what to do.
    pub message: String,
}

/// Kinds of problems, by remedy: those of the service, and those of HTTP.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ProblemKind {
    /// The request makes no sense: change it.
    Invalid,
    /// There is no such thing.
    NotFound,
    /// Not in this state: do something else first.
    Conflict,
    /// A take of that name exists: choose another.
    Exists,
    /// The device is not there, or does not answer.
    Device,
    /// The disk is full, or failed.
    Disk,
    /// The take has ended, and no name leads to its file any more: the message says where it can be copied from.
    Vanished,
    /// The take has ended by itself, and data was lost: its file was cut short or its file system unmounted.
    DataLost,
    /// The service is stopping, or too busy: try again.
    Unavailable,
    /// A fault of this program.
    Internal,
    /// A token is needed.
    Unauthorized,
    /// From another site, or under a name that is not the service's.
    Forbidden,
    /// Something is there, but not with this method.
    MethodNotAllowed,
    /// The client took too long.
    Timeout,
    /// More bytes than are taken.
    TooLarge,
    /// Not in a form that is understood here.
    UnsupportedMediaType,
    /// The bytes asked for are not there.
    Range,
}

impl Problem {
    pub(super) fn new(status: StatusCode, kind: ProblemKind, message: impl Into<String>) -> Self {
        Self { status: status.as_u16(), kind, message: message.into() }
    }

    pub(super) fn invalid(message: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, ProblemKind::Invalid, message)
    }

    pub(super) fn not_found(message: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, ProblemKind::NotFound, message)
    }

    pub(super) fn unavailable(message: impl Into<String>) -> Self {
        Self::new(StatusCode::SERVICE_UNAVAILABLE, ProblemKind::Unavailable, message)
    }

    pub(super) fn internal(message: impl Into<String>) -> Self {
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, ProblemKind::Internal, message)
    }

    /// For an answer that axum or hyper made, which has a status and hardly a word.
    pub(super) fn of_status(status: StatusCode, said: &str) -> Self {
        let (kind, words) = match status {
            StatusCode::NOT_FOUND => {
                (ProblemKind::NotFound, "there is nothing here: see /openapi.json")
            }
            StatusCode::METHOD_NOT_ALLOWED => {
                (ProblemKind::MethodNotAllowed, "not with this method: see the header Allow")
            }
            StatusCode::PAYLOAD_TOO_LARGE => (ProblemKind::TooLarge, "the body is too large"),
            StatusCode::UNSUPPORTED_MEDIA_TYPE => {
                (ProblemKind::UnsupportedMediaType, "send application/json")
            }
            status if status.is_server_error() => {
                (ProblemKind::Internal, "this is a bug in mocapd")
            }
            _ => (ProblemKind::Invalid, "the request makes no sense"),
        };
        Self::new(status, kind, if said.is_empty() { words } else { said })
    }

    pub(super) fn status_code(&self) -> StatusCode {
        StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR)
    }
}

impl From<Refusal> for Problem {
    fn from(refusal: Refusal) -> Self {
        let (status, kind) = match refusal.kind {
            RefusalKind::Invalid => (StatusCode::BAD_REQUEST, ProblemKind::Invalid),
            RefusalKind::NotFound => (StatusCode::NOT_FOUND, ProblemKind::NotFound),
            RefusalKind::Conflict => (StatusCode::CONFLICT, ProblemKind::Conflict),
            RefusalKind::Exists => (StatusCode::CONFLICT, ProblemKind::Exists),
            // To the client the service is what stands before the device.
            RefusalKind::Device => (StatusCode::BAD_GATEWAY, ProblemKind::Device),
            RefusalKind::Disk => (StatusCode::INSUFFICIENT_STORAGE, ProblemKind::Disk),
            RefusalKind::Vanished => (StatusCode::GONE, ProblemKind::Vanished),
            RefusalKind::DataLost => (StatusCode::CONFLICT, ProblemKind::DataLost),
            RefusalKind::Unavailable => (StatusCode::SERVICE_UNAVAILABLE, ProblemKind::Unavailable),
            RefusalKind::Internal => (StatusCode::INTERNAL_SERVER_ERROR, ProblemKind::Internal),
        };
        Self::new(status, kind, refusal.message)
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        // Strings and numbers are always JSON.
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
