//! What a higher rate costs: one recorded motion, sampled at 60 to 1000 Hz, coded as a recording codes it.
//!
//! `cargo bench --bench rates -- TAKE... [--plot FILE.svg] [--csv FILE]`
//!
//! Each take is smoothed until nothing is left above 29 Hz, so that every rate can carry the same motion.
//! What the smoothing took away is the sensor's noise: it is measured, and added to every sample anew.
//! Prints Markdown. The bytes are those of the blocks; what frames a stretch and its time line are left
//! out, and measured by the bench `recorded`.

#![expect(clippy::print_stdout, reason = "a tool that prints its result")]
#![expect(clippy::print_stderr, reason = "a tool that tells how far it is")]

mod coding;
mod low_pass;
mod noise;
mod plot;
mod report;
mod smooth;

use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use mocapd_codec::{ResamplerKind, Settings, Tolerance};
use mocapd_take::interchange::Format;

use self::{
    noise::Noise,
    report::{Point, Study},
    smooth::Smooth,
};

const RATES_HZ: [f64; 5] = [60.0, 120.0, 240.0, 500.0, 1000.0];
const TOLERANCES_MM: [f64; 3] = [0.5, 1.0, 5.0];
const RESAMPLERS: [ResamplerKind; 2] = [ResamplerKind::Dense, ResamplerKind::Fast];

/// The noise is the same in every run.
const SEED: u64 = 1;

const USAGE: &str = "use TAKE... [--plot FILE.svg] [--csv FILE]";

fn main() -> anyhow::Result<()> {
    let (mut takes, mut plot_to, mut csv_to) = (Vec::new(), None, None);
    let mut args = std::env::args().skip(1).filter(|arg| arg != "--bench");
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--plot" => plot_to = Some(args.next().context("--plot needs a file")?),
            "--csv" => csv_to = Some(args.next().context("--csv needs a file")?),
            word if word.starts_with('-') => bail!("unknown option {word}: {USAGE}"),
            _ => takes.push(PathBuf::from(arg)),
        }
    }
    ensure!(!takes.is_empty(), "no .c3d, .trc, .tsv or .csv take is given: {USAGE}");
    let mut studies = Vec::new();
    for take in &takes {
        eprintln!("{}", take.display());
        let study = study(take).with_context(|| take.display().to_string())?;
        println!("{}", report::markdown(&study));
        studies.push(study);
    }
    if let Some(file) = csv_to {
        std::fs::write(&file, report::csv(&studies))
            .with_context(|| format!("cannot write {file}"))?;
    }
    if let Some(file) = plot_to {
        std::fs::write(&file, plot::svg(&studies)?)
            .with_context(|| format!("cannot write {file}"))?;
    }
    Ok(())
}

fn study(take: &Path) -> anyhow::Result<Study> {
    let format = Format::from_extension(take).context("no known ending")?;
    let motion = format.read(&std::fs::read(take)?)?;
    let smooth = Smooth::new(&motion)?;
    let noise = Noise::measure(&smooth);
    let mut points = Vec::new();
    for rate_hz in RATES_HZ {
        for is_noisy in [false, true] {
            let mut columns = smooth.sampled(rate_hz);
            if is_noisy {
                noise.add_to(&mut columns, SEED);
            }
            for kind in RESAMPLERS {
                for tolerance_mm in TOLERANCES_MM {
                    let tolerance = Tolerance::from_mm(tolerance_mm)?;
                    let coded = coding::code(&Settings { kind, tolerance }, &columns, rate_hz)?;
                    points.push(Point { kind, tolerance_mm, rate_hz, is_noisy, coded });
                }
            }
        }
    }
    let name = take.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    Ok(Study::new(name, &motion, &smooth, noise, points))
}
