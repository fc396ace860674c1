//! Speed and peak memory of `mocapd export`: a long generated take, converted to each format.
//!
//! `cargo bench --bench exports -- [--seconds 3600] [--markers 64] [--rate 240] [--tolerance 1mm]
//!     [--resamplers dense,fast,lossless] [--formats c3d,npz,xdf,csv,tsv,trc,bids]`
//!
//! The take is generated from a seed and written at full speed by the encoder of `mocapd import`. MB/s is the size of
//! the exported file divided by the elapsed time, which includes the sync of the file. Memory is the peak resident set
//! of the process.

#![expect(clippy::print_stdout, reason = "a tool that prints its result")]
#![expect(clippy::print_stderr, reason = "a tool that reports its progress")]

use std::{
    fs::{self, File},
    io::BufWriter,
    path::{Path, PathBuf},
    process::{Child, Command},
    sync::atomic::AtomicU64,
    time::{Duration, Instant},
};

use anyhow::{Context, bail, ensure};
use mocapd_acquire::{header, pipeline::offline, threads};
use mocapd_codec::{ResamplerKind, Settings, Tolerance};
use mocapd_service::units;
use mocapd_simulator::generator::{JumpSpec, Occlusion};
use mocapd_take::motion::Motion;

const MOCAPD: &str = env!("CARGO_BIN_EXE_mocapd");
/// Interval at which the memory and processor time of the export are read.
const POLL_INTERVAL: Duration = Duration::from_millis(5);

struct Args {
    spec: JumpSpec,
    tolerance_mm: f64,
    resamplers: Vec<String>,
    formats: Vec<String>,
}

fn main() -> anyhow::Result<()> {
    let args = parse()?;
    let (markers, rate_hz) = (args.spec.n_markers, args.spec.rate_hz);
    let seconds = args.spec.seconds.unwrap_or_default();
    let folder = tempfile::Builder::new().prefix("mocapd-exports").tempdir_in(".")?;
    eprintln!("generating {seconds} s of {markers} markers at {rate_hz} Hz");
    let motion = args.spec.generate()?.motion;
    let mut takes = Vec::new();
    for name in &args.resamplers {
        eprintln!("encoding with {name}");
        let take = folder.path().join(format!("{name}.take"));
        let bytes = encode(&motion, name, args.tolerance_mm, &take)?;
        takes.push((name, take, bytes));
    }
    drop(motion);
    println!("{seconds} s of {markers} markers at {rate_hz} Hz, {} mm\n", args.tolerance_mm);
    println!(
        "| take | its bytes | to | bytes | seconds | MB/s | processor seconds | memory, MiB |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for (name, take, take_bytes) in &takes {
        for format in &args.formats {
            let Run { bytes, seconds, busy_s, memory_bytes } = export(take, format)?;
            println!(
                "| {name} | {take_bytes} | {format} | {bytes} | {seconds:.2} | {:.0} | {busy_s:.2} | {:.0} |",
                bytes as f64 / 1e6 / seconds,
                memory_bytes as f64 / f64::from(1 << 20),
            );
        }
    }
    Ok(())
}

fn parse() -> anyhow::Result<Args> {
    let occlusion = Some(Occlusion { fraction: 0.02, mean_gap_s: 0.1 });
    let spec =
        JumpSpec { n_markers: 64, seconds: Some(3600.0), occlusion, ..JumpSpec::new(1, 240.0) };
    let list = |names: &str| names.split(',').map(str::to_owned).collect::<Vec<_>>();
    let mut parsed = Args {
        spec,
        tolerance_mm: 1.0,
        resamplers: list("dense,fast,lossless"),
        formats: list("c3d,npz,xdf,csv,tsv,trc,bids"),
    };
    let mut args = std::env::args().skip(1).filter(|arg| arg != "--bench");
    while let Some(arg) = args.next() {
        let mut value = || args.next().with_context(|| format!("{arg} needs a value"));
        match arg.as_str() {
            "--seconds" => parsed.spec.seconds = Some(value()?.parse()?),
            "--markers" => parsed.spec.n_markers = value()?.parse()?,
            "--rate" => parsed.spec.rate_hz = value()?.parse()?,
            "--tolerance" => {
                parsed.tolerance_mm = units::tolerance(&value()?, "--resamplers lossless")
                    .map_err(anyhow::Error::msg)?
                    .mm();
            }
            "--resamplers" => parsed.resamplers = list(&value()?),
            "--formats" => parsed.formats = list(&value()?),
            other => bail!("unknown option {other}"),
        }
    }
    Ok(parsed)
}

/// Writes the motion as an import would and returns the size of the take in bytes.
fn encode(motion: &Motion, name: &str, tolerance_mm: f64, to: &Path) -> anyhow::Result<u64> {
    let kind: ResamplerKind = name.parse()?;
    let codec = Settings { kind, tolerance: Tolerance::from_mm(tolerance_mm)? };
    let info = &motion.info;
    let mut header = header::of_import(&codec, info.rate_hz);
    header.channels = header::channels(&info.markers);
    header.stretch_rows =
        offline::stretch_rows(&codec, info.rate_hz, motion.n_frames(), info.markers.len()) as u32;
    let out = BufWriter::new(File::create_new(to)?);
    let progress = AtomicU64::new(0);
    let (written, out) =
        offline::write_take(motion, &header, threads::default_workers(), &progress, out)?;
    out.into_inner().context("cannot write the take")?.sync_all()?;
    Ok(written.file_bytes)
}

struct Run {
    bytes: u64,
    seconds: f64,
    busy_s: f64,
    memory_bytes: u64,
}

fn export(take: &Path, format: &str) -> anyhow::Result<Run> {
    let output = take.with_extension(format!("out.{format}"));
    let start = Instant::now();
    let mut child = Command::new(MOCAPD)
        .arg("export")
        .arg(take)
        .arg("-o")
        .arg(&output)
        .args(["--format", format])
        .spawn()?;
    let (mut memory_bytes, mut busy_s) = (0, 0.0);
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        if let Some((memory, busy)) = usage(&child) {
            (memory_bytes, busy_s) = (memory, busy);
        }
        std::thread::sleep(POLL_INTERVAL);
    };
    let seconds = start.elapsed().as_secs_f64();
    ensure!(status.success(), "mocapd export to {format} failed: {status}");
    let bytes = size(&output)?;
    if output.is_dir() {
        fs::remove_dir_all(&output)?;
    } else {
        fs::remove_file(&output)?;
    }
    Ok(Run { bytes, seconds, busy_s, memory_bytes })
}

/// Peak resident memory of the process so far, in bytes, and its processor time in seconds.
fn usage(child: &Child) -> Option<(u64, f64)> {
    let process = PathBuf::from(format!("/proc/{}", child.id()));
    let status = fs::read_to_string(process.join("status")).ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let memory: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    let stat = fs::read_to_string(process.join("stat")).ok()?;
    let ticks =
        |index: usize| stat.rsplit(')').next()?.split_whitespace().nth(index)?.parse::<f64>().ok();
    Some((memory << 10, (ticks(11)? + ticks(12)?) / rustix::param::clock_ticks_per_second() as f64))
}

/// Size of a file, or of all files in a folder, in bytes.
fn size(path: &Path) -> anyhow::Result<u64> {
    let meta = path.metadata()?;
    if !meta.is_dir() {
        return Ok(meta.len());
    }
    path.read_dir()?.try_fold(0, |sum, entry| Ok(sum + size(&entry?.path())?))
}
