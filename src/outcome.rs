//! How a command ended, and its exit code.

use std::process::ExitCode;

/// The result of a command that ran to its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Outcome {
    /// Nothing was lost.
    Done,
    /// Done, but data was lost; the command has already reported which.
    DataLost,
    /// Done but for some files that failed; the command has already reported which and why.
    Failed,
}

impl Outcome {
    /// `DataLost` if `lost`, else `Done`.
    #[must_use]
    pub fn of(lost: bool) -> Self {
        if lost { Self::DataLost } else { Self::Done }
    }

    /// The worse of two.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        self.max(other)
    }
}

/// An invalid argument: exit code 2 instead of 1.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct UsageError(pub String);

/// The command was carried out, but data was lost: exit code 3 instead of 1.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct DataLostError(pub String);

/// Exit codes: 0 done, 1 failed, 2 usage error or invalid value, 3 done but data was lost.
#[must_use]
pub fn exit_code(result: &anyhow::Result<Outcome>) -> ExitCode {
    ExitCode::from(match result {
        Ok(Outcome::Done) => 0,
        Ok(Outcome::DataLost) => 3,
        Ok(Outcome::Failed) => 1,
        Err(error) if error.downcast_ref::<UsageError>().is_some() => 2,
        Err(error) if error.downcast_ref::<DataLostError>().is_some() => 3,
        Err(_) => 1,
    })
}
