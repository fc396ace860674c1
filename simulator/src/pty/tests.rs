use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use mocapd_drivers::device::{Command, DeviceEvent, MarkerSample, Protocol, Status};
use mocapd_drivers::link::HostLink;
use mocapd_drivers::transport::Transport;
use mocapd_drivers::transport::serial::SerialTransport;
use mocapd_take::motion::Motion;

use super::*;
use crate::device::{Device, DeviceSettings};
use crate::generator::JumpSpec;
use crate::line::Line;

/// Generous, because the machine may be busy.
const TIMEOUT: Duration = Duration::from_secs(20);

fn jump(rate_hz: f64, seconds: f64, n_markers: usize) -> Motion {
    let spec = JumpSpec { seconds: Some(seconds), n_markers, ..JumpSpec::new(3, rate_hz) };
    spec.generate().unwrap().motion
}

/// A device served on its own thread.
struct Served {
    path: PathBuf,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Result<SentLog, PtyError>>,
}

fn serve_in_background(motion: Motion, settings: DeviceSettings, options: ServeOptions) -> Served {
    let mut line = PtyLine::open(None).unwrap();
    let path = line.path().to_owned();
    let stop = Arc::new(AtomicBool::new(false));
    let seen = Arc::clone(&stop);
    let thread = std::thread::Builder::new()
        .name("sim-test".to_owned())
        .spawn(move || {
            let mut device = Device::new(motion, settings).unwrap();
            serve(&mut line, &mut device, options, &seen)
        })
        .unwrap();
    Served { path, stop, thread }
}

impl Served {
    fn finish(self) -> SentLog {
        self.stop.store(true, std::sync::atomic::Ordering::Relaxed);
        self.thread.join().unwrap().unwrap()
    }
}

/// A host that keeps what it receives.
struct Host {
    port: SerialTransport,
    link: HostLink,
    frames: Vec<(u32, Vec<MarkerSample>)>,
    n_markers: usize,
    end: Option<Status>,
}

impl Host {
    fn open(path: &Path) -> Self {
        let port = SerialTransport::open(path, None).unwrap();
        Self { port, link: HostLink::new(), frames: Vec::new(), n_markers: 0, end: None }
    }

    fn send(&mut self, command: Command) {
        let mut bytes = Vec::new();
        self.link.command(command, &mut bytes);
        self.port.write_all(&bytes).unwrap();
    }

    fn read_until(&mut self, enough: impl Fn(&Self) -> bool) -> u64 {
        let give_up = Instant::now() + TIMEOUT;
        let mut buffer = vec![0; 1 << 16];
        while !enough(self) {
            assert!(Instant::now() < give_up, "{} frames, end {:?}", self.frames.len(), self.end);
            let n = self.port.read(&mut buffer).unwrap();
            let (frames, n_markers, end) = (&mut self.frames, &mut self.n_markers, &mut self.end);
            self.link.push(&buffer[..n], &mut |event| match event {
                DeviceEvent::Frame(frame) => frames.push((frame.seq, frame.markers.to_vec())),
                DeviceEvent::Markers(markers) => *n_markers += markers.len(),
                DeviceEvent::EndOfStream(status) => *end = Some(status),
                _ => {}
            });
        }
        self.link.counters().bytes
    }

    fn record(path: &Path) -> Self {
        let mut host = Self::open(path);
        host.send(Command::Identify);
        host.read_until(|host| host.n_markers > 0);
        host.send(Command::Start { line_bytes_per_s: 0 });
        host.read_until(|host| host.end.is_some());
        assert_eq!(host.link.counters().bytes_skipped, 0);
        host
    }
}

#[test]
fn every_byte_passes_both_ways() {
    let mut line = PtyLine::open(None).unwrap();
    let mut host = SerialTransport::open(line.path(), Some(3_000_000)).unwrap();
    // All bytes twice, among them 0x00, ^C, ^D, XON, XOFF, CR, LF and 0xff, adjacent and apart.
    let bytes: Vec<u8> =
        (0..=255).chain((0..=255).rev()).chain([0, 3, 4, 0x11, 0x13, 13, 10, 255]).collect();
    assert_eq!(line.write(&bytes).unwrap(), bytes.len());
    let mut got = Vec::new();
    let mut buffer = [0; 1000];
    let give_up = Instant::now() + TIMEOUT;
    while got.len() < bytes.len() && Instant::now() < give_up {
        let n = host.read(&mut buffer).unwrap();
        got.extend_from_slice(&buffer[..n]);
    }
    assert_eq!(got, bytes);
    host.write_all(&bytes).unwrap();
    got.clear();
    while got.len() < bytes.len() && Instant::now() < give_up {
        if let Ok(n) = line.read(&mut buffer) {
            got.extend_from_slice(&buffer[..n]);
        }
    }
    assert_eq!(got, bytes);
}

