//! Devices for the program to open: simulated ones, and raw lines.

use std::{
    fs::File,
    io::Read,
    os::{fd::OwnedFd, unix::ffi::OsStringExt},
    path::{Path, PathBuf},
    process::{Child, ExitStatus},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{Builder, JoinHandle, sleep},
    time::{Duration, Instant},
};

use mocapd_simulator::{
    device::{Device, DeviceSettings, LineDevice, SentLog},
    pty::{ServeOptions, serve_pty},
};
use mocapd_take::{TakeFrames, motion::FrameSource, motion::Motion};
use rustix::{
    process::{Pid, Signal, kill_process},
    pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt},
};

use super::{Folder, Ran};

/// Longer than any test takes on the slowest machine; a test that waits this long has failed.
const GIVE_UP: Duration = Duration::from_secs(60);

/// A simulated device on a pty, until it is dropped.
pub(crate) struct Simulated {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<SentLog>>,
    /// The folder of its link.
    _place: tempfile::TempDir,
    pub(crate) path: PathBuf,
}

impl Simulated {
    pub(crate) fn start(motion: Motion, settings: DeviceSettings, baud: Option<u32>) -> Self {
        Self::at(None, motion, settings, baud)
    }

    /// An endless device, at a path that another can reuse.
    pub(crate) fn endless_at(link: &Path, serial: &str, motion: Motion) -> Self {
        let serial = serial.to_owned();
        let settings = DeviceSettings { looping: true, serial, ..DeviceSettings::default() };
        Self::at(Some(link.to_owned()), motion, settings, None)
    }

    fn at(
        link: Option<PathBuf>,
        motion: Motion,
        settings: DeviceSettings,
        baud: Option<u32>,
    ) -> Self {
        // A busy machine must not make the device drop frames.
        let settings = DeviceSettings { queue_bytes: Some(64 << 20), ..settings };
        Self::serve_at(link, Device::new(motion, settings).unwrap(), baud)
    }

    /// Serves any device.
    pub(crate) fn serve(device: impl LineDevice + Send + 'static, baud: Option<u32>) -> Self {
        Self::serve_at(None, device, baud)
    }

    /// Serves any device at a given path.
    pub(crate) fn serve_at(
        link: Option<PathBuf>,
        mut device: impl LineDevice + Send + 'static,
        baud: Option<u32>,
    ) -> Self {
        // A unique path: the pty's number is reused by the next test, and a recorder waiting for this device would
        // take that one for it.
        let place = tempfile::tempdir().unwrap();
        let link = link.unwrap_or_else(|| place.path().join("device"));
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let (path_in, path) = crossbeam_channel::bounded(1);
        let serve = move || {
            let options = ServeOptions { baud, ..ServeOptions::default() };
            let on_ready = |path: &Path| path_in.send(path.to_owned()).unwrap();
            serve_pty(&mut device, Some(&link), options, &stopped, on_ready).unwrap()
        };
        let thread = Builder::new().name("simulator".to_owned()).spawn(serve).unwrap();
        Self { stop, thread: Some(thread), _place: place, path: path.recv().unwrap() }
    }

    /// A device that plays its motion once.
    pub(crate) fn of(motion: Motion) -> Self {
        Self::start(motion, DeviceSettings::default(), None)
    }

    /// An endless device.
    pub(crate) fn endless(motion: Motion) -> Self {
        let settings = DeviceSettings { looping: true, ..DeviceSettings::default() };
        Self::start(motion, settings, None)
    }

    pub(crate) fn uri(&self) -> String {
        format!("serial:{}", self.path.display())
    }

    /// Pulls the plug; returns what was sent until then.
    pub(crate) fn unplug(mut self) -> SentLog {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap()
    }
}

