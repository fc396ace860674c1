//! A server of the Foxglove WebSocket protocol for what is recorded (docs/foxglove.md).

mod outbox;
mod protocol;
mod server;
mod stream_time;
mod topics;
mod web_socket;

use std::{
    io,
    net::SocketAddr,
    sync::Arc,
    time::{Duration, Instant},
};

use anyhow::anyhow;
use mocapd_acquire::{
    ledger::LedgerDocument,
    pipeline::{TappedBatch, TappedFrame},
};
use mocapd_drivers::transport::network::server::TcpServer;
use mocapd_take::interchange::foxglove::{self, LogLevel};

use self::{
    protocol::Channel,
    server::{ClientId, ClientReport, FoxgloveServer},
    stream_time::unix_now_ns,
    topics::{DeviceTopics, LOG, TRANSFORMS},
};
use super::{
    LivePublisher, PublishedDevice, PublishedFeed, PublisherName, RunningPublisher, WantedKinds,
    clients::ClientLimits, runner,
};
use crate::{
    config::FoxglovePublishConfig,
    control::{Control, EventFeed},
    status::{PublishStatus, PublishedClient, ServiceEvent, ServiceEventKind},
};

/// The Foxglove WebSocket protocol.
pub const FOXGLOVE: PublisherName = PublisherName { id: "foxglove", title: "Foxglove" };

/// How long clients have to take what is pending when the service stops.
const DRAIN: Duration = Duration::from_millis(500);

/// Time between two log entries of the ledger of a take that is recorded.
const LEDGER_INTERVAL: Duration = Duration::from_secs(1);

/// Opens the port and publishes.
///
/// # Errors
/// The thread cannot be started.
pub fn open(
    config: &FoxglovePublishConfig,
    feed: PublishedFeed,
    control: &Arc<dyn Control>,
) -> anyhow::Result<RunningPublisher> {
    let (listen, config, owner) = (config.listen, config.clone(), Arc::clone(control));
    let open = move || {
        let clients = TcpServer::open(config.listen).map_err(|error| {
            anyhow!(
                "cannot publish at publish.foxglove.listen = {}: {error}; `ss -tlpn` shows which program uses the port, \
                 `ip address` lists the addresses of this machine",
                config.listen
            )
        })?;
        let limits = ClientLimits::new(FOXGLOVE, &config.allow_from, config.clients_max);
        // Another for each start, by which clients know that the channels have other numbers.
        let session = format!("{:x}", unix_now_ns());
        let name = format!("{} (mocapd {})", owner.status().rig, env!("CARGO_PKG_VERSION"));
        let mut server = FoxgloveServer::new(name, session, limits, config.origins.clone());
        server.set_channels(vec![log_channel()]);
        let began = Instant::now();
        Ok(FoxglovePublisher {
            clients,
            server,
            topics: None,
            events: owner.events(),
            control: Arc::clone(&owner),
            began,
            ledger_at: began,
        })
    };
    runner::start(feed, control, listen, open)
}

fn log_channel() -> Channel {
    let schema_name = "foxglove.Log";
    Channel {
        topic: LOG.to_owned(),
        schema_name: schema_name.to_owned(),
        schema: foxglove::descriptor_set(schema_name),
    }
}

/// The server with its sockets.
#[derive(Debug)]
struct FoxglovePublisher {
    clients: TcpServer<ClientId>,
    server: FoxgloveServer,
    topics: Option<DeviceTopics>,
    events: EventFeed,
    control: Arc<dyn Control>,
    began: Instant,
    /// When the ledger was logged last.
    ledger_at: Instant,
}

impl LivePublisher for FoxglovePublisher {
    fn address(&self) -> SocketAddr {
        self.clients.address()
    }

    fn set_device(&mut self, device: Option<&PublishedDevice>) {
        self.topics = device.map(|device| DeviceTopics::new(device, device.subject.clone()));
        let of_device = self.topics.as_ref().map_or_else(Vec::new, DeviceTopics::channels);
        self.server.set_channels([vec![log_channel()], of_device].concat());
    }

    fn wanted(&self) -> WantedKinds {
        let topics = self.topics.as_ref();
        let [frames, samples] = topics.map_or([false; 2], |topics| topics.wanted(&self.server));
        WantedKinds { frames, samples }
    }

    fn wants_poses(&self) -> bool {
        self.topics.is_some() && self.server.is_wanted(TRANSFORMS)
    }

    fn frame(&mut self, device: &PublishedDevice, frame: &TappedFrame) {
        if let Some(topics) = &mut self.topics {
            topics.frame(device, frame, &mut self.server);
        }
    }

