//! The trials of a study: read, and divided into phases.

use std::{
    collections::BTreeMap,
    io::Read,
    path::{Path, PathBuf},
};

use anyhow::Context;
use mocapd::outcome::UsageError;
use mocapd_acquire::files;
use mocapd_report::{
    phases::{self, Phase},
    study::Trial,
};
use mocapd_take::escape::to_cell;

use crate::cli::{
    output::say,
    whole::{name, read_samples},
};

/// Most bytes of a file of phases: a hundred thousand trials.
const PHASES_BYTES_MAX: u64 = 1 << 26;

type Given = BTreeMap<String, Vec<(Phase, usize)>>;

/// Reads every file, and finds its phases where `given` does not say them.
///
/// # Errors
/// The first file that cannot be read; a usage error for phases of files that are not there.
pub(super) fn trials(paths: &[PathBuf], given: Option<&Path>) -> anyhow::Result<Vec<Trial>> {
    let given = given.map(read_phases).transpose()?.unwrap_or_default();
    let names: Vec<String> = paths.iter().map(|path| name(path)).collect();
    if let Some(stranger) = given.keys().find(|file| !names.contains(file)) {
        return Err(UsageError(format!(
            "the phases tell of {stranger}, which is not among the files: add it, or take its lines out"
        ))
        .into());
    }
    paths.iter().zip(names).map(|(path, name)| trial(path, name, &given)).collect()
}

fn trial(path: &Path, name: String, given: &Given) -> anyhow::Result<Trial> {
    let (motion, settings) = read_samples(path)?;
    if let Some(settings) = settings.filter(|settings| !settings.kind.is_lossless()) {
        say(&format!(
            "{}: a take within {} mm: its reconstruction is studied, not its original",
            path.display(),
            settings.tolerance.mm()
        ));
    }
    let starts = match given.get(&name) {
        Some(starts) => Ok(starts.clone()),
        None => phases::find(&motion).map_err(|none| none.0),
    };
    if let Err(why) = &starts {
        say(&format!("{}: no phases, only the whole is studied: {why}", path.display()));
    }
    let phases = starts.map(|starts| phases::parts(&starts, motion.n_frames()));
    Ok(Trial { name, motion, phases })
}

fn read_phases(path: &Path) -> anyhow::Result<Given> {
    let reading = || format!("cannot read {}", path.display());
    let mut text = String::new();
    files::open(path)?.take(PHASES_BYTES_MAX).read_to_string(&mut text).with_context(reading)?;
    phases::parse(&text).map_err(|error| UsageError(format!("{}: {error}", path.display())).into())
}

/// The phases that were used, in the form in which they can be given.
pub(super) fn phases_csv(trials: &[Trial]) -> String {
    let mut out = "file,phase,first_frame\n".to_owned();
    for trial in trials {
        for part in trial.phases.iter().flatten() {
            let name = to_cell(&trial.name);
            out += &format!("{name},{},{}\n", part.phase.name(), part.frames.start);
        }
    }
    out
}
