//! Reloading the configuration of a running service, for every key that the table says applies at once.

use std::{
    collections::BTreeSet,
    io::{Read, Write},
    net::{SocketAddr, TcpStream, UdpSocket},
    path::Path,
    time::{Duration, Instant},
};

use mocapd_service::config::{ReloadPolicy, keys::KEYS};
use mocapd_simulator::generator::JumpSpec;

use super::{Folder, devices::Simulated, service::Service};

/// Longer than any step takes on the slowest machine.
const GIVE_UP: Duration = Duration::from_secs(120);

/// How long to wait for something that must not happen.
const QUIET: Duration = Duration::from_millis(300);

struct Scene {
    folder: Folder,
    service: Service,
    http: SocketAddr,
    /// The address of the trigger listener.
    triggers: SocketAddr,
    /// Another program, which sends triggers and receives ours.
    peer: UdpSocket,
    takes: u32,
}

impl Scene {
    fn state(&self) -> String {
        self.service.get("/v1/status")["state"].as_str().unwrap().to_owned()
    }

    fn next_take(&mut self) -> String {
        self.takes += 1;
        format!("take-{}", self.takes)
    }

    fn start(&mut self) {
        let body = format!("{{\"name\":\"{}\"}}", self.next_take());
        let begun = Instant::now();
        loop {
            let (code, answer) = self.service.post("/v1/start", &body);
            if code == 200 {
                return;
            }
            // A trigger of a row before may have started a take later than the row waited for it.
            assert!(code == 409 && begun.elapsed() < GIVE_UP, "{answer}");
            self.stop();
        }
    }

    fn stop(&mut self) {
        self.service.post("/v1/stop", "{}");
        self.service.wait_until("the end", |status| status["state"] == "armed");
    }

