//! Recovers takes that a kill or power cut left without an end, when the service starts.

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
use mocapd_take::recovery::{RecoveryScan, repair_start};

use super::{Inner, folder::summary_of, uploads};
use crate::status::{ServiceEventKind, TakeSummary};

/// Most takes that are recovered at startup. Older ones are left to `mocapd recover`.
const TAKES_MAX: usize = 64;

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
    let with_path = |take: TakeSummary| Some((inner.path_of(&take.name).ok()?, take.take_id));
    let is_recovered = |(path, take_id): &(PathBuf, String)| {
        recovered_paths(path).map_while(|path| summary_of(&path)).any(|it| it.take_id == *take_id)
    };
    let open = takes.filter_map(with_path).filter(|take| !is_recovered(take));
    open.map(|(path, _)| path).collect()
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
