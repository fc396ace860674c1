//! Which figures there are: names in Prometheus' base units, and what each means.

use std::{
    fmt::Error,
    sync::{Arc, atomic::Ordering},
};

use mocapd_acquire::{health::TakeHealth, ledger::LedgerDocument};
use prometheus_client::{
    collector::Collector,
    encoding::{DescriptorEncoder, EncodeMetric},
    metrics::{MetricType, counter::ConstCounter, gauge::ConstGauge},
    registry::Unit,
};

use crate::{
    http::counts::Counts,
    status::{State, Status, TakeStatus, TakeSummary},
};

/// The figures at one time.
#[derive(Debug)]
pub(super) struct Figures {
    pub(super) status: Status,
    pub(super) counts: Arc<Counts>,
}

impl Collector for Figures {
    fn encode(&self, encoder: DescriptorEncoder<'_>) -> Result<(), Error> {
        let mut out = Out(encoder);
        self.service(&mut out)?;
        self.device(&mut out)?;
        self.input(&mut out)?;
        self.pre_roll_and_disk(&mut out)?;
        if let Some(take) = &self.status.take {
            of_take(take, &mut out)?;
        }
        if let Some(take) = &self.status.last_take {
            of_last_take(take, &mut out)?;
        }
        self.http(&mut out)
    }
}

/// The unit that a figure is in, which its name ends with.
#[derive(Debug, Clone, Copy)]
enum In {
    Numbers,
    Seconds,
    Bytes,
    Meters,
    Hertz,
    Ratio,
}

impl In {
    fn unit(self) -> Option<Unit> {
        match self {
            Self::Numbers => None,
            Self::Seconds => Some(Unit::Seconds),
            Self::Bytes => Some(Unit::Bytes),
            Self::Meters => Some(Unit::Meters),
            Self::Hertz => Some(Unit::Other("hertz".to_owned())),
            Self::Ratio => Some(Unit::Other("ratio".to_owned())),
        }
    }
}

/// Writes one figure after the other.
struct Out<'a>(DescriptorEncoder<'a>);

impl Out<'_> {
    fn gauge(&mut self, name: &str, help: &str, unit: In, value: f64) -> Result<(), Error> {
        let unit = unit.unit();
        let metric = self.0.encode_descriptor(name, help, unit.as_ref(), MetricType::Gauge)?;
        ConstGauge::new(value).encode(metric)
    }

    fn counter(&mut self, name: &str, help: &str, value: u64) -> Result<(), Error> {
        let metric = self.0.encode_descriptor(name, help, None, MetricType::Counter)?;
        ConstCounter::new(value).encode(metric)
    }

    /// One figure with several values, told apart by a label.
    fn by(
        &mut self,
        name: &str,
        help: &str,
        label: &str,
        values: &[(&str, f64)],
    ) -> Result<(), Error> {
        let mut metric = self.0.encode_descriptor(name, help, None, MetricType::Gauge)?;
        for &(which, value) in values {
            ConstGauge::new(value).encode(metric.encode_family(&[(label, which)])?)?;
        }
        Ok(())
    }

    /// Which one of several it is.
    fn one_of(&mut self, name: &str, help: &str, names: &[&str], is: &str) -> Result<(), Error> {
        let values: Vec<_> =
            names.iter().map(|&which| (which, f64::from(u8::from(which == is)))).collect();
        let label = name.rsplit('_').next().unwrap_or(name);
        self.by(name, help, label, &values)
    }
}

fn flag(is: bool) -> f64 {
    f64::from(u8::from(is))
}

impl Figures {
    fn service(&self, out: &mut Out<'_>) -> Result<(), Error> {
        let status = &self.status;
        let mut build =
            out.0.encode_descriptor("build_info", "Program and rig", None, MetricType::Gauge)?;
        let labels = [("software", status.software.as_str()), ("rig", status.rig.as_str())];
        ConstGauge::new(1.0).encode(build.encode_family(&labels)?)?;
        out.gauge("uptime", "Since the service was started", In::Seconds, status.uptime_s)?;
        let state = match status.state {
            State::Idle => "idle",
            State::Armed => "armed",
            State::Recording => "recording",
            State::Failed => "failed",
        };
        let names = ["idle", "armed", "recording", "failed"];
        out.one_of("state", "What the service is doing: 1 for the state it is in", &names, state)
    }

