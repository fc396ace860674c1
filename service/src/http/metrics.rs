//! The figures of the status as Prometheus metrics.

use std::{
    fmt,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use axum::{
    extract,
    http::{HeaderMap, header},
    response::{IntoResponse, Response},
};
use mocapd_acquire::ledger::{LedgerDocument, SampleLedgerDocument, TakeHealth};
use prometheus_client::{
    collector::Collector,
    encoding::{DescriptorEncoder, EncodeMetric, text::encode},
    metrics::{MetricType, counter::ConstCounter, gauge::ConstGauge},
    registry::{Registry, Unit},
};

use super::{Counts, Shared, body::Problem};
use crate::status::{ArchiveStatus, PublishStatus, State, Status, TakeStatus, TakeSummary};

const OPEN_METRICS: &str = "application/openmetrics-text";

/// Metrics for Prometheus
///
/// In the `OpenMetrics` text format if the client accepts it, otherwise in Prometheus' classic text format.
#[utoipa::path(get, path = "/metrics", tag = "status", responses((status = 200, content(
    (String = "text/plain; version=0.0.4; charset=utf-8"),
    (String = "application/openmetrics-text; version=1.0.0; charset=utf-8")))))]
pub(super) async fn metrics(
    extract::State(app): extract::State<Shared>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let mut registry = Registry::with_prefix("mocapd");
    let figures = StatusMetrics { status: app.control.status(), counts: Arc::clone(&app.counts) };
    registry.register_collector(Box::new(figures));
    let mut text = String::new();
    encode(&mut text, &registry).map_err(|error| Problem::internal(error.to_string()))?;
    let accepts = headers.get(header::ACCEPT).and_then(|accept| accept.to_str().ok());
    let (content_type, text) = if accepts.is_some_and(|types| types.contains(OPEN_METRICS)) {
        ("application/openmetrics-text; version=1.0.0; charset=utf-8", text)
    } else {
        ("text/plain; version=0.0.4; charset=utf-8", classic(&text))
    };
    Ok(([(header::CONTENT_TYPE, content_type)], text).into_response())
}

/// Converts `OpenMetrics` to the classic text format, in which the help and type of a counter stand under its full
/// name, a unit is only part of the name, and there is no end marker. Classic readers would otherwise find no help for
/// counters.
fn classic(text: &str) -> String {
    let counters: Vec<&str> = text
        .lines()
        .filter_map(|line| line.strip_prefix("# TYPE ")?.strip_suffix(" counter"))
        .collect();
    let mut out = String::with_capacity(text.len());
    for line in text.lines().filter(|line| !line.starts_with("# UNIT ") && *line != "# EOF") {
        let mut parts = line.splitn(4, ' ');
        match (parts.next(), parts.next(), parts.next(), parts.next()) {
            (Some("#"), Some(what), Some(name), Some(rest)) if counters.contains(&name) => {
                out += &format!("# {what} {name}_total {rest}\n");
            }
            _ => {
                out += line;
                out.push('\n');
            }
        }
    }
    out
}

/// The status at one moment: names in Prometheus' base units, each with its help text.
#[derive(Debug)]
struct StatusMetrics {
    status: Status,
    counts: Arc<Counts>,
}

impl Collector for StatusMetrics {
    fn encode(&self, encoder: DescriptorEncoder<'_>) -> fmt::Result {
        let mut out = MetricWriter(encoder);
        self.service(&mut out)?;
        self.device(&mut out)?;
        self.input(&mut out)?;
        self.pre_roll_and_disk(&mut out)?;
        if let Some(take) = &self.status.take {
            of_take(take, &mut out)?;
            of_ledger(&take.ledger, &mut out)?;
            if let Some(ledger) = &take.sample_ledger {
                of_sample_ledger(ledger, &mut out)?;
            }
        }
        if let Some(archive) = &self.status.archive {
            of_archive(archive, &mut out)?;
        }
        if !self.status.publish.is_empty() {
            of_publish(&self.status.publish, &mut out)?;
        }
        if let Some(take) = &self.status.last_take {
            of_last_take(take, &mut out)?;
        }
        self.http(&mut out)
    }
}

/// Writes metrics one after another.
struct MetricWriter<'a>(DescriptorEncoder<'a>);

