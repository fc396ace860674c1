//! Errors as Python has them, by what the caller can do about them. No panic gets past here.

use std::panic::{AssertUnwindSafe, catch_unwind};

use mocapd_codec::CodecError;
use pyo3::{
    PyErr, PyResult, Python,
    exceptions::{PyException, PyValueError},
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
        use mocapd_take::TakeError::{Codec, InvalidArgument, Io};
        match failure {
            Failure::Value(message)
            | Failure::Take(
                InvalidArgument(message) | Codec(CodecError::InvalidArgument(message)),
            ) => PyValueError::new_err(message),
            // OSError, and what of it the number says: FileNotFoundError, PermissionError.
            Failure::Take(Io(error)) => error.into(),
            Failure::Take(error) => TakeError::new_err(error.to_string()),
            Failure::Internal => TakeError::new_err(
                "a fault of mocapd itself, told on standard error: please report it, with the take",
            ),
        }
    }
}

/// Runs `work` without holding the interpreter, so that other threads of Python run on.
pub(crate) fn detached<T: Send>(
    py: Python<'_>,
    work: impl FnOnce() -> Result<T, Failure> + Send,
) -> PyResult<T> {
    let work = AssertUnwindSafe(work);
    let outcome = py.detach(|| catch_unwind(work).unwrap_or(Err(Failure::Internal)));
    Ok(outcome?)
}
