//! The event stream and the live stream, with fast, slow and returning clients.

use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpStream},
    time::{Duration, Instant},
};

use mocapd_service::{
    http::HttpOptions,
    status::{ServiceEventKind, State},
};

use super::{
    client::{Answer, connect, get, request, unchunked},
    local, serve, serve_with, short_limits,
};

/// An open stream, and the bytes received so far.
struct Stream {
    stream: TcpStream,
    bytes: Vec<u8>,
}

impl Stream {
    fn open(at: SocketAddr, path: &str, headers: &[(&str, &str)]) -> Self {
        let mut stream = connect(at);
        stream.write_all(&request("GET", path, headers, "")).unwrap();
        stream.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
        let mut stream = Self { stream, bytes: Vec::new() };
        stream.until(|stream| stream.bytes.windows(4).any(|window| window == b"\r\n\r\n"));
        stream
    }

    fn read(&mut self) -> bool {
        let mut piece = vec![0; 1 << 16];
        match self.stream.read(&mut piece) {
            Ok(0) => return false,
            Ok(len) => self.bytes.extend_from_slice(&piece[..len]),
            Err(error) => assert!(error.kind() == std::io::ErrorKind::WouldBlock, "{error}"),
        }
        true
    }

    fn until(&mut self, done: impl Fn(&Self) -> bool) {
        let began = Instant::now();
        while !done(self) {
            assert!(began.elapsed() < Duration::from_secs(10), "{}", self.text());
            assert!(self.read(), "it ended: {}", self.text());
        }
    }

    fn body(&self) -> Vec<u8> {
        let end = self.bytes.windows(4).position(|window| window == b"\r\n\r\n").unwrap();
        unchunked(&self.bytes[end + 4..])
    }

    fn text(&self) -> String {
        String::from_utf8_lossy(&self.body()).into_owned()
    }

    /// Id, kind and data of the events received so far.
    fn events(&self) -> Vec<(String, String, serde_json::Value)> {
        let text = self.text();
        let whole = text.rsplit_once("\n\n").map_or("", |whole| whole.0);
        let events = whole.split("\n\n").filter(|event| event.contains("data:"));
        events
            .map(|event| {
                let field = |name: &str| {
                    let line = event.lines().find_map(|line| line.strip_prefix(name));
                    line.unwrap_or_default().trim().to_owned()
                };
                (field("id:"), field("event:"), serde_json::from_str(&field("data:")).unwrap())
            })
            .collect()
    }

    /// Kind and body of the messages received so far.
    fn messages(&self) -> Vec<(u8, Vec<u8>)> {
        let body = self.body();
        let mut rest = &body[..];
        let mut messages = Vec::new();
        while let Some((len, tail)) = rest.split_first_chunk::<4>() {
            let len = u32::from_le_bytes(*len) as usize;
            let Some((message, tail)) = tail.split_at_checked(len) else { break };
            messages.push((message[0], message[1..].to_vec()));
            rest = tail;
        }
        messages
    }
}

fn serve_with_short_limits() -> super::Served {
    serve_with(HttpOptions { limits: short_limits(), ..local() })
}

#[test]
fn events_arrive_at_once_and_after_a_reconnection() {
    let served = serve_with_short_limits();
    let mark = |text: &str| {
        served.fake.feeds.publish(ServiceEventKind::Mark, text.to_owned(), State::Idle, None);
    };
    let mut first = Stream::open(served.at, "/v1/events", &[]);
    mark("one\nline");
    mark("two");
    first.until(|stream| stream.events().len() == 2);
    let events = first.events();
    assert_eq!((events[0].1.as_str(), &events[0].2["message"]), ("mark", &"one\nline".into()));
    assert_eq!(events[1].2["number"], 2);
    // Without events a comment is sent as a keep-alive.
    first.until(|stream| stream.text().contains("\n:") || stream.text().starts_with(':'));
    let last_seen = events[0].0.clone();
    drop(first);
    mark("three");
    let mut back = Stream::open(served.at, "/v1/events", &[("last-event-id", &last_seen)]);
    back.until(|stream| stream.events().len() == 2);
    let messages: Vec<_> = back.events().iter().map(|e| e.2["message"].clone()).collect();
    assert_eq!(messages, ["two", "three"]);
    let mut after = Stream::open(served.at, "/v1/events?after=0", &[]);
    after.until(|stream| stream.events().len() == 3);
    // With an id of another run of the service the number of missed events is unknown.
    let mut other = Stream::open(served.at, "/v1/events", &[("last-event-id", "17f-99")]);
    other.until(|stream| stream.events().len() == 4);
    assert_eq!(
        (other.events()[0].1.as_str(), &other.events()[0].2["missed"]),
        ("missed", &serde_json::Value::Null)
    );
    get(served.at, "/v1/events?after=x").refused(400, "invalid");
}

#[test]
fn a_client_that_returns_too_late_gets_the_number_of_missed_events() {
    let served = serve_with_short_limits();
    let mark = |n: u64| {
        served.fake.feeds.publish(ServiceEventKind::Mark, n.to_string(), State::Idle, None);
    };
    let mut seen = Stream::open(served.at, "/v1/events", &[]);
    mark(1);
    seen.until(|stream| stream.events().len() == 1);
    let id = seen.events()[0].0.clone();
    drop(seen);
    let mut stayed = Stream::open(served.at, "/v1/events", &[]);
    for n in 2..=700 {
        mark(n);
        // The queues of the fake are short, too.
        std::thread::sleep(Duration::from_micros(300));
    }
    // Wait until the server has received all events.
    stayed.until(|stream| stream.events().iter().any(|event| event.2["number"] == 700));
    let mut back = Stream::open(served.at, "/v1/events", &[("last-event-id", &id)]);
    back.until(|stream| stream.events().iter().any(|event| event.2["number"] == 700));
    let events = back.events();
    assert_eq!(events[0].1, "missed");
    // Missed and received events are all events.
    let missed: u64 = events.iter().filter_map(|event| event.2["missed"].as_u64()).sum();
    let received = events.iter().filter(|event| event.1 == "mark").count() as u64;
    assert_eq!(missed + received, 699, "{missed} missed, {received} received");
    assert!(received <= 512);
}