impl MetricWriter<'_> {
    /// A gauge; its name ends with the unit, if there is one.
    fn gauge(&mut self, name: &str, help: &str, unit: Option<&Unit>, value: f64) -> fmt::Result {
        let metric = self.0.encode_descriptor(name, help, unit, MetricType::Gauge)?;
        ConstGauge::new(value).encode(metric)
    }

    fn counter(&mut self, name: &str, help: &str, value: u64) -> fmt::Result {
        let metric = self.0.encode_descriptor(name, help, None, MetricType::Counter)?;
        ConstCounter::new(value).encode(metric)
    }

    /// A gauge with several values, distinguished by a label.
    fn by(&mut self, name: &str, help: &str, label: &str, values: &[(&str, u64)]) -> fmt::Result {
        let mut metric = self.0.encode_descriptor(name, help, None, MetricType::Gauge)?;
        for &(which, value) in values {
            ConstGauge::new(value as f64).encode(metric.encode_family(&[(label, which)])?)?;
        }
        Ok(())
    }

    /// A counter with several values, distinguished by a label.
    fn counters_by(
        &mut self,
        name: &str,
        help: &str,
        label: &str,
        values: &[(&str, u64)],
    ) -> fmt::Result {
        let mut metric = self.0.encode_descriptor(name, help, None, MetricType::Counter)?;
        for &(which, value) in values {
            ConstCounter::new(value).encode(metric.encode_family(&[(label, which)])?)?;
        }
        Ok(())
    }

    /// A gauge with one value per state: 1 for the current state, 0 for the others.
    fn one_of(&mut self, name: &str, help: &str, names: &[&str], is: &str) -> fmt::Result {
        let values: Vec<_> = names.iter().map(|&which| (which, u64::from(which == is))).collect();
        let label = name.rsplit('_').next().unwrap_or(name);
        self.by(name, help, label, &values)
    }
}

fn flag(is: bool) -> f64 {
    f64::from(u8::from(is))
}

