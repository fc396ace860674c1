//! What a configuration takes from where mocapd runs.

use std::{
    env,
    path::{Path, PathBuf},
};

/// Of the process and the file, what defaults depend on.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Surroundings {
    /// systemd's folder for what the service keeps.
    pub state_directory: Option<PathBuf>,
    /// systemd's folder for what is gone with the service.
    pub runtime_directory: Option<PathBuf>,
    /// The configuration's file name without its ending.
    pub file_stem: Option<String>,
}

impl Surroundings {
    /// Of this process and a file.
    #[must_use]
    pub fn of_process(file: &Path) -> Self {
        Self {
            state_directory: folder("STATE_DIRECTORY"),
            runtime_directory: folder("RUNTIME_DIRECTORY"),
            file_stem: file.file_stem().map(|stem| stem.to_string_lossy().into_owned()),
        }
    }
}

/// systemd gives more than one with colons between them: the first is the service's own. It writes UTF-8, and no
/// control character into it; whatever else somebody set cannot be written into a file.
fn folder(variable: &str) -> Option<PathBuf> {
    let value = env::var(variable).ok()?;
    let first = value.split(':').next().unwrap_or_default();
    (!first.is_empty() && !first.contains(char::is_control)).then(|| first.into())
}
