//! A server of a recorder: what is recorded is its measurement, and its owner executes what a client in control requests.

use std::net::SocketAddr;

use super::{ClientId, Measurement, QtmServer, Role, put_text};
use crate::qtm::{
    command::ClientCommand,
    packet::{Event, PacketKind},
    settings::ServedSettings,
};

/// Wrong passwords after which a client is disconnected: more than anybody mistypes.
const WRONG_PASSWORDS_MAX: u32 = 3;

/// Wrong passwords that are kept for the owner: its messages about them are few.
const WRONG_PASSWORDS_KEPT: usize = 16;

/// A password, which no message shows.
pub(super) struct Password(String);

impl std::fmt::Debug for Password {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Password")
    }
}

/// A command that the owner executes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum OwnerCommand {
    /// Begin a take.
    Start,
    /// End it.
    Stop,
    /// Put a mark with this text into it.
    Mark(String),
}

/// A command of a client in control. It waits for [`QtmServer::complete`], and sends no other meanwhile.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OwnerRequest {
    /// The client.
    pub client: ClientId,
    /// Its address.
    pub peer: SocketAddr,
    /// What it wants.
    pub command: OwnerCommand,
}

/// A client, as its owner reports it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClientReport {
    /// Its address.
    pub peer: SocketAddr,
    /// The version that it set, as the number after `1.`; `None` if it has not set one.
    pub minor: Option<u32>,
    /// Whether it requests frames.
    pub is_streaming: bool,
    /// Whether they leave in datagrams.
    pub by_datagrams: bool,
    /// Whether it is in control.
    pub is_master: bool,
    /// Frames that it was sent.
    pub frames_sent: u64,
    /// Frames that it requested and did not get, because it read too slowly or the network took no more.
    pub frames_missed: u64,
    /// Samples of analog devices and force plates that no frame had: its stream has too few frames for them.
    pub samples_missed: u64,
}

impl QtmServer {
    /// A server for what a recorder records: nothing at first. It has room for `clients_max` clients, and accepts
    /// control with `password`, or from nobody.
    #[must_use]
    pub fn of_recorder(version: String, clients_max: usize, password: Option<String>) -> Self {
        let nothing = ServedSettings { frequency_hz: 1.0, ..ServedSettings::default() };
        let mut server = Self::new(nothing, version);
        server.clients_max = clients_max;
        server.role = Role::Recorder { password: password.map(Password) };
        (server.measurement, server.state) = (Measurement::Closed, Event::ConnectionClosed);
        server
    }

    /// What the recorder receives now; `None` when it receives nothing. Clients learn of a change.
    pub fn set_source(&mut self, settings: Option<ServedSettings>) {
        let Some(settings) = settings else {
            if self.measurement != Measurement::Closed {
                self.set_capturing(false);
                self.end_measurement();
                self.measurement = Measurement::Closed;
            }
            return;
        };
        if self.measurement == Measurement::Closed {
            self.use_settings(settings);
            self.measurement = Measurement::Live;
            self.send_event(Event::Connected);
        } else {
            self.change_settings(settings);
        }
    }

    /// Whether a take is being recorded now.
    pub fn set_capturing(&mut self, is_capturing: bool) {
        match (self.measurement, is_capturing) {
            (Measurement::Live, true) => {
                self.measurement = Measurement::Capture;
                self.send_event(Event::CaptureStarted);
            }
            (Measurement::Capture, false) => {
                self.measurement = Measurement::Live;
                self.send_event(Event::CaptureStopped);
            }
            _ => {}
        }
    }

    /// Takes the commands for the owner.
    pub fn take_requests(&mut self) -> Vec<OwnerRequest> {
        std::mem::take(&mut self.requests)
    }

    /// Replies to a command that the owner executed, or could not.
    pub fn complete(&mut self, id: ClientId, reply: Result<&str, &str>) {
        let Some(client) = self.client(id).filter(|client| client.awaits_owner) else { return };
        client.awaits_owner = false;
        self.reply(id, reply);
        self.execute_received(id);
    }

    /// The clients, in the order in which they connected.
    #[must_use]
    pub fn reports(&self) -> Vec<ClientReport> {
        self.clients.iter().map(|client| self.report_of(client)).collect()
    }

    /// A client, while it is connected.
    #[must_use]
    pub fn report(&self, id: ClientId) -> Option<ClientReport> {
        self.clients.iter().find(|client| client.id == id).map(|client| self.report_of(client))
    }

    fn report_of(&self, client: &super::Client) -> ClientReport {
        ClientReport {
            peer: client.peer,
            minor: (client.minor > 1).then_some(client.minor),
            is_streaming: client.stream.is_some(),
            by_datagrams: client.stream.is_some_and(|stream| stream.target.is_some()),
            is_master: self.master == Some(client.id),
            frames_sent: client.outbox.frames_sent() + client.datagram_frames,
            frames_missed: client.frames_missed,
            samples_missed: client.samples_missed,
        }
    }

