//! `plot quality`.

use std::path::PathBuf;

use mocapd::outcome::Outcome;
use mocapd_report::plot::{Quality, quality};

use super::picture;
use crate::cli::whole::{name, read_coded};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The take
    take: PathBuf,
    /// The picture to write, .svg or .png; it must not exist
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// The original: a .c3d, .trc, .tsv or .csv file, or another .take
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    picture::check_output(&args.output)?;
    let coded = read_coded(&args.take)?;
    let original = args.against.as_ref().map(|path| picture::original(&args.take, &coded, path));
    let original = original.transpose()?;
    let wanted = Quality {
        name: &name(&args.take),
        coded: &coded,
        original: original.as_ref().map(|(motion, _)| motion),
        original_settings: original.as_ref().and_then(|(_, settings)| *settings),
    };
    picture::write(&args.output, &quality(&wanted)?)?;
    Ok(picture::outcome(&coded))
}
