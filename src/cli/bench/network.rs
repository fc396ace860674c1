//! `bench network`: how long the frames of a QTM are on their way: to the rings, beside those of a serial line, and through the service
//! to a client's socket.
//!
//! Every part is a process of its own, as in a laboratory on one machine. Each figure is the median of the runs.

use std::{
    collections::HashMap,
    fs,
    io::{Read, Write},
    net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, Builder, JoinHandle},
    time::{Duration, Instant},
};

use anyhow::{Context, anyhow, bail, ensure};
use mocapd::outcome::Outcome;
use mocapd_acquire::{host_clock::LatencyHistogram, ledger::LedgerDocument};
use mocapd_drivers::qtm::{PacketKind, PacketReader, put_text};
use mocapd_service::units;
use serde::Serialize;
use serde_json::Value;

use super::{
    check, median,
    pipeline::{KilledProcess, TemporaryTake, record, simulate},
};
use crate::cli::{
    output::{notify, print, print_json},
    record::LatencyReport,
    stop::stop_on_signal,
    values,
};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Number of markers of the simulated devices
    #[arg(long, value_name = "N", default_value = "64", value_parser = clap::value_parser!(u16).range(1..=4096))]
    markers: u16,
    /// Frame rate of the simulated devices: 240, 240Hz, 1kHz
    #[arg(long, value_name = "HZ", default_value = "240Hz", value_parser = units::rate_hz,
          allow_hyphen_values = true)]
    rate: f64,
    /// Length of each recording: 10s, 500ms, 2min
    #[arg(long, value_name = "TIME", default_value = "20s", value_parser = values::length,
          allow_hyphen_values = true)]
    seconds: Duration,
    /// Number of runs; the medians are reported
    #[arg(long, value_name = "N", default_value = "3", value_parser = clap::value_parser!(u16).range(1..=99))]
    runs: u16,
    /// Folder for the temporary takes, which are removed again
    #[arg(long, value_name = "DIR", default_value = ".")]
    dir: PathBuf,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// How much longer the motion is that the service records: it, its device and its clients start meanwhile.
const MARGIN: Duration = Duration::from_secs(20);

/// How long the service may take to start, and a server to send anything.
const PATIENCE: Duration = Duration::from_secs(10);

pub(super) fn run(args: &Args) -> anyhow::Result<Outcome> {
    ensure!(args.dir.is_dir(), "{} is not a folder: create it first", args.dir.display());
    check(args.markers, args.rate, (args.seconds + MARGIN).as_secs_f64())?;
    let stop = stop_on_signal()?;
    let mut report = NetworkBenchReport {
        markers: args.markers,
        rate_hz: args.rate,
        seconds: args.seconds.as_secs_f64(),
        runs: args.runs,
        cores: thread::available_parallelism().map_or(1, usize::from),
        ..NetworkBenchReport::default()
    };
    for run in 1..=args.runs {
        if !args.json {
            notify(&format!("run {run}/{}: four recordings of {} s", args.runs, report.seconds));
        }
        report.serial.push(recorded(args, Line::Serial)?);
        report.tcp.push(recorded(args, Line::Tcp)?);
        report.udp.push(recorded(args, Line::Udp)?);
        report.published.push(published(args)?);
        if stop.load(Ordering::Relaxed) {
            bail!("interrupted after {run} of {} runs: no results", args.runs);
        }
    }
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.text())?;
    }
    Ok(Outcome::of(report.lost_anything()))
}

/// On which way a frame reaches the recorder.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Line {
    Serial,
    Tcp,
    Udp,
}

/// Options of the simulated device.
fn device(args: &Args, length: Duration) -> Vec<String> {
    let words = ["--markers", &args.markers.to_string(), "--rate", &args.rate.to_string()];
    let seconds = ["--seconds", &length.as_secs_f64().to_string()];
    words.into_iter().chain(seconds).map(str::to_owned).collect()
}

fn recorded(args: &Args, line: Line) -> anyhow::Result<RecordedRun> {
    let own = std::env::current_exe().context("cannot find the mocapd executable")?;
    let mut words = device(args, args.seconds);
    words.extend((line != Line::Serial).then(|| "--qtm".to_owned()));
    let (_simulator, named) = simulate(&own, words)?;
    let uri = match line {
        Line::Serial => format!("serial:{named}"),
        Line::Tcp => named,
        Line::Udp => format!("{named}?transport=udp"),
    };
    let take = TemporaryTake::in_folder(&args.dir);
    let recorded = record(&own, &uri, &take.0, &[])?;
    Ok(RecordedRun {
        frames_sent: recorded.ledger.frames_sent,
        frames_recorded: recorded.frames,
        ring_latency_us: recorded.ring_latency_us,
    })
}

/// A frame's time stamp in microseconds, and when it was read.
type Arrivals = HashMap<u64, Instant>;

/// A client of a QTM server, which reads until it is asked to stop.
struct QtmClient {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<anyhow::Result<Arrivals>>,
}

