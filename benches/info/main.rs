//! Processor time of `mocapd info`, compared with that of reading the file and computing its checksums.
//!
//! `cargo bench --bench info -- [--seconds 3600] [--markers 64] [--rate 240] [--tolerance 0.5mm]`
//!
//! The motion is generated from a seed, and written once as an import and once as a recording, at full speed. Times are
//! those of whole processes, user and system, each the median of five means of [`RUNS`] runs; the kernel counts the
//! processor time of children to a hundredth of a second. Starting a program is a large part of them: that of mocapd is
//! measured, too. `verify`, measured once, decodes everything, as `info` does where a take does
//! not state its statistics.

#![expect(clippy::print_stdout, reason = "a tool that prints its result")]
#![expect(clippy::print_stderr, reason = "a tool that reports its progress")]

use std::{
    fs::{self, File},
    io::{self, BufWriter, Read, Write},
    path::Path,
    process::{Command, Stdio},
    sync::atomic::AtomicU64,
};

use anyhow::{Context, bail, ensure};
use mocapd_acquire::{
    header,
    pipeline::{NewTake, Pipeline, PipelineConfig, TakeOutput, offline},
    threads,
};
use mocapd_codec::{ResamplerKind, Settings};
use mocapd_drivers::device::{Frame, MarkerSample};
use mocapd_service::units;
use mocapd_simulator::{
    device::TICK_HZ,
    generator::{JumpSpec, Occlusion},
};
use mocapd_take::{
    motion::{Motion, is_gap},
    record::Device,
};

const MOCAPD: &str = env!("CARGO_BIN_EXE_mocapd");

/// Runs for one mean: the hundredths of a second that the kernel counts are then tenths of a millisecond.
const RUNS: u32 = 100;

/// Argument with which this program reads a file and computes its CRC-32.
const READ: &str = "--read-only";

fn main() -> anyhow::Result<()> {
    let args: Vec<String> = std::env::args().skip(1).filter(|arg| arg != "--bench").collect();
    if let [option, path] = &args[..]
        && option == READ
    {
        println!("{:08x}", crc_of(Path::new(path))?);
        return Ok(());
    }
    let (spec, codec) = parse(&args)?;
    let seconds = spec.seconds.unwrap_or_default();
    eprintln!("generating {seconds} s of {} markers at {} Hz", spec.n_markers, spec.rate_hz);
    let motion = spec.generate()?.motion;
    let folder = tempfile::Builder::new().prefix("mocapd-info").tempdir_in(".")?;
    let (imported, recorded) =
        (folder.path().join("import.take"), folder.path().join("recording.take"));
    eprintln!("writing two takes");
    import(&motion, &codec, &imported)?;
    record(&motion, &codec, &recorded)?;
    drop(motion);
    let this = std::env::current_exe()?;
    let run = |program: &Path, command: &str, take: &Path| {
        let mut run = Command::new(program);
        run.args([command.as_ref(), take.as_os_str()]).stdout(Stdio::null());
        run
    };
    let start = || {
        let mut start = Command::new(MOCAPD);
        start.arg("--version").stdout(Stdio::null());
        start
    };
    let start_ms = processor_ms(5, RUNS, start)?;
    println!("starting mocapd: {start_ms:.1} ms\n");
    println!("| take | bytes | read and check, ms | info, ms | verify, ms |");
    println!("|---|---|---|---|---|");
    for (name, take) in [("import", &imported), ("recording", &recorded)] {
        let read_ms = processor_ms(5, RUNS, || run(&this, READ, take))?;
        let info_ms = processor_ms(5, RUNS, || run(Path::new(MOCAPD), "info", take))?;
        let verify_ms = processor_ms(1, 1, || run(Path::new(MOCAPD), "verify", take))?;
        println!(
            "| {name} | {} | {read_ms:.1} | {info_ms:.1} | {verify_ms:.0} |",
            fs::metadata(take)?.len()
        );
    }
    Ok(())
}

fn parse(args: &[String]) -> anyhow::Result<(JumpSpec, Settings)> {
    let occlusion = Some(Occlusion { fraction: 0.02, mean_gap_s: 0.1 });
    let mut spec =
        JumpSpec { n_markers: 64, seconds: Some(3600.0), occlusion, ..JumpSpec::new(1, 240.0) };
    let tolerance = |text: &str| units::tolerance(text, "--lossless").map_err(anyhow::Error::msg);
    let mut codec = Settings { kind: ResamplerKind::Dense, tolerance: tolerance("0.5mm")? };
    for pair in args.chunks(2) {
        let [option, value] = pair else { bail!("{} needs a value", pair[0]) };
        match option.as_str() {
            "--seconds" => spec.seconds = Some(value.parse()?),
            "--markers" => spec.n_markers = value.parse()?,
            "--rate" => spec.rate_hz = value.parse()?,
            "--tolerance" => codec.tolerance = tolerance(value)?,
            other => bail!("unknown option {other}"),
        }
    }
    Ok((spec, codec))
}