    fn samples(&mut self, _: &PublishedDevice, batch: &TappedBatch) {
        if let Some(topics) = &mut self.topics {
            topics.samples(batch, &mut self.server);
        }
    }

    fn exchange(&mut self, timeout: Duration) -> io::Result<()> {
        self.log_events();
        self.log_ledger();
        self.server.set_now(self.began.elapsed());
        self.clients.exchange(&mut self.server);
        self.clients.wait(&mut self.server, timeout)
    }

    fn take_news(&mut self) -> Vec<String> {
        self.server.take_news()
    }

    fn status(&self) -> PublishStatus {
        let (clients_refused, clients_max) = self.server.limits();
        let (frames_sent, missed) = self.server.totals();
        PublishStatus {
            protocol: FOXGLOVE.id.to_owned(),
            listen: self.address().to_string(),
            clients_max,
            clients_refused,
            frames_sent,
            frames_missed: missed.frames,
            batches_missed: missed.batches,
            clients: self.server.reports().into_iter().map(PublishedClient::from).collect(),
            ..PublishStatus::default()
        }
    }

    fn close(mut self) {
        self.clients.finish(&mut self.server, DRAIN);
    }
}

impl FoxglovePublisher {
    fn log_events(&mut self) {
        while let Some(event) = self.events.next(Duration::ZERO) {
            let time_ns = u64::try_from(event.unix_ms).unwrap_or(0).saturating_mul(1_000_000);
            let entry = foxglove::log(level_of(&event), "mocapd", &event.message, time_ns);
            self.server.message_alone(LOG, time_ns, &entry, self.topics.is_none());
        }
        let missed = self.events.missed();
        if missed > 0 {
            let time_ns = unix_now_ns();
            let text = format!("{missed} events were missed");
            let entry = foxglove::log(LogLevel::Warning, "mocapd", &text, time_ns);
            self.server.message_alone(LOG, time_ns, &entry, self.topics.is_none());
        }
    }

    /// Logs the ledger of the take that is recorded, once a second.
    fn log_ledger(&mut self) {
        if self.ledger_at.elapsed() < LEDGER_INTERVAL || !self.server.is_wanted(LOG) {
            return;
        }
        self.ledger_at = Instant::now();
        if let Some(take) = self.control.status().take {
            let (level, text) = ledger_entry(&take.name, &take.ledger);
            let time_ns = unix_now_ns();
            let entry = foxglove::log(level, "ledger", &text, time_ns);
            self.server.message_alone(LOG, time_ns, &entry, self.topics.is_none());
        }
    }
}

fn level_of(event: &ServiceEvent) -> LogLevel {
    match event.kind {
        ServiceEventKind::Failure => LogLevel::Error,
        ServiceEventKind::Warning => LogLevel::Warning,
        _ => LogLevel::Info,
    }
}

fn ledger_entry(name: &str, ledger: &LedgerDocument) -> (LogLevel, String) {
    let causes = [
        ("on the link", ledger.lost_on_link),
        ("by the device", ledger.dropped_by_device),
        ("because a ring was full", ledger.lost_ring_full),
        ("in the host for other reasons", ledger.lost_other),
        ("maybe, after a disconnection", ledger.unknown_after_disconnect),
    ];
    let lost: Vec<String> = causes
        .into_iter()
        .filter(|(_, n)| *n > 0)
        .map(|(cause, n)| format!("{n} lost {cause}"))
        .collect();
    let level = if lost.is_empty() { LogLevel::Info } else { LogLevel::Warning };
    let lost = if lost.is_empty() { "none lost".to_owned() } else { lost.join(", ") };
    (level, format!("{name}: {} frames recorded, {lost}", ledger.recorded))
}

impl From<ClientReport> for PublishedClient {
    fn from(report: ClientReport) -> Self {
        Self {
            address: report.peer.to_string(),
            version: report.subprotocol.to_owned(),
            transport: "tcp".to_owned(),
            stream: String::new(),
            is_streaming: report.is_streaming,
            is_in_control: false,
            frames_sent: report.frames_sent,
            frames_missed: report.missed.frames,
            batches_missed: report.missed.batches,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ledger_is_a_warning_once_frames_are_lost() {
        let mut ledger = LedgerDocument { recorded: 1200, ..LedgerDocument::default() };
        let text = "jump: 1200 frames recorded, none lost".to_owned();
        assert_eq!(ledger_entry("jump", &ledger), (LogLevel::Info, text));
        (ledger.lost_on_link, ledger.lost_ring_full) = (3, 1);
        let text = "jump: 1200 frames recorded, 3 lost on the link, 1 lost because a ring was full";
        assert_eq!(ledger_entry("jump", &ledger), (LogLevel::Warning, text.to_owned()));
    }
}