    /// Frames that all clients have missed so far, also those that are gone.
    #[must_use]
    pub fn frames_missed(&self) -> u64 {
        self.missed_by_gone + self.clients.iter().map(|client| client.frames_missed).sum::<u64>()
    }

    /// Whether a client requests frames.
    #[must_use]
    pub fn wants_frames(&self) -> bool {
        let wants = |client: &super::Client| client.stream.is_some() || client.one_frame.is_some();
        self.clients.iter().any(wants)
    }

    /// Whether a client requests rigid bodies.
    #[must_use]
    pub fn wants_bodies(&self) -> bool {
        self.clients.iter().any(|client| {
            let stream = client.stream.as_ref().map(|stream| stream.components);
            stream.into_iter().chain(client.one_frame).any(|components| components.has_bodies())
        })
    }

    /// Whether a client requests samples of analog devices or force plates.
    #[must_use]
    pub fn wants_samples(&self) -> bool {
        self.clients.iter().any(|client| {
            let stream = client.stream.as_ref().map(|stream| stream.components);
            stream.into_iter().chain(client.one_frame).any(|components| components.has_samples())
        })
    }

    /// The clients that gave a wrong password for control since the last call.
    pub fn take_wrong_passwords(&mut self) -> Vec<SocketAddr> {
        std::mem::take(&mut self.wrong_passwords)
    }

    /// Counts a wrong password. A client that guesses is disconnected.
    pub(super) fn count_wrong_password(&mut self, id: ClientId) {
        let Some(client) = self.client(id) else { return };
        client.wrong_passwords += 1;
        let peer = client.peer;
        if client.wrong_passwords >= WRONG_PASSWORDS_MAX {
            client.set_out_of_step();
        }
        if self.wrong_passwords.len() < WRONG_PASSWORDS_KEPT {
            self.wrong_passwords.push(peer);
        }
    }

    /// Lets a client take control of a recorder, or says why not.
    pub(super) fn check_password(&self, given: &str) -> Result<(), &'static str> {
        match &self.role {
            Role::Simulated => Ok(()),
            Role::Recorder { password: None } => Err("Client control disabled in QTM"),
            Role::Recorder { password: Some(Password(password)) } if is_same(password, given) => {
                Ok(())
            }
            Role::Recorder { .. } => Err("Wrong or missing password"),
        }
    }

    /// Executes a command of the client in control of a recorder.
    pub(super) fn control_recorder(&mut self, id: ClientId, command: &ClientCommand) {
        let is_capturing = self.measurement == Measurement::Capture;
        let reply = match command {
            ClientCommand::New if self.measurement == Measurement::Closed => {
                Err("The recorder has no device: connect it, and arm the recorder")
            }
            ClientCommand::New => Ok("Already connected"),
            ClientCommand::Start { from_file: true } => Err("No file open"),
            ClientCommand::Start { .. } if is_capturing => Err("Measurement is already running"),
            ClientCommand::Start { .. } if self.measurement == Measurement::Closed => {
                Err("Not connected. Create connection with new")
            }
            ClientCommand::Start { .. } => return self.request(id, OwnerCommand::Start),
            ClientCommand::Stop if is_capturing => return self.request(id, OwnerCommand::Stop),
            ClientCommand::Stop => Err("No measurement is running"),
            ClientCommand::SetEvent(label) if is_capturing => {
                return self.request(id, OwnerCommand::Mark(label.clone()));
            }
            ClientCommand::SetEvent(_) => Err("QTM is not capturing"),
            ClientCommand::Trig => Err("QTM not waiting for trig"),
            ClientCommand::Save(_) => Err("No measurement to save"),
            _ => Err("This recorder does not have this command"),
        };
        self.reply(id, reply);
    }

    /// Whether there is a password to guess.
    pub(super) fn has_password(&self) -> bool {
        matches!(self.role, Role::Recorder { password: Some(_) })
    }

    fn request(&mut self, id: ClientId, command: OwnerCommand) {
        let Some(client) = self.client(id) else { return };
        client.awaits_owner = true;
        let peer = client.peer;
        self.requests.push(OwnerRequest { client: id, peer, command });
    }

    /// The message for a client that may not connect.
    #[must_use]
    pub fn exclusion() -> Vec<u8> {
        let mut bytes = Vec::new();
        put_text(PacketKind::Error, "Connection refused. Address not allowed.", &mut bytes);
        bytes
    }
}

/// Compares in a time that depends on the length of the given text alone.
fn is_same(password: &str, given: &str) -> bool {
    let (password, given) = (password.as_bytes(), given.as_bytes());
    let difference =
        given.iter().enumerate().fold(password.len() ^ given.len(), |sum, (at, byte)| {
            let of_password = password.get(at % password.len().max(1)).copied().unwrap_or(0);
            sum | usize::from(byte ^ of_password)
        });
    difference == 0
}
