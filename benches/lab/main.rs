//! Compression experiments with `dense`: the gain of a change to the codec, and the share of each kind of decision in
//! the bits.
//!
//! `cargo bench --bench lab --features training -- FOLDER_OF_TAKES [--without WORD] [--keep FILE]
//! [--against FILE] [--prior FILE]`
//!
//! Encodes every file of the folder at six tolerances in key blocks of ten seconds, and prints the geometric mean of
//! the compression ratio and the ideal code length of each kind of decision. To evaluate a change: `--keep` the bytes
//! of the build without it, then run the build with it `--against` them.
//!
//! `--prior` writes the initial probabilities of the model (`codec/src/dense/prior.bin`): the mean probabilities and
//! mixing weights over all files. They depend on the table that is compiled in, so the result converges after two or
//! three rounds of writing and rebuilding. `--without` leaves out the files whose names contain WORD. Encoded with the
//! table of the other files, they show the effect of the table.

#![expect(clippy::print_stdout, reason = "a tool that prints its result")]

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
            _ if arg.starts_with("--") => bail!("unknown option {arg}"),
            _ => folder = Some(PathBuf::from(arg)),
        }
    }
    let Some(folder) = folder else { bail!("give the folder that holds the takes") };
    let cells = takes::measure(&folder, &without)?;
    println!("{}", report::ratios(&cells, against.as_deref())?);
    println!("{}", report::lengths(&cells)?);
    if let Some(file) = keep {
        std::fs::write(&file, report::bytes(&cells))
            .with_context(|| format!("cannot write {}", file.display()))?;
    }
    if let Some(file) = prior {
        let tallies: Vec<_> = cells.into_iter().map(|cell| cell.tallies).collect();
        std::fs::write(&file, prior::table(&tallies))
            .with_context(|| format!("cannot write {}", file.display()))?;
    }
    Ok(())
}
