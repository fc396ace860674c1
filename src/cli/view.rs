//! `view`: plays takes and motion files in a browser.

use std::{
    fs,
    io::{self, BufReader, BufWriter, Write},
    net::{Ipv4Addr, SocketAddr},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use anyhow::{Context, bail, ensure};
use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::{files, pipeline::offline, threads};
use mocapd_cli::stop;
use mocapd_codec::{ResamplerKind, Settings, Tolerance};
use mocapd_service::{
    http::{HttpOptions, HttpServer},
    viewer::TakeViewer,
};
use mocapd_take::{
    TakeMap,
    foreign::analog,
    interchange::ReadOptions,
    motion::{FrameSource, MotionInfo, Position},
};
use tempfile::TempDir;

use super::{
    batch::{FileKinds, Input, Inputs, inputs},
    motion_files::{MotionSource, header_of, open_motion},
    output::{Progress, notify, plain_path, print},
    paths::InputFormat,
    remote,
};

/// How long requests may go on after Ctrl-C.
const SHUTDOWN_TIMEOUT: Duration = Duration::from_secs(1);

/// Maximum number of files: as many as the API lists.
const FILES_MAX: usize = 1000;

/// Interval at which Ctrl-C is noticed.
const STOP_INTERVAL: Duration = Duration::from_millis(100);

#[derive(Debug, clap::Args)]
#[command(
    after_help = "The address works on this machine alone, until Ctrl-C. Whoever has it can see the files: it contains a token. \
    From another machine: ssh -L PORT:127.0.0.1:PORT HOST, with --port, and open the same address there."
)]
pub(crate) struct Args {
    /// Takes, C3D, TRC, TSV or CSV files, or folders with such files
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Show how far the take is from this take or motion file, such as its lossless original: markers are matched by their
    /// labels, and frames by their numbers
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
    /// With folders, also show the files in their subfolders
    #[arg(short, long)]
    recursive: bool,
    /// Port to listen on, on the loopback address [default: any free port]
    #[arg(long, value_name = "PORT", default_value = "0", hide_default_value = true)]
    port: u16,
    /// Open the address in the default browser
    #[arg(long)]
    open: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let folder = tempfile::tempdir().context("cannot create a temporary folder")?;
    let made = folder.path().to_owned();
    // A second Ctrl-C ends the process at once, while a file may still be written into the folder.
    let stop = stop::stop_on_signal_or(move || drop(fs::remove_dir_all(made)))?;
    let inputs = inputs::find_named(&args.files, args.recursive, FileKinds::Both)?;
    for message in &inputs.unreadable {
        notify(message);
    }
    let n_files = inputs.files.len();
    if n_files > FILES_MAX {
        bail!(UsageError(format!("{n_files} files: give at most {FILES_MAX}")));
    }
    let mut viewer = TakeViewer::default();
    let against = args.against.as_deref().map(|path| original(args, &inputs, path)).transpose()?;
    let mut failed = inputs.unreadable.len();
    for input in inputs.files.iter().chain(&against) {
        if stop.load(Ordering::Relaxed) {
            return Ok(Outcome::Done);
        }
        match take_of(input, &folder, viewer.takes().len(), &stop) {
            Ok(path) => viewer.add(&name_of(&input.name), path),
            Err(_) if stop.load(Ordering::Relaxed) => return Ok(Outcome::Done),
            Err(error) if inputs.is_single || against.is_some() => return Err(error),
            Err(error) => {
                notify(&format!("{error:#}"));
                failed += 1;
            }
        }
    }
    if viewer.takes().is_empty() {
        bail!("none of the files can be shown");
    }
    let names: Vec<String> = viewer.takes().iter().map(|take| take.name.clone()).collect();
    let n_takes = names.len();
    let token = TakeViewer::token()?;
    let options = HttpOptions {
        tcp: Some(SocketAddr::from((Ipv4Addr::LOCALHOST, args.port))),
        token: Some(token.clone()),
        is_viewer: true,
        ..HttpOptions::default()
    };
    let server = HttpServer::start(options, Arc::new(viewer))?;
    let address = server.tcp_address().context("the server has no address")?;
    let query = match names.as_slice() {
        [take, other] if against.is_some() => format!("?{}", TakeViewer::comparison(take, other)),
        _ => String::new(),
    };
    let url = format!("http://{address}/{query}#token={token}");
    print(&format!("{url}\n"))?;
    let shown = if against.is_some() {
        "a comparison".to_owned()
    } else if n_takes == 1 {
        "1 file".to_owned()
    } else {
        format!("{n_takes} files")
    };
    notify(&format!("showing {shown}; Ctrl-C ends it"));
    if args.open {
        open_browser(&url, &folder)?;
    }
    while !stop.load(Ordering::Relaxed) {
        std::thread::sleep(STOP_INTERVAL);
    }
    server.stop(SHUTDOWN_TIMEOUT)?;
    if failed > 0 { bail!("{failed} of the files could not be shown") } else { Ok(Outcome::Done) }
}