#[test]
fn two_hosts_in_turn_receive_every_frame() {
    let motion = jump(1000.0, 0.5, 40);
    let served =
        serve_in_background(motion.clone(), DeviceSettings::default(), ServeOptions::default());
    for run in 0..2u32 {
        // The port closes in between.
        let host = Host::record(&served.path);
        assert_eq!((host.n_markers, host.frames.len()), (40, 500));
        for (k, (seq, samples)) in host.frames.iter().enumerate() {
            assert_eq!(*seq, 500 * run + k as u32);
            assert!(samples.iter().map(|s| s.position_mm).eq(motion.frame(k).iter().copied()));
        }
        assert_eq!(host.end.unwrap().frames_dropped, 0);
    }
    let log = served.finish();
    assert_eq!(
        (log.starts, log.ends, log.total.frames_produced, log.frames_sent),
        (2, 2, 1000, 1000)
    );
}

#[test]
fn a_host_that_sleeps_loses_only_the_frames_that_the_device_counts() {
    let settings = DeviceSettings { queue_bytes: Some(100_000), ..DeviceSettings::default() };
    // 5 MB in all: more than pty and queue hold.
    let served = serve_in_background(jump(1000.0, 1.0, 300), settings, ServeOptions::default());
    let mut host = Host::open(&served.path);
    host.send(Command::Start { line_bytes_per_s: 0 });
    std::thread::sleep(Duration::from_millis(1_200));
    host.read_until(|host| host.end.is_some());
    let end = host.end.unwrap();
    assert_eq!(end.frames_produced, 1000);
    assert!(end.frames_dropped > 500, "{end:?}");
    assert_eq!(host.frames.len() as u64 + end.frames_dropped, end.frames_produced);
    assert_eq!(host.link.counters().bytes_skipped, 0);
    assert_eq!(served.finish().frames_sent, host.frames.len() as u64);
}

#[test]
fn once_returns_when_a_slow_host_has_read_all() {
    let motion = jump(500.0, 0.2, 15);
    let options = ServeOptions { once: true, ..ServeOptions::default() };
    let served = serve_in_background(motion, DeviceSettings::default(), options);
    let mut host = Host::open(&served.path);
    host.send(Command::Start { line_bytes_per_s: 0 });
    // By now everything is in the kernel's buffer, which a hang-up would discard.
    std::thread::sleep(Duration::from_millis(300));
    host.read_until(|host| host.end.is_some());
    assert_eq!(host.frames.len(), 100);
    let log = served.thread.join().unwrap().unwrap();
    assert_eq!(log.frames_sent, 100);
}

#[test]
fn once_waits_for_a_host_that_reads_late() {
    let options = ServeOptions { once: true, ..ServeOptions::default() };
    let served = serve_in_background(jump(500.0, 0.1, 15), DeviceSettings::default(), options);
    let mut host = Host::open(&served.path);
    host.send(Command::Start { line_bytes_per_s: 0 });
    // The motion takes 0.1 s.
    std::thread::sleep(Duration::from_millis(2500));
    assert!(!served.thread.is_finished(), "it hung up on a host that was late");
    host.read_until(|host| host.end.is_some());
    assert_eq!(host.frames.len(), 50);
    assert_eq!(served.thread.join().unwrap().unwrap().frames_sent, 50);
}

