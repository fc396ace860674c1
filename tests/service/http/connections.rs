//! Slow clients, and too many of them.

use std::{
    io::{Read, Write},
    net::TcpStream,
    time::{Duration, Instant},
};

use mocapd_service::http::HttpOptions;

use super::{
    client::{Answer, connect, get, request},
    local, serve_with, short_limits,
};
use crate::support::assert_mentions;

fn serve_with_short_limits(connections_max: usize) -> super::Served {
    serve_with(HttpOptions { limits: short_limits(), connections_max, ..local() })
}

/// Reads until the server closes: the time taken, and the bytes received.
fn until_closed(mut stream: &TcpStream) -> (Duration, Vec<u8>) {
    let began = Instant::now();
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).ok();
    (began.elapsed(), bytes)
}

#[test]
fn slow_senders_are_disconnected_and_do_not_delay_others() {
    let served = serve_with_short_limits(128);
    let at = served.at;
    std::thread::scope(|scope| {
        let drips: Vec<_> = (0..60)
            .map(|n| {
                scope.spawn(move || {
                    let mut stream = connect(at);
                    let began = Instant::now();
                    // One byte every 40 ms: the header never ends.
                    let drip = b"GET /v1/status HTTP/1.1\r\nx-a: ";
                    for n in n.. {
                        if stream.write_all(&drip[n % drip.len()..][..1]).is_err()
                            || began.elapsed() > Duration::from_secs(10)
                        {
                            break;
                        }
                        std::thread::sleep(Duration::from_millis(40));
                    }
                    began.elapsed()
                })
            })
            .collect();
        std::thread::sleep(Duration::from_millis(200));
        for _ in 0..20 {
            let asked = Instant::now();
            assert_eq!(get(at, "/v1/status").status, 200);
            assert!(asked.elapsed() < Duration::from_millis(500), "{:?}", asked.elapsed());
        }
        for drip in drips {
            let lasted = drip.join().unwrap();
            assert!(lasted < Duration::from_secs(5), "{lasted:?}");
        }
    });
}

#[test]
fn a_silent_connection_is_closed() {
    let served = serve_with_short_limits(8);
    let silent = connect(served.at);
    let (lasted, _) = until_closed(&silent);
    assert!((300..4000).contains(&lasted.as_millis()), "{lasted:?}");
    // A kept-alive connection that becomes silent.
    let mut kept = connect(served.at);
    kept.write_all(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n").unwrap();
    let (lasted, bytes) = until_closed(&kept);
    assert_eq!(Answer::parse(&bytes).status, 200);
    assert!((300..4000).contains(&lasted.as_millis()), "{lasted:?}");
}

#[test]
fn a_missing_body_is_a_timeout() {
    let served = serve_with_short_limits(8);
    let mut stream = connect(served.at);
    let head = request("POST", "/v1/arm", &[("content-length", "10")], "");
    stream.write_all(&head).unwrap();
    stream.write_all(b"{").unwrap();
    let (lasted, bytes) = until_closed(&stream);
    Answer::parse(&bytes).refused(408, "timeout");
    assert!((300..4000).contains(&lasted.as_millis()), "{lasted:?}");
    // A truncated request is not executed.
    let mut stream = connect(served.at);
    stream.write_all(&head).unwrap();
    stream.write_all(b"{}").unwrap();
    stream.shutdown(std::net::Shutdown::Write).unwrap();
    until_closed(&stream);
    assert_eq!(served.fake.executed.load(std::sync::atomic::Ordering::Relaxed), 0);
}

#[test]
fn a_connection_beyond_the_limit_is_refused_and_the_slot_is_free_afterwards() {
    let served = serve_with_short_limits(4);
    served.fake.command_ms.store(1000, std::sync::atomic::Ordering::Relaxed);
    let busy: Vec<_> = (0..4)
        .map(|_| {
            let mut stream = connect(served.at);
            stream.write_all(&request("POST", "/v1/arm", &[], "{}")).unwrap();
            stream
        })
        .collect();
    std::thread::sleep(Duration::from_millis(200));
    let answer = get(served.at, "/v1/status");
    assert_mentions(&answer.refused(503, "unavailable"), &["connections"]);
    assert_eq!(answer.header("retry-after"), Some("1"));
    for stream in &busy {
        assert_eq!(Answer::parse(&until_closed(stream).1).status, 200);
    }
    assert_eq!(get(served.at, "/v1/status").status, 200);
}

#[test]
fn one_connection_serves_many_requests() {
    let served = serve_with_short_limits(4);
    let mut stream = connect(served.at);
    for _ in 0..50 {
        stream.write_all(b"GET /healthz HTTP/1.1\r\nhost: localhost\r\n\r\n").unwrap();
        let mut bytes = Vec::new();
        while !bytes.ends_with(b"}") {
            let mut piece = [0; 1024];
            let len = stream.read(&mut piece).unwrap();
            assert!(len > 0);
            bytes.extend_from_slice(&piece[..len]);
        }
        assert_eq!(Answer::parse(&bytes).status, 200);
    }
}