/// The file that a take is compared with.
fn original(args: &Args, inputs: &Inputs, path: &Path) -> anyhow::Result<Input> {
    ensure!(
        inputs.files.len() == 1,
        UsageError("--against compares one file with another: give one file".to_owned())
    );
    let found = inputs::find_named(&[path.to_owned()], args.recursive, FileKinds::Both)?;
    let n_files = found.files.len();
    let mut files = found.files.into_iter();
    match (files.next(), n_files) {
        (Some(file), 1) => Ok(file),
        _ => bail!(UsageError(format!(
            "--against compares with one file, and {} has {n_files}",
            path.display()
        ))),
    }
}

/// The name of a file in the list, without folders; that of a take without its extension.
fn name_of(file: &Path) -> String {
    let name = if super::paths::is_take(file) { file.file_stem() } else { file.file_name() };
    name.unwrap_or_default().to_string_lossy().into_owned()
}

/// The take to show for a file: itself, or a lossless one that is made of it.
fn take_of(
    input: &Input,
    folder: &TempDir,
    number: usize,
    stop: &AtomicBool,
) -> anyhow::Result<PathBuf> {
    let name = input.name.display();
    if let InputFormat::Take = input.format()? {
        let path = remote::local(&input.path)?;
        let path = path.canonicalize().with_context(|| format!("cannot read {name}"))?;
        let file = files::open(&path)?;
        ensure!(
            !files::is_being_written(&file),
            "{name} is being recorded: it can be shown when the recording has stopped"
        );
        TakeMap::open(&mut BufReader::new(file)).with_context(|| format!("cannot show {name}"))?;
        return Ok(path);
    }
    let source = MotionSource::of(input)?;
    let bytes_read = Arc::default();
    // The player shows force plates.
    let mut reader = open_motion(&source, &ReadOptions::default(), true, &bytes_read)?;
    reader.info_mut().foreign.retain(|part| analog::is_needed(&part.kind));
    let codec = Settings { kind: ResamplerKind::Lossless, tolerance: Tolerance::from_mm(1.0)? };
    let header = header_of(&*reader.info_mut(), &input.name, &codec);
    let samples = Arc::default();
    let total = offline::sample_count(reader.info_mut())?;
    let _progress = Progress::follow("reading", &samples, total);
    let path = folder.path().join(format!("{number}.take"));
    let out = BufWriter::new(files::create_new(&path)?);
    let workers = threads::default_workers();
    let mut frames = StoppableFrames { frames: &mut reader, stop };
    let (_, mut out) = offline::write_frames(&mut frames, &header, workers, &samples, out)
        .with_context(|| format!("cannot read {name}"))?;
    out.flush().with_context(|| format!("cannot write {}", plain_path(&path)))?;
    Ok(path)
}

/// Frames that fail after Ctrl-C: a large file takes a while to read.
struct StoppableFrames<'a> {
    frames: &'a mut dyn FrameSource,
    stop: &'a AtomicBool,
}

impl FrameSource for StoppableFrames<'_> {
    fn info(&self) -> &MotionInfo {
        self.frames.info()
    }

    fn next_frame(&mut self, row: &mut [Position]) -> io::Result<bool> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(io::ErrorKind::Interrupted.into());
        }
        self.frames.next_frame(row)
    }
}

/// Opens the address by a file that leads to it: the arguments of a program are visible to every user of the machine.
fn open_browser(url: &str, folder: &TempDir) -> anyhow::Result<()> {
    let page = folder.path().join("open.html");
    let lead = format!(
        "<!doctype html><meta charset=\"utf-8\"><meta http-equiv=\"refresh\" content=\"0; url={url}\">\n"
    );
    let mut file = files::create_new(&page)?;
    file.write_all(lead.as_bytes())
        .with_context(|| format!("cannot write {}", plain_path(&page)))?;
    let opened = Command::new("xdg-open")
        .arg(&page)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn();
    match opened {
        Ok(mut opener) => drop(threads::spawn("mocapd-browser", move || drop(opener.wait()))?),
        Err(error) => notify(&format!(
            "cannot open a browser with xdg-open: {error}; open the address yourself"
        )),
    }
    Ok(())
}
