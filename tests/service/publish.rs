//! What is recorded, published as a QTM does: every client's frames are accounted for, and no client costs the recording one.

use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    thread::{self, Builder, JoinHandle},
    time::Duration,
};

use mocapd_acquire::threads::Heartbeat;
use mocapd_drivers::qtm::{
    Event, FrameComponent, MarkerComponentKind, PacketKind, PacketReader, SampledComponentKind,
    put_text, read_components, read_frame,
};
use mocapd_service::{
    config::{DeviceChoice, QtmPublishConfig},
    control::{Control, Request},
    engine::{Engine, EngineOptions},
    publish::{QTM, RunningPublisher, open_qtm},
    status::{PublishStatus, PublishedClient, State},
};
use mocapd_simulator::{
    NetworkOptions,
    generator::{ForcePlates, JumpSpec, RigidBodies},
    qtm::{QtmDevice, QtmListener, QtmSettings, force_of},
    sampled::SampledSource,
};
use mocapd_take::motion::{Motion, is_gap};

use super::engine::{named, options, read, wait_until};
use crate::support::{assert_mentions, fast};

/// A simulated QTM on a port of its own, until it is dropped.
pub(super) struct Source {
    pub(super) uri: String,
    stop: Arc<AtomicBool>,
}

impl Source {
    pub(super) fn new(motion: Motion, settings: QtmSettings) -> Self {
        let mut device = QtmDevice::new(motion, settings).unwrap();
        let listener = QtmListener::open(0).unwrap();
        let (uri, stop) = (listener.uri(), Arc::new(AtomicBool::new(false)));
        let stopped = Arc::clone(&stop);
        let serve = move || drop(listener.serve(&mut device, NetworkOptions::default(), &stopped));
        Builder::new().name("simulator".to_owned()).spawn(serve).unwrap();
        Self { uri, stop }
    }
}

impl Drop for Source {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// An engine that records a source, and its publisher.
struct Published {
    _directory: tempfile::TempDir,
    _source: Source,
    engine: Arc<Engine>,
    publisher: Option<RunningPublisher>,
}

impl Published {
    fn new(motion: Motion, change: impl FnOnce(&mut QtmPublishConfig)) -> Self {
        Self::with(motion, QtmSettings { looping: true, ..QtmSettings::default() }, change)
    }

    fn with(
        motion: Motion,
        settings: QtmSettings,
        change: impl FnOnce(&mut QtmPublishConfig),
    ) -> Self {
        let directory = tempfile::tempdir().unwrap();
        let source = Source::new(motion, settings);
        let mut publish =
            QtmPublishConfig { enabled: true, clients_max: 10, ..QtmPublishConfig::default() };
        change(&mut publish);
        let options = options(directory.path(), directory.path());
        let mut options = EngineOptions { publishers: vec![QTM], ..options };
        options.device.uri = DeviceChoice::At(source.uri.parse().unwrap());
        options.take.codec = fast(1.0);
        let engine = Arc::new(Engine::start(options, &Heartbeat::default()).unwrap());
        let control: Arc<dyn Control> = Arc::<Engine>::clone(&engine);
        let feed = engine.published(QTM).unwrap();
        let publisher = Some(open_qtm(&publish, feed, &control).unwrap());
        Self { _directory: directory, _source: source, engine, publisher }
    }

    fn address(&self) -> SocketAddr {
        self.publisher.as_ref().unwrap().address()
    }

    fn status(&self) -> PublishStatus {
        self.engine.status().publish.into_iter().next().unwrap_or_default()
    }

    fn client(&self, address: SocketAddr) -> Option<PublishedClient> {
        let address = address.to_string();
        self.status().clients.into_iter().find(|client| client.address == address)
    }
}

impl Drop for Published {
    fn drop(&mut self) {
        self.publisher.take().unwrap().close();
        self.engine.stop_service();
    }
}

/// A client that sends commands and reads packets.
struct Client {
    stream: TcpStream,
    reader: PacketReader,
}

impl Client {
    fn connect(address: SocketAddr) -> Self {
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
        Self { stream, reader: PacketReader::default() }
    }