impl QtmClient {
    fn start(address: SocketAddr) -> anyhow::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let mut connection =
            TcpStream::connect(address).with_context(|| format!("cannot connect to {address}"))?;
        connection.set_read_timeout(Some(PATIENCE))?;
        let mut requests = Vec::new();
        for command in ["Version 1.28", "StreamFrames AllFrames 3D"] {
            put_text(PacketKind::Command, command, &mut requests);
        }
        connection.write_all(&requests)?;
        let thread = Builder::new()
            .name("mocapd-client".to_owned())
            .spawn(move || read_frames(&mut connection, &stopped))?;
        Ok(Self { stop, thread })
    }

    fn finish(self) -> anyhow::Result<Arrivals> {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().map_err(|_| anyhow!("a client has failed"))?
    }
}

/// Nothing is done with a frame: a client that computes would wait less for the next one.
fn read_frames(connection: &mut TcpStream, stop: &AtomicBool) -> anyhow::Result<Arrivals> {
    let (mut arrivals, mut reader) = (Arrivals::new(), PacketReader::default());
    let mut buffer = vec![0; 64 << 10];
    while !stop.load(Ordering::Relaxed) {
        let n = connection.read(&mut buffer).context("a server of frames sends none")?;
        let now = Instant::now();
        ensure!(n > 0, "a server of frames has closed the connection");
        reader.extend(buffer.get(..n).unwrap_or_default());
        while let Some(packet) = reader
            .next_packet()
            .map_err(|error| anyhow!("what a server sends is no packet: {error:?}"))?
        {
            match (packet.kind, packet.body.first_chunk()) {
                (Some(PacketKind::Error), _) => bail!("a server refuses: {}", packet.text()),
                (Some(PacketKind::Data), Some(time)) => {
                    arrivals.insert(u64::from_le_bytes(*time), now);
                }
                _ => {}
            }
        }
    }
    Ok(arrivals)
}

/// A service of its own that records a QTM and publishes what it receives, killed when dropped.
struct RecordingService {
    /// First, so that it has ended when its folders are removed.
    _process: KilledProcess,
    own: PathBuf,
    /// With its socket, its configuration and its log; short, as the path of a socket has to be.
    folder: tempfile::TempDir,
    address: SocketAddr,
    _takes: tempfile::TempDir,
}

impl RecordingService {
    fn start(own: &Path, uri: &str, dir: &Path) -> anyhow::Result<Self> {
        let takes = tempfile::tempdir_in(dir).context("cannot create a folder for takes")?;
        let folder = tempfile::tempdir().context("cannot create a temporary folder")?;
        let directory = fs::canonicalize(takes.path())?;
        // A port that is free now; it is opened by the service.
        let address = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?.local_addr()?;
        let config = format!(
            "[device]\nuri = {}\n[take]\ndirectory = {}\nkeep_free = \"0B\"\n[http]\nlisten = \"\"\nsocket = {}\n\
             [publish.qtm]\nenabled = true\nlisten = \"{address}\"\n",
            quoted(uri),
            quoted(&directory.display().to_string()),
            quoted(&folder.path().join("socket").display().to_string()),
        );
        // The name of the file becomes that of the rig: a letter comes first.
        let mut file =
            tempfile::Builder::new().prefix("bench-").suffix(".toml").tempfile_in(folder.path())?;
        file.write_all(config.as_bytes())?;
        let log = tempfile::NamedTempFile::new_in(folder.path())?;
        let process = Command::new(own)
            .args(["run", "--config"])
            .arg(file.path())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log.reopen()?)
            .spawn()
            .context("cannot start the service")?;
        let (own, process) = (own.to_owned(), KilledProcess(process));
        let service = Self { own, folder, address, _takes: takes, _process: process };
        let until = Instant::now() + PATIENCE;
        while !service.ctl(&["status"]).is_ok_and(|status| status["state"] == "armed") {
            if Instant::now() > until {
                let log = fs::read_to_string(log.path())?;
                bail!("the service does not start: {}", log.lines().last().unwrap_or_default());
            }
            thread::sleep(Duration::from_millis(50));
        }
        Ok(service)
    }

    fn ctl(&self, words: &[&str]) -> anyhow::Result<Value> {
        let socket = self.folder.path().join("socket");
        let output = Command::new(&self.own)
            .args(["ctl", "--connect", &format!("unix:{}", socket.display())])
            .args(words)
            .arg("--json")
            .stdin(Stdio::null())
            .output()
            .context("cannot start `mocapd ctl`")?;
        let message = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.success(), "{}", message.trim().trim_start_matches("mocapd: "));
        serde_json::from_slice(&output.stdout).context("cannot parse the service's answer")
    }
}

/// Text as a string of TOML.
fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