impl Drop for Simulated {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// A running `mocapd record`.
pub(crate) struct Recorder {
    child: Child,
}

impl Recorder {
    /// Starts recording into `take`, and waits until a frame is on disk.
    pub(crate) fn start(folder: &Folder, device: &Simulated, take: &str, more: &[&str]) -> Self {
        let mut recorder = Self::spawn(folder, device, take, more);
        recorder.wait_for_frames(&folder.path(take), 0);
        recorder
    }

    /// Starts recording into `NAME-001.take` and further ones, and waits until a frame is on disk.
    pub(crate) fn start_series(
        folder: &Folder,
        device: &Simulated,
        name: &str,
        more: &[&str],
    ) -> Self {
        let mut recorder = Self::spawn(folder, device, &format!("{name}.take"), more);
        recorder.wait_for_frames(&folder.path(&format!("{name}-001.take")), 0);
        recorder
    }

    fn spawn(folder: &Folder, device: &Simulated, output: &str, more: &[&str]) -> Self {
        let uri = device.uri();
        let args = [&["record", "-d", &uri, "-o", output], more].concat();
        Self { child: folder.command(&args).spawn().unwrap() }
    }

    /// Waits until more frames than these are on disk.
    pub(crate) fn wait_for_frames(&mut self, take: &Path, n_frames: u64) {
        let begun = Instant::now();
        while frames_in(take) <= n_frames {
            if let Some(status) = self.child.try_wait().unwrap() {
                panic!("{status} before frame {n_frames}: {:?}", self.wait());
            }
            assert!(begun.elapsed() < GIVE_UP, "no frame arrives");
            sleep(Duration::from_millis(5));
        }
    }

    pub(crate) fn pid(&self) -> u32 {
        self.child.id()
    }

    pub(crate) fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
    }

    /// Waits for a message with this fact on stderr.
    pub(crate) fn wait_for_message(&mut self, fact: &str) {
        let begun = Instant::now();
        let mut received = Vec::new();
        let mut byte = [0];
        while !String::from_utf8_lossy(&received).contains(fact) {
            let n = self.child.stderr.as_mut().unwrap().read(&mut byte).unwrap();
            assert!(n > 0 && begun.elapsed() < GIVE_UP, "{}", String::from_utf8_lossy(&received));
            received.extend(byte);
        }
    }

    /// Waits for its end.
    pub(crate) fn wait(&mut self) -> Ran {
        let status = self.status();
        let mut ran = Ran { code: status.code(), stdout: String::new(), stderr: String::new() };
        self.child.stdout.as_mut().unwrap().read_to_string(&mut ran.stdout).unwrap();
        self.child.stderr.as_mut().unwrap().read_to_string(&mut ran.stderr).unwrap();
        ran
    }

    fn status(&mut self) -> ExitStatus {
        let begun = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(begun.elapsed() < GIVE_UP, "it does not end");
            sleep(Duration::from_millis(5));
        }
    }
}

/// How many frames of a take are on disk.
pub(crate) fn frames_in(take: &Path) -> u64 {
    let frames = File::open(take).ok().and_then(|file| TakeFrames::open(file).ok());
    frames.map_or(0, |frames| frames.info().n_frames)
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// A pty whose master side the test controls.
pub(crate) struct RawLine {
    pub(crate) master: OwnedFd,
    /// Kept open, so that the line is not hung up between two hosts.
    _slave: OwnedFd,
    pub(crate) path: PathBuf,
}

impl RawLine {
    pub(crate) fn open() -> Self {
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let master = openpt(flags).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let name = ptsname(&master, Vec::new()).unwrap().into_bytes();
        let path = PathBuf::from(std::ffi::OsString::from_vec(name));
        let slave = rustix::fs::open(
            &path,
            rustix::fs::OFlags::RDWR | rustix::fs::OFlags::NOCTTY | rustix::fs::OFlags::CLOEXEC,
            rustix::fs::Mode::empty(),
        );
        rustix::io::ioctl_fionbio(&master, true).unwrap();
        Self { master, _slave: slave.unwrap(), path }
    }

    pub(crate) fn uri(&self) -> String {
        format!("serial:{}", self.path.display())
    }
}
