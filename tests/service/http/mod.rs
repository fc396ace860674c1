//! Tests of the HTTP API with a fake service, over real sockets.

mod bodies;
pub(crate) mod client;
mod commands;
mod connections;
mod document;
mod finished;
mod forces;
mod hostile;
mod lifecycle;
mod page;
mod playback;
mod security;
mod soak;
mod streams;
mod takes;

use std::{net::SocketAddr, sync::Arc, time::Duration};

use mocapd_service::http::{HttpOptions, HttpServer, TimeLimits};

use super::fake::Fake;
use crate::support::{config, dense, jump, record};

/// An HTTP server with a fake service, and the folder of its takes.
pub(crate) struct Served {
    pub(crate) fake: Arc<Fake>,
    pub(crate) at: SocketAddr,
    pub(crate) folder: tempfile::TempDir,
    server: HttpServer,
}

/// Time limits short enough for a test.
fn short_limits() -> TimeLimits {
    TimeLimits {
        head: Duration::from_millis(600),
        body: Duration::from_millis(600),
        stall: Duration::from_millis(800),
        work: Duration::from_secs(20),
        keep_alive: Duration::from_millis(200),
    }
}

fn local() -> HttpOptions {
    HttpOptions { tcp: Some("127.0.0.1:0".parse().unwrap()), ..HttpOptions::default() }
}

/// A take of one second of a jump.
pub(crate) fn take() -> Vec<u8> {
    let motion = jump(1, 120.0, 1.0);
    let n_frames = motion.n_frames();
    record(&motion, &config(&motion, dense(0.5)), 0..n_frames).1
}

fn serve() -> Served {
    serve_with(local())
}

fn serve_with(options: HttpOptions) -> Served {
    let folder = tempfile::tempdir().unwrap();
    let takes = folder.path().join("takes");
    std::fs::create_dir(&takes).unwrap();
    let fake = Fake::new(&takes, take());
    let server = HttpServer::start(options, fake.clone()).unwrap();
    let at = server.tcp_address().unwrap_or_else(|| "127.0.0.1:0".parse().unwrap());
    Served { fake, at, folder, server }
}

impl Served {
    fn stop(self) {
        self.server.stop(Duration::from_secs(5)).unwrap();
    }
}