    fn ready(address: SocketAddr) -> Self {
        let mut client = Self::connect(address);
        assert_eq!(client.text(), "QTM RT Interface connected");
        assert_eq!(client.ask("Version 1.28"), "Version set to 1.28");
        client
    }

    fn send(&mut self, command: &str) {
        let mut bytes = Vec::new();
        put_text(PacketKind::Command, command, &mut bytes);
        self.stream.write_all(&bytes).unwrap();
    }

    /// The next packet; `None` at the end of the connection.
    fn packet(&mut self) -> Option<(PacketKind, Vec<u8>)> {
        loop {
            if let Some(packet) = self.reader.next_packet().unwrap() {
                return Some((packet.kind.unwrap(), packet.body.to_vec()));
            }
            let mut buffer = [0; 1 << 16];
            match self.stream.read(&mut buffer).unwrap() {
                0 => return None,
                n => self.reader.extend(&buffer[..n]),
            }
        }
    }

    /// The next text; events before it are left out.
    fn text(&mut self) -> String {
        loop {
            let (kind, body) = self.packet().unwrap();
            if kind != PacketKind::Event {
                return String::from_utf8(body).unwrap().trim_end_matches('\0').to_owned();
            }
        }
    }

    fn ask(&mut self, command: &str) -> String {
        self.send(command);
        self.text()
    }

    fn event(&mut self) -> Event {
        loop {
            if let (PacketKind::Event, body) = self.packet().unwrap() {
                return Event::of(body[0]).unwrap();
            }
        }
    }

