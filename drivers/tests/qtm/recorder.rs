//! A server of a recorder: who may control it, what its clients learn, and which frames a slow one misses.

use std::net::SocketAddr;

use mocapd_drivers::qtm::{
    AnalogDevice, ClientId, ClientReport, Event, FrameHeader, OwnerCommand, PacketKind,
    PacketReader, QtmServer, ServedFrame, ServedSettings, WireMarker, put_text, read_frame,
};

const PASSWORD: &str = "correct horse battery";

fn settings(labels: &[&str]) -> ServedSettings {
    let labels = labels.iter().map(|label| (*label).to_owned()).collect();
    ServedSettings { frequency_hz: 100.0, up_axis: "+Y", labels, ..ServedSettings::default() }
}

/// A server and one client that reads what it gets.
struct Connected {
    server: QtmServer,
    id: ClientId,
    reader: PacketReader,
}

#[derive(Debug, PartialEq)]
enum Received {
    Ok(String),
    Error(String),
    Event(Event),
    Frame(u32),
    NoMoreData,
}

impl Connected {
    fn new(password: Option<&str>) -> Self {
        let password = password.map(str::to_owned);
        let mut server = QtmServer::of_recorder("mocapd 1".to_owned(), 2, password);
        let id = server.connect(peer(1)).unwrap();
        let mut connected = Self { server, id, reader: PacketReader::default() };
        assert_eq!(connected.ask("Version 1.28"), [ok("Version set to 1.28")]);
        connected
    }

    fn send(&mut self, command: &str) {
        let mut bytes = Vec::new();
        put_text(PacketKind::Command, command, &mut bytes);
        self.server.receive(self.id, &bytes);
    }

    /// All that waits.
    fn read(&mut self) -> Vec<Received> {
        let bytes = self.server.take_pending(self.id);
        self.reader.extend(&bytes);
        let mut received = Vec::new();
        while let Some(packet) = self.reader.next_packet().unwrap() {
            received.push(match packet.kind.unwrap() {
                PacketKind::Error => Received::Error(packet.text().into_owned()),
                PacketKind::Event => Received::Event(Event::of(packet.body[0]).unwrap()),
                PacketKind::Data => {
                    Received::Frame(read_frame(packet.body, &mut |_, _| {}).unwrap().number)
                }
                PacketKind::NoMoreData => Received::NoMoreData,
                _ => Received::Ok(packet.text().into_owned()),
            });
        }
        received.retain(|it| *it != ok("QTM RT Interface connected"));
        received
    }

    fn ask(&mut self, command: &str) -> Vec<Received> {
        self.send(command);
        self.read()
    }

    fn frames(&mut self, numbers: std::ops::Range<u32>) {
        let labelled = [WireMarker { position_mm: [1.0; 3], id: 0, residual_mm: 0.0 }];
        for number in numbers {
            let header = FrameHeader { time_us: u64::from(number) * 10_000, number };
            let frame =
                ServedFrame { header, rates: [0; 2], labelled: &labelled, ..Default::default() };
            self.server.frame(&frame);
        }
    }

    fn report(&self) -> ClientReport {
        self.server.report(self.id).unwrap()
    }
}

fn peer(port: u16) -> SocketAddr {
    ([127, 0, 0, 1], port).into()
}

fn ok(text: &str) -> Received {
    Received::Ok(text.to_owned())
}

fn error(text: &str) -> Received {
    Received::Error(text.to_owned())
}

#[test]
fn what_is_recorded_is_the_measurement() {
    let mut client = Connected::new(None);
    assert_eq!(client.ask("GetState"), [Received::Event(Event::ConnectionClosed)]);
    assert_eq!(client.ask("GetParameters 3D"), [error("Parameters not available")]);
    assert_eq!(client.ask("StreamFrames AllFrames 3D"), [Received::NoMoreData]);
    client.server.set_source(Some(settings(&["head"])));
    assert_eq!(client.read(), [Received::Event(Event::Connected)]);
    client.frames(7..9);
    assert_eq!(client.read(), [Received::Frame(7), Received::Frame(8)]);
    client.server.set_capturing(true);
    client.server.set_capturing(true);
    client.server.set_source(Some(settings(&["head", "hand"])));
    let events = [Event::CaptureStarted, Event::CameraSettingsChanged].map(Received::Event);
    assert_eq!(client.read(), events);
    let [Received::Ok(xml)] = &client.ask("GetParameters 3D General")[..] else { panic!() };
    assert!(xml.contains("hand") && xml.contains("<Frequency>100</Frequency>"), "{xml}");
    client.server.set_source(None);
    let end = [
        Received::Event(Event::CaptureStopped),
        Received::Event(Event::ConnectionClosed),
        Received::NoMoreData,
    ];
    assert_eq!(client.read(), end);
    client.server.set_capturing(true);
    assert_eq!(client.read(), [], "nothing is captured without a device");
}

