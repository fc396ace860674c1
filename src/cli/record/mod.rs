//! `record`: records a device to a take.

mod raw;
mod report;
mod split;
mod watch;

use std::{path::PathBuf, time::Duration};

use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::{
    files::{FileState, SettledFile},
    raw_log::RawLog,
    record::Recorded,
    rig::Rig,
    series::{RecordedSeries, SeriesTake},
};
use mocapd_drivers::{
    registry::OpenError,
    uri::{DeviceUri, Location},
};
use mocapd_service::units;
use mocapd_take::record::EndingKind;
use serde::Serialize;

use self::{report::SeriesReport, split::SplitValue, watch::record_series_and_watch};
pub(crate) use self::{
    report::{LatencyReport, ProcessReport, RecordReport},
    watch::{Limits, record_and_watch},
};
use super::{
    output::{notify, print, print_json},
    paths, remote,
    stop::stop_on_signal,
    subject::SubjectArgs,
    values::{self, CodecArgs},
};

/// Default disk space to keep free: a system with a full disk cannot even log what went wrong.
pub(crate) const KEEP_FREE: &str = "256MiB";

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Device to record: serial:PATH[@BAUD], usb:VID:PID[:SERIAL], qtm:HOST[:PORT], natnet:HOST[:PORT] or lsl:NAME, with ?driver=NAME to choose a driver
    #[arg(short, long, value_name = "URI")]
    device: String,
    /// The take to write; it must not exist
    #[arg(short, long, value_name = "TAKE")]
    output: PathBuf,
    /// Stop after this time: 10s, 500ms, 2min [default: at the end of a replay, or on Ctrl-C]
    #[arg(long, value_name = "TIME", value_parser = values::length, allow_hyphen_values = true)]
    seconds: Option<Duration>,
    /// Begin a new take whenever the current one has this length or size, without losing a frame: 10s, 30min, 500MB,
    /// 2GiB, at least 1s or 1MB; -o run.take writes run-001.take, run-002.take and so on
    #[arg(long, value_name = "TIME|SIZE", value_parser = split::split, allow_hyphen_values = true)]
    split: Option<SplitValue>,
    /// Set the device to this frame rate: 240, 240Hz, 1kHz; it keeps the rate afterwards
    #[arg(long, value_name = "HZ", value_parser = units::rate_hz, allow_hyphen_values = true)]
    rate: Option<f64>,
    /// Wait this long for a disconnected device to come back before ending the take; 0s ends it at once
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = units::duration, allow_hyphen_values = true)]
    reconnect: Duration,
    /// Write to the file at this interval, 50ms to 10s: a killed process loses no more than this; shorter intervals
    /// make larger files
    #[arg(long, value_name = "TIME", default_value = "500ms", value_parser = values::stretch, allow_hyphen_values = true)]
    stretch: Duration,
    /// Sync the file to disk at this interval: a power cut loses no more than this plus a stretch
    #[arg(long, value_name = "TIME", default_value = "500ms", value_parser = values::sync, allow_hyphen_values = true)]
    sync: Duration,
    /// End the take when no more than this is free on the disk: 256MiB, 2GB; 0 uses the whole disk
    #[arg(long, value_name = "SIZE", default_value = KEEP_FREE, value_parser = units::size_bytes, allow_hyphen_values = true)]
    keep_free: u64,
    /// Also log every byte to and from the device to this file; `mocapd-sim serve` replays it as the device, if that speaks the link protocol (dvmc)
    #[arg(long, value_name = "LOG")]
    raw: Option<PathBuf>,
    /// Largest error of the rotations of rigid bodies: 0.05deg, 0.0001 to 10 degrees [default: the angle by which a point
    /// 200 mm away moves by the tolerance]
    #[arg(long, value_name = "ANGLE", value_parser = units::angle_degrees, conflicts_with = "lossless", allow_hyphen_values = true)]
    angle_tolerance: Option<f64>,
    #[command(flatten)]
    codec: CodecArgs,
    #[command(flatten)]
    subject: SubjectArgs,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Parses the device. Unlike the service, `record` has no default: the user names the device.
