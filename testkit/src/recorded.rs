//! Recorded data, which is not part of the project: tests that need it are skipped where there is none, and say so.

use std::{
    env, fmt,
    io::{self, Write},
    panic::Location,
    path::PathBuf,
};

/// When this environment variable is `1`, a test that finds no data fails: `.ci/run` sets it where the data is there.
pub const REQUIRED: &str = "MOCAPD_DATA_REQUIRED";

/// A kind of recorded data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordedData {
    /// Takes of motion-capture systems, as C3D, TRC, TSV and CSV.
    Takes,
    /// Meshes of bodies, with joint centres that are known.
    Bodies,
    /// Photographs of faces, with landmarks that are known.
    Faces,
}

impl RecordedData {
    /// The environment variable that names its folder.
    #[must_use]
    pub fn variable(self) -> &'static str {
        match self {
            Self::Takes => "MOCAPD_TAKES",
            Self::Bodies => "MOCAPD_BODIES",
            Self::Faces => "MOCAPD_FACES",
        }
    }

    /// Its folder. Where there is none, the test that calls this is skipped: a line on standard error says which and why,
    /// also without `--nocapture`.
    ///
    /// # Panics
    /// When the variable names no folder; when it is not set although data is [required](REQUIRED).
    #[must_use]
    #[track_caller]
    pub fn folder(self) -> Option<PathBuf> {
        let variable = self.variable();
        let Some(folder) = env::var_os(variable).filter(|folder| !folder.is_empty()) else {
            let is_required = env::var_os(REQUIRED).is_some_and(|value| value == "1");
            assert!(
                !is_required,
                "{REQUIRED} is 1, and {variable} is not set to the folder of {self}"
            );
            let place = Location::caller();
            // Not `eprintln!`, which the test harness keeps to itself when the test passes.
            let line = format!("skipped: {place}: {variable} is not set to a folder of {self}\n");
            io::stderr().write_all(line.as_bytes()).ok();
            return None;
        };
        let folder = PathBuf::from(folder);
        assert!(folder.is_dir(), "{variable} is {}, which is no folder", folder.display());
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