    /// Whether a start trigger with a delay, from the network, starts a take.
    fn is_triggered(&mut self, delay_ms: u32) -> bool {
        let name = self.next_take();
        let datagram = format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\" standalone=\"no\" ?><CaptureStart><Name VALUE=\"{name}\"/>\
             <Notes VALUE=\"\"/><Description VALUE=\"\"/><DatabasePath VALUE=\"\"/>\
             <Delay VALUE=\"{delay_ms}\"/><PacketID VALUE=\"{}\"/></CaptureStart>",
            self.takes
        );
        self.peer.send_to(datagram.as_bytes(), self.triggers).unwrap();
        let until = Instant::now() + Duration::from_millis(delay_ms.into()) + QUIET;
        while Instant::now() < until {
            if self.state() == "recording" {
                self.stop();
                return true;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        false
    }

    /// The upload of a take that is recorded now, once it has begun; null if the take has left the folder.
    fn uploaded(&mut self) -> serde_json::Value {
        self.start();
        self.stop();
        let name = format!("take-{}", self.takes);
        let begun = Instant::now();
        loop {
            let takes = self.service.get("/v1/takes");
            let take = takes.as_array().unwrap().iter().find(|take| take["name"] == name.as_str());
            let upload = take.map_or(serde_json::Value::Null, |take| take["upload"].clone());
            if take.is_none() || upload["state"] == "uploading" || upload["state"] == "uploaded" {
                return upload;
            }
            assert!(begun.elapsed() < GIVE_UP, "{upload}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn has_take(&self, number: u32) -> bool {
        let takes = self.service.get("/v1/takes");
        let name = format!("take-{number}");
        takes.as_array().unwrap().iter().any(|take| take["name"] == name.as_str())
    }

    /// What the peer receives about a take.
    fn announced(&mut self) -> String {
        self.start();
        self.stop();
        let (mut received, mut bytes) = (String::new(), [0; 4096]);
        while let Ok(n) = self.peer.recv(&mut bytes) {
            received += &String::from_utf8_lossy(&bytes[..n]);
        }
        received
    }

    /// The HTTP status of a request with the host name `name`.
    fn called(&self, name: &str) -> String {
        let mut stream = TcpStream::connect(self.http).unwrap();
        write!(stream, "GET /v1/status HTTP/1.1\r\nhost: {name}\r\nconnection: close\r\n\r\n")
            .unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer.split(' ').nth(1).unwrap().to_owned()
    }
}

/// A key with another value, and a check that the service applies it. All other keys keep their values.
struct Row {
    key: &'static str,
    value: String,
    /// The part of its section, or of the triggers', before it.
    before: String,
    is_so: fn(&mut Scene) -> bool,
}

fn rows(triggers: SocketAddr, peer: SocketAddr, archive: &Path) -> Vec<Row> {
    let row = |key, value: &str, before: &str, is_so| Row {
        key,
        value: value.to_owned(),
        before: before.to_owned(),
        is_so,
    };
    let url = format!("url = 'file://{}/'", archive.display());
    let listen = format!("listen = '{triggers}'");
    let send_to = format!("send_to = ['{peer}']");
    vec![
        row("rig.name", "name = 'right'", &send_to, |scene| {
            let is_in_triggers = scene.announced().contains("mocapd right ");
            is_in_triggers && scene.service.get("/v1/status")["rig"] == "right"
        }),
        row("take.max_length", "max_length = '1s'", "", |scene| {
            scene.start();
            let until = Instant::now() + Duration::from_millis(2500);
            while Instant::now() < until && scene.state() == "recording" {
                std::thread::sleep(Duration::from_millis(20));
            }
            let is_over = scene.state() != "recording";
            scene.stop();
            is_over
        }),
        row("take.trash_keep", "trash_keep = '2h'", "", |scene| {
            // One of those that the rows before have recorded.
            let takes = scene.service.get("/v1/takes");
            let path = format!("/v1/takes/{}/trash", takes[0]["name"].as_str().unwrap());
            let (code, trashed) = scene.service.post(&path, "{}");
            assert_eq!(code, 200, "{trashed}");
            let ms = |field: &str| trashed[field].as_i64().unwrap();
            ms("removed_unix_ms") - ms("trashed_unix_ms") == 7_200_000
        }),
        row("http.allowed_hosts", "allowed_hosts = ['rig.lab']", "", |scene| {
            scene.called("rig.lab") == "200"
        }),
        row("trigger.listen", &listen, "", |scene| scene.is_triggered(0)),
        row("trigger.send_to", &send_to, "", |scene| scene.announced().contains("CaptureStart")),
        row("trigger.allow_from", "allow_from = ['192.0.2.1']", &listen, |scene| {
            !scene.is_triggered(0)
        }),
        row("trigger.delay_max", "delay_max = '0s'", &listen, |scene| !scene.is_triggered(100)),
        row("archive.url", &url, "", |scene| !scene.service.get("/v1/status")["archive"].is_null()),
        row("archive.remove_local_after", "remove_local_after = '0s'", &url, |scene| {
            scene.uploaded();
            std::thread::sleep(2 * QUIET);
            !scene.has_take(scene.takes)
        }),
        // A take needs more than a second at this rate.
        row("archive.rate_max", "rate_max = '1KiB'", &url, |scene| {
            let is_uploading = scene.uploaded()["state"] == "uploading";
            std::thread::sleep(2 * QUIET);
            let status = scene.service.get("/v1/status");
            is_uploading && status["archive"]["waiting"] == 1
        }),
        row("log.level", "level = 'error'", "", |scene| {
            let before = scene.folder.text("rig.log");
            scene.start();
            scene.stop();
            std::thread::sleep(QUIET);
            scene.folder.text("rig.log") == before
        }),
    ]
}

/// Every section with what a row says, and without.
fn config(base: &str, row: &Row, has_value: bool) -> String {
    let (section, _) = row.key.split_once('.').unwrap();
    let around = if section == "archive" { "[archive]" } else { "[trigger]" };
    let base = base.replacen(around, &format!("{around}\n{}", row.before), 1);
    match has_value {
        true => base.replacen(&format!("[{section}]"), &format!("[{section}]\n{}", row.value), 1),
        false => base,
    }
}

#[test]
fn keys_that_apply_at_once_do() {
    let free = || UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let (triggers, peer) = (free(), UdpSocket::bind("127.0.0.1:0").unwrap());
    peer.set_read_timeout(Some(QUIET)).unwrap();
    let folder = Folder::new();
    let rows = rows(triggers, peer.local_addr().unwrap(), &folder.path("archive"));
    let at_once = KEYS.iter().filter(|key| key.when == ReloadPolicy::Now).map(|key| key.path);
    let tried: BTreeSet<_> = rows.iter().map(|row| row.key).collect();
    assert_eq!(tried, at_once.collect(), "each key that is taken over at once has a row here");

    let device = Simulated::endless(JumpSpec::new(1, 120.0).generate().unwrap().motion);
    let http = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let base = format!(
        "[rig]\n[device]\nuri = '{}'\n[take]\ndirectory = '{}'\nkeep_free = '0B'\n\
         [http]\nlisten = '{http}'\nsocket = '{}'\n[trigger]\n[archive]\n[log]\n",
        device.uri(),
        folder.path("takes").display(),
        folder.path("rig.sock").display()
    );
    let service = Service::run(&folder, &base, "");
    let mut scene = Scene { folder, service, http, triggers, peer, takes: 0 };
    for row in &rows {
        for has_value in [false, true] {
            scene.service.reload(&scene.folder, &config(&base, row, has_value));
            let begun = Instant::now();
            while (row.is_so)(&mut scene) != has_value {
                let effect = if has_value { "is not taken over" } else { "does nothing" };
                assert!(begun.elapsed() < GIVE_UP, "{} {effect}", row.key);
            }
        }
    }
}