    fn local(&self) -> SocketAddr {
        self.stream.local_addr().unwrap()
    }
}

/// A thread that reads frames: the client, and the numbers of its frames.
type Reading = JoinHandle<(Client, Vec<u32>)>;

/// Reads frames until `stop`, and for as long as some wait; returns their numbers.
fn read_frames(
    mut client: Client,
    stop: &AtomicBool,
    n_read: &AtomicUsize,
    check: impl Fn(u32, &[u8]),
) -> (Client, Vec<u32>) {
    client.send("StreamFrames AllFrames 3DRes 3DNoLabelsRes");
    let mut numbers = Vec::new();
    while let Some((kind, body)) = client.packet() {
        if kind == PacketKind::Data {
            let number = read_frame(&body, &mut |_, _| {}).unwrap().number;
            check(number, &body);
            numbers.push(number);
            n_read.fetch_add(1, Ordering::Relaxed);
        }
        if stop.load(Ordering::Relaxed) {
            break;
        }
    }
    (client, numbers)
}

/// Two hundred markers at 1000 Hz, of which every fourth has no label.
pub(super) fn crowd() -> Motion {
    let spec = JumpSpec {
        seconds: Some(1.0),
        n_markers: 200,
        occlusion: None,
        ..JumpSpec::new(5, 1000.0)
    };
    let mut motion = spec.generate().unwrap().motion;
    assert_eq!(motion.info.markers.len(), 200);
    for (column, marker) in motion.info.markers.iter_mut().enumerate() {
        marker.labelled = column % 4 != 3;
    }
    motion
}

/// Frames within which the writer knows all markers, on the slowest machine.
pub(super) const KNOWN_WITHIN: u32 = 1500;

/// Compares a frame with the source, float by float. The row of a frame is its number.
fn assert_is_source(motion: &Motion, number: u32, body: &[u8]) {
    let frame = motion.frame(number as usize % motion.n_frames());
    let of = |labelled: bool| {
        let markers = motion.info.markers.iter().zip(frame);
        let markers = markers.filter(move |(marker, _)| marker.labelled == labelled);
        markers.map(|(_, position)| *position)
    };
    read_frame(body, &mut |_, component| {
        let is_labelled = component.kind == MarkerComponentKind::LabelledWithResiduals;
        let mut expected: Vec<_> = of(is_labelled).collect();
        expected.retain(|position| is_labelled || !is_gap(*position));
        let found: Vec<_> = component.markers().collect();
        // Unlabelled markers, which appear with the first frames, are left out until the writer knows them.
        if !is_labelled && number < KNOWN_WITHIN && found.len() < expected.len() {
            return;
        }
        assert_eq!(found.len(), expected.len(), "frame {number}");
        for (found, expected) in found.iter().zip(expected) {
            assert_eq!(found.position_mm.map(f32::to_bits), expected.map(f32::to_bits));
            assert_eq!(found.residual_mm, 0.25);
        }
    })
    .unwrap();
}

#[test]
fn eight_clients_of_which_two_hardly_read_cost_the_recording_no_frame() {
    let motion = Arc::new(crowd());
    let published = Published::new((*motion).clone(), |_| {});
    let address = published.address();
    let (stop, n_read) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicUsize::new(0)));
    let good: Vec<(SocketAddr, Reading)> = (0..6)
        .map(|index| {
            let client = Client::ready(address);
            let (stop, n_read) = (Arc::clone(&stop), Arc::clone(&n_read));
            let (local, motion) = (client.local(), Arc::clone(&motion));
            let check = move |number: u32, body: &[u8]| {
                if index == 0 {
                    assert_is_source(&motion, number, body);
                }
            };
            let read = move || read_frames(client, &stop, &n_read, check);
            (local, Builder::new().name("client".to_owned()).spawn(read).unwrap())
        })
        .collect();
    let [mut stuck, mut slow] = [(); 2].map(|()| Client::ready(address));
    for client in [&mut stuck, &mut slow] {
        client.send("StreamFrames AllFrames 3DRes 3DNoLabelsRes");
    }
    let started = published.engine.start(&named("crowd")).unwrap();
    // One reads a byte a second, the other nothing, until both have missed more than all buffers hold.
    let missed = |client: &Client| published.client(client.local()).map_or(0, |c| c.frames_missed);
    let mut byte = [0; 1];
    let mut rounds = 0;
    while missed(&stuck) < 2000 || missed(&slow) < 2000 {
        slow.stream.read_exact(&mut byte).unwrap();
        thread::sleep(Duration::from_secs(1));
        rounds += 1;
        assert!(rounds < 120, "{:?}", published.status());
    }
    let stopped = published.engine.stop(&Request::default()).unwrap();
    let ledger = &stopped.ledger;
    assert!(ledger.closes && ledger.recorded > 2000, "{ledger:?}");
    assert_eq!((ledger.frames_sent, ledger.recorded), (ledger.recorded, ledger.recorded));
    read(&started.path);
    stop.store(true, Ordering::Relaxed);
    // They stay connected, so that their reports count all that they missed before their last frames.
    let good: Vec<_> =
        good.into_iter().map(|(local, thread)| (local, thread.join().unwrap())).collect();
    thread::sleep(Duration::from_secs(1));
    for (local, (_client, numbers)) in &good {
        let missed = published.client(*local).unwrap().frames_missed as usize;
        let passed = (numbers[numbers.len() - 1] - numbers[0]) as usize + 1;
        assert!(numbers.is_sorted_by(|a, b| a < b), "in order, and none twice");
        assert!(passed - numbers.len() <= missed, "{passed} {} {missed}", numbers.len());
    }
    let status = published.status();
    assert!(status.frames_missed >= missed(&stuck) + missed(&slow), "{status:?}");
    for client in [&stuck, &slow] {
        let report = published.client(client.local()).unwrap();
        assert_eq!((report.version.as_str(), report.transport.as_str()), ("1.28", "tcp"));
        assert!(report.is_streaming && !report.is_in_control, "{report:?}");
    }
}

