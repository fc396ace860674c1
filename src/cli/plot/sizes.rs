//! `plot sizes`: size of the take against the tolerance, by resampler.

use std::{
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use mocapd::outcome::Outcome;
use mocapd_acquire::{pipeline::offline, threads};
use mocapd_codec::{ResamplerKind, Settings, SplineVariant, Tolerance};
use mocapd_report::plot::{SizeLine, SizePanel, sizes};
use mocapd_take::motion::{Motion, is_gap};

use crate::cli::{
    batch::{self, FileKinds},
    motion_files::{AnalogSize, file_name, header_of, measure_analog, read_samples},
    output::Progress,
    plot,
    values::{self, count, rate},
};

/// Default tolerances, mm.
const TOLERANCES_MM: [f64; 8] = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0];

/// Longest motion coded with the published spline method, frames: its time grows faster than the number of frames.
const SPLINE_FRAMES_MAX: usize = 5000;

const RESAMPLERS: [ResamplerKind; 3] =
    [ResamplerKind::Dense, ResamplerKind::Fast, ResamplerKind::Spline(SplineVariant::WorstSample)];

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Takes, or .c3d, .trc, .tsv or .csv files, or folders with such files; each is a panel
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// With folders, also read the files in their subfolders
    #[arg(short, long)]
    recursive: bool,
    /// The plot to write, .svg or .png; it must not exist
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Tolerances to measure [default: 0.1mm,0.2mm,0.5mm,1mm,2mm,5mm,10mm,20mm]
    #[arg(long, value_name = "LENGTH,...", value_delimiter = ',', value_parser = values::tolerance)]
    tolerances: Vec<Tolerance>,
}

pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    plot::check_output(&args.output)?;
    let inputs = batch::inputs::find_named(&args.files, args.recursive, FileKinds::Both)?;
    let mut tolerances_mm: Vec<f64> = args.tolerances.iter().map(|t| t.mm()).collect();
    if tolerances_mm.is_empty() {
        tolerances_mm.extend(TOLERANCES_MM);
    }
    tolerances_mm.sort_by(f64::total_cmp);
    tolerances_mm.dedup();
    let mut panels = Vec::new();
    for input in inputs.all()? {
        panels.push(panel(&input.path, &tolerances_mm)?);
    }
    plot::write(&args.output, &sizes(&panels)?)?;
    Ok(Outcome::Done)
}

fn panel(path: &Path, tolerances_mm: &[f64]) -> anyhow::Result<SizePanel> {
    let (mut motion, source) = read_samples(path)?;
    // Foreign data and documents would add the same bytes to every size; those of analog samples are a line of their own.
    motion.info.subject = None;
    let analog = measure_analog(path, &mut motion)?;
    let n_frames = motion.n_frames();
    let samples = motion.positions_mm.iter().filter(|&&at| !is_gap(at)).count();
    let mut caption = format!(
        "{}, {}, {}",
        count(motion.info.markers.len() as u64, "marker"),
        count(n_frames as u64, "frame"),
        rate(motion.info.rate_hz)
    );
    if let Some(AnalogSize { samples, .. }) = analog {
        caption += &format!(", {}", count(samples, "analog sample"));
    }
    if let Some(source) = source.filter(|source| !source.kind.is_lossless()) {
        caption += &format!("; source already coded at {} mm", source.tolerance.mm());
    }
    let mut kinds = RESAMPLERS.to_vec();
    if n_frames > SPLINE_FRAMES_MAX {
        kinds.pop();
        caption += "; too long for spline";
    }
    let counter = Arc::new(AtomicU64::new(0));
    let settings = (kinds.len() * tolerances_mm.len() + 1) as u64;
    let total = settings * motion.positions_mm.len() as u64;
    let progress = Progress::follow("resampling", &counter, total);
    let level = |name: &str, bytes: u64| SizeLine {
        name: name.to_owned(),
        points: tolerances_mm.iter().map(|&mm| (mm, bytes)).collect(),
        is_level: true,
    };
    let mut lines = Vec::new();
    for kind in kinds {
        let mut points = Vec::new();
        for &mm in tolerances_mm {
            points.push((mm, file_bytes(path, &motion, kind, mm, &counter)?));
        }
        let name = kind.to_string().replace(":worst-sample", "");
        lines.push(SizeLine { name, points, is_level: false });
    }
    let lossless = file_bytes(path, &motion, ResamplerKind::LosslessPredictive, 1.0, &counter)?;
    lines.push(level("lossless", lossless));
    lines.push(level("float32", 12 * samples as u64));
    lines.extend(analog.map(|analog| level("analog", analog.bytes)));
    drop(progress);
    Ok(SizePanel { name: file_name(path), caption, lines })
}

/// The size of the whole take, bytes.
fn file_bytes(
    path: &Path,
    motion: &Motion,
    kind: ResamplerKind,
    tolerance_mm: f64,
    counter: &AtomicU64,
) -> anyhow::Result<u64> {
    let settings = Settings { kind, tolerance: Tolerance::from_mm(tolerance_mm)? };
    let header = header_of(&motion.info, path, &settings);
    let before = counter.load(Ordering::Relaxed);
    let workers = threads::default_workers();
    let (written, _) = offline::write_take(motion, &header, workers, counter, std::io::sink())?;
    // The writer counts samples continuously, or all at the end for a resampler that works on the whole motion.
    let after = before + motion.positions_mm.len() as u64;
    counter.store(after, Ordering::Relaxed);
    Ok(written.file_bytes)
}