    fn device(&self, out: &mut Out<'_>) -> Result<(), Error> {
        let device = &self.status.device;
        let names = ["absent", "present", "streaming", "silent"];
        let help = "Whether the device is there: 1 for how it is";
        out.one_of("device_presence", help, &names, &device.presence.to_string())?;
        out.gauge(
            "device_rate",
            "Frames a second that the device states",
            In::Hertz,
            device.rate_hz,
        )?;
        let markers = device.markers as f64;
        out.gauge(
            "device_markers",
            "Markers announced, and those that appeared since",
            In::Numbers,
            markers,
        )?;
        let help = "Times that the device went away and came back since it was armed";
        out.counter("device_outages", help, u64::from(device.outages))?;
        let help = "1 while the device is absent and waited for";
        out.gauge("device_is_awaited", help, In::Numbers, flag(device.is_awaited))?;
        let outage = device.outage.unwrap_or_default();
        let help =
            "Since the last frame, while the device should stream and does not; 0 while it does";
        out.gauge("device_outage", help, In::Seconds, outage.seconds)?;
        let help = "Frames that were due in that time";
        out.gauge("device_outage_frames", help, In::Numbers, outage.frames as f64)?;
        if let Some(ends_in_s) = outage.ends_in_s {
            let help = "Until a device that is away is given up, and its take ends";
            out.gauge("device_outage_ends_in", help, In::Seconds, ends_in_s)?;
        }
        Ok(())
    }

    fn input(&self, out: &mut Out<'_>) -> Result<(), Error> {
        let input = &self.status.input;
        out.counter("input_frames", "Frames taken in since the device was armed", input.frames)?;
        let help = "Frames lost since the device was armed, for whatever reason";
        out.counter("input_frames_lost", help, input.lost)?;
        let help = "Frames a second over the last seconds, as they arrived";
        out.gauge("input_measured_rate", help, In::Hertz, input.measured_hz)?;
        out.gauge("input_ring_fill", "How full the fullest ring is", In::Ratio, input.ring_fill)?;
        let help = "From a frame's last byte to its place in every ring: 99 of 100 frames, at most";
        let latency_s = input.ring_latency_p99_us as f64 / 1e6;
        out.gauge("input_ring_latency_p99", help, In::Seconds, latency_s)?;
        let help =
            "What 99 of 100 frames were no later than after the clock's line; 0 while unknown";
        out.gauge("input_jitter_p99", help, In::Seconds, input.jitter_p99_us as f64 / 1e6)?;
        let help = "How much faster the host's clock runs than the device's";
        out.gauge("input_clock_drift", help, In::Ratio, input.drift_ppm / 1e6)?;
        let help = "Processor time of all threads over the last seconds, in cores";
        out.gauge("cpu_cores", help, In::Numbers, input.cpu_cores)
    }

    fn pre_roll_and_disk(&self, out: &mut Out<'_>) -> Result<(), Error> {
        let (pre_roll, disk) = (&self.status.pre_roll, &self.status.disk);
        out.gauge(
            "pre_roll_wanted",
            "Pre-roll that is to be held",
            In::Seconds,
            pre_roll.wanted_s,
        )?;
        out.gauge("pre_roll_held", "Pre-roll that is held", In::Seconds, pre_roll.held_s)?;
        let held_bytes = pre_roll.held_bytes as f64;
        out.gauge("pre_roll_memory", "What the pre-roll takes", In::Bytes, held_bytes)?;
        let help = "1 when less is held than wanted because of the bound on memory";
        out.gauge("pre_roll_is_cut", help, In::Numbers, flag(pre_roll.is_cut))?;
        if let Some(free) = disk.free_bytes {
            out.gauge(
                "disk_free",
                "Free on the disk of the takes' folder",
                In::Bytes,
                free as f64,
            )?;
        }
        let keep = disk.keep_free_bytes as f64;
        out.gauge(
            "disk_keep_free",
            "What stays free: a take that comes there is closed",
            In::Bytes,
            keep,
        )?;
        if let Some(left) = disk.left_s {
            let help = "How long a take can go on at the rate of the last half a minute";
            out.gauge("disk_left", help, In::Seconds, left as f64)?;
        }
        Ok(())
    }