/// One client reads the device, and one the service that records it: how much later each frame arrives there is what the service
/// adds.
fn published(args: &Args) -> anyhow::Result<PublishedRun> {
    let own = std::env::current_exe().context("cannot find the mocapd executable")?;
    let mut words = device(args, args.seconds + MARGIN);
    words.push("--qtm".to_owned());
    let (_simulator, uri) = simulate(&own, words)?;
    let address = uri.trim_start_matches("qtm:").parse().context("the device names no address")?;
    // The first one to be sent a frame, so that the difference is not smaller than the delay.
    let beside = QtmClient::start(address)?;
    let service = RecordingService::start(&own, &uri, &args.dir)?;
    let client = QtmClient::start(service.address)?;
    service.ctl(&["start", "--name", "bench"])?;
    thread::sleep(args.seconds);
    let status = service.ctl(&["status"])?;
    let mut stopped = service.ctl(&["stop"])?;
    let (published, sent) = (client.finish()?, beside.finish()?);
    let ledger = stopped.get_mut("ledger").map(Value::take).unwrap_or_default();
    let ledger: LedgerDocument =
        serde_json::from_value(ledger).context("the service states no ledger")?;
    let mut delay = LatencyHistogram::default();
    for (time_us, arrived) in &published {
        if let Some(before) = sent.get(time_us) {
            delay.add(arrived.saturating_duration_since(*before).as_nanos() as u64);
        }
    }
    ensure!(delay.count() > 0, "the client got none of the device's frames");
    let us = |ns: u64| ns as f64 / 1e3;
    Ok(PublishedRun {
        frames_sent: ledger.frames_sent,
        frames_recorded: ledger.recorded,
        frames_received: delay.count(),
        frames_missed: status["publish"][0]["clients"][0]["frames_missed"].as_u64().unwrap_or(0),
        delay_us: LatencyReport {
            p50: us(delay.quantile_ns(0.5)),
            p99: us(delay.quantile_ns(0.99)),
            max: us(delay.max_ns()),
        },
    })
}

/// A recording from one device.
#[derive(Debug, Clone, Serialize)]
struct RecordedRun {
    frames_sent: u64,
    frames_recorded: u64,
    ring_latency_us: LatencyReport,
}

/// A recording of the service, and what its client received.
#[derive(Debug, Clone, Serialize)]
struct PublishedRun {
    frames_sent: u64,
    frames_recorded: u64,
    frames_received: u64,
    frames_missed: u64,
    delay_us: LatencyReport,
}

#[derive(Debug, Default, Serialize)]
struct NetworkBenchReport {
    markers: u16,
    rate_hz: f64,
    seconds: f64,
    runs: u16,
    cores: usize,
    serial: Vec<RecordedRun>,
    tcp: Vec<RecordedRun>,
    udp: Vec<RecordedRun>,
    published: Vec<PublishedRun>,
}

impl NetworkBenchReport {
    /// Whether any frame was lost. What a client misses is no loss.
    fn lost_anything(&self) -> bool {
        let recordings = [&self.serial, &self.tcp, &self.udp].into_iter().flatten();
        recordings.map(|run| (run.frames_sent, run.frames_recorded)).any(|(a, b)| b < a)
            || self.published.iter().any(|run| run.frames_recorded < run.frames_sent)
    }

    fn text(&self) -> String {
        let of = |runs: &[RecordedRun], figure: fn(&LatencyReport) -> f64| {
            median(runs.iter().map(|run| figure(&run.ring_latency_us)))
        };
        let line = |name: &str, runs: &[RecordedRun]| {
            let lost: u64 = runs.iter().map(|run| run.frames_sent - run.frames_recorded).sum();
            format!(
                "\x20 {name:<24} {:>9.1} us at p99; p50 {:.1} us, max {:.1} us; {:.2} times the serial line's p99; {lost} frames lost\n",
                of(runs, |latency| latency.p99),
                of(runs, |latency| latency.p50),
                of(runs, |latency| latency.max),
                of(runs, |latency| latency.p99) / of(&self.serial, |latency| latency.p99),
            )
        };
        let through = |figure: fn(&LatencyReport) -> f64| {
            median(self.published.iter().map(|run| figure(&run.delay_us))) / 1e3
        };
        let sum = |figure: fn(&PublishedRun) -> u64| self.published.iter().map(figure).sum::<u64>();
        format!(
            "{} markers at {}, {} s, {} cores; medians of {} runs\n\
             from the arrival of a frame's last byte to the rings\n{}{}{}\
             through the service to the socket of a client of [publish.qtm], while a take is recorded\n\
             \x20 {:<24} {:>9.2} ms at p99; p50 {:.2} ms, max {:.2} ms; {} frames received, {} missed, {} lost by the recording\n",
            self.markers,
            values::rate(self.rate_hz),
            self.seconds,
            self.cores,
            self.runs,
            line("serial line (pty)", &self.serial),
            line("QTM by TCP", &self.tcp),
            line("QTM by UDP", &self.udp),
            "later than at the service",
            through(|delay| delay.p99),
            through(|delay| delay.p50),
            through(|delay| delay.max),
            sum(|run| run.frames_received),
            sum(|run| run.frames_missed),
            sum(|run| run.frames_sent) - sum(|run| run.frames_recorded),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_strings_of_toml() {
        assert_eq!(quoted(r#"/a "b"\c"#), r#""/a \"b\"\\c""#);
    }
}
