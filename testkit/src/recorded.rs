//! Recorded data, which is not part of the project. Tests that need it are skipped without it, with a message.

use std::{
    env, fmt,
    io::{self, Write},
    panic::Location,
    path::PathBuf,
};

/// If this environment variable is `1`, tests without their data fail. `.ci/run` sets it on machines that have the
/// data.
pub const REQUIRED: &str = "MOCAPD_DATA_REQUIRED";

/// A kind of recorded data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordedData {
    /// Takes of motion-capture systems, as C3D, TRC, TSV and CSV.
    Takes,
    /// Meshes of bodies with known joint centres.
    Bodies,
    /// Photographs of faces with known landmarks.
    Faces,
}

impl RecordedData {
    /// The environment variable that names the folder.
    #[must_use]
    pub fn variable(self) -> &'static str {
        match self {
            Self::Takes => "MOCAPD_TAKES",
            Self::Bodies => "MOCAPD_BODIES",
            Self::Faces => "MOCAPD_FACES",
        }
    }

    /// The folder of the data; `None` if it is not set, in which case the calling test should return. A line on
    /// standard error then reports the skipped test, even without `--nocapture`.
    ///
    /// # Panics
    /// When the variable does not name a folder, or is not set although data is [required](REQUIRED).
    #[must_use]
    #[track_caller]
    pub fn folder(self) -> Option<PathBuf> {
        let variable = self.variable();
        let Some(folder) = env::var_os(variable).filter(|folder| !folder.is_empty()) else {
            let is_required = env::var_os(REQUIRED).is_some_and(|value| value == "1");
            assert!(
                !is_required,
                "{REQUIRED} is 1, but {variable} is not set to the folder of {self}"
            );
            let place = Location::caller();
            // Not `eprintln!`, whose output the test harness hides when the test passes.
            let line = format!("skipped: {place}: {variable} is not set to a folder of {self}\n");
            io::stderr().write_all(line.as_bytes()).ok();
            return None;
        };
        let folder = PathBuf::from(folder);
        assert!(folder.is_dir(), "{variable} is {}, which is not a folder", folder.display());
        Some(folder)
    }
}

impl fmt::Display for RecordedData {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Takes => "recorded takes",
            Self::Bodies => "bodies with known joints",
            Self::Faces => "photographs with known landmarks",
        })
    }
}
