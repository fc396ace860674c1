//! Makes `codec/src/dense/prior.bin`: what the odds of `dense` are before it has seen anything.
//!
//! `cargo bench --bench prior --features training -- FOLDER_OF_TAKES [--without NAME] [--out FILE]`
//!
//! Codes every file of the folder at six tolerances, counts what each context saw, and writes the mean
//! odds and mixing weights. A file counts as at most 300 bits a context, so that long takes do not
//! decide alone. `--without` leaves files out whose names contain a word: how well the odds of
//! the others serve them is how much of a result is the table's doing.
//! The counts rest on the table that is compiled in, so it settles after two or three rounds.

#![expect(clippy::print_stderr, reason = "a tool that tells how far it is")]

use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use mocapd_codec::{GROUP_CHANNELS, Rows, Tolerance, training};
use mocapd_take::{
    interchange::Format,
    motion::{Motion, is_gap},
};

const TOLERANCES_MM: [f64; 6] = [0.1, 0.5, 1.0, 5.0, 10.0, 20.0];
/// Key stretches of an import.
const STRETCH_S: f64 = 10.0;
/// Most that a file counts for in one context, and in one mixer.
const BITS_MAX: (f64, f64) = (300.0, 2000.0);

/// Weighted sums of the tallies of all files.
#[derive(Default)]
struct Sums {
    contexts: Vec<[f64; 2]>,
    mixers: Vec<([f64; 3], f64)>,
}

impl Sums {
    fn add(&mut self, tally: &training::Tally) {
        self.contexts.resize(tally.contexts.len(), [0.0; 2]);
        self.mixers.resize(tally.mixers.len(), Default::default());
        for (sum, counts) in self.contexts.iter_mut().zip(&tally.contexts) {
            let bits = (counts[0] + counts[1]) as f64;
            let share = bits.min(BITS_MAX.0) / bits.max(1.0);
            sum[0] += counts[0] as f64 * share;
            sum[1] += counts[1] as f64 * share;
        }
        for ((sum, n), (weights, bits)) in self.mixers.iter_mut().zip(&tally.mixers) {
            let share = (*bits as f64).min(BITS_MAX.1) / (*bits as f64).max(1.0);
            for (sum, weight) in sum.iter_mut().zip(weights) {
                *sum += *weight as f64 * share;
            }
            *n += *bits as f64 * share;
        }
    }

    /// The layout that `codec/src/dense/prior.rs` states.
    fn table(&self) -> Vec<u8> {
        let odds = self.contexts.iter().map(|[unset, set]| {
            let bits = unset + set;
            let odds = (set + 0.4) / (bits + 0.8) * 256.0;
            if bits < 0.5 { 0 } else { odds.clamp(1.0, 255.0) as u8 }
        });
        let mut table: Vec<u8> = odds.collect();
        for (sum, n) in &self.mixers {
            for sum in sum {
                // 1 is 2^16 in the codec and 1024 in the table; 0.35 is where unseen mixers start.
                let weight = if *n > 0.0 { sum / n / 64.0 } else { 358.0 };
                table.extend((weight.round().clamp(-32000.0, 32000.0) as i16).to_le_bytes());
            }
        }
        table
    }
}

fn main() -> anyhow::Result<()> {
    let (mut folder, mut without, mut out) = (None, None, PathBuf::from("prior.bin"));
    let mut args = std::env::args().skip(1).filter(|arg| arg != "--bench");
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--without" => without = Some(args.next().context("--without needs a word")?),
            "--out" => out = args.next().context("--out needs a file")?.into(),
            _ => folder = Some(PathBuf::from(arg)),
        }
    }
    let Some(folder) = folder else { bail!("give the folder that holds the takes") };
    let mut sums = Sums::default();
    let mut files: Vec<_> = std::fs::read_dir(&folder)?
        .map(|entry| Ok(entry?.path()))
        .collect::<std::io::Result<_>>()?;
    files.sort();
    files.retain(|file| Format::from_extension(file).is_some());
    let is_out = |file: &Path| {
        without.as_ref().is_some_and(|word| file.to_string_lossy().contains(word.as_str()))
    };
    files.retain(|file| !is_out(file));
    ensure!(!files.is_empty(), "{} holds no takes", folder.display());
    for file in &files {
        eprintln!("{}", file.display());
        count(file, &mut sums)?;
    }
    std::fs::write(&out, sums.table()).with_context(|| format!("cannot write {}", out.display()))
}

fn count(file: &Path, sums: &mut Sums) -> anyhow::Result<()> {
    let format = Format::from_extension(file).context("no format")?;
    let motion = format.read(&std::fs::read(file)?)?;
    let n_markers = motion.info.markers.len();
    let columns: Vec<_> = (0..n_markers).map(|marker| column(&motion, marker)).collect();
    let stretch_rows = (STRETCH_S * motion.info.rate_hz) as usize;
    for tolerance_mm in TOLERANCES_MM {
        for group in columns.chunks(GROUP_CHANNELS) {
            let rows = group.iter().map(|(positions, present)| Rows::new(positions, present));
            let rows = rows.collect::<Result<Vec<_>, _>>()?;
            sums.add(&training::tally(Tolerance::from_mm(tolerance_mm)?, &rows, stretch_rows)?);
        }
    }
    Ok(())
}

fn column(motion: &Motion, marker: usize) -> (Vec<[f32; 3]>, Vec<bool>) {
    let positions = (0..motion.n_frames()).map(|frame| motion.frame(frame)[marker]);
    let positions: Vec<_> = positions.collect();
    let present = positions.iter().map(|&position| !is_gap(position)).collect();
    (positions, present)
}
