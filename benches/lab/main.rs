//! The lab of `dense`: what an idea is worth, and where the bits go.
//!
//! `cargo bench --bench lab --features training -- FOLDER_OF_TAKES [--without WORD] [--keep FILE]
//! [--against FILE] [--prior FILE]`
//!
//! Codes every file of the folder at six tolerances in key blocks of ten seconds, and prints the geometric
//! mean of the ratio and the ideal code length of each kind of decision. To judge an idea: `--keep` the
//! bytes of the build without it, and hold the build with it `--against` them.
//!
//! `--prior` writes what the odds are before anything has been seen (`codec/src/dense/prior.bin`): the mean
//! odds and mixing weights of all files. They rest on the table that is compiled in, so that it settles
//! after two or three rounds. `--without` leaves files out whose names contain the word: how well the odds
//! of the others serve them is how much of a result is the table's doing.

#![expect(clippy::print_stdout, reason = "a tool that prints what it finds")]

mod prior;
mod report;
mod takes;

use std::path::PathBuf;

use anyhow::{Context, bail};

fn main() -> anyhow::Result<()> {
    let (mut folder, mut without) = (None, Vec::new());
    let (mut keep, mut against, mut prior) = (None, None, None);
    let mut args = std::env::args().skip(1).filter(|arg| arg != "--bench");
    while let Some(arg) = args.next() {
        let mut value = || args.next().with_context(|| format!("{arg} needs a value"));
        match arg.as_str() {
            "--without" => without.push(value()?),
            "--keep" => keep = Some(PathBuf::from(value()?)),
            "--against" => against = Some(PathBuf::from(value()?)),
            "--prior" => prior = Some(PathBuf::from(value()?)),
            _ if arg.starts_with("--") => bail!("there is no option {arg}"),
            _ => folder = Some(PathBuf::from(arg)),
        }
    }
    let Some(folder) = folder else { bail!("give the folder that holds the takes") };
    let cells = takes::measure(&folder, &without)?;
    println!("{}", report::ratios(&cells, against.as_deref())?);
    println!("{}", report::lengths(&cells)?);
    if let Some(file) = keep {
        std::fs::write(&file, report::to_keep(&cells))
            .with_context(|| format!("cannot write {}", file.display()))?;
    }
    if let Some(file) = prior {
        let tallies: Vec<_> = cells.into_iter().map(|cell| cell.tallies).collect();
        std::fs::write(&file, prior::table(&tallies))
            .with_context(|| format!("cannot write {}", file.display()))?;
    }
    Ok(())
}
