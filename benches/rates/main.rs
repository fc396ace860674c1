//! Bytes against sampling rate: one recorded motion, sampled at 60 to 1000 Hz and encoded as in a recording.
//!
//! `cargo bench --bench rates -- TAKE... [--plot FILE.svg] [--csv FILE]`
//!
//! A low-pass filter removes everything above 29 Hz from each take, so that every rate can represent the same motion.
//! The residual is the noise of the sensor: its level is measured, and white noise of this level is added to every
//! sample again. Prints Markdown. The bytes are those of the blocks; the framing of a stretch and its time line are
//! left out, because the bench `recorded` measures them.

#![expect(clippy::print_stdout, reason = "a tool that prints its result")]
#![expect(clippy::print_stderr, reason = "a tool that reports its progress")]

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

/// Seed of the noise, so that every run adds the same.
const SEED: u64 = 1;

const USAGE: &str = "use TAKE... [--plot FILE.svg] [--csv FILE]";

fn main() -> anyhow::Result<()> {
    let (mut takes, mut plot_to, mut csv_to) = (Vec::new(), None, None);
    let mut args = std::env::args().skip(1).filter(|arg| arg != "--bench");
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--plot" => plot_to = Some(args.next().context("--plot needs a file")?),
            "--csv" => csv_to = Some(args.next().context("--csv needs a file")?),
            option if option.starts_with('-') => bail!("unknown option {option}: {USAGE}"),
            _ => takes.push(PathBuf::from(arg)),
        }
    }
    ensure!(!takes.is_empty(), "name at least one .c3d, .trc, .tsv or .csv take: {USAGE}");
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
    let format = Format::from_extension(take).context("unknown file extension")?;
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
                    let size = coding::encode(&Settings { kind, tolerance }, &columns, rate_hz)?;
                    points.push(Point { kind, tolerance_mm, rate_hz, is_noisy, size });
                }
            }
        }
    }
    let name = take.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    Ok(Study::new(name, &motion, &smooth, noise, points))
}
