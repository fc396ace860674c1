//! The Unix socket, and starting and stopping the server.

use std::{
    io::{Read, Write},
    net::TcpStream,
    os::unix::net::UnixStream,
    path::Path,
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

use mocapd_service::http::{HttpOptions, HttpServer};

use super::{
    client::{Answer, connect, post, request},
    local, serve, serve_with,
};
use crate::{service::fake::Fake, support::assert_mentions};

fn over_unix(path: &Path, bytes: &[u8]) -> Answer {
    let mut stream = UnixStream::connect(path).unwrap();
    stream.write_all(bytes).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    Answer::parse(&answer)
}

#[test]
fn the_unix_socket_needs_no_token() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.sock");
    let options = HttpOptions {
        unix_socket: Some(path.clone()),
        token: Some("correct-horse-battery-staple".to_owned()),
        ..local()
    };
    let served = serve_with(options);
    assert_eq!(over_unix(&path, &request("GET", "/v1/status", &[], "")).status, 200);
    let named = request("POST", "/v1/arm", &[("host", "whatever")], "{}");
    assert_eq!(over_unix(&path, &named).status, 200);
    // Behind a proxy the service's own page is accepted, a page of another site is not.
    let through = |origin| [("host", "rig.lab"), ("origin", origin)];
    let ours = request("POST", "/v1/arm", &through("https://rig.lab"), "{}");
    assert_eq!(over_unix(&path, &ours).status, 200);
    let other = request("POST", "/v1/arm", &through("https://evil.example"), "{}");
    over_unix(&path, &other).refused(403, "forbidden");

    let again = HttpOptions { unix_socket: Some(path.clone()), ..HttpOptions::default() };
    let refused = HttpServer::start(again, Fake::new(folder.path(), Vec::new())).unwrap_err();
    assert_mentions(&refused.to_string(), &[&path.display().to_string()]);
    served.stop();
    assert!(!path.exists());
}

#[test]
fn stopping_waits_only_for_running_requests() {
    let served = serve();
    let at = served.at;
    // An idle connection and an incomplete request would never end.
    let idle = connect(at);
    let mut slow = connect(at);
    slow.write_all(b"GET /v1/st").unwrap();
    served.fake.command_ms.store(400, Ordering::Relaxed);
    let response = std::thread::scope(|scope| {
        let request = scope.spawn(|| post(at, "/v1/arm", "{}"));
        std::thread::sleep(Duration::from_millis(150));
        let began = Instant::now();
        served.stop();
        assert!(began.elapsed() < Duration::from_secs(6), "{:?}", began.elapsed());
        request.join().unwrap()
    });
    assert_eq!(response.status, 200, "it was being executed");
    assert!(TcpStream::connect(at).is_err(), "the server no longer listens");
    drop(idle);
}

#[test]
fn stopping_waits_no_longer_than_requested() {
    let served = serve();
    let at = served.at;
    served.fake.command_ms.store(3000, Ordering::Relaxed);
    let mut stream = connect(at);
    stream.write_all(&request("POST", "/v1/arm", &[], "{}")).unwrap();
    std::thread::sleep(Duration::from_millis(150));
    let began = Instant::now();
    served.server.stop(Duration::from_millis(300)).unwrap();
    assert!(began.elapsed() < Duration::from_millis(1500), "{:?}", began.elapsed());
}