#[test]
fn nobody_controls_a_recorder_without_a_password() {
    let mut client = Connected::new(None);
    client.server.set_source(Some(settings(&[])));
    client.read();
    for password in ["", PASSWORD] {
        let refused = error("Client control disabled in QTM");
        assert_eq!(client.ask(&format!("TakeControl {password}")), [refused]);
    }
    for command in ["Start", "Stop", "New", "Close", "Event x", "Load \"a\"", "Save \"a\""] {
        let refused = error("You must be master to issue this command");
        assert_eq!(client.ask(command), [refused], "{command}");
    }
    assert_eq!(client.server.take_requests(), []);
}

#[test]
fn the_client_with_the_password_starts_and_stops() {
    let mut client = Connected::new(Some(PASSWORD));
    for wrong in ["", "correct horse batter", "correct horse battery!", "Correct horse battery"] {
        // One guess each: a third one disconnects.
        let mut client = Connected::new(Some(PASSWORD));
        let refused = error("Wrong or missing password");
        assert_eq!(client.ask(&format!("TakeControl {wrong}")), [refused], "{wrong}");
    }
    assert_eq!(client.ask(&format!("TakeControl {PASSWORD}")), [ok("You are now master")]);
    assert!(client.report().is_master);
    assert_eq!(client.ask("Start"), [error("Not connected. Create connection with new")]);
    client.server.set_source(Some(settings(&[])));
    assert_eq!(client.read(), [Received::Event(Event::Connected)]);
    assert_eq!(client.ask("Event x"), [error("QTM is not capturing")]);
    client.send("Start");
    // The next command waits for the reply to this one.
    assert_eq!(client.ask("QTMVersion"), []);
    assert!(!client.server.may_receive(client.id));
    let requests = client.server.take_requests();
    assert_eq!((requests.len(), &requests[0].command), (1, &OwnerCommand::Start));
    assert_eq!((requests[0].client, requests[0].peer), (client.id, peer(1)));
    client.server.complete(client.id, Ok("Starting measurement"));
    let replies = [ok("Starting measurement"), ok("QTM Version is mocapd 1")];
    assert_eq!(client.read(), replies);
    client.server.set_capturing(true);
    client.read();
    assert_eq!(client.ask("Start"), [error("Measurement is already running")]);
    client.send("Event a label");
    let mark = OwnerCommand::Mark("a label".to_owned());
    assert_eq!(client.server.take_requests()[0].command, mark);
    client.server.complete(client.id, Err("the disk is full"));
    assert_eq!(client.read(), [error("the disk is full")]);
    client.send("Stop");
    assert_eq!(client.server.take_requests()[0].command, OwnerCommand::Stop);
    // A client that leaves meanwhile gets no reply, and nobody else is confused.
    client.server.disconnect(client.id);
    client.server.complete(client.id, Ok("Stopping measurement"));
}

#[test]
fn a_client_that_guesses_is_disconnected_and_reported() {
    let mut client = Connected::new(Some(PASSWORD));
    let refused = || [error("Wrong or missing password")];
    for _ in 0..3 {
        assert!(!client.server.is_out_of_step(client.id));
        assert_eq!(client.ask("TakeControl guess"), refused());
    }
    assert!(client.server.is_out_of_step(client.id));
    assert_eq!(client.ask(&format!("TakeControl {PASSWORD}")), []);
    assert_eq!(client.server.take_wrong_passwords(), [peer(1); 3]);
    assert_eq!(client.server.take_wrong_passwords(), []);
    // Nobody guesses where there is none.
    let mut client = Connected::new(None);
    (0..5).for_each(|_| drop(client.ask("TakeControl guess")));
    assert!(!client.server.is_out_of_step(client.id));
    assert_eq!(client.server.take_wrong_passwords(), []);
    assert!(!format!("{:?}", Connected::new(Some(PASSWORD)).server).contains(PASSWORD));
}

#[test]
fn a_client_out_of_step_gets_no_more_frames() {
    let mut client = Connected::new(None);
    client.server.set_source(Some(settings(&["head"])));
    client.send("StreamFrames AllFrames 3D");
    client.read();
    client.server.receive(client.id, &[255; 8]);
    client.frames(0..5);
    assert_eq!(client.read(), [error("Parse error")]);
    assert!(!client.server.wants_frames());
}