/// Metrics with their help texts. A gauge may have a unit.
macro_rules! figures {
    ($out:ident: $(#[doc = $help:literal] $kind:ident $name:ident $(in $unit:ident)? = $value:expr;)*) => {
        $(figures!(@$kind $out, stringify!($name), $help.trim_ascii(), $($unit)?, $value)?;)*
    };
    (@counter $out:ident, $name:expr, $help:expr, , $value:expr) => {
        $out.counter($name, $help, $value)
    };
    (@gauge $out:ident, $name:expr, $help:expr, , $value:expr) => {
        $out.gauge($name, $help, None, $value)
    };
    (@gauge $out:ident, $name:expr, $help:expr, Hertz, $value:expr) => {
        $out.gauge($name, $help, Some(&Unit::Other("hertz".to_owned())), $value)
    };
    (@gauge $out:ident, $name:expr, $help:expr, Ratio, $value:expr) => {
        $out.gauge($name, $help, Some(&Unit::Other("ratio".to_owned())), $value)
    };
    (@gauge $out:ident, $name:expr, $help:expr, $unit:ident, $value:expr) => {
        $out.gauge($name, $help, Some(&Unit::$unit), $value)
    };
}

impl StatusMetrics {
    fn service(&self, out: &mut MetricWriter<'_>) -> fmt::Result {
        let status = &self.status;
        let mut build = out.0.encode_descriptor(
            "build_info",
            "Software version and name of the rig; always 1",
            None,
            MetricType::Gauge,
        )?;
        let labels = [("software", status.software.as_str()), ("rig", status.rig.as_str())];
        ConstGauge::new(1.0).encode(build.encode_family(&labels)?)?;
        figures! { out:
            /// Time since the service was started
            gauge uptime in Seconds = status.uptime_s;
        }
        let state = match status.state {
            State::Idle => "idle",
            State::Armed => "armed",
            State::Recording => "recording",
            State::Failed => "failed",
        };
        let names = ["idle", "armed", "recording", "failed"];
        out.one_of(
            "state",
            "State of the service: 1 for the current state, 0 for the others",
            &names,
            state,
        )
    }

    fn device(&self, out: &mut MetricWriter<'_>) -> fmt::Result {
        let device = &self.status.device;
        let names = ["absent", "present", "streaming", "silent"];
        let help = "Presence of the device: 1 for the current presence, 0 for the others";
        out.one_of("device_presence", help, &names, &device.presence.to_string())?;
        let outage = device.outage.unwrap_or_default();
        figures! { out:
            /// Frame rate that the device reports
            gauge device_rate in Hertz = device.rate_hz;
            /// Markers announced by the device, and those that appeared since
            gauge device_markers = device.markers as f64;
            /// Number of times that the device disconnected and came back since it was armed
            counter device_outages = u64::from(device.outages);
            /// 1 while the service waits for an absent device
            gauge device_is_awaited = flag(device.is_awaited);
            /// Time since the last frame while the device should stream but does not; otherwise 0
            gauge device_outage in Seconds = outage.seconds;
            /// Frames due during that time
            gauge device_outage_frames = outage.frames as f64;
        }
        if let Some(ends_in_s) = outage.ends_in_s {
            figures! { out:
                /// Time until the service stops waiting for an absent device and ends the take
                gauge device_outage_ends_in in Seconds = ends_in_s;
            }
        }
        Ok(())
    }

    fn input(&self, out: &mut MetricWriter<'_>) -> fmt::Result {
        let input = &self.status.input;
        figures! { out:
            /// Frames received since the device was armed
            counter input_frames = input.frames;
            /// Frames lost since the device was armed, for any reason
            counter input_frames_lost = input.lost;
            /// Frame rate over the last seconds, by arrival
            gauge input_measured_rate in Hertz = input.measured_hz;
            /// Fill level of the fullest ring
            gauge input_ring_fill in Ratio = input.ring_fill;
            /// Time from a frame's last byte to its place in every ring, 99th percentile
            gauge input_ring_latency_p99 in Seconds = input.ring_latency_p99_us as f64 / 1e6;
            /// 99th percentile of the delay of frames against the clock line; 0 while unknown
            gauge input_jitter_p99 in Seconds = input.jitter_p99_us as f64 / 1e6;
            /// Relative drift: how much faster the host's clock runs than the device's
            gauge input_clock_drift in Ratio = input.drift_ppm / 1e6;
            /// Processor time of all threads over the last seconds, in cores
            gauge cpu_cores = input.cpu_cores;
        }
        Ok(())
    }

    fn pre_roll_and_disk(&self, out: &mut MetricWriter<'_>) -> fmt::Result {
        let (pre_roll, disk) = (&self.status.pre_roll, &self.status.disk);
        figures! { out:
            /// Configured length of the pre-roll
            gauge pre_roll_wanted in Seconds = pre_roll.wanted_s;
            /// Length of the pre-roll held
            gauge pre_roll_held in Seconds = pre_roll.held_s;
            /// Memory used by the pre-roll
            gauge pre_roll_memory in Bytes = pre_roll.held_bytes as f64;
            /// 1 if the memory limit keeps the pre-roll shorter than configured
            gauge pre_roll_is_cut = flag(pre_roll.is_cut);
        }
        if let Some(free) = disk.free_bytes {
            figures! { out:
                /// Free space on the disk of the takes' folder
                gauge disk_free in Bytes = free as f64;
            }
        }
        figures! { out:
            /// Space to keep free: a take that reaches it is closed
            gauge disk_keep_free in Bytes = disk.keep_free_bytes as f64;
        }
        if let Some(left) = disk.left_s {
            figures! { out:
                /// How long a take can continue at the rate of the last half minute
                gauge disk_left in Seconds = left as f64;
            }
        }
        Ok(())
    }

    fn http(&self, out: &mut MetricWriter<'_>) -> fmt::Result {
        let counts = &self.counts;
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        figures! { out:
            /// Open connections to the API
            gauge http_connections = count(&counts.connections) as f64;
            /// Connections rejected because there were too many
            counter http_connections_refused = count(&counts.connections_refused);
            /// Connections without a request in progress that were closed in favour of new ones
            counter http_connections_evicted = count(&counts.connections_evicted);
            /// Requests to the API
            counter http_requests = count(&counts.requests);
            /// Requests that got a status of 400 or above
            counter http_requests_refused = count(&counts.requests_refused);
            /// Messages of the live stream skipped because viewers were too slow
            counter http_live_messages_skipped = count(&counts.live_frames_skipped);
            /// Events missed because the API itself was too slow
            counter http_events_missed = count(&counts.events_missed);
        }
        Ok(())
    }
}

/// A number of what one server publishes.
type PublishFigure = fn(&PublishStatus) -> u64;

/// What each client was sent is in the status alone: their addresses would be ever new series.
fn of_publish(publish: &[PublishStatus], out: &mut MetricWriter<'_>) -> fmt::Result {
    let by = |value: PublishFigure| {
        let values = publish.iter().map(|status| (status.protocol.as_str(), value(status)));
        values.collect::<Vec<_>>()
    };
    let help = "Clients that what is received is published to";
    out.by("publish_clients", help, "protocol", &by(|it| it.clients.len() as u64))?;
    let figures: [(&str, &str, PublishFigure); 7] = [
        (
            "clients_refused",
            "Clients that were refused: too many, or from an address that is not allowed",
            |it| it.clients_refused,
        ),
        ("frames_sent", "Frames that clients were sent, also those that have left", |it| {
            it.frames_sent
        }),
        ("frames_missed", "Frames that clients missed, also those that have left", |it| {
            it.frames_missed
        }),
        (
            "batches_missed",
            "Batches of samples that clients missed beside frames, also those that have left",
            |it| it.batches_missed,
        ),
        (
            "frames_left_out",
            "Frames that all clients missed because the server was too slow",
            |it| it.frames_left_out,
        ),
        (
            "poses_left_out",
            "Frames whose poses all clients missed: the server was too slow, or they came without their frame",
            |it| it.poses_left_out,
        ),
        ("batches_left_out", "Batches of samples that all clients missed", |it| {
            it.batches_left_out
        }),
    ];
    for (name, help, value) in figures {
        out.counters_by(&format!("publish_{name}"), help, "protocol", &by(value))?;
    }
    Ok(())
}

fn of_take(take: &TakeStatus, out: &mut MetricWriter<'_>) -> fmt::Result {
    figures! { out:
        /// Time of the take's start request, since 1970
        gauge take_started_timestamp in Seconds = take.started_unix_ms as f64 / 1e3;
        /// Rows of the take so far, including lost frames
        gauge take_rows = take.rows as f64;
        /// Length of the take
        gauge take_length in Seconds = take.seconds;
        /// Size of the take's file
        gauge take_size in Bytes = take.bytes as f64;
        /// Bytes of the take that would survive a power cut
        gauge take_durable in Bytes = take.durable_bytes as f64;
        /// Compression ratio: 12 bytes per present sample, divided by the size of the file; 0 before there are samples
        gauge take_compression in Ratio = take.ratio;
        /// Largest error of any sample of the take so far
        gauge take_max_error in Meters = take.max_error_mm / 1e3;
    }
    Ok(())
}

fn of_ledger(ledger: &LedgerDocument, out: &mut MetricWriter<'_>) -> fmt::Result {
    figures! { out:
        /// Frames that the device sent for the take, if known
        gauge take_frames_sent = ledger.frames_sent as f64;
    }
    let frames = [
        ("recorded", ledger.recorded),
        ("lost_on_link", ledger.lost_on_link),
        ("dropped_by_device", ledger.dropped_by_device),
        ("lost_ring_full", ledger.lost_ring_full),
        ("lost_other", ledger.lost_other),
        ("duplicate", ledger.duplicates),
        ("unknown_after_disconnect", ledger.unknown_after_disconnect),
    ];
    out.by("take_frames", "Frames of the take by fate", "fate", &frames)?;
    figures! { out:
        /// Samples that the take's frames should contain
        gauge take_samples_announced = ledger.samples_announced as f64;
    }
    let samples = [
        ("present", ledger.samples_present),
        ("occluded", ledger.samples_occluded),
        ("not_finite", ledger.samples_not_finite),
    ];
    out.by("take_samples", "Samples of the take by fate", "fate", &samples)?;
    figures! { out:
        /// Samples of markers without a channel
        gauge take_markers_dropped = ledger.markers_dropped as f64;
        /// Contradictions between the ledger's counters
        gauge take_contradictions = ledger.contradictions.len() as f64;
        /// 1 if every frame and sample sent is accounted for
        gauge take_ledger_closes = flag(ledger.closes);
        /// Frames sent minus frames accounted for; 0 if the ledger closes
        gauge take_frame_balance = ledger.frame_balance as f64;
        /// Samples announced minus samples accounted for; 0 if the ledger closes
        gauge take_sample_balance = ledger.sample_balance as f64;
    }
    let bytes = [("received", ledger.link_bytes), ("skipped", ledger.link_bytes_skipped)];
    let messages = [
        ("whole", ledger.link_messages),
        ("damaged", ledger.link_messages_damaged),
        ("unknown", ledger.link_messages_unknown),
    ];
    let help = "Bytes received during the take; those skipped are also counted as received";
    out.by("take_link_bytes", help, "fate", &bytes)?;
    out.by("take_link_messages", "Messages received during the take", "fate", &messages)
}

fn of_sample_ledger(ledger: &SampleLedgerDocument, out: &mut MetricWriter<'_>) -> fmt::Result {
    let help = "Samples of each channel of a group in the take, by fate";
    let mut metric =
        out.0.encode_descriptor("take_sampled_samples", help, None, MetricType::Gauge)?;
    for group in &ledger.groups {
        let number = group.group.to_string();
        for (fate, n) in [
            ("stored", group.stored),
            ("lost_on_link", group.lost_on_link),
            ("dropped_by_device", group.dropped_by_device),
            ("lost_ring_full", group.lost_ring_full),
            ("lost_other", group.lost_other),
            ("unknown_after_disconnect", group.unknown_after_disconnect),
            ("duplicate", group.duplicates),
        ] {
            let labels = [("group", number.as_str()), ("fate", fate)];
            ConstGauge::new(n as f64).encode(metric.encode_family(&labels)?)?;
        }
    }
    let help = "Samples of each channel of a group that the device took for the take";
    let mut metric =
        out.0.encode_descriptor("take_sampled_taken", help, None, MetricType::Gauge)?;
    for group in &ledger.groups {
        let number = group.group.to_string();
        ConstGauge::new(group.taken as f64)
            .encode(metric.encode_family(&[("group", number.as_str())])?)?;
    }
    let help = "Times that the numbers of a group's samples began again or jumped";
    let mut metric =
        out.0.encode_descriptor("take_sampled_jumps", help, None, MetricType::Gauge)?;
    for group in &ledger.groups {
        let number = group.group.to_string();
        ConstGauge::new(group.jumps as f64)
            .encode(metric.encode_family(&[("group", number.as_str())])?)?;
    }
    figures! { out:
        /// Batches of samples that did not fit their announcement, or had none
        gauge take_sampled_batches_refused = ledger.batches_refused as f64;
        /// 1 if every sample of every group is accounted for
        gauge take_sampled_ledger_closes = flag(ledger.closes);
    }
    Ok(())
}

fn of_archive(archive: &ArchiveStatus, out: &mut MetricWriter<'_>) -> fmt::Result {
    figures! { out:
        /// Takes that wait to be uploaded, or are being uploaded
        gauge archive_takes_waiting = archive.waiting as f64;
        /// Takes in the folder that were uploaded
        gauge archive_takes_uploaded = archive.uploaded as f64;
        /// Takes that cannot be uploaded
        gauge archive_takes_failed = archive.failed as f64;
        /// Bytes sent to the archive since the service was started
        counter archive_sent_bytes = archive.sent_bytes;
        /// Failed attempts to upload since the service was started
        counter archive_retries = archive.retries;
        /// 1 if the last attempt to reach the archive failed
        gauge archive_is_unavailable = flag(archive.error.is_some());
    }
    Ok(())
}

fn of_last_take(take: &TakeSummary, out: &mut MetricWriter<'_>) -> fmt::Result {
    figures! { out:
        /// Size of the previous take's file
        gauge last_take_size in Bytes = take.bytes as f64;
        /// Last modification of the previous take, since 1970
        gauge last_take_modified_timestamp in Seconds = take.modified_unix_ms as f64 / 1e3;
        /// Length of the previous take; 0 while unknown
        gauge last_take_length in Seconds = take.seconds;
        /// Markers of the previous take; 0 while unknown
        gauge last_take_markers = take.markers as f64;
    }
    let names = TakeHealth::ALL.map(TakeHealth::name);
    let help = "Health of the previous take: 1 for its health, 0 for the others";
    out.one_of("last_take_health", help, &names, take.health.name())
}

#[cfg(test)]
mod tests {
    use mocapd_acquire::ledger::GroupLedgerDocument;
    use serde_json::Value;

    use super::*;
    use crate::status::{DeviceStatus, OutageStatus};

    fn text(status: Status) -> String {
        let mut registry = Registry::with_prefix("mocapd");
        registry.register_collector(Box::new(StatusMetrics { status, counts: Arc::default() }));
        let mut text = String::new();
        encode(&mut text, &registry).unwrap();
        text
    }

    /// Replaces every number in a document by a unique one, and records its path.
    fn number(value: &mut Value, path: &str, numbers: &mut Vec<(String, u64)>) {
        match value {
            Value::Object(fields) => {
                for (name, field) in fields {
                    number(field, &format!("{path}.{name}"), numbers);
                }
            }
            Value::Number(old) => {
                let new = 1_000_003 + 7 * numbers.len() as u64;
                *value = if old.is_f64() { Value::from(new as f64) } else { Value::from(new) };
                numbers.push((path.to_owned(), new));
            }
            _ => {}
        }
    }

    #[test]
    fn every_number_of_the_status_is_a_metric() {
        let outage = OutageStatus { ends_in_s: Some(0.0), ..OutageStatus::default() };
        let groups = vec![GroupLedgerDocument::default()];
        let samples = SampleLedgerDocument { groups, ..SampleLedgerDocument::default() };
        let full = Status {
            device: DeviceStatus { outage: Some(outage), ..DeviceStatus::default() },
            take: Some(TakeStatus { sample_ledger: Some(samples), ..TakeStatus::default() }),
            last_take: Some(TakeSummary::default()),
            archive: Some(ArchiveStatus::default()),
            disk: crate::status::DiskStatus {
                free_bytes: Some(0),
                left_s: Some(0),
                ..Default::default()
            },
            ..Status::default()
        };
        let (mut document, mut numbers) = (serde_json::to_value(full).unwrap(), Vec::new());
        number(&mut document, "status", &mut numbers);
        assert!(numbers.len() > 40, "{numbers:?}");
        let text = text(serde_json::from_value(document).unwrap());
        let values: Vec<f64> = text
            .lines()
            .filter(|line| !line.starts_with('#'))
            .map(|line| line.rsplit_once(' ').unwrap().1.parse().unwrap())
            .collect();
        for (path, number) in numbers {
            // The number of a group is a label.
            if path.ends_with(".group") {
                assert!(text.contains(&format!("group=\"{number}\"")), "{path}");
                continue;
            }
            let in_base_units = [1.0, 1e-3, 1e-6].map(|factor| number as f64 * factor);
            let found = values.iter().any(|value| {
                in_base_units.iter().any(|wanted| (value - wanted).abs() < 1e-9 * wanted)
            });
            assert!(found, "{path} is in no figure");
        }
    }

    #[test]
    fn every_number_of_a_server_that_publishes_is_a_metric() {
        let mut numbers = Vec::new();
        let mut server = serde_json::to_value(PublishStatus::default()).unwrap();
        server["protocol"] = "foxglove".into();
        number(&mut server, "", &mut numbers);
        let publish = vec![serde_json::from_value(server).unwrap()];
        let text = text(Status { publish, ..Status::default() });
        for (path, number) in numbers.iter().filter(|(path, _)| path != ".clients_max") {
            let name = path.trim_start_matches('.');
            let line = format!("mocapd_publish_{name}_total{{protocol=\"foxglove\"}} {number}\n");
            assert!(text.contains(&line), "{line}: {text}");
        }
        assert!(numbers.len() > 7, "{numbers:?}");
    }

    #[test]
    fn states_are_one_of_several() {
        let text = text(Status { state: State::Armed, ..Status::default() });
        assert!(text.contains("mocapd_state{state=\"armed\"} 1.0\n"), "{text}");
        assert!(text.contains("mocapd_state{state=\"recording\"} 0.0\n"), "{text}");
        assert!(!text.contains("mocapd_take_"), "no take, no figures of it");
    }

    #[test]
    fn the_classic_format_has_help_for_counters() {
        let new = text(Status::default());
        assert!(new.contains("# TYPE mocapd_input_frames counter\n") && new.ends_with("# EOF\n"));
        let old = classic(&new);
        assert!(old.contains("# HELP mocapd_input_frames_total "), "{old}");
        assert!(
            old.contains("# TYPE mocapd_input_frames_total counter\nmocapd_input_frames_total 0\n")
        );
        assert!(!old.contains("# EOF") && !old.contains("# UNIT"));
        let values = |text: &str| text.lines().filter(|line| !line.starts_with('#')).count();
        assert_eq!(values(&old), values(&new));
    }
}
