//! Takes that a kill or a power cut left without an end, closed again when the service starts.

use std::{
    io::BufWriter,
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::Context;
use mocapd_acquire::{
    files::{NewFile, SparseFile},
    header::SOFTWARE,
    health::TakeHealth,
};
use mocapd_take::recovery::{Survey, mend_start};

use super::{Inner, folder::summary_of};
use crate::status::{ServiceEventKind, TakeSummary};

/// Takes that are looked at: those of a bad day. Older ones are `mocapd recover`'s.
const TAKES_MAX: usize = 64;

/// Stands behind the name of a take that was closed again, and a dot before it.
const RECOVERED: &str = "recovered";

/// Recoveries of takes of one name: more are somebody's game.
const RECOVERED_MAX: u32 = 100;

/// Takes that are cut off, and have not been closed again. To be asked before a take is begun: one that is being written
/// has no end, either.
pub(super) fn cut_off(inner: &Inner) -> Vec<PathBuf> {
    let Ok(takes) = inner.list_takes(TAKES_MAX) else { return Vec::new() };
    let is_cut_off = |take: &TakeSummary| take.health == TakeHealth::CutOff && take.bytes > 0;
    let takes = takes.into_iter().filter(is_cut_off);
    let with_path = |take: TakeSummary| Some((inner.path_of(&take.name).ok()?, take.take_id));
    let is_recovered = |(path, take_id): &(PathBuf, String)| {
        recovered_paths(path).map_while(|path| summary_of(&path)).any(|it| it.take_id == *take_id)
    };
    let open = takes.filter_map(with_path).filter(|take| !is_recovered(take));
    open.map(|(path, _)| path).collect()
}

/// Where a recovery of it may be: another take of its name may have been recovered before.
fn recovered_paths(path: &Path) -> impl Iterator<Item = PathBuf> {
    (1..=RECOVERED_MAX).map(|number| {
        path.with_extension(match number {
            1 => format!("{RECOVERED}.take"),
            _ => format!("{RECOVERED}-{number}.take"),
        })
    })
}

/// Closes them, each beside itself: what was written is not touched.
pub(super) fn run(inner: &Arc<Inner>, takes: Vec<PathBuf>) {
    for path in takes {
        if inner.is_stopping() {
            return;
        }
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let output = recovered_paths(&path).find(|path| path.symlink_metadata().is_err());
        let Some(output) = output else { continue };
        match recover(&path, &output) {
            Ok(losses) => {
                let to = output.file_stem().unwrap_or_default().to_string_lossy();
                let message = format!("the take {name} was cut off, and is closed as {to}: {losses}");
                inner.publish(ServiceEventKind::Warning, &message, Some(&name));
            }
            Err(error) => {
                let message = format!("the take {name} is cut off and cannot be closed: {error:#}");
                inner.publish(ServiceEventKind::Warning, &message, Some(&name));
            }
        }
    }
}

fn recover(path: &Path, output: &Path) -> anyhow::Result<String> {
    let reading = || format!("cannot read {}", path.display());
    let (mut input, _) = mend_start(SparseFile::open(path)?).with_context(reading)?;
    let survey = Survey::read(&mut input).with_context(reading)?;
    let mut file = NewFile::create(output)?;
    survey.write(&mut input, BufWriter::new(&mut file), SOFTWARE)?;
    file.keep()?;
    let losses = survey.losses_in_words();
    Ok(if survey.lost_anything() { losses } else { "all that was written is there".to_owned() })
}
