//! Encodes the takes of a folder with `dense` at each tolerance.

use std::{
    path::{Path, PathBuf},
    sync::{
        Mutex,
        atomic::{AtomicUsize, Ordering},
    },
};

use anyhow::{Context, ensure};
use mocapd_codec::{GROUP_CHANNELS, Rows, Tolerance, training};
use mocapd_take::{
    interchange::Format,
    motion::{Motion, is_gap},
};

pub(crate) const TOLERANCES_MM: [f64; 6] = [0.1, 0.5, 1.0, 5.0, 10.0, 20.0];
/// Length of a key stretch of an import, in seconds.
const STRETCH_S: f64 = 10.0;

/// One file encoded at one tolerance: the tallies of its groups of channels.
pub(crate) struct Cell {
    pub(crate) file: String,
    pub(crate) tolerance_mm: f64,
    pub(crate) samples: usize,
    pub(crate) tallies: Vec<training::Tally>,
}

impl Cell {
    pub(crate) fn bytes(&self) -> usize {
        self.tallies.iter().map(|tally| tally.bytes).sum()
    }
}

struct Take {
    name: String,
    rate_hz: f64,
    columns: Vec<(Vec<[f32; 3]>, Vec<bool>)>,
}

/// Encodes every take of the folder except those whose names contain a string of `without`.
pub(crate) fn measure(folder: &Path, without: &[String]) -> anyhow::Result<Vec<Cell>> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .with_context(|| format!("cannot read {}", folder.display()))?
        .map(|entry| Ok(entry?.path()))
        .collect::<std::io::Result<_>>()?;
    files.sort();
    files.retain(|file| {
        let name = file.to_string_lossy();
        Format::from_extension(file).is_some() && !without.iter().any(|word| name.contains(word))
    });
    ensure!(!files.is_empty(), "{} holds no takes", folder.display());
    let takes = files.iter().map(|file| read(file)).collect::<anyhow::Result<Vec<_>>>()?;
    // Each cell is one job; one thread per processor takes the next job.
    let jobs: Vec<_> = takes.iter().flat_map(|take| TOLERANCES_MM.map(|mm| (take, mm))).collect();
    let (next, cells) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let work = || {
        while let Some(&(take, mm)) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
            let cell = encode(take, mm);
            if let Ok(mut cells) = cells.lock() {
                cells.push(cell);
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(work);
        }
    });
    let cells = cells.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    let mut cells = cells.into_iter().collect::<anyhow::Result<Vec<_>>>()?;
    cells.sort_by(|a, b| {
        (&a.file, a.tolerance_mm)
            .partial_cmp(&(&b.file, b.tolerance_mm))
            .unwrap_or(std::cmp::Ordering::Equal)
    });
    Ok(cells)
}

fn read(file: &Path) -> anyhow::Result<Take> {
    let format = Format::from_extension(file).context("unknown file extension")?;
    let motion = format.read(&std::fs::read(file)?)?;
    let n_markers = motion.info.markers.len();
    Ok(Take {
        name: file.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        rate_hz: motion.info.rate_hz,
        columns: (0..n_markers).map(|marker| column(&motion, marker)).collect(),
    })
}

fn column(motion: &Motion, marker: usize) -> (Vec<[f32; 3]>, Vec<bool>) {
    let positions = (0..motion.n_frames()).map(|frame| motion.frame(frame)[marker]);
    let positions: Vec<_> = positions.collect();
    let present = positions.iter().map(|&position| !is_gap(position)).collect();
    (positions, present)
}

fn encode(take: &Take, tolerance_mm: f64) -> anyhow::Result<Cell> {
    let stretch_rows = (STRETCH_S * take.rate_hz) as usize;
    let mut tallies = Vec::new();
    for group in take.columns.chunks(GROUP_CHANNELS) {
        let rows = group.iter().map(|(positions, present)| Rows::new(positions, present));
        let rows = rows.collect::<Result<Vec<_>, _>>()?;
        tallies.push(training::tally(Tolerance::from_mm(tolerance_mm)?, &rows, stretch_rows)?);
    }
    let present = take.columns.iter().flat_map(|(_, present)| present);
    let samples = present.filter(|&&present| present).count();
    Ok(Cell { file: take.name.clone(), tolerance_mm, samples, tallies })
}