#[test]
fn frames_follow_their_table_of_markers() {
    let served = serve();
    let mut viewer = Stream::open(served.at, "/v1/live", &[]);
    viewer.until(|stream| stream.messages().len() == 1);
    let (kind, table) = viewer.messages().remove(0);
    let table: serde_json::Value = serde_json::from_slice(&table).unwrap();
    assert_eq!((kind, &table["labels"][1]), (1, &"m1".into()));
    served.fake.feeds.send_frame(7, 2);
    viewer.until(|stream| stream.messages().len() == 4);
    assert_eq!(table["bodies"], serde_json::json!(["wand"]));
    let (kind, frame) = viewer.messages().remove(1);
    assert_eq!((kind, frame.len()), (2, 3 + 24 + 24));
    assert_eq!(u64::from_le_bytes(frame[3..11].try_into().unwrap()), 7);
    assert!(f32::from_le_bytes(frame[35..39].try_into().unwrap()).is_nan());
    // Its sampled channels follow it: group 1, one channel from -0.5 to 9.
    let (kind, samples) = viewer.messages().remove(2);
    assert_eq!((kind, &samples[..3]), (4, &[1, 0, 0][..]));
    assert_eq!(samples[3..15], [&40_u64.to_le_bytes()[..], &50_u32.to_le_bytes()].concat());
    assert_eq!(samples[15..], [(-0.5_f32).to_le_bytes(), 9_f32.to_le_bytes()].concat());
    // And so do its rigid bodies: one, tracked in three frames of five.
    let (kind, poses) = viewer.messages().remove(3);
    assert_eq!((kind, &poses[..3], poses.len()), (5, &[0; 3][..], 3 + 8 + 36 + 8));
    assert_eq!(poses[3..11], 5_u64.to_le_bytes());
    let expected = [0.0, 0.25, 1.0, 2.0, 3.0, 0.6, 0.0, 0.8, 0.0_f32];
    assert_eq!(poses[11..47], expected.map(f32::to_le_bytes).concat());
    assert_eq!(poses[47..], 3_u64.to_le_bytes());
    // A later viewer gets the table at once.
    served.fake.feeds.send_table(5);
    viewer.until(|stream| stream.messages().len() == 5);
    let mut second = Stream::open(served.at, "/v1/live", &[]);
    second.until(|stream| stream.messages().len() == 1);
    assert_eq!(served.fake.feeds.send_frame(8, 5), 1, "one feed serves all viewers");
    second.until(|stream| stream.messages().len() == 2);
    served.fake.feeds.close();
    let began = Instant::now();
    while viewer.read() {
        assert!(began.elapsed() < Duration::from_secs(5), "the stream ends with the frames");
    }
}

#[test]
fn a_slow_viewer_misses_frames_but_no_table() {
    let served = serve();
    let mut slow = Stream::open(served.at, "/v1/live", &[]);
    slow.until(|stream| stream.messages().len() == 1);
    let before = resident_bytes();
    // 4000 frames of 5000 markers: 240 MB that the viewer does not read, with a new table in the middle.
    for row in 0..4000_u64 {
        if row == 2000 {
            served.fake.feeds.send_table(5000);
        }
        served.fake.feeds.send_frame(row, 5000);
        std::thread::sleep(Duration::from_micros(100));
    }
    let grown = resident_bytes().saturating_sub(before);
    assert!(grown < 48 << 20, "{grown} bytes of memory for a viewer that does not read");
    served.fake.feeds.send_frame(4000, 5000);
    slow.until(|stream| {
        served.fake.feeds.send_frame(5000, 5000);
        stream.bytes.len() > 1 << 16
            && stream
                .messages()
                .iter()
                .any(|(kind, frame)| *kind == 2 && frame[3..11] == 5000_u64.to_le_bytes())
    });
    let messages = slow.messages();
    let tables: Vec<_> = messages.iter().filter(|message| message.0 == 1).collect();
    assert_eq!(tables.len(), 2, "both tables");
    let frames = messages.len() - tables.len();
    assert!(frames < 3000, "{frames} of 4000 frames were queued");
}

#[test]
fn streams_end_with_the_server_and_leave_connections_for_requests() {
    let options = HttpOptions { connections_max: 6, limits: short_limits(), ..local() };
    let served = serve_with(options);
    let streams: Vec<_> = ["/v1/events", "/v1/live", "/v1/events"]
        .map(|path| Stream::open(served.at, path, &[]))
        .into();
    get(served.at, "/v1/live").refused(503, "unavailable");
    assert_eq!(get(served.at, "/v1/status").status, 200);
    let began = Instant::now();
    served.stop();
    assert!(began.elapsed() < Duration::from_secs(3), "{:?}", began.elapsed());
    for mut stream in streams {
        while stream.read() {}
        assert_eq!(Answer::parse(&stream.bytes).status, 200);
    }
}

/// The resident memory of this process.
fn resident_bytes() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<u64>().unwrap() << 10
}