fn small() -> Motion {
    JumpSpec { seconds: Some(1.0), ..JumpSpec::new(2, 100.0) }.generate().unwrap().motion
}

#[test]
fn a_client_with_the_password_starts_and_stops_a_take() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("password");
    let password = "a password of some length".replace(' ', "-");
    std::fs::write(&file, &password).unwrap();
    std::fs::set_permissions(&file, std::os::unix::fs::PermissionsExt::from_mode(0o600)).unwrap();
    let published = Published::new(small(), |config| {
        (config.control, config.password_file) = (true, Some(file.clone()));
    });
    published.engine.arm(&Request::default()).unwrap();
    let mut client = Client::ready(published.address());
    wait_until("the device", || client.ask("GetParameters General").contains("<Frequency>100"));
    assert_eq!(client.ask("TakeControl wrong"), "Wrong or missing password");
    assert_eq!(client.ask("Start"), "You must be master to issue this command");
    assert_eq!(client.ask(&format!("TakeControl {password}")), "You are now master");
    assert_eq!(client.ask("Start"), "Starting measurement");
    assert_eq!(client.event(), Event::CaptureStarted);
    assert_eq!(published.engine.status().state, State::Recording);
    assert_eq!(client.ask("Start"), "Measurement is already running");
    assert_eq!(client.ask("Event a mark"), "Event set");
    let path = published.engine.status().take.unwrap().path;
    assert_eq!(client.ask("Stop"), "Stopping measurement");
    assert_eq!(client.event(), Event::CaptureStopped);
    let summary = read(std::path::Path::new(&path));
    let texts: Vec<_> = summary.take.events.iter().map(|event| event.text.as_str()).collect();
    assert_mentions(&texts.join("\n"), &["started by the QTM client 127.0.0.1", "a mark"]);
    assert_eq!(client.ask("Stop"), "No measurement is running");
    published.engine.disarm(&Request::default()).unwrap();
    assert_eq!(client.event(), Event::ConnectionClosed);
    assert_eq!(client.ask("GetParameters General"), "Parameters not available");
}

#[test]
fn clients_are_bounded_and_only_read_unless_told_otherwise() {
    let published = Published::new(small(), |config| config.clients_max = 2);
    let address = published.address();
    assert!(address.ip().is_loopback(), "the default");
    let mut first = Client::ready(address);
    assert_eq!(first.ask("TakeControl"), "Client control disabled in QTM");
    let second = Client::ready(address);
    let mut third = Client::connect(address);
    assert_eq!(third.text(), "Connection refused. Max number of clients reached.");
    assert_eq!(third.packet(), None);
    wait_until("the refusal", || published.status().clients_refused == 1);
    drop(second);
    wait_until("the place", || published.status().clients.len() == 1);
    drop(Client::ready(address));
}

/// The values of the source: of electrodes, and of a force plate.
struct SentSamples {
    electrodes: Vec<f32>,
    plates: [Vec<f32>; 2],
}

impl SentSamples {
    fn new(sources: &[SampledSource], seconds: f64) -> Self {
        let physical = |index: usize, rate_hz: f64| -> Vec<Vec<f64>> {
            let (mut counts, info) = (Vec::new(), sources[index].info());
            sources[index].samples(0, (seconds * rate_hz) as u64, &mut counts);
            let scaled = |sample: &[f32]| {
                let all = sample.iter().zip(&info.channels);
                all.map(|(count, c)| (f64::from(*count) - c.offset) * c.scale).collect()
            };
            counts.chunks(info.channels.len()).map(scaled).collect()
        };
        let (loads, emg) = (physical(0, 1000.0), physical(1, 2000.0));
        let plates = [0, 6]
            .map(|at| loads.iter().flat_map(|sample| force_of(&sample[at..at + 6])).collect());
        Self { electrodes: emg.concat().iter().map(|value| *value as f32).collect(), plates }
    }
}

