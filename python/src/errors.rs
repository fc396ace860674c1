//! Conversion of errors to Python exceptions, by what the caller can do about them.

use std::path::Path;

use mocapd_codec::CodecError;
use mocapd_store::StoreError;
use pyo3::{
    PyErr, Python,
    exceptions::{
        PyConnectionError, PyException, PyFileExistsError, PyFileNotFoundError, PyOSError,
        PyPermissionError, PyValueError,
    },
    types::PyAnyMethods,
};

pyo3::create_exception!(
    mocapd,
    TakeError,
    PyException,
    "A file that cannot be read as a take: not a take, a take of another version, or one with a damaged header."
);

/// The result of work that has not been converted to Python yet.
pub(crate) type Result<T, E = Failure> = std::result::Result<T, E>;

/// An error, before its conversion to an exception.
#[derive(Debug)]
pub(crate) enum Failure {
    Take(mocapd_take::TakeError),
    Value(String),
    /// Part of a take is damaged, with what cannot be read for it.
    Damaged(String),
    /// The take is closed.
    Closed,
    /// Not a plain file: `errno` and the reason.
    NotAFile(i32, &'static str),
    /// A store failed.
    Store(StoreError),
    /// A panic.
    Internal,
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
}

impl From<mocapd_take::TakeError> for Failure {
    fn from(error: mocapd_take::TakeError) -> Self {
        Self::Take(error)
    }
}

impl From<CodecError> for Failure {
    fn from(error: CodecError) -> Self {
        Self::Take(error.into())
    }
}

impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Self {
        Self::Take(error.into())
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        Python::attach(|py| failure.into_py_err(py, None))
    }
}

impl Failure {
    /// The exception for the take at `path`, which begins the message; bytes in memory have no path.
    pub(crate) fn into_py_err(self, py: Python<'_>, path: Option<&Path>) -> PyErr {
        use mocapd_take::TakeError::{Codec, InvalidArgument, Io};
        let named = |message: &str| match path {
            Some(path) => format!("{}: {message}", path.display()),
            None => message.to_owned(),
        };
        match self {
            Self::Value(message)
            | Self::Take(InvalidArgument(message) | Codec(CodecError::InvalidArgument(message))) => {
                PyValueError::new_err(message)
            }
            Self::Damaged(message) => TakeError::new_err(named(&message)),
            Self::Closed => PyValueError::new_err(named(
                "the take is closed: read inside the `with` block, or open it again with mocapd.open",
            )),
            Self::NotAFile(code, why) => os_error(code, why.to_owned(), path),
            Self::Store(error) => store_error(&error),
            Self::Take(Io(error)) if StoreError::of(&error).is_some() => {
                StoreError::of(&error).map_or_else(|| error.into(), |error| store_error(&error))
            }
            Self::Take(Io(error)) => match error.raw_os_error() {
                Some(code) => {
                    let text = py.import("os").and_then(|os| os.call_method1("strerror", (code,)));
                    let text = text.and_then(|text| text.extract());
                    os_error(code, text.unwrap_or_else(|_| error.to_string()), path)
                }
                None => error.into(),
            },
            Self::Take(error) => TakeError::new_err(named(&error.to_string())),
            Self::Internal => TakeError::new_err(named(
                "internal error, see standard error for details: please report it with the take",
            )),
        }
    }
}

/// The exception for an error of a store: a ConnectionError if the same call may succeed later.
fn store_error(error: &StoreError) -> PyErr {
    let message = error.to_string();
    match error {
        StoreError::NotFound(_) | StoreError::NoBucket(_) => PyFileNotFoundError::new_err(message),
        StoreError::Exists(_) => PyFileExistsError::new_err(message),
        StoreError::NoCredentials { .. } | StoreError::Forbidden { .. } => {
            PyPermissionError::new_err(message)
        }
        StoreError::InvalidUrl { .. } => PyValueError::new_err(message),
        error if error.is_temporary() => PyConnectionError::new_err(message),
        _ => PyOSError::new_err(message),
    }
}

/// An OSError, which Python makes a FileNotFoundError, PermissionError... by its number.
fn os_error(code: i32, text: String, path: Option<&Path>) -> PyErr {
    match path {
        Some(path) => PyOSError::new_err((code, text, path.to_string_lossy().into_owned())),
        None => PyOSError::new_err((code, text)),
    }
}
