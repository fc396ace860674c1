//! What is recorded, published as NatNet and LSL at the same time: every frame and sample is accounted for, and no client costs
//! the recording one.

use std::{
    io::{Read, Write},
    net::{Ipv4Addr, SocketAddr, TcpStream, UdpSocket},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::Builder,
    time::{Duration, Instant},
};

use mocapd_acquire::threads::Heartbeat;
use mocapd_drivers::{
    lsl::StreamDescription,
    natnet::{
        Bitstream, FrameOfData, MODELS_CHANGED, Message, MessageKind, Model, OCCLUDED, in_m,
        put_message, put_text,
    },
};
use mocapd_service::{
    config::{DeviceChoice, LslPublishConfig, NatNetPublishConfig},
    control::{Control, Mark, Request},
    engine::{Engine, EngineOptions},
    publish::{LSL, NATNET, RunningPublisher, open_lsl, open_natnet},
    status::{PublishStatus, PublishedClient},
};
use mocapd_simulator::{
    NetworkOptions,
    generator::JumpSpec,
    qtm::{QtmDevice, QtmListener, QtmSettings},
};
use mocapd_take::motion::{Motion, is_gap};

use super::engine::{named, options, wait_until};
use crate::support::{assert_mentions, fast};

/// An engine that records a simulated QTM, and publishes it.
struct Published {
    _directory: tempfile::TempDir,
    stop: Arc<AtomicBool>,
    engine: Arc<Engine>,
    natnet: Option<RunningPublisher>,
    lsl: Option<RunningPublisher>,
}

impl Published {
    fn new(motion: Motion, clients_max: usize) -> Self {
        let directory = tempfile::tempdir().unwrap();
        let settings = QtmSettings { looping: true, ..QtmSettings::default() };
        let mut device = QtmDevice::new(motion, settings).unwrap();
        let listener = QtmListener::open(0).unwrap();
        let (uri, stop) = (listener.uri(), Arc::new(AtomicBool::new(false)));
        let stopped = Arc::clone(&stop);
        let serve = move || drop(listener.serve(&mut device, NetworkOptions::default(), &stopped));
        Builder::new().name("simulator".to_owned()).spawn(serve).unwrap();
        let options = options(directory.path(), directory.path());
        let mut options = EngineOptions { publishers: vec![NATNET, LSL], ..options };
        options.device.uri = DeviceChoice::At(uri.parse().unwrap());
        options.take.codec = fast(1.0);
        let engine = Arc::new(Engine::start(options, &Heartbeat::default()).unwrap());
        let control: Arc<dyn Control> = Arc::<Engine>::clone(&engine);
        let feed = |name| engine.published(name).unwrap();
        let natnet = NatNetPublishConfig {
            enabled: true,
            data_port: 1,
            bitstream: Bitstream::new(4, 1),
            clients_max,
            ..NatNetPublishConfig::default()
        };
        let natnet = Some(open_natnet(&natnet, feed(NATNET), &control).unwrap());
        let lsl = LslPublishConfig { enabled: true, clients_max: 2, ..LslPublishConfig::default() };
        let lsl = Some(open_lsl(&lsl, feed(LSL), &control).unwrap());
        Self { _directory: directory, stop, engine, natnet, lsl }
    }

    fn status(&self, protocol: &str) -> PublishStatus {
        let all = self.engine.status().publish;
        all.into_iter().find(|status| status.protocol == protocol).unwrap_or_default()
    }

    fn client(&self, protocol: &str, address: SocketAddr) -> Option<PublishedClient> {
        let address = address.to_string();
        self.status(protocol).clients.into_iter().find(|client| client.address == address)
    }
}

impl Drop for Published {
    fn drop(&mut self) {
        for publisher in [self.natnet.take(), self.lsl.take()].into_iter().flatten() {
            publisher.close();
        }
        self.engine.stop_service();
        self.stop.store(true, Ordering::Relaxed);
    }
}

fn motion(rate_hz: f64) -> Motion {
    let spec = JumpSpec { seconds: Some(1.0), n_markers: 20, ..JumpSpec::new(2, rate_hz) };
    let mut motion = spec.generate().unwrap().motion;
    for (column, marker) in motion.info.markers.iter_mut().enumerate() {
        marker.labelled = column < 16;
        marker.label = if column < 8 { format!("Leg:m{column}") } else { format!("m{column}") };
    }
    motion
}

/// A NatNet client at a socket of its own.
pub(super) struct Client(pub(super) UdpSocket);