fn device(text: &str) -> anyhow::Result<DeviceUri> {
    if text == "auto" {
        let message = "--device auto: only the service selects a device (device.uri = \"auto\"): \
                       give the one to record, as `mocapd devices` lists it, such as serial:/dev/ttyUSB0";
        return Err(UsageError(message.to_owned()).into());
    }
    Ok(text.parse().map_err(|error| UsageError(format!("{error}")))?)
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let uri = device(&args.device)?;
    let codec = args.codec.live_settings()?;
    let options = |split: &SplitValue| split.options(&args.output, args.seconds, args.stretch);
    let series = args.split.as_ref().map(options).transpose()?;
    let first = series.as_ref().map_or_else(|| args.output.clone(), |series| series.names.path(1));
    remote::refuse_recording(&args.output)?;
    paths::check_take_output(&first)?;
    if let Some(raw) = &args.raw {
        if paths::are_one(raw, &first) {
            return Err(UsageError("--raw and --output name the same file".to_owned()).into());
        }
        remote::refuse_recording(raw)?;
        paths::check_output(raw)?;
        let is_stream = match &uri.location {
            Location::Network(at) => !at.datagrams,
            Location::Streams(_) => true,
            Location::Serial { .. } | Location::Usb { .. } => false,
        };
        if is_stream {
            notify(
                "a raw log of a device on the network cannot be replayed: it shows what was sent",
            );
        }
    }
    let subject = args.subject.load()?;
    let stop = stop_on_signal()?;
    let raw = args.raw.as_deref();
    let has_take =
        || series.as_ref().map_or_else(|| first.exists(), |series| series.names.any_exists());
    let ((recorded, takes), log) = raw::with_log(raw, has_take, args.sync, |log| {
        let opened = Rig::open_logged(&uri, log.map(RawLog::tap));
        let mut rig = opened.map_err(|error| match error.downcast_ref() {
            Some(OpenError::UnknownDriver { .. }) => UsageError(error.to_string()).into(),
            _ => error,
        })?;
        if let Some(rate_hz) = args.rate {
            rig.set_rate(rate_hz).map_err(watch::name_option)?;
        }
        rig.wait_for_replug(args.reconnect);
        rig.limit_loss(args.stretch, args.sync);
        rig.limit_angles(args.angle_tolerance);
        let same_disk = log.filter(|log| paths::are_on_one_disk(log.path(), &first));
        let limits = Limits {
            length: args.seconds,
            keep_free_bytes: args.keep_free,
            raw_log_bytes: same_disk.map(RawLog::file_bytes),
            subject,
        };
        let Some(series) = &series else {
            let recorded = record_and_watch(rig, &args.output, codec, &limits, &stop)?;
            return Ok((recorded, Vec::new()));
        };
        let recorded = record_series_and_watch(rig, &args.output, series, codec, &limits, &stop)?;
        let RecordedSeries { takes, total } = recorded;
        Ok((total, takes))
    })?;
    let report = RecordReport::new(&args.output, &recorded, &codec).with_log(log);
    if let Some(series) = &series {
        let report = SeriesReport::new(&report, series, &takes);
        print_report(args.json, &report, || report.text())?;
    } else {
        print_report(args.json, &report, || report.text())?;
    }
    Ok(outcome(&recorded, &report, &takes))
}

fn print_report(
    json: bool,
    report: &impl Serialize,
    text: impl FnOnce() -> String,
) -> anyhow::Result<()> {
    if json { print_json(report) } else { print(&text()) }
}

/// Reports what went wrong on stderr. `takes`: those of a recording that was divided.
fn outcome(recorded: &Recorded, report: &RecordReport, takes: &[SeriesTake]) -> Outcome {
    let disconnected = recorded.recording.ending == EndingKind::DeviceGone;
    if disconnected {
        notify("the device was disconnected: the take ends there");
    }
    let is_full = recorded.recording.ending == EndingKind::DiskFull;
    if is_full {
        notify(&report.disk_full());
    }
    let files = std::iter::once(&recorded.file).chain(takes.iter().map(|take| &take.file));
    files.filter_map(SettledFile::message).for_each(|notice| notify(&notice));
    if let Some(outages) = report.outages.text() {
        notify(&outages);
    }
    if let Some(losses) = report.losses() {
        notify(&format!("not in the take: {losses}"));
    }
    let sample_losses = report.sample_losses();
    sample_losses.iter().for_each(|losses| notify(losses));
    if let Some(why) = report.not_closing() {
        notify(&why);
    }
    let ledger = &recorded.written.ledger;
    let had_outage = disconnected || recorded.recording.outages > 0;
    let is_displaced = recorded.file.state != FileState::InPlace;
    let lost_anything = ledger.lost_anything()
        || !sample_losses.is_empty()
        || !ledger.closes()
        || report.log_lost();
    Outcome::of(lost_anything || had_outage || is_full || is_displaced)
}