/// Bodies, analog channels and forces of the source reach the clients with their names, numbers and bits.
#[test]
fn bodies_and_samples_are_published_as_the_source_sent_them() {
    const SECONDS: f64 = 30.0;
    let spec = JumpSpec { seconds: Some(SECONDS), ..JumpSpec::new(4, 100.0) };
    let plates = Arc::new(ForcePlates::new(&spec).unwrap());
    let sampled = vec![
        SampledSource::plates(0, plates, 1000.0).unwrap(),
        SampledSource::electrodes(1, "5@2kHz".parse().unwrap(), 9).unwrap(),
    ];
    let bodies = Arc::new(RigidBodies::new(&spec, 3).unwrap());
    let sent = SentSamples::new(&sampled, SECONDS);
    let settings =
        QtmSettings { sampled, bodies: Some(Arc::clone(&bodies)), ..QtmSettings::default() };
    let published = Published::with(spec.generate().unwrap().motion, settings, |_| {});
    published.engine.arm(&Request::default()).unwrap();
    let mut client = Client::ready(published.address());
    wait_until("the device", || client.ask("GetParameters General").contains("<Frequency>100"));
    let named = client.ask("GetParameters 6D");
    let names: Vec<String> = bodies.infos().into_iter().map(|body| body.name).collect();
    assert!(names.iter().all(|name| named.contains(&format!("<Name>{name}</Name>"))), "{named}");
    assert_mentions(&client.ask("GetParameters Analog"), &["EMG5", "<Unit>V</Unit>", "COPz2"]);
    let plates = client.ask("GetParameters Force");
    assert_mentions(&plates, &["<Plate_ID>1</Plate_ID>", "<Plate_ID>2</Plate_ID>"]);
    client.send("StreamFrames AllFrames 3D 6DRes Analog Force");
    let (mut frames, mut n_components, mut poses, mut n_values) = (0, 0, Vec::new(), [0; 2]);
    while frames < 300 {
        let Some((PacketKind::Data, body)) = client.packet() else { continue };
        frames += 1;
        read_components(&body, &mut |header, component| match component {
            FrameComponent::Bodies(component) => {
                bodies.poses(u64::from(header.number), 100.0, &mut poses);
                assert_eq!(component.n_bodies(), 3);
                n_components += 1;
                for (found, sent) in component.bodies().zip(&poses) {
                    assert_eq!(found.position_mm, sent.position_mm, "{header:?}");
                    assert_eq!(found.residual_mm, sent.residual_mm);
                    // Its first column is the image of the x axis.
                    let [w, x, y, z] = sent.quaternion;
                    let image = [
                        w * w + x * x - y * y - z * z,
                        2.0 * (x * y + w * z),
                        2.0 * (x * z - w * y),
                    ];
                    let apart = found.matrix.iter().zip(image).map(|(a, b)| (a - b).abs());
                    assert!(apart.fold(0.0, f32::max) < 1e-5, "{found:?} {sent:?}");
                }
            }
            FrameComponent::Samples(samples) => {
                let (sent, is_force) = match (samples.kind, samples.id) {
                    (SampledComponentKind::Analog, 1) => (&sent.electrodes, 0),
                    (SampledComponentKind::Force, id) => (&sent.plates[id as usize - 1], 1),
                    // The nine channels of the plates, as of an analog device.
                    _ => return,
                };
                let mut values = Vec::new();
                samples.put_interleaved(0..samples.n_channels, 0..samples.n_samples, &mut values);
                let from = samples.first as usize * samples.n_channels;
                let sent = &sent[from..from + values.len()];
                assert!(values.iter().zip(sent).all(|(a, b)| a.to_bits() == b.to_bits()));
                n_values[is_force] += values.len();
            }
            _ => {}
        })
        .unwrap();
    }
    assert_eq!(n_components, 300);
    // Three seconds of each: 2000 samples of five channels, and 1000 forces of two plates.
    assert!(n_values[0] > 25_000 && n_values[1] > 45_000, "{n_values:?}");
}