impl Client {
    pub(super) fn connect(server: SocketAddr) -> Self {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        socket.connect(server).unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(1))).unwrap();
        let client = Self(socket);
        let mut bytes = Vec::new();
        put_text(MessageKind::Connect, "Ping", &mut bytes);
        client.0.send(&bytes).unwrap();
        client
    }

    pub(super) fn send(&self, kind: MessageKind, text: &str) {
        let mut bytes = Vec::new();
        match text {
            "" => put_message(kind, &mut bytes, |_| {}),
            text => put_text(kind, text, &mut bytes),
        }
        self.0.send(&bytes).unwrap();
    }

    /// The content of the next message of a kind; `None` if there is none for a second.
    pub(super) fn next(&self, kind: MessageKind) -> Option<Vec<u8>> {
        let mut buffer = vec![0; 1 << 16];
        let until = Instant::now() + Duration::from_secs(1);
        loop {
            if Instant::now() > until {
                return None;
            }
            let n = self.0.recv(&mut buffer).ok()?;
            let message = Message::of(&buffer[..n]).unwrap();
            if message.kind == Some(kind) {
                return Some(message.body.to_vec());
            }
        }
    }
}

#[test]
fn natnet_clients_get_every_frame_in_their_version_with_the_sources_positions() {
    let motion = motion(200.0);
    let published = Published::new(motion.clone(), 2);
    let address = published.natnet.as_ref().unwrap().address();
    // Its viewer was there before the device.
    let viewer = Client::connect(address);
    viewer.next(MessageKind::ServerInfo).unwrap();
    published.engine.arm(&Request::default()).unwrap();
    let first = viewer.next(MessageKind::Frame).unwrap();
    let first = FrameOfData::read(&first, Bitstream::new(4, 1)).unwrap();
    assert_eq!(first.end.flags & MODELS_CHANGED, MODELS_CHANGED, "it has to ask for names");
    wait_until("frames", || published.engine.status().input.frames > 200);
    let other = Client::connect(address);
    other.next(MessageKind::ServerInfo).unwrap();
    let third = Client::connect(address);
    assert_eq!(third.next(MessageKind::ServerInfo), None, "there is room for two");
    wait_until("the refusal", || published.status("natnet").clients_refused == 1);
    for client in [&viewer, &other] {
        client.send(MessageKind::Disconnect, "");
    }
    wait_until("their places", || published.status("natnet").clients.is_empty());
    published.engine.start(&named("natnet")).unwrap();
    let mut n_missed = 0;
    for version in [Bitstream::new(4, 1), Bitstream::new(3, 1)] {
        let client = Client::connect(address);
        client.next(MessageKind::ServerInfo).unwrap();
        client.send(MessageKind::Request, &format!("Bitstream,{version}"));
        assert_eq!(client.next(MessageKind::Response).unwrap(), [0; 4]);
        let model = (0..5).find_map(|_| {
            client.send(MessageKind::RequestModel, "");
            client.next(MessageKind::Model)
        });
        let model = Model::read(&model.unwrap(), version).unwrap();
        let sets: Vec<_> =
            model.sets.iter().map(|set| (set.name.as_str(), set.markers.len())).collect();
        assert_eq!(sets, [("Leg", 8), ("", 8)], "{version}");
        let (mut numbers, mut before_ns) = (Vec::new(), 0);
        for _ in 0..200 {
            let body = client.next(MessageKind::Frame).unwrap();
            let frame = FrameOfData::read(&body, version).unwrap();
            let source = motion.frame(frame.number as usize % motion.n_frames());
            for (marker, position) in frame.markers().zip(source).take(16) {
                assert_eq!(marker.flags & OCCLUDED != 0, is_gap(*position), "{}", frame.number);
                let position_m = if is_gap(*position) { [0.0; 3] } else { in_m(*position) };
                assert_eq!(marker.position_m, position_m, "frame {}", frame.number);
            }
            let [captured_ns, arrived_ns, sent_ns] = frame.end.ticks;
            assert!(before_ns < captured_ns && captured_ns <= arrived_ns + 1_000_000);
            assert!(arrived_ns <= sent_ns, "{:?}", frame.end);
            before_ns = captured_ns;
            numbers.push(frame.number);
            client.send(MessageKind::KeepAlive, "");
        }
        let local = client.0.local_addr().unwrap();
        let missed = published.client("natnet", local).unwrap().frames_missed as usize;
        let passed = (numbers[numbers.len() - 1] - numbers[0]) as usize + 1;
        assert!(passed - numbers.len() <= missed, "{passed} of {}, {missed}", numbers.len());
        n_missed += missed;
        client.send(MessageKind::Disconnect, "");
        wait_until("the place", || published.client("natnet", local).is_none());
    }
    let stopped = published.engine.stop(&Request::default()).unwrap();
    assert!(stopped.ledger.closes && stopped.ledger.recorded > 0, "{:?}", stopped.ledger);
    assert_eq!(stopped.ledger.frames_sent, stopped.ledger.recorded);
    let status = published.status("natnet");
    assert!(status.frames_sent >= 400 && status.frames_missed >= n_missed as u64, "{status:?}");
}

