//! A hundred clients, half of them hostile, during a take: latency of the status for the others, and lost frames. To
//! measure:
//!
//! ```text
//! cargo test --release --test integration -- --ignored --nocapture service::http::soak
//! ```

use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use mocapd_service::{
    control::{Control, Request},
    http::HttpServer,
};

use super::{client::request, local};
use crate::{
    service::engine::{Room, named, read, room},
    support::Seeded,
};

const CLIENTS: u64 = 100;
const LENGTH: Duration = Duration::from_secs(30);

/// Ten times the rate of a browser.
const INTERVAL: Duration = Duration::from_millis(100);

#[test]
#[ignore = "half a minute on an otherwise idle machine"]
fn status_latency_and_a_take_with_hostile_clients() {
    let Room { directory: _directory, device: _device, engine } = room(|_| {});
    let engine: Arc<dyn Control> = Arc::new(engine);
    let server = HttpServer::start(local(), Arc::clone(&engine)).unwrap();
    let at = server.tcp_address().unwrap();
    let started = engine.start(&named("besieged")).unwrap();
    let began = Instant::now();
    let over = AtomicBool::new(false);
    let attacks = AtomicU64::new(0);
    let mut waits: Vec<Duration> = std::thread::scope(|scope| {
        for n in 0..CLIENTS / 2 {
            let (over, attacks) = (&over, &attacks);
            scope.spawn(move || {
                let mut random = Seeded::new(n);
                while !over.load(Ordering::Relaxed) {
                    // The server may close the connection.
                    attack(at, &mut random).ok();
                    attacks.fetch_add(1, Ordering::Relaxed);
                }
            });
        }
        let honest: Vec<_> = (0..CLIENTS / 2)
            .map(|n| {
                scope.spawn(move || {
                    std::thread::sleep(INTERVAL.mul_f64(n as f64 / 50.0));
                    poll_status(at)
                })
            })
            .collect();
        let waits = honest.into_iter().flat_map(|client| client.join().unwrap()).collect();
        over.store(true, Ordering::Relaxed);
        waits
    });
    waits.sort();
    let at = |share: f64| waits[((waits.len() - 1) as f64 * share) as usize];
    println!(
        "{} responses during {} attacks: p50 {:?}, p99 {:?}, longest {:?}",
        waits.len(),
        attacks.load(Ordering::Relaxed),
        at(0.5),
        at(0.99),
        at(1.0)
    );
    let seconds = began.elapsed().as_secs_f64();
    let ledger = engine.stop(&Request::default()).unwrap().ledger;
    println!("a take of {seconds:.0} s meanwhile: {ledger:?}");
    server.stop(Duration::from_secs(5)).unwrap();
    assert!(ledger.closes && ledger.recorded as f64 > 110.0 * seconds, "{ledger:?}");
    assert_eq!(ledger.frames_sent, ledger.recorded, "{ledger:?}");
    assert_eq!(read(&started.path).take.ledger.unwrap().recorded, ledger.recorded);
    assert!(at(0.99) < Duration::from_millis(50), "{:?}", at(0.99));
}

fn poll_status(at: SocketAddr) -> Vec<Duration> {
    let mut stream = TcpStream::connect(at).unwrap();
    stream.set_nodelay(true).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let (began, mut waits) = (Instant::now(), Vec::new());
    while began.elapsed() < LENGTH {
        let start = Instant::now();
        stream.write_all(b"GET /v1/status HTTP/1.1\r\nhost: localhost\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        while !answer.ends_with(b"}}") {
            let mut piece = [0; 4096];
            let len = stream.read(&mut piece).unwrap();
            assert!(len > 0, "an honest client was cut off");
            answer.extend_from_slice(&piece[..len]);
        }
        assert!(answer.starts_with(b"HTTP/1.1 200"), "{}", String::from_utf8_lossy(&answer));
        waits.push(start.elapsed());
        std::thread::sleep(INTERVAL.saturating_sub(start.elapsed()));
    }
    waits
}

fn attack(at: SocketAddr, random: &mut Seeded) -> std::io::Result<()> {
    let mut stream = TcpStream::connect(at)?;
    stream.set_read_timeout(Some(Duration::from_secs(2)))?;
    stream.set_write_timeout(Some(Duration::from_secs(2)))?;
    let mut answer = [0; 256];
    match random.below(8) {
        5 => stream.write_all(&request("POST", "/v1/stop", &[("host", "evil.example")], "{}"))?,
        6 => stream.write_all(&request("GET", "/v1/takes/..%2f..%2fetc%2fpasswd", &[], ""))?,
        7 => stream.write_all(&request("POST", "/v1/stop", &[("origin", "http://a.b")], "{}"))?,
        0 => {
            // A slowly sent header.
            for byte in b"GET /v1/status HTTP/1.1\r\nx-a: bbbbbbbbbbbbb" {
                stream.write_all(&[*byte])?;
                std::thread::sleep(Duration::from_millis(20));
            }
        }
        1 => {
            let noise: Vec<u8> = (0..random.below(8000)).map(|_| random.next() as u8).collect();
            stream.write_all(&noise)?;
        }
        2 => stream.write_all(&request("POST", "/v1/arm", &[], &"x".repeat(60 << 10)))?,
        3 => {
            // A stream that is never read.
            stream.write_all(&request("GET", "/v1/live", &[], ""))?;
            std::thread::sleep(Duration::from_millis(500));
        }
        _ => stream.write_all(&request("POST", "/v1/arm", &[("content-length", "1000")], "{"))?,
    }
    // A stream of frames does not end.
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(1) && stream.read(&mut answer)? > 0 {}
    Ok(())
}
