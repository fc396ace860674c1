//! Work on all bytes of a take in memory, for archives: checking it, and writing it again in fewer bytes.

use std::io::Cursor;

use mocapd_codec::{Effort, ResamplerKind, Settings, Tolerance};
use mocapd_take::{
    TakeTraversal,
    edit::{EditContext, RepackSettings, SourceTake, check_repacked, repack},
    import::IMPORTER_VERSION,
    traversal::Decode,
};
use pyo3::{prelude::*, types::PyBytes};

use crate::{
    background::{Cancel, run_detached},
    errors::{Failure, Result},
    foreign::scratch,
};

/// Reads and decodes every part of a take. Returns what is wrong with it as text.
#[pyfunction]
pub(crate) fn check_take(py: Python<'_>, data: &Bound<'_, PyBytes>) -> PyResult<Vec<String>> {
    let bytes = data.as_bytes();
    run_detached(py, None, |cancel| {
        let traversal = TakeTraversal::new(Cursor::new(bytes), Decode::All);
        let end = traversal.run(|_, _| Ok(cancel.check()?))?;
        let mut problems: Vec<String> = end.take.problems.iter().map(ToString::to_string).collect();
        if end.take.ledger.as_ref().is_some_and(|ledger| !ledger.closes()) {
            problems.push("its ledger does not add up".to_owned());
        }
        Ok(problems)
    })
}

/// Writes a take again, and compares the result. Returns None if it cannot be made smaller.
#[pyfunction]
pub(crate) fn repack_take<'py>(
    py: Python<'py>,
    data: &Bound<'py, PyBytes>,
) -> PyResult<Option<Bound<'py, PyBytes>>> {
    let bytes = data.as_bytes();
    let new = run_detached(py, None, |cancel| repacked(bytes, cancel))?;
    Ok(new.map(|new| PyBytes::new(py, &new)))
}

fn repacked(bytes: &[u8], cancel: &Cancel) -> Result<Option<Vec<u8>>> {
    let source = SourceTake::read(&mut Cursor::new(bytes))?;
    cancel.check()?;
    let lossless = RepackSettings {
        codec: Settings {
            kind: ResamplerKind::LosslessPredictive,
            tolerance: Tolerance::from_mm(Tolerance::MAX_MM)?,
        },
        effort: Effort::MIN,
        keys: None,
    };
    let is_lossless = source.map().header.codec()?.kind.is_lossless();
    let settings = is_lossless.then_some(&lossless);
    let software = format!("mocapd importer {IMPORTER_VERSION}");
    let context = EditContext { software: &software, new_scratch: &scratch, on_rows: &|_| {} };
    let mut new = Vec::new();
    repack(&source, Cursor::new(bytes), settings, &mut new, &context)?;
    if new.len() >= bytes.len() {
        return Ok(None);
    }
    cancel.check()?;
    match check_repacked(&source, Cursor::new(bytes), Cursor::new(&new), settings, &context)? {
        None => Ok(Some(new)),
        Some(difference) => Err(Failure::Damaged(format!(
            "the repacked take differs, so it is not stored ({difference}): please report this bug"
        ))),
    }
}
