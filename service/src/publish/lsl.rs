//! Streams of the Lab Streaming Layer for what is received (docs/lsl.md).

use std::{
    io,
    net::{Ipv4Addr, SocketAddr},
    sync::Arc,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use anyhow::{Context, anyhow};
use mocapd_acquire::{
    host_clock::monotonic_ns,
    pipeline::{TappedBatch, TappedFrame, lock},
};
use mocapd_drivers::{
    device::SampledGroupInfo,
    lsl::{InletId, InletReport, OutletServer, Publisher},
    natnet::in_m,
    transport::{lsl::OutletSockets, network::server::StreamServer},
};
use mocapd_take::poses::PoseState;

use super::{
    LivePublisher, PublishedDevice, PublishedFeed, PublisherName, RunningPublisher, WantedKinds,
    clients::ClientLimits, host_time::HostTime, runner,
};
use crate::{
    config::LslPublishConfig,
    control::{Control, EventFeed},
    status::{PublishStatus, PublishedClient, ServiceEvent, ServiceEventKind},
};

/// The Lab Streaming Layer.
pub const LSL: PublisherName = PublisherName { id: "lsl", title: "LSL" };

/// What the streams say to come from.
const PROGRAM: &str = concat!("mocapd ", env!("CARGO_PKG_VERSION"));

/// The streams, by the order of their ports: those of the groups of sampled channels follow.
const MARKERS: usize = 0;
const POSES: usize = 1;
const EVENTS: usize = 2;
const GROUPS: usize = 3;

/// How long labels must have been the same until a stream has them: one whose channels change is another stream, and a system
/// announces its markers one after another.
const SETTLED: Duration = Duration::from_millis(500);

/// How long a labelled marker waits for that, at most.
const SETTLED_MAX: Duration = Duration::from_secs(2);

/// Events that are passed on between two looks at frames.
const EVENTS_A_TURN: usize = 64;

/// Events of the service that are older are not late, but of a clock that was set.
const EVENT_AGE_MAX_NS: u64 = 10_000_000_000;

/// How long readers have to take what is pending when the service stops.
const DRAIN: Duration = Duration::from_millis(500);

/// Time between two looks for interfaces that have come.
const JOIN_INTERVAL: Duration = Duration::from_secs(5);

/// A larger step back is a clock that was set.
const STEP_MAX_NS: u64 = 1_000_000_000;

/// Opens the ports and publishes.
///
/// # Errors
/// The thread cannot be started.
pub fn open(
    config: &LslPublishConfig,
    feed: PublishedFeed,
    control: &Arc<dyn Control>,
) -> anyhow::Result<RunningPublisher> {
    let (listen, config, control_of) =
        ((config.listen, 0).into(), config.clone(), Arc::clone(control));
    runner::start(feed, control, listen, move || LslPublisher::open(&config, &control_of))
}

/// The server, and who may read from it.
#[derive(Debug)]
struct AllowedOutlets {
    server: OutletServer,
    limits: ClientLimits,
    news: Vec<String>,
    /// Frames, batches and events that readers were sent which are gone.
    sent_to_gone: u64,
}

impl AsMut<OutletServer> for AllowedOutlets {
    fn as_mut(&mut self) -> &mut OutletServer {
        &mut self.server
    }
}

impl StreamServer for AllowedOutlets {
    type Id = InletId;

    fn connect(&mut self, peer: SocketAddr) -> Result<InletId, Vec<u8>> {
        self.connect_at(peer, peer)
    }

    fn connect_at(&mut self, peer: SocketAddr, local: SocketAddr) -> Result<InletId, Vec<u8>> {
        // The number of readers is counted where a connection asks to be one.
        self.limits.check(peer, 0).map_err(|_| Vec::new())?;
        self.server.connect_at(peer, local).inspect_err(|_| {
            self.limits.check(peer, usize::MAX).ok();
        })
    }

    fn disconnect(&mut self, id: InletId) {
        if let Some(report) = self.server.report(id) {
            self.sent_to_gone += report.frames_sent;
            if report.frames_missed > 0 {
                self.news.push(format!(
                    "LSL client {} has left: it read '{}' too slowly, and missed {} of {} samples or batches",
                    report.peer,
                    report.stream,
                    report.frames_missed,
                    report.frames_missed + report.frames_sent
                ));
            }
        }
        self.server.disconnect(id);
    }

    fn receive(&mut self, id: InletId, bytes: &[u8]) {
        let refused = self.server.n_refused();
        self.server.receive(id, bytes);
        if self.server.n_refused() > refused
            && let Some(report) = self.server.report(id)
        {
            self.limits.check(report.peer, usize::MAX).ok();
        }
    }

    fn may_receive(&self, id: InletId) -> bool {
        self.server.may_receive(id)
    }

    fn is_over(&self, id: InletId) -> bool {
        self.server.is_over(id)
    }

    fn pending(&self, id: InletId) -> &[u8] {
        self.server.pending(id)
    }

    fn sent(&mut self, id: InletId, n: usize) {
        self.server.sent(id, n);
    }
}

/// What is published of a device.
#[derive(Debug)]
struct StreamedDevice {
    device: PublishedDevice,
    time: HostTime,
    /// Slots of the labelled markers in the order of the stream, and their labels.
    slots: Vec<usize>,
    labels: Vec<String>,
    /// Channels that were looked at, and the labelled ones among them.
    n_channels: usize,
    n_labelled: usize,
    /// When the first labelled marker appeared that the stream has not, and the last one.
    appeared: Option<(Instant, Instant)>,
    /// The time stamp of the last sample of each group, by the monotonic clock.
    last_samples_ns: Vec<u64>,
}

/// The server with its sockets.
#[derive(Debug)]
struct LslPublisher {
    sockets: OutletSockets,
    server: AllowedOutlets,
    listen: Ipv4Addr,
    name: String,
    hostname: String,
    events: EventFeed,
    device: Option<StreamedDevice>,
    values: Vec<f32>,
    /// When the groups of questions were joined.
    joined_at: Option<Instant>,
}

impl LslPublisher {
    fn open(config: &LslPublishConfig, control: &Arc<dyn Control>) -> anyhow::Result<Self> {
        let listen = config.listen;
        let sockets = OutletSockets::open(listen).map_err(|error| {
            anyhow!(
                "cannot publish at publish.lsl.listen = {listen}: {error}; end programs with LSL outlets, which use ports 16572 to \
                 16604 of TCP and UDP; `ip address` lists the addresses of this machine"
            )
        })?;
        let service_port = sockets.service_port().context("a UDP socket has no address")?;
        let mut news = Vec::new();
        if !sockets.gets_questions() {
            news.push(
                "LSL streams are found only by programs that ask this machine: UDP port 16571 is used by a program that does \
                 not share it; end it and restart the service"
                    .to_owned(),
            );
        }
        let server = AllowedOutlets {
            server: OutletServer::new(service_port, config.clients_max),
            limits: ClientLimits::new(LSL, &config.allow_from, config.clients_max),
            news,
            sent_to_gone: 0,
        };
        let name = control.status().rig;
        let hostname = mocapd_drivers::lsl::hostname();
        let (events, values) = (control.events(), Vec::new());
        let mut publisher = Self {
            sockets,
            server,
            listen,
            name,
            hostname,
            events,
            device: None,
            values,
            joined_at: None,
        };
        // From now to the end: what ends a take comes when the device is gone.
        let events = |publisher: Publisher<'_>| publisher.events();
        publisher.set_stream(EVENTS, "-events", Some(&events));
        Ok(publisher)
    }

    /// Publishes a stream whose name ends so, or nothing in its place.
    fn set_stream(
        &mut self,
        stream: usize,
        suffix: &str,
        describe: Option<&dyn Fn(Publisher<'_>) -> mocapd_drivers::lsl::StreamInfo>,
    ) {
        let port = match self.sockets.port(stream) {
            Ok(port) => port,
            Err(error) => {
                self.server.news.push(format!(
                    "the LSL stream {}{suffix} is not published: no port of 16572 to 16604 is free ({error}); end programs with \
                     LSL outlets, and arm again",
                    self.name
                ));
                return;
            }
        };
        let name = format!("{}{suffix}", self.name);
        let source_id = format!("mocapd {} {name}", self.hostname);
        let publisher = Publisher { name: &name, source_id: &source_id, program: PROGRAM };
        let info = describe.map(|describe| describe(publisher));
        self.server.server.set_stream(port, info, monotonic_ns());
    }

    fn port(&mut self, stream: usize) -> u16 {
        self.sockets.opened(stream)
    }

    fn is_read(&self, stream: usize) -> bool {
        self.server.server.is_read(self.sockets.opened(stream))
    }

    /// Publishes the stream of positions anew once other labels have settled.
    fn follow_labels(&mut self) {
        let Some(served) = &mut self.device else { return };
        let channels = lock(&served.device.progress.channels);
        if channels.len() != served.n_channels {
            served.n_channels = channels.len();
            let n_labelled = channels.iter().filter(|channel| channel.labelled).count();
            // Unlabelled ones, which come and go, are none of it.
            if std::mem::replace(&mut served.n_labelled, n_labelled) != n_labelled {
                let now = Instant::now();
                let first = served.appeared.map_or(now, |(first, _)| first);
                served.appeared = Some((first, now));
            }
        }
        drop(channels);
        let is_due = |(first, last): (Instant, Instant)| {
            last.elapsed() >= SETTLED || first.elapsed() >= SETTLED_MAX
        };
        if served.appeared.is_some_and(is_due) {
            self.publish_markers();
        }
    }

    fn publish_markers(&mut self) {
        let Some(served) = &mut self.device else { return };
        let channels = lock(&served.device.progress.channels).clone();
        served.n_channels = channels.len();
        served.n_labelled = channels.iter().filter(|channel| channel.labelled).count();
        served.appeared = None;
        let labelled = channels.iter().enumerate().filter(|(_, channel)| channel.labelled);
        let (slots, labels): (Vec<usize>, Vec<String>) =
            labelled.map(|(slot, channel)| (slot, channel.label.clone())).unzip();
        if labels == served.labels {
            return;
        }
        let rate_hz = served.device.header.rate_hz;
        (served.slots, served.labels) = (slots, labels.clone());
        let describe = |publisher: Publisher<'_>| publisher.positions(&labels, rate_hz);
        self.set_stream(MARKERS, "", (!labels.is_empty()).then_some(&describe));
    }

    /// Publishes the streams that a device has from the start.
    fn publish_device(&mut self) {
        let Some(served) = &self.device else { return };
        let names = served.device.body_names();
        let PublishedDevice { header, sampled, .. } = served.device.clone();
        let poses = |publisher: Publisher<'_>| publisher.poses(&names, header.rate_hz);
        self.set_stream(POSES, "-poses", (!names.is_empty()).then_some(&poses));
        for (index, group) in sampled.iter().enumerate() {
            let suffix = format!("-analog-{}", group.id);
            // As in our XDF files, where the loads of plates that follow from their channels are another stream.
            let describe = |publisher: Publisher<'_>| publisher.samples("Analog", group);
            self.set_stream(GROUPS + index, &suffix, Some(&describe));
        }
        self.publish_markers();
    }

    fn answer(&mut self) {
        let may_ask =
            |server: &AllowedOutlets, from: SocketAddr| server.limits.is_allowed(from.ip());
        self.sockets.answer(&mut self.server, may_ask);
    }

    fn pass_events(&mut self) {
        let missed = self.events.missed();
        let port = self.port(EVENTS);
        self.server.server.left_out(port, missed);
        for _ in 0..EVENTS_A_TURN {
            let Some(event) = self.events.next(Duration::ZERO) else { return };
            let Some(text) = text_of(&event) else { continue };
            self.server.server.push_text(port, seconds(time_of(&event)), &text);
        }
    }
}

impl LivePublisher for LslPublisher {
    fn address(&self) -> SocketAddr {
        SocketAddr::new(self.listen.into(), self.sockets.opened(MARKERS))
    }

    fn set_device(&mut self, device: Option<&PublishedDevice>) {
        for stream in (0..self.sockets.n_opened()).filter(|stream| *stream != EVENTS) {
            let port = self.sockets.opened(stream);
            self.server.server.set_stream(port, None, monotonic_ns());
        }
        self.device = device.map(|device| StreamedDevice {
            time: HostTime::new(device),
            n_channels: 0,
            n_labelled: 0,
            appeared: None,
            last_samples_ns: vec![0; device.sampled.len()],
            device: device.clone(),
            slots: Vec::new(),
            labels: Vec::new(),
        });
        self.publish_device();
    }

    fn wanted(&self) -> WantedKinds {
        WantedKinds {
            frames: self.is_read(MARKERS) || self.is_read(POSES),
            samples: (GROUPS..self.sockets.n_opened()).any(|stream| self.is_read(stream)),
        }
    }

    fn wants_poses(&self) -> bool {
        self.is_read(POSES)
    }

    fn frame(&mut self, device: &PublishedDevice, frame: &TappedFrame) {
        let [markers, poses] = [MARKERS, POSES].map(|stream| self.port(stream));
        let Some(served) = &mut self.device else { return };
        let server = &mut self.server.server;
        let captured_ns =
            served.time.of_frame(frame.device_ticks, frame.arrival_ns, &device.progress);
        let time_s = seconds(captured_ns);
        for port in [markers, poses] {
            server.left_out(port, frame.frames_left_out);
        }
        self.values.clear();
        for slot in &served.slots {
            let marker = frame.markers.get(*slot);
            let position_m = marker.map_or([f32::NAN; 3], |marker| in_m(marker.position_mm));
            self.values.extend(position_m);
        }
        server.push(markers, time_s, &self.values);
        // A frame from before a program read the poses has none, which would look like bodies that are not tracked.
        if served.device.bodies.is_empty() || !frame.wants_poses {
            return;
        }
        self.values.clear();
        for index in 0..served.device.bodies.len() {
            let pose = frame.poses.get(index).filter(|pose| pose.state == PoseState::Tracked);
            match pose {
                Some(pose) => {
                    self.values.extend(in_m(pose.position_mm));
                    self.values.extend(pose.quaternion);
                }
                None => self.values.extend([f32::NAN; 7]),
            }
        }
        server.push(poses, time_s, &self.values);
    }

    fn samples(&mut self, device: &PublishedDevice, batch: &TappedBatch) {
        let found = device.sampled.iter().position(|group| group.id == batch.group);
        let Some((index, group)) = found.and_then(|at| Some((at, device.sampled.get(at)?))) else {
            return;
        };
        let port = self.port(GROUPS + index);
        let Some(served) = &mut self.device else { return };
        let now_ns = monotonic_ns();
        let first_ns = served.time.of_sample(batch.device_ticks, now_ns, &device.progress);
        put_values(group, batch, &mut self.values);
        let n_samples = self.values.len() / group.channels.len().max(1);
        let period_ns = 1e12 / f64::from(group.rate_millihertz.max(1));
        let Some(last_ns) = served.last_samples_ns.get_mut(index) else { return };
        let first_ns = in_order(first_ns, *last_ns);
        *last_ns = first_ns + (n_samples.saturating_sub(1) as f64 * period_ns) as u64;
        let server = &mut self.server.server;
        server.push(port, seconds(first_ns), &self.values);
        // Of any group: nobody knows which.
        for stream in GROUPS..self.sockets.n_opened() {
            server.left_out(self.sockets.opened(stream), batch.batches_left_out);
        }
    }

    fn exchange(&mut self, timeout: Duration) -> io::Result<()> {
        self.server.server.set_now(monotonic_ns());
        if self.joined_at.is_none_or(|at| at.elapsed() >= JOIN_INTERVAL) {
            self.joined_at = Some(Instant::now());
            self.sockets.join_groups();
        }
        self.follow_labels();
        self.pass_events();
        self.sockets.exchange(&mut self.server);
        let waited = self.sockets.wait(&mut self.server, timeout);
        self.answer();
        waited
    }

    fn take_news(&mut self) -> Vec<String> {
        let mut news = self.server.limits.take_news();
        news.append(&mut self.server.news);
        news
    }

    fn status(&self) -> PublishStatus {
        let AllowedOutlets { server, limits, sent_to_gone, .. } = &self.server;
        let client = |report: InletReport| PublishedClient {
            address: report.peer.to_string(),
            version: "1.10".to_owned(),
            transport: "tcp".to_owned(),
            stream: report.stream,
            is_streaming: true,
            frames_sent: report.frames_sent,
            frames_missed: report.frames_missed,
            ..PublishedClient::default()
        };
        let clients: Vec<_> = server.reports().into_iter().map(client).collect();
        let sent: u64 = clients.iter().map(|client| client.frames_sent).sum();
        PublishStatus {
            protocol: LSL.id.to_owned(),
            listen: self.listen.to_string(),
            clients_max: limits.clients_max(),
            clients_refused: limits.refused(),
            frames_sent: sent + sent_to_gone,
            frames_missed: server.frames_missed(),
            clients,
            ..PublishStatus::default()
        }
    }

    fn close(mut self) {
        self.pass_events();
        let Self { sockets, mut server, .. } = self;
        sockets.finish(&mut server, DRAIN);
    }
}

/// Nanoseconds of the monotonic clock as LSL's time, which is that clock in seconds.
fn seconds(ns: u64) -> f64 {
    ns as f64 * 1e-9
}

/// The time of a batch's first sample, or that of the last sample before it, if that is later: a refitted line may be some
/// microseconds earlier, or some milliseconds than the arrivals before there was one.
///
/// Not the end of the batch before, which follows from the nominal rate: where converters run faster than that, stamps would
/// leave the time of capture behind for good.
fn in_order(first_ns: u64, last_ns: u64) -> u64 {
    let is_step = last_ns.saturating_sub(first_ns) >= STEP_MAX_NS;
    if is_step { first_ns } else { first_ns.max(last_ns) }
}

/// The values of a batch in the units of its channels, one sample after another.
fn put_values(group: &SampledGroupInfo, batch: &TappedBatch, out: &mut Vec<f32>) {
    out.clear();
    let n_channels = group.channels.len().max(1);
    for sample in batch.samples.chunks_exact(n_channels) {
        let channels = sample.iter().zip(&group.channels);
        out.extend(channels.map(|(value, channel)| channel.value(*value) as f32));
    }
}

/// An event of the service as a text: its kind, and the take or the message.
fn text_of(event: &ServiceEvent) -> Option<String> {
    let what = match event.kind {
        ServiceEventKind::TakeStarted
        | ServiceEventKind::TakeStopped
        | ServiceEventKind::TakeSaved => event.take.as_deref().unwrap_or_default(),
        ServiceEventKind::Mark | ServiceEventKind::Device => event.message.as_str(),
        _ => return None,
    };
    Some(format!("{} {what}", event.kind))
}

/// When an event happened, by the monotonic clock; it states the time of day in milliseconds.
fn time_of(event: &ServiceEvent) -> u64 {
    let now_ms = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_millis();
    let age_ms = now_ms.saturating_sub(u128::from(event.unix_ms.max(0).unsigned_abs()));
    let age_ns = u64::try_from(age_ms.saturating_mul(1_000_000)).unwrap_or(u64::MAX);
    monotonic_ns().saturating_sub(if age_ns < EVENT_AGE_MAX_NS { age_ns } else { 0 })
}

#[cfg(test)]
mod tests {
    use mocapd_drivers::device::SampledChannelInfo;

    use super::*;
    use crate::status::State;

    #[test]
    fn events_of_takes_marks_and_the_device_are_texts_with_their_time() {
        let now_ms = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_millis() as i64;
        let event = |kind, unix_ms| ServiceEvent {
            number: 1,
            unix_ms,
            kind,
            message: "words".to_owned(),
            state: State::Recording,
            take: Some("hall_001".to_owned()),
            notes: None,
        };
        for (kind, text) in [
            (ServiceEventKind::TakeStarted, Some("take-started hall_001")),
            (ServiceEventKind::TakeSaved, Some("take-saved hall_001")),
            (ServiceEventKind::Mark, Some("mark words")),
            (ServiceEventKind::Device, Some("device words")),
            (ServiceEventKind::Warning, None),
        ] {
            assert_eq!(text_of(&event(kind, now_ms)).as_deref(), text);
        }
        let before = monotonic_ns();
        let age = before.abs_diff(time_of(&event(ServiceEventKind::Mark, now_ms - 500)));
        assert!((400_000_000..2_000_000_000).contains(&age), "{age} ns ago");
        // The time of day was set.
        assert!(time_of(&event(ServiceEventKind::Mark, 0)) >= before);
    }

    #[test]
    fn stamps_stay_at_the_time_of_capture_whatever_the_true_rate() {
        // 20 samples a batch of nominally 1 ms, by converters that are 200 ppm fast or slow, read with jitter.
        for period_ns in [999_800_u64, 1_000_200] {
            let mut last_ns = 0;
            for batch in 0..200_000_u64 {
                let captured_ns = 5_000_000_000 + batch * 20 * period_ns + batch % 7 * 300_000;
                let first_ns = in_order(captured_ns, last_ns);
                assert!(first_ns >= last_ns && first_ns - captured_ns < 2_000_000, "{batch}");
                last_ns = first_ns + 19 * 1_000_000;
            }
        }
        assert_eq!(in_order(1_000, 5_000), 5_000, "a refitted line");
        assert_eq!(in_order(1_000, 1_000 + STEP_MAX_NS), 1_000, "a clock that was set");
    }

    #[test]
    fn values_are_in_the_units_of_their_channels() {
        let channel =
            |scale, offset| SampledChannelInfo { scale, offset, ..SampledChannelInfo::default() };
        let group = SampledGroupInfo {
            channels: vec![channel(0.5, 10.0), channel(1.0, 0.0)],
            ..SampledGroupInfo::default()
        };
        let samples = vec![12.0, 0.1, 10.0, f32::NAN];
        let batch = TappedBatch { samples, n_channels: 2, ..TappedBatch::default() };
        let mut values = vec![7.0];
        put_values(&group, &batch, &mut values);
        assert_eq!(values[..3], [1.0, 0.1, 0.0]);
        assert!(values[3].is_nan() && values.len() == 4);
    }
}
