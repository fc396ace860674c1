//! Idle TCP connections without a token shut the owner out of the Unix socket, and slow clients of the socket shut out
//! TCP.

use std::{
    io::{Read, Write},
    net::SocketAddr,
    os::unix::net::UnixStream,
    path::PathBuf,
    time::{Duration, Instant},
};

use mocapd_service::http::{HttpOptions, HttpServer, TimeLimits};

use crate::service::{
    fake::Fake,
    http::client::{Answer, connect, exchange, request},
};

/// Connection slots of each listener.
const CONNECTIONS_MAX: usize = 8;

/// Idle connections: several times as many.
const STRANGERS: usize = 40;

const TOKEN: &str = "correct-horse-battery-staple";

struct Rig {
    tcp: SocketAddr,
    socket: PathBuf,
    server: Option<HttpServer>,
    _folder: tempfile::TempDir,
}

impl Rig {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("rig.sock");
        // No time-outs during a test: only the number of places counts.
        let long = Duration::from_secs(600);
        let limits = TimeLimits { head: long, body: long, stall: long, ..TimeLimits::default() };
        let options = HttpOptions {
            unix_socket: Some(socket.clone()),
            tcp: Some("127.0.0.1:0".parse().unwrap()),
            token: Some(TOKEN.to_owned()),
            connections_max: CONNECTIONS_MAX,
            limits,
            ..HttpOptions::default()
        };
        let server = HttpServer::start(options, Fake::new(folder.path(), Vec::new())).unwrap();
        let tcp = server.tcp_address().unwrap();
        Self { tcp, socket, server: Some(server), _folder: folder }
    }

    fn over_unix(&self, path: &str) -> Answer {
        let mut stream = self.connect_unix();
        stream.write_all(&request("GET", path, &[], "")).unwrap();
        Answer::parse(&to_the_end(stream))
    }

    fn connect_unix(&self) -> UnixStream {
        let stream = UnixStream::connect(&self.socket).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        stream
    }

    fn over_tcp(&self, path: &str) -> Answer {
        let bearer = format!("Bearer {TOKEN}");
        let asked = request("GET", path, &[("authorization", &bearer)], "");
        Answer::parse(&exchange(self.tcp, &asked))
    }

    fn figure(&self, name: &str) -> u64 {
        let metrics = String::from_utf8(self.over_unix("/metrics").body).unwrap();
        let line = metrics.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
        line.unwrap_or_else(|| panic!("no {name}: {metrics}")).parse::<f64>().unwrap() as u64
    }

    /// Waits until the server has accepted every connection: each holds a slot or was turned away.
    fn settled(&self, made: usize) {
        let deadline = Instant::now() + Duration::from_secs(20);
        loop {
            let [refused, evicted] = ["refused", "evicted"]
                .map(|which| self.figure(&format!("mocapd_http_connections_{which}_total")));
            // The connection of this request is open as well.
            let open = self.figure("mocapd_http_connections") - 1;
            if open + refused + evicted >= made as u64 {
                return;
            }
            assert!(Instant::now() < deadline, "{open} open, {refused} refused, {evicted} evicted");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn end(mut self) {
        self.server.take().unwrap().stop(Duration::ZERO).unwrap();
    }
}

fn to_the_end(mut stream: impl Read) -> Vec<u8> {
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).ok();
    bytes
}

#[test]
fn idle_and_dripping_strangers_on_tcp_leave_the_socket_alone() {
    let rig = Rig::start();
    let strangers: Vec<_> = (0..STRANGERS)
        .map(|n| {
            let mut stream = connect(rig.tcp);
            // Every second one is silent; the others begin a request or a wrong login.
            match n % 4 {
                1 => stream.write_all(b"GET /v1/st").unwrap(),
                3 => {
                    let form = [("content-type", "application/x-www-form-urlencoded")];
                    let login = request("POST", "/login", &form, "token=wrong");
                    stream.write_all(&login).unwrap();
                }
                _ => {}
            }
            stream
        })
        .collect();
    let answered: Vec<u16> = (0..50).map(|_| rig.over_unix("/v1/status").status).collect();
    assert_eq!(answered, [200; 50]);
    rig.settled(STRANGERS);
    // Requests with the token are served over TCP as well: idle connections are closed for them.
    let answered: Vec<u16> = (0..20).map(|_| rig.over_tcp("/v1/status").status).collect();
    assert_eq!(answered, [200; 20]);
    // Only as many as there are places stay open; each of the others gets a reason, unless it had its answer.
    let open = rig.figure("mocapd_http_connections") as usize - 1;
    assert!(open <= CONNECTIONS_MAX, "{open}");
    rig.end();
    let mut turned_away = 0;
    for stream in strangers {
        let bytes = to_the_end(stream);
        if bytes.starts_with(b"HTTP/1.1 503 ") {
            let answer = Answer::parse(&bytes);
            answer.refused(503, "unavailable");
            assert_eq!(answer.header("retry-after"), Some("1"));
            turned_away += 1;
        }
    }
    // A wrong login may have been answered before it was turned away.
    assert!(turned_away >= STRANGERS * 3 / 4 - CONNECTIONS_MAX, "{turned_away}");
}

#[test]
fn slow_clients_of_the_socket_shut_out_neither_tcp_nor_one_another() {
    let rig = Rig::start();
    // More connections than places, some of which are reserved for requests in progress.
    let slow: Vec<_> = (0..3 * STRANGERS)
        .map(|n| {
            let mut stream = rig.connect_unix();
            let begun: &[u8] = match n % 3 {
                0 => b"",
                1 => b"GET /v1/st",
                // The header is complete, the body is not.
                _ => &request("POST", "/v1/mark", &[("content-length", "100")], "{"),
            };
            stream.write_all(begun).unwrap();
            stream
        })
        .collect();
    let answered: Vec<u16> = (0..50).map(|_| rig.over_tcp("/v1/status").status).collect();
    assert_eq!(answered, [200; 50]);
    let answered: Vec<u16> = (0..50).map(|_| rig.over_unix("/v1/status").status).collect();
    assert_eq!(answered, [200; 50]);
    drop(slow);
    rig.end();
}

#[test]
fn other_connections_do_not_end_a_request_in_progress() {
    let rig = Rig::start();
    let mut stream = connect(rig.tcp);
    let bearer = format!("Bearer {TOKEN}");
    stream.write_all(&request("GET", "/v1/events", &[("authorization", &bearer)], "")).unwrap();
    let mut began = [0; 15];
    stream.read_exact(&mut began).unwrap();
    assert_eq!(&began, b"HTTP/1.1 200 OK");
    let strangers: Vec<_> = (0..STRANGERS).map(|_| connect(rig.tcp)).collect();
    rig.settled(STRANGERS + 1);
    stream.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
    let mut rest = Vec::new();
    let ended = stream.read_to_end(&mut rest);
    assert!(ended.is_err(), "the stream goes on: {}", String::from_utf8_lossy(&rest));
    drop(strangers);
    rig.end();
}
