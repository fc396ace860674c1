//! Malformed requests.

use std::{
    io::{Read, Write},
    sync::atomic::Ordering,
    time::Duration,
};

use mocapd_service::http::HttpOptions;

use super::{
    client::{connect, get, request},
    local, serve_with, short_limits,
};
use crate::support::Seeded;

const N_REQUESTS: usize = 10_000;
const SEED: u64 = 20_260_401;

/// A malformed request: bytes changed, removed or inserted, truncated, or random bytes only.
fn malformed(random: &mut Seeded) -> Vec<u8> {
    let whole = [
        request("GET", "/v1/status", &[], ""),
        request("POST", "/v1/start", &[], r#"{"name": "x"}"#),
        request("POST", "/v1/arm", &[("transfer-encoding", "chunked")], "2\r\n{}\r\n0\r\n\r\n"),
        request("GET", "/v1/takes/x/download", &[("range", "bytes=0-5,7-9")], ""),
        request("GET", "/v1/events", &[("last-event-id", "4")], ""),
    ];
    let mut bytes = whole[random.below(whole.len())].clone();
    match random.below(4) {
        0 => bytes = (0..random.below(300)).map(|_| random.next() as u8).collect(),
        1 => bytes.truncate(random.below(bytes.len())),
        _ => {}
    }
    for _ in 0..=random.below(6) {
        let at = random.below(bytes.len() + 1);
        let what = random.next() as u8;
        match random.below(5) {
            0 if at < bytes.len() => bytes[at] = what,
            1 if at < bytes.len() => drop(bytes.remove(at)),
            2 => bytes.insert(at, what),
            3 => drop(bytes.splice(at..at, *b"\r\n")),
            _ => drop(bytes.splice(at..at, *b"%00%2e%2e/")),
        }
    }
    bytes
}

#[test]
fn ten_thousand_malformed_requests_change_nothing() {
    let served = serve_with(HttpOptions { limits: short_limits(), ..local() });
    let at = served.at;
    std::thread::scope(|scope| {
        for worker in 0..8 {
            scope.spawn(move || {
                let mut random = Seeded::new(SEED + worker);
                for n in 0..N_REQUESTS / 8 {
                    let bytes = malformed(&mut random);
                    let mut stream = connect(at);
                    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
                    stream.write_all(&bytes).ok();
                    stream.shutdown(std::net::Shutdown::Write).ok();
                    let mut answer = [0; 64];
                    // A response or none, but never a hang.
                    match stream.read(&mut answer) {
                        Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {
                            panic!("seed {SEED} + {worker}, request {n} hangs: {bytes:?}")
                        }
                        Ok(len) if len > 0 => {
                            let text = String::from_utf8_lossy(&answer[..len]).into_owned();
                            assert!(text.starts_with("HTTP/1."), "{text}");
                            assert!(!text.starts_with("HTTP/1.1 500"), "{bytes:?}");
                        }
                        _ => {}
                    }
                }
            });
        }
    });
    assert_eq!(get(at, "/v1/status").status, 200);
    // Some mutations leave a valid request.
    let executed = served.fake.executed.load(Ordering::Relaxed) as usize;
    assert!(executed < N_REQUESTS / 10, "{executed}");
    served.stop();
}
