//! `bench codec`: sizes, errors and speeds of every resampler on files of one's own.

mod measure;
mod report;

use std::path::PathBuf;

use mocapd::outcome::Outcome;
use mocapd_codec::{ResamplerKind, Settings, SplineVariant, Tolerance};
use mocapd_service::units;

use self::{
    measure::{Subject, measure},
    report::{FileReport, Report},
};
use crate::cli::{
    original::read_motion,
    output::{print, print_json, say},
};

/// What the tables of docs/benchmarks.md are made for.
const TOLERANCES_MM: [f64; 6] = [0.1, 0.5, 1.0, 5.0, 10.0, 20.0];

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// .c3d, .trc, .tsv (QTM) or .csv files; their marker trajectories alone are coded
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// A resampler; may be given several times [default: dense, fast, lossless, spline, sync]
    #[arg(long = "resampler", value_name = "NAME", value_parser = str::parse::<ResamplerKind>)]
    resamplers: Vec<ResamplerKind>,
    /// A tolerance; may be given several times [default: 0.1 0.5 1 5 10 20 mm]
    #[arg(long = "tolerance", value_name = "LENGTH", value_parser = units::tolerance)]
    tolerances: Vec<Tolerance>,
    /// Measurements of each speed, of 20 ms or one run at least; the median counts
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u8).range(1..=20))]
    repeats: u8,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let mut report = Report::default();
    let settings = all_settings(args)?;
    for file in &args.files {
        let mut motion = read_motion(file)?;
        motion.info.foreign.clear();
        let subject = Subject { file, motion: &motion };
        let mut about = FileReport::new(&subject);
        if !args.json {
            print(&about.head())?;
        }
        for codec in &settings {
            // An exhaustive search that a long run refuses is no reason to stop.
            match measure(&subject, codec, args.repeats) {
                Ok(result) => {
                    if !args.json {
                        print(&result.line())?;
                    }
                    about.results.push(result);
                }
                Err(error) => say(&format!("{}: {}: {error:#}", file.display(), codec.kind)),
            }
        }
        report.files.push(about);
    }
    if args.json {
        print_json(&report)?;
    }
    Ok(Outcome::of(false))
}

/// Lossless once, everything else at every tolerance.
fn all_settings(args: &Args) -> anyhow::Result<Vec<Settings>> {
    let mut resamplers = args.resamplers.clone();
    if resamplers.is_empty() {
        resamplers = vec![
            ResamplerKind::Dense,
            ResamplerKind::Fast,
            ResamplerKind::Lossless,
            ResamplerKind::Spline(SplineVariant::WorstSample),
            ResamplerKind::Sync(SplineVariant::WorstSample),
        ];
    }
    let mut tolerances = args.tolerances.clone();
    if tolerances.is_empty() {
        tolerances = TOLERANCES_MM.into_iter().map(Tolerance::from_mm).collect::<Result<_, _>>()?;
    }
    let mut settings = Vec::new();
    for kind in resamplers {
        let n = if kind.is_lossless() { 1 } else { tolerances.len() };
        settings.extend(tolerances[..n].iter().map(|&tolerance| Settings { kind, tolerance }));
    }
    Ok(settings)
}
