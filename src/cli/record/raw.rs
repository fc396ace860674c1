//! `--raw`: a log of the line beside the take.

use std::path::Path;

use mocapd::raw_log::{RawLog, Tap};

use crate::cli::{numbers::bytes, output::say};

/// Records with a log where one is asked for. With what came of it: whether the log has less than the line.
///
/// # Errors
/// Those of the recording, and that no log can be made. A log that ends early is told, and the take stays.
pub(super) fn with_log<T>(
    path: Option<&Path>,
    record: impl FnOnce(Option<Tap>) -> anyhow::Result<T>,
) -> anyhow::Result<(T, bool)> {
    let Some(path) = path else { return record(None).map(|recorded| (recorded, false)) };
    let log = RawLog::start(path)?;
    let recorded = record(Some(log.tap()));
    let logged = log.finish();
    if recorded.is_err() && logged.as_ref().is_ok_and(|logged| logged.line_bytes == 0) {
        // Nothing was said: a log of it helps nobody.
        std::fs::remove_file(path).ok();
    }
    let recorded = recorded?;
    Ok((
        recorded,
        match logged {
            Ok(logged) if logged.missing_bytes == 0 => false,
            Ok(logged) => {
                let missing = bytes(logged.missing_bytes);
                say(&format!("{missing} of the line are not in the raw log: its disk is too slow"));
                true
            }
            Err(error) => {
                say(&format!("{error:#}"));
                true
            }
        },
    ))
}