pub(super) fn asked(port: u16, request: &str) -> TcpStream {
    let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port)).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    stream.write_all(request.as_bytes()).unwrap();
    stream
}

pub(super) fn described(port: u16) -> StreamDescription {
    let mut xml = String::new();
    asked(port, "LSL:fullinfo\r\n").read_to_string(&mut xml).unwrap();
    StreamDescription::parse(&xml).unwrap()
}

#[test]
fn lsl_inlets_get_every_frame_and_event_and_one_that_does_not_read_costs_nothing() {
    let motion = motion(1000.0);
    let published = Published::new(motion.clone(), 2);
    let port = published.lsl.as_ref().unwrap().address().port();
    published.engine.arm(&Request::default()).unwrap();
    wait_until("frames", || published.engine.status().input.frames > 1200);
    let stream = described(port);
    assert_eq!((stream.kind.as_str(), stream.n_channels, stream.rate_hz), ("MoCap", 48, 1000.0));
    assert_eq!(stream.channels[1].label, "Leg:m0.y");
    let feed = |held: u32| {
        let request = format!(
            "LSL:streamfeed/110 {}\r\nNative-Byte-Order: 1234\r\nValue-Size: 4\r\nMax-Buffer-Length: {held}\r\n\
             Protocol-Version: 110\r\n\r\n",
            stream.uid
        );
        asked(port, &request)
    };
    let (mut good, stuck) = (feed(10_000), feed(100));
    let mut refused = String::new();
    let (mut bytes, mut headers) = (Vec::new(), [0; 1]);
    while !bytes.ends_with(b"\r\n\r\n") {
        good.read_exact(&mut headers).unwrap();
        bytes.push(headers[0]);
    }
    assert_mentions(&String::from_utf8(bytes).unwrap(), &["200 OK", &stream.uid]);
    feed(10).read_to_string(&mut refused).unwrap();
    assert_mentions(&refused, &["503"]);
    published.engine.start(&named("lsl")).unwrap();
    // Two test samples, then frames: a tag, a time stamp and 48 floats.
    let mut sample = [0; 1 + 8 + 48 * 4];
    good.read_exact(&mut sample).unwrap();
    good.read_exact(&mut sample).unwrap();
    let n_frames = motion.n_frames();
    let (mut row, mut before_s) = (None, 0.0);
    let until = Instant::now() + Duration::from_secs(60);
    let local = stuck.local_addr().unwrap();
    let missed = || published.client("lsl", local).map_or(0, |client| client.frames_missed);
    let mut n = 0;
    while missed() < 500 || n < 3000 {
        good.read_exact(&mut sample).unwrap();
        let time_s = f64::from_le_bytes(sample[1..9].try_into().unwrap());
        assert!(sample[0] == 2 && time_s > before_s, "{time_s} after {before_s} s");
        before_s = time_s;
        let values: Vec<f32> = sample[9..]
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
            .collect();
        let expected = |row: usize| -> Vec<f32> {
            motion.frame(row).iter().take(16).flat_map(|position| in_m(*position)).collect()
        };
        let same =
            |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| a == b || a.is_nan() && b.is_nan());
        let at = row.unwrap_or_else(|| {
            (0..n_frames).find(|row| same(&values, &expected(*row))).expect("a frame of the source")
        });
        assert!(same(&values, &expected(at % n_frames)), "sample {n}");
        row = Some(at + 1);
        n += 1;
        assert!(Instant::now() < until, "{:?}", published.status("lsl"));
    }
    published.engine.mark(&Mark { text: "here".to_owned(), ..Mark::default() }).unwrap();
    let stopped = published.engine.stop(&Request::default()).unwrap();
    assert!(stopped.ledger.closes, "{:?}", stopped.ledger);
    assert_eq!(stopped.ledger.frames_sent, stopped.ledger.recorded);
    let good = published.client("lsl", good.local_addr().unwrap()).unwrap();
    assert_eq!((good.frames_missed, good.transport.as_str()), (0, "tcp"));
    assert_eq!(published.status("lsl").clients_refused, 1);
    drop(stuck);
    wait_until("the place", || {
        published.status("lsl").clients.iter().all(|it| it.frames_missed == 0)
    });
    published.engine.disarm(&Request::default()).unwrap();
    wait_until("the end of the streams", || published.status("lsl").clients.is_empty());
}
