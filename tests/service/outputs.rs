//! All publishers at once, each with clients that read, that do not, and that send garbage: what is recorded is complete, and every
//! client's frames are accounted for.
//!
//! For longer, with a release build:
//!
//! ```sh
//! MOCAPD_OUTPUTS_SECONDS=60 cargo test --release -p mocapd --test integration -- --nocapture all_outputs
//! ```

use std::{
    io::{ErrorKind, Read, Write},
    net::{Ipv4Addr, SocketAddr, TcpStream, UdpSocket},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, Builder, JoinHandle},
    time::{Duration, Instant},
};

use mocapd_acquire::threads::Heartbeat;
use mocapd_drivers::{
    natnet::{Bitstream, FrameOfData, MessageKind},
    qtm::{PacketKind, PacketReader, put_text, read_frame},
};
use mocapd_service::{
    config::{
        DeviceChoice, FoxglovePublishConfig, LslPublishConfig, NatNetPublishConfig,
        QtmPublishConfig,
    },
    control::{Control, Request},
    engine::{Engine, EngineOptions},
    publish::{
        FOXGLOVE, LSL, NATNET, PublishedFeed, PublisherName, QTM, RunningPublisher, open_foxglove,
        open_lsl, open_natnet, open_qtm,
    },
    status::{PublishStatus, PublishedClient},
};
use mocapd_simulator::qtm::QtmSettings;
use mocapd_testkit::random::Random;

use super::{
    engine::{named, options, read, wait_until},
    publish::{KNOWN_WITHIN, Source, crowd},
    publish_network::{Client, asked, described},
};
use crate::support::fast;

/// A publisher, and how its clients read it.
struct Output {
    name: PublisherName,
    open: fn(PublishedFeed, &Arc<dyn Control>) -> RunningPublisher,
    /// A client that has requested all frames.
    request: fn(SocketAddr) -> TcpStream,
    /// A frame's place in time, for each frame in what a client has read so far; frames follow each other by `step`, if their
    /// times are even.
    frames: fn() -> Box<dyn FrameReader>,
    step: Option<u64>,
}

/// Finds frames in the bytes that a client reads.
trait FrameReader: Send {
    fn extend(&mut self, bytes: &[u8]);
    fn next(&mut self) -> Option<u64>;
}

/// The publishers whose clients connect by TCP. Those of NatNet have datagrams: [`NatNetClients`].
const OUTPUTS: &[Output] = &[
    Output {
        name: QTM,
        open: |feed, control| {
            let config = QtmPublishConfig { clients_max: 10, ..QtmPublishConfig::default() };
            open_qtm(&config, feed, control).unwrap()
        },
        request: |address| {
            let mut stream = TcpStream::connect(address).unwrap();
            let mut bytes = Vec::new();
            put_text(PacketKind::Command, "Version 1.28", &mut bytes);
            let all = "StreamFrames AllFrames 3DRes 3DNoLabelsRes";
            put_text(PacketKind::Command, all, &mut bytes);
            stream.write_all(&bytes).unwrap();
            stream
        },
        frames: || Box::new(QtmFrames(PacketReader::default())),
        step: Some(1),
    },
    Output {
        name: FOXGLOVE,
        open: |feed, control| {
            let config =
                FoxglovePublishConfig { clients_max: 10, ..FoxglovePublishConfig::default() };
            open_foxglove(&config, feed, control).unwrap()
        },
        request: |address| {
            let mut stream = TcpStream::connect(address).unwrap();
            subscribe_to_all(&mut stream, address);
            stream
        },
        frames: || Box::new(FoxgloveFrames { is_open: true, ..FoxgloveFrames::default() }),
        step: Some(1_000_000),
    },
    Output {
        name: LSL,
        open: |feed, control| {
            let config = LslPublishConfig { enabled: true, ..LslPublishConfig::default() };
            let config = LslPublishConfig { clients_max: 10, ..config };
            open_lsl(&config, feed, control).unwrap()
        },
        request: |address| {
            let request = format!(
                "LSL:streamfeed/110 {}\r\nNative-Byte-Order: 1234\r\nValue-Size: 4\r\nMax-Buffer-Length: 10000\r\n\
                 Protocol-Version: 110\r\n\r\n",
                described(address.port()).uid
            );
            asked(address.port(), &request)
        },
        frames: || Box::new(LslFrames::default()),
        step: None,
    },
];

