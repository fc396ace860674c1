//! `mocapd-sim generate`: writes a data set of jumps.

use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use mocapd_simulator::generator::{JumpSet, JumpSpec, SetJump};
use mocapd_take::interchange::Format;
use mocapd_take::motion::MotionFrames;

use super::{Failure, length_mm};

#[derive(Debug, Args)]
pub(super) struct GenerateArgs {
    /// New folder for the C3D files and phases.csv
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Number of subjects, each with its own body and style.
    #[arg(long, value_name = "N", default_value_t = 10)]
    subjects: u32,
    /// Total number of jumps, divided evenly among the subjects.
    #[arg(long, value_name = "N", default_value_t = 326)]
    jumps: u32,
    /// Frames per second.
    #[arg(long, value_name = "HZ", default_value_t = 60.0)]
    rate: f64,
    /// Seed of subjects, movements and noise.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Standard deviation of the noise on each axis [default: 0.05mm].
    #[arg(long, value_name = "LENGTH", value_parser = length_mm)]
    noise: Option<f64>,
}

pub(super) fn run(args: &GenerateArgs) -> Result<(), Failure> {
    let mut spec = JumpSpec::new(args.seed, args.rate);
    spec.noise_mm = args.noise.unwrap_or(spec.noise_mm);
    let set = JumpSet::new(spec, args.subjects, args.jumps).map_err(Failure::usage)?;
    // A trial run: a refused value must not leave an empty folder behind.
    spec.generate().map_err(Failure::usage)?;
    fs::create_dir(&args.out)
        .with_context(|| format!("cannot create the folder {}", args.out.display()))?;
    let mut phases = "file,phase,first_frame\n".to_owned();
    for jump in set.jumps() {
        let SetJump { subject, trial, jump } = jump.map_err(Failure::usage)?;
        let name = format!("subject-{subject:02}-jump-{trial:02}.c3d");
        for (phase, first_frame) in &jump.phases {
            writeln!(phases, "{name},{},{first_frame}", phase.name())?;
        }
        write(&args.out.join(&name), |out| {
            Ok(Format::C3d.write(&mut MotionFrames::new(&jump.motion), out)?)
        })?;
    }
    write(&args.out.join("phases.csv"), |out| Ok(out.write_all(phases.as_bytes())?))?;
    Ok(())
}

fn write(path: &Path, content: impl FnOnce(&mut dyn Write) -> Result<()>) -> Result<()> {
    let writing = || format!("cannot write {}", path.display());
    let mut out = BufWriter::new(File::create_new(path).with_context(writing)?);
    content(&mut out).with_context(writing)?;
    out.flush().with_context(writing)
}