/// Writes the motion as an import would.
fn import(motion: &Motion, codec: &Settings, to: &Path) -> anyhow::Result<()> {
    let info = &motion.info;
    let mut header = header::of_import(codec, info.rate_hz);
    header.channels = header::channels(&info.markers);
    header.stretch_rows =
        offline::stretch_rows(codec, info.rate_hz, motion.n_frames(), info.markers.len()) as u32;
    let out = BufWriter::new(File::create_new(to)?);
    let progress = AtomicU64::new(0);
    let workers = threads::default_workers();
    let (_, out) = offline::write_take(motion, &header, workers, &progress, out)?;
    out.into_inner().context("cannot write the take")?.sync_all()?;
    Ok(())
}

/// A file, written as a recording.
#[derive(Debug)]
struct RecordedFile(BufWriter<File>);

impl Write for RecordedFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl TakeOutput for RecordedFile {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Writes the motion as a recording: stretches of half a second, with the times of the frames, which arrive up to 0.9
/// ms late.
fn record(motion: &Motion, codec: &Settings, to: &Path) -> anyhow::Result<()> {
    let rate_hz = motion.info.rate_hz;
    let channels = header::channels(&motion.info.markers);
    let config = PipelineConfig::new(*codec, rate_hz, TICK_HZ, channels.clone());
    let mut header = header::new(codec, rate_hz)?;
    header.channels = channels;
    header.stretch_rows = config.stretch_rows();
    header.device = Some(Device { tick_hz: TICK_HZ, ..Device::default() });
    let output = RecordedFile(BufWriter::new(File::create_new(to)?));
    let (mut intake, pipeline) = Pipeline::start(&config, NewTake::new(output, header))?;
    let mut markers = Vec::new();
    for seq in 0..motion.n_frames() {
        let sample = |(id, &position_mm): (usize, &[f32; 3])| MarkerSample {
            id: id as u16,
            occluded: is_gap(position_mm),
            position_mm,
            ..MarkerSample::default()
        };
        markers.clear();
        markers.extend(motion.frame(seq).iter().enumerate().map(sample));
        let device_ticks = (seq as f64 * TICK_HZ as f64 / rate_hz).round() as u64;
        let frame = Frame { seq: seq as u32, device_ticks, timecode: None, markers: &markers };
        while intake.is_full() {
            std::thread::yield_now();
        }
        let late_us = (seq as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32;
        let at_us = device_ticks * 1_000_000 / TICK_HZ + late_us % 900;
        intake.frame(&frame, (1_000_000 + at_us) * 1000);
    }
    intake.finish();
    match pipeline.finish() {
        Ok((account, _)) => ensure!(account.ledger.closes(), "{:?}", account.ledger),
        Err(failed) => return Err(failed.error),
    }
    Ok(())
}

/// The CRC-32 of a file, read in the pieces in which `info` reads.
fn crc_of(path: &Path) -> anyhow::Result<u32> {
    let mut file = File::open(path)?;
    let mut crc = crc32fast::Hasher::new();
    let mut buffer = vec![0; 1 << 16];
    loop {
        match file.read(&mut buffer)? {
            0 => return Ok(crc.finalize()),
            n => crc.update(&buffer[..n]),
        }
    }
}

/// Processor time of a run of `command` in milliseconds: the median of `n_means` means of `runs`.
fn processor_ms(n_means: usize, runs: u32, command: impl Fn() -> Command) -> anyhow::Result<f64> {
    let mut means = Vec::new();
    for _ in 0..n_means {
        let before = of_children_s()?;
        for _ in 0..runs {
            let status = command().status()?;
            ensure!(status.success(), "{:?}: {status}", command());
        }
        means.push((of_children_s()? - before) / f64::from(runs) * 1e3);
    }
    means.sort_by(f64::total_cmp);
    Ok(means[n_means / 2])
}

/// Processor time of all children that have ended, in seconds.
fn of_children_s() -> anyhow::Result<f64> {
    let stat = fs::read_to_string("/proc/self/stat")?;
    let fields = stat.rsplit(')').next().context("no statistics of this process")?;
    let ticks = fields.split_whitespace().skip(13).take(2).map(str::parse::<f64>);
    let ticks: f64 = ticks.sum::<Result<f64, _>>()?;
    Ok(ticks / rustix::param::clock_ticks_per_second() as f64)
}