struct QtmFrames(PacketReader);

impl FrameReader for QtmFrames {
    fn extend(&mut self, bytes: &[u8]) {
        self.0.extend(bytes);
    }

    fn next(&mut self) -> Option<u64> {
        while let Some(packet) = self.0.next_packet().unwrap() {
            if packet.kind == Some(PacketKind::Data) {
                return Some(read_frame(packet.body, &mut |_, _| {}).unwrap().number.into());
            }
        }
        None
    }
}

/// Opens a web socket, and subscribes to every channel of the device.
fn subscribe_to_all(stream: &mut TcpStream, address: SocketAddr) {
    let request = format!(
        "GET / HTTP/1.1\r\nHost: {address}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: foxglove.websocket.v1\r\n\r\n"
    );
    stream.write_all(request.as_bytes()).unwrap();
    let mut frames = FoxgloveFrames::default();
    let mut buffer = [0; 4096];
    while frames.channels.len() < 6 {
        let n = stream.read(&mut buffer).unwrap();
        frames.extend(&buffer[..n]);
        assert_eq!(frames.next(), None, "nothing is subscribed to");
    }
    let subscription = |id: &u64| format!(r#"{{"id":{},"channelId":{id}}}"#, id + 100);
    assert_eq!(frames.channels[0] + 100, u64::from(LOG_SUBSCRIPTION), "the server's first channel");
    let all: Vec<String> = frames.channels.iter().map(subscription).collect();
    let text = format!(r#"{{"op":"subscribe","subscriptions":[{}]}}"#, all.join(","));
    // A mask of zeros leaves the text as it is.
    let mut message = vec![0x81, 0x80 | 126];
    message.extend((text.len() as u16).to_be_bytes());
    message.extend([0; 4]);
    message.extend(text.as_bytes());
    stream.write_all(&message).unwrap();
}

/// The subscription to the log.
const LOG_SUBSCRIPTION: u32 = 101;

/// Frames of a web socket: each begins with a message of its time.
#[derive(Default)]
struct FoxgloveFrames {
    bytes: Vec<u8>,
    is_open: bool,
    channels: Vec<u64>,
    /// The time of the next message.
    time_ns: Option<u64>,
}

impl FrameReader for FoxgloveFrames {
    fn extend(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
        if !self.is_open
            && let Some(end) = self.bytes.windows(4).position(|four| four == b"\r\n\r\n")
        {
            assert!(self.bytes.starts_with(b"HTTP/1.1 101 "));
            self.bytes.drain(..end + 4);
            self.is_open = true;
        }
    }

    fn next(&mut self) -> Option<u64> {
        let mut at = 0;
        let mut found = None;
        while self.is_open && found.is_none() {
            let rest = &self.bytes[at..];
            let (Some(&kind), Some(&short)) = (rest.first(), rest.get(1)) else { break };
            let n_long = match short {
                126 => 2,
                127 => 8,
                _ => 0,
            };
            let Some(long) = rest.get(2..2 + n_long) else { break };
            let long = long.iter().fold(0, |n, byte| n << 8 | usize::from(*byte));
            let length = if n_long == 0 { usize::from(short) } else { long };
            let Some(payload) = rest.get(2 + n_long..2 + n_long + length) else { break };
            match (kind, payload.first()) {
                (0x81, _) => self.channels.extend(channel_ids(payload)),
                (0x82, Some(2)) => {
                    self.time_ns = Some(u64::from_le_bytes(payload[1..9].try_into().unwrap()));
                }
                (0x82, Some(1)) => {
                    // The log states its time while there is no device.
                    let time_ns = self.time_ns.take();
                    found = time_ns.filter(|_| payload[1..5] != LOG_SUBSCRIPTION.to_le_bytes());
                }
                other => panic!("{other:?}"),
            }
            at += 2 + n_long + length;
        }
        self.bytes.drain(..at);
        found
    }
}

/// The numbers of the channels that a message announces.
fn channel_ids(message: &[u8]) -> Vec<u64> {
    let message: serde_json::Value = serde_json::from_slice(message).unwrap();
    let channels = message["channels"].as_array().cloned().unwrap_or_default();
    channels.iter().map(|channel| channel["id"].as_u64().unwrap()).collect()
}

/// Samples behind the headers of a stream, after two that test the line: each has a tag, its time and three floats a marker.
#[derive(Default)]
struct LslFrames {
    bytes: Vec<u8>,
    is_open: bool,
    n_tested: usize,
}

impl FrameReader for LslFrames {
    fn extend(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
        if !self.is_open
            && let Some(end) = self.bytes.windows(4).position(|four| four == b"\r\n\r\n")
        {
            self.bytes.drain(..end + 4);
            self.is_open = true;
        }
    }

    fn next(&mut self) -> Option<u64> {
        // Three of four markers of the crowd are labelled.
        const SAMPLE_BYTES: usize = 1 + 8 + 3 * 4 * 150;
        while self.is_open && self.bytes.len() >= SAMPLE_BYTES {
            let sample: Vec<u8> = self.bytes.drain(..SAMPLE_BYTES).collect();
            assert_eq!(sample[0], 2, "it has a time");
            self.n_tested += 1;
            if self.n_tested > 2 {
                let time_s = f64::from_le_bytes(sample[1..9].try_into().unwrap());
                return Some((time_s * 1e9) as u64);
            }
        }
        None
    }
}

/// Clients of NatNet, to which datagrams are sent whether they read them or not: one reads, one does not, and one sends garbage.
struct NatNetClients {
    good: JoinHandle<Vec<u32>>,
    _deaf: Client,
    garbage: JoinHandle<()>,
}

impl NatNetClients {
    fn connect(address: SocketAddr, stop: &Arc<AtomicBool>) -> Self {
        let (good, deaf) = (Client::connect(address), Client::connect(address));
        let until = Arc::clone(stop);
        let read = move || {
            let mut numbers = Vec::new();
            while !until.load(Ordering::Relaxed) {
                if let Some(body) = good.next(MessageKind::Frame) {
                    numbers.push(FrameOfData::read(&body, Bitstream::new(4, 1)).unwrap().number);
                }
                if numbers.len() % 500 == 0 {
                    good.send(MessageKind::KeepAlive, "");
                }
            }
            numbers
        };
        let good = Builder::new().name("client".to_owned()).spawn(read).unwrap();
        let until = Arc::clone(stop);
        let send = move || {
            let mut random = Random::new(8);
            let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
            while !until.load(Ordering::Relaxed) {
                let length = (random.next_u64() % 1400) as usize;
                let mut bytes: Vec<u8> = (0..length).map(|_| random.next_u64() as u8).collect();
                // Half of them have a kind that exists.
                if let [kind, high, ..] = &mut bytes[..]
                    && *kind < 128
                {
                    (*kind, *high) = (*kind % 11, 0);
                }
                socket.send_to(&bytes, address).unwrap();
                thread::sleep(Duration::from_millis(5));
            }
        };
        let garbage = Builder::new().name("garbage".to_owned()).spawn(send).unwrap();
        Self { good, _deaf: deaf, garbage }
    }
}

/// A client that reads as fast as it can, until it is told to stop and nothing comes any more: the places of its frames.
fn read_all(
    mut stream: TcpStream,
    mut frames: Box<dyn FrameReader>,
    stop: &AtomicBool,
) -> (TcpStream, Vec<u64>) {
    stream.set_read_timeout(Some(Duration::from_secs(1))).unwrap();
    let (mut places, mut buffer) = (Vec::new(), vec![0; 1 << 18]);
    loop {
        let is_over = stop.load(Ordering::Relaxed);
        match stream.read(&mut buffer) {
            // As streams of LSL are, when their device is disarmed.
            Ok(0) => break,
            Ok(n) => {
                frames.extend(&buffer[..n]);
                places.extend(std::iter::from_fn(|| frames.next()));
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock && is_over => break,
            Err(error) => assert_eq!(error.kind(), ErrorKind::WouldBlock),
        }
    }
    (stream, places)
}

/// A client that sends garbage, and connects again whenever it is disconnected: at first at once, then after a proper start.
fn send_garbage(output: &Output, address: SocketAddr, stop: &AtomicBool) {
    let mut random = Random::new(7);
    let mut stream: Option<TcpStream> = None;
    let mut is_proper = false;
    while !stop.load(Ordering::Relaxed) {
        let bytes: Vec<u8> = (0..1000).map(|_| random.next_u64() as u8).collect();
        match &mut stream {
            None => {
                let open = match is_proper {
                    true => (output.request)(address),
                    false => TcpStream::connect(address).unwrap(),
                };
                open.set_nonblocking(true).unwrap();
                (stream, is_proper) = (Some(open), !is_proper);
            }
            Some(open) => match open.write(&bytes) {
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(_) => stream = None,
            },
        }
        thread::sleep(Duration::from_millis(5));
    }
}

/// The clients of an output.
struct Clients {
    output: &'static Output,
    local: SocketAddr,
    good: JoinHandle<(TcpStream, Vec<u64>)>,
    garbage: Option<JoinHandle<()>>,
    stuck: TcpStream,
    slow: TcpStream,
}

impl Clients {
    fn connect(output: &'static Output, address: SocketAddr, stop: &Arc<AtomicBool>) -> Self {
        let good = (output.request)(address);
        let local = good.local_addr().unwrap();
        let until = Arc::clone(stop);
        let read = move || read_all(good, (output.frames)(), &until);
        let good = Builder::new().name("client".to_owned()).spawn(read).unwrap();
        let until = Arc::clone(stop);
        let garbage = move || send_garbage(output, address, &until);
        let garbage = Builder::new().name("garbage".to_owned()).spawn(garbage).ok();
        let [stuck, slow] = [(); 2].map(|()| (output.request)(address));
        Self { output, local, good, garbage, stuck, slow }
    }

    /// Whether both clients that hardly read have missed more than all buffers hold.
    fn have_missed(&self, engine: &Engine) -> bool {
        [&self.stuck, &self.slow].into_iter().all(|stream| {
            let local = stream.local_addr().unwrap();
            client(engine, self.output, local).is_some_and(|client| client.frames_missed > 500)
        })
    }
}

/// Frames that may wait for a client, or that it requested later than another: two seconds, and 4 MiB of those of QTM.
const WAITING_MAX: u64 = 4000;

fn status(engine: &Engine, output: &Output) -> PublishStatus {
    let all = engine.status().publish;
    all.into_iter().find(|status| status.protocol == output.name.id).unwrap()
}

fn client(engine: &Engine, output: &Output, local: SocketAddr) -> Option<PublishedClient> {
    let local = local.to_string();
    status(engine, output).clients.into_iter().find(|client| client.address == local)
}

#[test]
fn all_outputs_with_hostile_clients_cost_the_recording_no_frame() {
    let seconds = std::env::var("MOCAPD_OUTPUTS_SECONDS").map_or(3, |text| text.parse().unwrap());
    let directory = tempfile::tempdir().unwrap();
    let source = Source::new(crowd(), QtmSettings { looping: true, ..QtmSettings::default() });
    let options = options(directory.path(), directory.path());
    let publishers = OUTPUTS.iter().map(|output| output.name).chain([NATNET]).collect();
    let mut options = EngineOptions { publishers, ..options };
    options.device.uri = DeviceChoice::At(source.uri.parse().unwrap());
    options.take.codec = fast(1.0);
    let engine = Arc::new(Engine::start(options, &Heartbeat::default()).unwrap());
    let control: Arc<dyn Control> = Arc::<Engine>::clone(&engine);
    let running: Vec<RunningPublisher> = OUTPUTS
        .iter()
        .map(|output| (output.open)(engine.published(output.name).unwrap(), &control))
        .collect();
    let config =
        NatNetPublishConfig { enabled: true, data_port: 1, ..NatNetPublishConfig::default() };
    let config = NatNetPublishConfig { bitstream: Bitstream::new(4, 1), clients_max: 10, ..config };
    let natnet = open_natnet(&config, engine.published(NATNET).unwrap(), &control).unwrap();
    engine.arm(&Request::default()).unwrap();
    let stop = Arc::new(AtomicBool::new(false));
    // Streams and settings begin anew while markers appear.
    wait_until("all markers", || engine.status().input.frames > KNOWN_WITHIN.into());
    let natnet_clients = NatNetClients::connect(natnet.address(), &stop);
    let mut clients: Vec<Clients> = OUTPUTS
        .iter()
        .zip(&running)
        .map(|(output, running)| Clients::connect(output, running.address(), &stop))
        .collect();
    wait_until("frames for everybody", || {
        clients.iter().all(|of| {
            client(&engine, of.output, of.local).is_some_and(|client| client.frames_sent > 0)
        })
    });
    let started = engine.start(&named("crowd")).unwrap();
    let began = Instant::now();
    while began.elapsed().as_secs() < seconds
        || !clients.iter().all(|clients| clients.have_missed(&engine))
    {
        assert!(began.elapsed().as_secs() < 120 + seconds, "{:?}", engine.status().publish);
        thread::sleep(Duration::from_secs(1));
        for Clients { slow, .. } in &mut clients {
            slow.read_exact(&mut [0]).unwrap();
        }
    }
    let ledger = engine.stop(&Request::default()).unwrap().ledger;
    assert!(ledger.closes && ledger.recorded > 2000, "{ledger:?}");
    assert_eq!(ledger.frames_sent, ledger.recorded, "{ledger:?}");
    read(&started.path);
    stop.store(true, Ordering::Relaxed);
    for garbage in clients.iter_mut().filter_map(|clients| clients.garbage.take()) {
        garbage.join().unwrap();
    }
    engine.disarm(&Request::default()).unwrap();
    for Clients { output, local, good, stuck, slow, .. } in clients {
        let (good, places) = good.join().unwrap();
        let title = output.name.title;
        // The status is 200 ms old at most.
        thread::sleep(Duration::from_millis(500));
        assert!(places.is_sorted_by(|a, b| a < b), "{title}: in order, and none twice");
        let Some(report) = client(&engine, output, local) else {
            let n_sent = status(&engine, output).frames_sent;
            assert!((2000..=n_sent).contains(&(places.len() as u64)), "{title}: {n_sent}");
            println!("{title}: a client read {} frames", places.len());
            continue;
        };
        assert_eq!(places.len() as u64, report.frames_sent, "{title}: {report:?}");
        let [first, last] = [0, places.len() - 1].map(|at| places[at]);
        assert_eq!((last - first) % output.step.unwrap_or(1), 0, "{title}");
        let n_between =
            output.step.map_or(0, |step| (last - first) / step + 1 - places.len() as u64);
        assert!(n_between <= report.frames_missed, "{title}: {n_between}, {report:?}");
        let wanted = report.frames_sent + report.frames_missed;
        let others = [&stuck, &slow].map(|stream| stream.local_addr().unwrap());
        let others = others.map(|local| client(&engine, output, local).unwrap());
        for other in &others {
            // It requested frames some tenths of a second later, and some wait for it.
            let counted = other.frames_sent + other.frames_missed;
            assert!(counted <= wanted + 1000, "{title}: {counted} of {wanted}");
            assert!(counted + WAITING_MAX >= wanted, "{title}: {counted} of {wanted}");
        }
        println!(
            "{title}: a client read {} frames and missed {n_between}; those that hardly read missed {} and {}; {} refused",
            places.len(),
            others[0].frames_missed,
            others[1].frames_missed,
            status(&engine, output).clients_refused,
        );
        drop((good, stuck, slow));
    }
    let NatNetClients { good, garbage, .. } = natnet_clients;
    let numbers = good.join().unwrap();
    garbage.join().unwrap();
    assert!(numbers.is_sorted_by(|a, b| a < b), "in order, and none twice");
    assert!(numbers.len() as u64 > ledger.recorded / 2, "{} frames of NatNet", numbers.len());
    println!("NatNet: a client read {} frames", numbers.len());
    println!("recorded {} frames of {}", ledger.recorded, ledger.frames_sent);
    running.into_iter().chain([natnet]).for_each(RunningPublisher::close);
    engine.stop_service();
}
