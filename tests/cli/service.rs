//! `mocapd run` as a program, with a simulated device, controlled over its socket.

use std::{
    io::{Read, Write},
    os::unix::net::UnixStream,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use super::{Folder, devices::Simulated};

/// Longer than any step takes on the slowest machine.
const GIVE_UP: Duration = Duration::from_secs(60);

/// A running service with its takes in `takes`, stopped when dropped.
pub(crate) struct Service {
    child: Child,
    socket: std::path::PathBuf,
}

impl Service {
    /// Runs `shell` before the program, in the same process, and waits until it answers.
    pub(crate) fn start(folder: &Folder, device: &Simulated, take: &str, shell: &str) -> Self {
        let socket = folder.path("rig.sock");
        let config = format!(
            "[device]\nuri = '{}'\n[take]\ndirectory = '{}'\nkeep_free = '0B'\n{take}\n\
             [http]\nlisten = ''\nsocket = '{}'\n",
            device.uri(),
            folder.path("takes").display(),
            socket.display()
        );
        Self::run(folder, &config, shell)
    }

    /// Starts a service with a given configuration, whose socket is `rig.sock` in the folder.
    pub(crate) fn run(folder: &Folder, config: &str, shell: &str) -> Self {
        folder.write("rig.toml", config);
        let child = Command::new("sh")
            .args(["-c", &format!("{shell}\nexec \"$mocapd\" run --config rig.toml")])
            .env("mocapd", env!("CARGO_BIN_EXE_mocapd"))
            .current_dir(folder.path(""))
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(std::fs::File::create(folder.path("rig.log")).unwrap())
            .spawn()
            .unwrap();
        let mut service = Self { child, socket: folder.path("rig.sock") };
        service.wait_until("the device", |status| status["state"] == "armed");
        service
    }

    pub(crate) fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Makes the service read another configuration.
    pub(crate) fn reload(&self, folder: &Folder, config: &str) {
        folder.write("rig.toml", config);
        kill_process(Pid::from_child(&self.child), Signal::HUP).unwrap();
    }

    /// Status and document of a response; `None` without a connection.
    fn ask(&self, head: &str, body: &str) -> Option<(u16, Value)> {
        let mut stream = UnixStream::connect(&self.socket).ok()?;
        let length = body.len();
        write!(
            stream,
            "{head} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\
             content-type: application/json\r\ncontent-length: {length}\r\n\r\n{body}"
        )
        .ok()?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer).ok()?;
        let status = answer.split(' ').nth(1)?.parse().ok()?;
        let body = answer.split_once("\r\n\r\n")?.1;
        Some((status, serde_json::from_str(body).ok()?))
    }

    pub(crate) fn get(&self, path: &str) -> Value {
        self.ask(&format!("GET {path}"), "").unwrap().1
    }

    pub(crate) fn post(&self, path: &str, body: &str) -> (u16, Value) {
        self.ask(&format!("POST {path}"), body).unwrap()
    }

    pub(crate) fn wait_until(&mut self, what: &str, is_so: impl Fn(&Value) -> bool) -> Value {
        let begun = Instant::now();
        loop {
            if let Some(ended) = self.child.try_wait().unwrap() {
                let log = std::fs::read_to_string(self.socket.with_extension("log"));
                panic!("the service ended: {ended}: {log:?}");
            }
            if let Some((_, status)) = self.ask("GET /v1/status", "")
                && is_so(&status)
            {
                return status;
            }
            assert!(begun.elapsed() < GIVE_UP, "{what} did not come");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        kill_process(Pid::from_child(&self.child), Signal::TERM).ok();
        self.child.wait().ok();
    }
}