    fn http(&self, out: &mut Out<'_>) -> Result<(), Error> {
        let count = |counter: &std::sync::atomic::AtomicU64| counter.load(Ordering::Relaxed);
        let counts = &self.counts;
        let open = count(&counts.connections) as f64;
        out.gauge("http_connections", "Connections to the API that are open", In::Numbers, open)?;
        for (name, help, counter) in [
            (
                "http_connections_refused",
                "Connections that were closed at once: there were too many",
                &counts.connections_refused,
            ),
            (
                "http_connections_evicted",
                "Connections without a request in progress that were closed to make room for others",
                &counts.connections_evicted,
            ),
            ("http_requests", "Requests to the API", &counts.requests),
            (
                "http_requests_refused",
                "Requests that were answered with 400 or more",
                &counts.requests_refused,
            ),
            (
                "http_live_messages_skipped",
                "Messages of the live stream that viewers were too slow for",
                &counts.live_frames_skipped,
            ),
            (
                "http_events_missed",
                "Events that the API itself was too slow for",
                &counts.events_missed,
            ),
        ] {
            out.counter(name, help, count(counter))?;
        }
        Ok(())
    }
}

fn of_take(take: &TakeStatus, out: &mut Out<'_>) -> Result<(), Error> {
    let started = take.started_unix_ms as f64 / 1e3;
    out.gauge(
        "take_started_timestamp",
        "When the take was asked for, since 1970",
        In::Seconds,
        started,
    )?;
    out.gauge(
        "take_rows",
        "Rows of the take so far, lost ones included",
        In::Numbers,
        take.rows as f64,
    )?;
    out.gauge("take_length", "What the rows of the take make", In::Seconds, take.seconds)?;
    out.gauge("take_size", "The take's file", In::Bytes, take.bytes as f64)?;
    let help = "What of the take would survive a power cut";
    out.gauge("take_durable", help, In::Bytes, take.durable_bytes as f64)?;
    let help = "12 bytes a present sample, over the bytes of the file; 0 before there are any";
    out.gauge("take_compression", help, In::Ratio, take.ratio)?;
    let help = "Largest error of a sample of the take so far";
    out.gauge("take_max_error", help, In::Meters, take.max_error_mm / 1e3)?;
    of_ledger(&take.ledger, out)
}

fn of_ledger(ledger: &LedgerDocument, out: &mut Out<'_>) -> Result<(), Error> {
    let help = "Frames that the device sent for the take, as far as is known";
    out.gauge("take_frames_sent", help, In::Numbers, ledger.frames_sent as f64)?;
    let frames = [
        ("recorded", ledger.recorded),
        ("lost_on_link", ledger.lost_on_link),
        ("dropped_by_device", ledger.dropped_by_device),
        ("lost_ring_full", ledger.lost_ring_full),
        ("lost_other", ledger.lost_other),
        ("duplicate", ledger.duplicates),
        ("unknown_after_disconnect", ledger.unknown_after_disconnect),
    ]
    .map(|(fate, n)| (fate, n as f64));
    out.by("take_frames", "What became of the take's frames", "fate", &frames)?;
    let announced = ledger.samples_announced as f64;
    out.gauge(
        "take_samples_announced",
        "Samples that the take's frames should have",
        In::Numbers,
        announced,
    )?;
    let samples = [
        ("present", ledger.samples_present),
        ("occluded", ledger.samples_occluded),
        ("not_finite", ledger.samples_not_finite),
    ]
    .map(|(fate, n)| (fate, n as f64));
    out.by("take_samples", "What became of the take's samples", "fate", &samples)?;
    let dropped = ledger.markers_dropped as f64;
    out.gauge(
        "take_markers_dropped",
        "Samples of markers that there was no channel for",
        In::Numbers,
        dropped,
    )?;
    let contradictions = ledger.contradictions.len() as f64;
    out.gauge(
        "take_contradictions",
        "Counters that contradict themselves",
        In::Numbers,
        contradictions,
    )?;
    let help = "1 when what was sent and what became of it are equal";
    out.gauge("take_ledger_closes", help, In::Numbers, flag(ledger.closes))
}

fn of_last_take(take: &TakeSummary, out: &mut Out<'_>) -> Result<(), Error> {
    out.gauge("last_take_size", "The file of the take before", In::Bytes, take.bytes as f64)?;
    let modified = take.modified_unix_ms as f64 / 1e3;
    let help = "When the take before was last written, since 1970";
    out.gauge("last_take_modified_timestamp", help, In::Seconds, modified)?;
    out.gauge(
        "last_take_length",
        "Length of the take before; 0 while unknown",
        In::Seconds,
        take.seconds,
    )?;
    let markers = take.markers as f64;
    out.gauge(
        "last_take_markers",
        "Markers of the take before; 0 while unknown",
        In::Numbers,
        markers,
    )?;
    let names = TakeHealth::ALL.map(TakeHealth::word);
    out.one_of(
        "last_take_health",
        "How the take before is: 1 for what is known",
        &names,
        take.health.word(),
    )
}
