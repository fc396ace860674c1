//! Recovers takes that a kill or power cut left without an end, when the service starts.

use std::{
    collections::HashSet,
    io::BufWriter,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use anyhow::Context;
use mocapd_acquire::{
    files::{NewFile, SparseFile},
    header::SOFTWARE,
    ledger::TakeHealth,
};
use mocapd_take::{
    record::EndingKind,
    recovery::{RecoveryScan, repair_start},
};

use super::{Inner, folder::summary_of, uploads};
use crate::{
    status::{ServiceEventKind, TakeSummary},
    take_files::trash,
};

/// Most takes that are recovered at startup. Older ones are left to `mocapd recover`.
const TAKES_MAX: usize = 64;

/// Newest takes among which those are looked for that were recovered already: as many summaries are cached.
const LISTED_MAX: usize = 4000;

/// Extension of recovered takes, before `.take`.
const RECOVERED: &str = "recovered";

/// Maximum number of recovered takes of one name.
const RECOVERED_MAX: u32 = 100;

/// Takes that are cut off and have not been recovered yet. Must be called before a take is started, because a take
/// in progress has no end either.
pub(super) fn cut_off(inner: &Inner) -> Vec<PathBuf> {
    let Ok(takes) = inner.list_takes(TAKES_MAX) else { return Vec::new() };
    let is_cut_off = |take: &TakeSummary| take.health == TakeHealth::CutOff && take.bytes > 0;
    // A recovered take that was uploaded and then removed here needs no other.
    let removed = uploads::removed_ids(&inner.core().options.take.directory);
    let takes =
        takes.into_iter().filter(is_cut_off).filter(|take| !removed.contains(&take.take_id));
    let cut_off: Vec<_> = takes.collect();
    if cut_off.is_empty() {
        return Vec::new();
    }
    let recovered = recovered_ids(inner);
    let open = cut_off.into_iter().filter(|take| !recovered.contains(&take.take_id));
    open.filter_map(|take| inner.path_of(&take.name).ok()).collect()
}

/// The ids of recovered takes, under whatever name, also in the trash.
fn recovered_ids(inner: &Inner) -> HashSet<String> {
    let folder = inner.core().options.take.directory.clone();
    let trashed = trash::trashed(&folder, Duration::ZERO, LISTED_MAX);
    let trash = folder.join(trash::TRASH);
    let trashed =
        trashed.iter().filter_map(|it| summary_of(&trash.join(format!("{}.take", it.id))));
    let listed = inner.list_takes(LISTED_MAX).unwrap_or_default();
    let is_recovered = |take: &TakeSummary| {
        take.health != TakeHealth::CutOff && take.ending == Some(EndingKind::CutOff)
    };
    let recovered = listed.into_iter().chain(trashed).filter(is_recovered);
    recovered.map(|take| take.take_id).filter(|id| !id.is_empty()).collect()
}

/// Possible paths of a recovered take: another take of the same name may have been recovered before.
fn recovered_paths(path: &Path) -> impl Iterator<Item = PathBuf> {
    (1..=RECOVERED_MAX).map(|number| {
        path.with_extension(match number {
            1 => format!("{RECOVERED}.take"),
            _ => format!("{RECOVERED}-{number}.take"),
        })
    })
}

/// Recovers each take into a new file; the original stays unchanged.
pub(super) fn run(inner: &Arc<Inner>, takes: Vec<PathBuf>) {
    for path in takes {
        if inner.is_stopping() {
            return;
        }
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        // Renamed or trashed since: it is looked at again with the next start.
        let Some(_claim) = inner.claims.claim(&name, "recovered") else { continue };
        if path.symlink_metadata().is_err() {
            continue;
        }
        let output = recovered_paths(&path).find(|path| path.symlink_metadata().is_err());
        let Some(output) = output else { continue };
        let message = match recover(&path, &output) {
            Ok(losses) => {
                let to = output.file_stem().unwrap_or_default().to_string_lossy();
                format!("the take {name} was cut off; recovered as {to}: {losses}")
            }
            Err(error) => format!("the take {name} is cut off; recovery failed: {error:#}"),
        };
        inner.publish(ServiceEventKind::Warning, &message, Some(&name));
    }
}

fn recover(path: &Path, output: &Path) -> anyhow::Result<String> {
    let reading = || format!("cannot read {}", path.display());
    let (mut input, _) = repair_start(SparseFile::open(path)?).with_context(reading)?;
    let scan = RecoveryScan::read(&mut input).with_context(reading)?;
    let mut file = NewFile::create(output)?;
    scan.write(&mut input, BufWriter::new(&mut file), SOFTWARE)?;
    file.keep()?;
    let losses = scan.loss_summary();
    Ok(if scan.lost_anything() { losses } else { "nothing that was written is lost".to_owned() })
}