#[test]
fn a_slow_client_misses_the_oldest_frames_and_all_are_counted() {
    let mut client = Connected::new(None);
    client.server.set_source(Some(settings(&["head"])));
    client.read();
    client.send("StreamFrames AllFrames 3D");
    client.frames(0..250);
    // A second of frames waits. None of the first one was sent.
    let frames = client.read();
    assert_eq!(frames.first(), Some(&Received::Frame(150)));
    assert_eq!((frames.len(), frames.last()), (100, Some(&Received::Frame(249))));
    assert_eq!((client.report().frames_sent, client.report().frames_missed), (100, 150));
    // The rest of a frame that was begun is sent, and what a divisor leaves out is not missed. A second of its frames are 50.
    client.send("StreamFrames FrequencyDivisor:2 3D");
    client.frames(300..301);
    let first = client.server.pending(client.id)[..1].to_vec();
    client.server.sent(client.id, 1);
    client.reader.extend(&first);
    client.frames(301..601);
    let frames = client.read();
    let expected = [300, 504, 600].map(|number| Some(Received::Frame(number)));
    assert_eq!(frames.len(), 50);
    assert_eq!(
        [frames.first(), frames.get(1), frames.last()],
        expected.each_ref().map(Option::as_ref)
    );
    let report = client.report();
    assert_eq!((report.frames_sent, report.frames_missed), (150, 150 + 101));
    client.server.left_out(10);
    assert_eq!(client.report().frames_missed, 251 + 5);
    client.server.disconnect(client.id);
    assert_eq!(client.server.frames_missed(), 256, "those of clients that left count");
}

#[test]
fn there_is_room_for_so_many_clients() {
    let mut client = Connected::new(None);
    let second = client.server.connect(peer(2)).unwrap();
    assert_eq!(client.server.connect(peer(3)), None);
    client.server.disconnect(second);
    assert!(client.server.connect(peer(3)).is_some());
    assert_eq!(client.server.reports().len(), 2);
}

#[test]
fn frames_that_fit_into_no_datagram_are_refused_by_udp_and_those_that_grow_are_reported() {
    let labels: Vec<String> = (0..4096).map(|k| format!("m{k}")).collect();
    let channels = (0..16).map(|k| (format!("EMG {k}"), "V".to_owned())).collect();
    let analog = vec![AnalogDevice { id: 1, rate_hz: 2000.0, channels }];
    let crowded = ServedSettings { labels: labels.clone(), analog, ..settings(&[]) };
    let mut client = Connected::new(None);
    client.server.set_source(Some(crowded));
    client.read();
    let refused = [error("Frames are too large for UDP, request them by TCP")];
    // 4096 markers with residuals are 65 552 bytes; a second of the analog device is 128 kB.
    for (request, fits) in [
        ("AllFrames UDP:5000 3DRes", false),
        ("AllFrames UDP:5000 3D Analog", true),
        ("Frequency:1 UDP:5000 3D Analog", false),
        ("Frequency:1 UDP:5000 3D AnalogSingle", true),
        ("FrequencyDivisor:100 UDP:5000 Analog", false),
        ("Frequency:1 3DRes Analog", true),
    ] {
        let reply = client.ask(&format!("StreamFrames {request}"));
        assert_eq!(reply, if fits { &[][..] } else { &refused[..] }, "{request}");
        client.ask("StreamFrames Stop");
    }

    client.server.set_source(Some(settings(&["head"])));
    client.ask("StreamFrames AllFrames UDP:5000 3DRes 3DNoLabelsRes");
    let missing = WireMarker { position_mm: [1.0; 3], id: 0, residual_mm: 0.0 };
    let many = vec![missing; 4000];
    for number in 0..3 {
        let header = FrameHeader { time_us: u64::from(number) * 10_000, number };
        let frame =
            ServedFrame { header, labelled: &many[..1], unlabelled: &many, ..Default::default() };
        client.server.frame(&frame);
    }
    assert_eq!(client.report().frames_missed, 3);
    assert_eq!(client.server.take_datagrams().len(), 0);
    assert_eq!(client.server.take_too_large(), [peer(1)], "once a stream");
    client.frames(3..5);
    assert_eq!(
        (client.server.take_datagrams().len(), client.server.take_too_large().len()),
        (2, 0)
    );
}
