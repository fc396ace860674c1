//! The commands of the client that controls the server, with the replies of the protocol's documents.

use super::{ClientId, Measurement, QtmServer, Role};
use crate::qtm::{command::ClientCommand, packet::Event};

impl QtmServer {
    /// Executes a command about control, and replies.
    pub(super) fn control(&mut self, id: ClientId, command: &ClientCommand) {
        let reply = match command {
            ClientCommand::TakeControl(password) => return self.take_control(id, password),
            ClientCommand::ReleaseControl if self.master == Some(id) => {
                self.master = None;
                Ok("You are now a regular client")
            }
            ClientCommand::ReleaseControl => Ok("You are already a regular client"),
            ClientCommand::GetCapture => Err("No capture to get"),
            ClientCommand::Unknown => Err("Parse error"),
            _ if self.master != Some(id) => Err("You must be master to issue this command"),
            other if matches!(self.role, Role::Recorder { .. }) => {
                return self.control_recorder(id, other);
            }
            ClientCommand::New => return self.open_live(id),
            ClientCommand::Close => return self.close_measurement(id),
            ClientCommand::Start { from_file } => return self.start(id, *from_file),
            ClientCommand::Stop
                if matches!(self.measurement, Measurement::PlayedFile | Measurement::Capture) =>
            {
                self.reply(id, Ok("Stopping measurement"));
                return self.end_measurement();
            }
            ClientCommand::Stop => Err("No measurement is running"),
            ClientCommand::Trig => Err("QTM not waiting for trig"),
            ClientCommand::SetEvent(_) if self.measurement == Measurement::Capture => {
                Ok("Event set")
            }
            ClientCommand::SetEvent(_) => Err("QTM is not capturing"),
            ClientCommand::Load(name) if name.is_empty() => Err("Missing file name"),
            ClientCommand::LoadProject(name) if name.is_empty() => Err("Missing project name"),
            ClientCommand::Load(_) | ClientCommand::LoadProject(_) if self.is_connected() => {
                Err("Active camera connection exists")
            }
            ClientCommand::Load(_) => Err("Failed to load measurement"),
            ClientCommand::LoadProject(_) => Err("Failed to load project"),
            ClientCommand::Save(_) => Err("No measurement to save"),
            ClientCommand::Reprocess if self.measurement == Measurement::PlayedFile => {
                Err("RT from file running")
            }
            ClientCommand::Reprocess => Err("No file open"),
            _ => Err("Parse error"),
        };
        self.reply(id, reply);
    }

    /// Whether the cameras are connected.
    fn is_connected(&self) -> bool {
        matches!(self.measurement, Measurement::Live | Measurement::Capture)
    }

    fn take_control(&mut self, id: ClientId, password: &str) {
        if let Err(refusal) = self.check_password(password) {
            self.reply(id, Err(refusal));
            if self.has_password() {
                self.count_wrong_password(id);
            }
            return;
        }
        match self.master {
            Some(master) if master == id => self.reply(id, Ok("You are already master")),
            Some(master) => {
                let peer = self.client(master).map(|client| client.peer);
                let text = peer.map_or_else(String::new, |peer| {
                    format!("{} ({}) is already master", peer.ip(), peer.port())
                });
                self.reply(id, Err(&text));
            }
            None => {
                self.master = Some(id);
                self.reply(id, Ok("You are now master"));
            }
        }
    }

    fn open_live(&mut self, id: ClientId) {
        if self.is_connected() {
            return self.reply(id, Ok("Already connected"));
        }
        self.reply(id, Ok("Creating new connection"));
        self.end_measurement();
        self.measurement = Measurement::Live;
        self.send_event(Event::Connected);
    }

    fn close_measurement(&mut self, id: ClientId) {
        let reply = match self.measurement {
            Measurement::Closed => "No connection to close",
            Measurement::File | Measurement::PlayedFile => "Closing file",
            Measurement::Live | Measurement::Capture => "Closing connection",
        };
        self.reply(id, Ok(reply));
        if self.measurement == Measurement::Capture {
            // The capture ends first, and then the connection.
            self.send_event(Event::CaptureStopped);
            self.measurement = Measurement::Live;
        }
        self.end_measurement();
        self.measurement = Measurement::Closed;
    }

    fn start(&mut self, id: ClientId, from_file: bool) {
        let (reply, next) = match (self.measurement, from_file) {
            (Measurement::PlayedFile, true) => (Ok("RT from file already running"), None),
            (Measurement::File, true) => (
                Ok("Starting RT from file"),
                Some((Measurement::PlayedFile, Event::RtFromFileStarted)),
            ),
            (_, true) => (Err("No file open"), None),
            (Measurement::Live, false) => {
                (Ok("Starting measurement"), Some((Measurement::Capture, Event::CaptureStarted)))
            }
            (Measurement::Capture, false) => (Err("Measurement is already running"), None),
            (_, false) => (Err("Not connected. Create connection with new"), None),
        };
        self.reply(id, reply);
        if let Some((measurement, event)) = next {
            self.measurement = measurement;
            self.send_event(event);
        }
    }
}
