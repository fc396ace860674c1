//! Errors as Python has them, by what the caller can do about them. No panic gets past here.

use std::path::Path;

use mocapd_codec::CodecError;
use pyo3::{
    PyErr, Python,
    exceptions::{PyException, PyOSError, PyValueError},
    types::PyAnyMethods,
};

pyo3::create_exception!(
    mocapd,
    TakeError,
    PyException,
    "A take that cannot be read: not a take, of another version, or without a header that is whole."
);

/// What went wrong, before Python is asked for.
#[derive(Debug)]
pub(crate) enum Failure {
    Take(mocapd_take::TakeError),
    Value(String),
    /// What is there is not a file: the number of the error and why.
    NotAFile(i32, &'static str),
    Internal,
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
        Python::attach(|py| failure.of(py, None))
    }
}

impl Failure {
    /// Of the take at `path`, which the words begin with; bytes have no path.
    pub(crate) fn of(self, py: Python<'_>, path: Option<&Path>) -> PyErr {
        use mocapd_take::TakeError::{Codec, InvalidArgument, Io};
        let named = |message: String| match path {
            Some(path) => format!("{}: {message}", path.display()),
            None => message,
        };
        match self {
            Self::Value(message)
            | Self::Take(InvalidArgument(message) | Codec(CodecError::InvalidArgument(message))) => {
                PyValueError::new_err(message)
            }
            Self::NotAFile(code, why) => os_error(code, why.to_owned(), path),
            Self::Take(Io(error)) => match error.raw_os_error() {
                Some(code) => {
                    let words = py.import("os").and_then(|os| os.call_method1("strerror", (code,)));
                    let words = words.and_then(|words| words.extract());
                    os_error(code, words.unwrap_or_else(|_| error.to_string()), path)
                }
                None => error.into(),
            },
            Self::Take(error) => TakeError::new_err(named(error.to_string())),
            Self::Internal => TakeError::new_err(named(
                "a fault of mocapd itself, told on standard error: please report it, with the take"
                    .to_owned(),
            )),
        }
    }
}

/// OSError, and what of it the number says: FileNotFoundError, PermissionError.
fn os_error(code: i32, words: String, path: Option<&Path>) -> PyErr {
    match path {
        Some(path) => PyOSError::new_err((code, words, path.to_string_lossy().into_owned())),
        None => PyOSError::new_err((code, words)),
    }
}