#[test]
fn a_host_that_never_reads_does_not_keep_the_line_open() {
    let options = ServeOptions { once: true, ..ServeOptions::default() };
    let served = serve_in_background(jump(500.0, 0.1, 15), DeviceSettings::default(), options);
    let mut host = Host::open(&served.path);
    host.send(Command::Start { line_bytes_per_s: 0 });
    let begun = Instant::now();
    while !served.thread.is_finished() {
        assert!(begun.elapsed() < TIMEOUT, "it still waits");
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(begun.elapsed() > Duration::from_secs(5), "{:?}", begun.elapsed());
}

#[test]
fn bytes_on_their_way_to_the_host_count_as_unread() {
    let mut line = PtyLine::open(None).unwrap();
    let mut host = SerialTransport::open(line.path(), None).unwrap();
    let (bytes, mut buffer) = ([7; 3000], [0; 4096]);
    // The kernel's worker is often, but not always, later than the question.
    for _ in 0..500 {
        assert_eq!(line.write(&bytes).unwrap(), bytes.len());
        assert!(line.unread().unwrap() > 0);
        let mut read = 0;
        while read < bytes.len() {
            read += host.read(&mut buffer).unwrap();
        }
        assert_eq!(line.unread().unwrap(), 0);
    }
}

#[test]
fn a_paced_line_is_no_faster_than_its_baud_rate() {
    // The device produces 260 kB/s, the line carries 23 kB/s.
    let settings = DeviceSettings { looping: true, ..DeviceSettings::default() };
    let options = ServeOptions { baud: Some(230_400), ..ServeOptions::default() };
    let served = serve_in_background(jump(1000.0, 1.0, 15), settings, options);
    let mut host = Host::open(&served.path);
    let begun = Instant::now();
    host.send(Command::Start { line_bytes_per_s: 0 });
    let bytes = host.read_until(|host| host.frames.len() >= 60);
    let carried = 23_040.0 * (begun.elapsed().as_secs_f64() + 0.01);
    assert!((bytes as f64) < carried, "{bytes} bytes, the line carries {carried}");
    drop(host);
    served.finish();
}

#[test]
fn the_log_has_every_frame() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sent.csv");
    let log = Box::new(fs::File::create(&path).unwrap());
    let options = ServeOptions { log: Some(log), once: true, ..ServeOptions::default() };
    let served = serve_in_background(jump(500.0, 0.1, 15), DeviceSettings::default(), options);
    let host = Host::record(&served.path);
    served.thread.join().unwrap().unwrap();
    let text = fs::read_to_string(&path).unwrap();
    let lines: Vec<_> = text.lines().collect();
    assert_eq!(
        (lines[0], lines.len(), host.frames.len()),
        ("run,seq,device_ticks,present,dropped,host_ns,unasked", 51, 50)
    );
    assert!(lines[50].starts_with("1,49,") && lines[50].contains(",15,0,"), "{}", lines[50]);
}

#[test]
fn links_replace_dangling_links_only() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("rig");
    let line = PtyLine::open(Some(&link)).unwrap();
    assert_eq!(line.path(), link);
    assert!(fs::read_link(&link).unwrap().starts_with("/dev/pts"));
    let second = PtyLine::open(Some(&link)).unwrap_err();
    assert!(matches!(second, PtyError::LinkExists { .. }), "{second}");
    drop(line);
    assert!(fs::symlink_metadata(&link).is_err(), "the link outlived its pty");
    std::os::unix::fs::symlink("/dev/pts/999999", &link).unwrap();
    drop(PtyLine::open(Some(&link)).unwrap());
    fs::write(&link, "precious").unwrap();
    assert!(matches!(PtyLine::open(Some(&link)), Err(PtyError::LinkExists { .. })));
    assert_eq!(fs::read_to_string(&link).unwrap(), "precious");
    let nowhere = PtyLine::open(Some(&folder.path().join("no/such/rig"))).unwrap_err();
    assert!(matches!(nowhere, PtyError::Link { .. }), "{nowhere}");
}

#[test]
fn an_early_stop_still_opens_and_closes_the_line() {
    let mut device = Device::new(jump(60.0, 0.1, 1), DeviceSettings::default()).unwrap();
    let stop = AtomicBool::new(true);
    let mut opened = None;
    let sent = serve_pty(&mut device, None, ServeOptions::default(), &stop, |path| {
        opened = Some((path.to_owned(), path.exists()));
    });
    let (path, existed) = opened.unwrap();
    assert!(existed && !path.exists(), "{}", path.display());
    assert_eq!(sent.unwrap(), SentLog::default());
}

#[test]
fn a_pulled_cable_disconnects_the_host_and_comes_back_under_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("rig");
    let mut line = PtyLine::open(Some(&link)).unwrap();
    for round in 0..3u8 {
        let mut host = SerialTransport::open(&link, None).unwrap();
        assert_eq!(line.write(&[round, 7]).unwrap(), 2);
        let mut buffer = [0; 8];
        let give_up = Instant::now() + TIMEOUT;
        while host.read(&mut buffer).unwrap() == 0 {
            assert!(Instant::now() < give_up, "nothing arrives");
        }
        assert_eq!(buffer[..2], [round, 7]);
        line.unplug().unwrap();
        assert!(link.symlink_metadata().is_err(), "the link is still there");
        assert!(host.read(&mut buffer).is_err(), "the host does not see that it is gone");
        // Without a host, nothing is written or read, and nothing fails.
        assert_eq!((line.write(b"x").unwrap(), line.read(&mut buffer).unwrap()), (0, 0));
        assert_eq!(line.unread().unwrap(), 0);
        assert!(!line.wait(Duration::from_millis(1)).unwrap());
        line.maintain().unwrap();
        line.plug_in().unwrap();
        assert_eq!(line.path(), link);
    }
    drop(line);
    assert!(link.symlink_metadata().is_err(), "the link is still there");
}
