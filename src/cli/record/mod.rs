//! `record`: a device into a take.

mod raw;
mod report;
mod watch;

use std::{path::PathBuf, time::Duration};

use mocapd::outcome::{Outcome, UsageError};
use mocapd_acquire::{files::FileState, raw_log::RawLog, rig::Rig};
use mocapd_drivers::{registry::OpenError, uri::DeviceUri};
use mocapd_service::units;
use mocapd_take::record::EndingKind;

pub(crate) use self::{
    report::{LatencyReport, ProcessReport, Report},
    watch::{Limits, record_and_watch},
};
use super::{
    output::{print, print_json, say},
    paths,
    stop::stop_on_signal,
    subject::SubjectArgs,
    values,
    values::CodecArgs,
};

/// What stays free of the disk: a system that has nothing left does not even log why.
pub(crate) const KEEP_FREE: &str = "256MiB";

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// serial:PATH[@BAUD] or usb:VID:PID[:SERIAL], with ?driver=NAME where needed
    #[arg(short, long, value_name = "URI")]
    device: String,
    /// The take to write; it must not exist
    #[arg(short, long, value_name = "TAKE")]
    output: PathBuf,
    /// Stop after so long: 10s, 500ms, 2min; without it at the end of a replay, or on Ctrl-C
    #[arg(long, value_name = "TIME", value_parser = values::length, allow_hyphen_values = true)]
    seconds: Option<Duration>,
    /// Set the device to this frame rate, which it keeps: 240, 240Hz, 1kHz
    #[arg(long, value_name = "HZ", value_parser = units::rate_hz, allow_hyphen_values = true)]
    rate: Option<f64>,
    /// Wait so long for a device that goes away, and go on when it is back; 0s ends the take at once
    #[arg(long, value_name = "TIME", default_value = "60s", value_parser = units::duration, allow_hyphen_values = true)]
    reconnect: Duration,
    /// Write so often: a kill loses no more, and shorter ones take more room; 50ms to 10s
    #[arg(long, value_name = "TIME", default_value = "500ms", value_parser = values::stretch, allow_hyphen_values = true)]
    stretch: Duration,
    /// Force what is written onto the disk so often: a power cut loses no more than this and a stretch
    #[arg(long, value_name = "TIME", default_value = "500ms", value_parser = values::sync, allow_hyphen_values = true)]
    sync: Duration,
    /// End the take when no more than so much of the disk is free: 256MiB, 2GB; 0 uses all of it
    #[arg(long, value_name = "SIZE", default_value = KEEP_FREE, value_parser = units::size_bytes, allow_hyphen_values = true)]
    keep_free: u64,
    /// Keep every byte of the line in this file, too: a log that `mocapd-sim serve` replays as the device
    #[arg(long, value_name = "LOG")]
    raw: Option<PathBuf>,
    #[command(flatten)]
    codec: CodecArgs,
    #[command(flatten)]
    subject: SubjectArgs,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<Outcome> {
    let uri: DeviceUri = args.device.parse().map_err(|error| UsageError(format!("{error}")))?;
    let codec = args.codec.live_settings()?;
    paths::check_take_output(&args.output)?;
    if let Some(raw) = &args.raw {
        if paths::are_one(raw, &args.output) {
            return Err(UsageError("--raw and --output name the same file".to_owned()).into());
        }
        paths::check_output(raw)?;
    }
    let subject = args.subject.load()?;
    let stop = stop_on_signal()?;
    let raw = args.raw.as_deref();
    let (recorded, log) = raw::with_log(raw, &args.output, args.sync, |log| {
        let mut rig = Rig::open_logged(&uri, log.map(RawLog::tap)).map_err(|error| match error
            .downcast_ref()
        {
            Some(OpenError::UnknownDriver { .. }) => UsageError(error.to_string()).into(),
            _ => error,
        })?;
        if let Some(rate_hz) = args.rate {
            rig.set_rate(rate_hz).map_err(watch::in_options)?;
        }
        rig.wait_for_replug(args.reconnect);
        rig.risk_at_most(args.stretch, args.sync);
        let beside = log.filter(|log| paths::are_on_one_disk(log.path(), &args.output));
        let limits = Limits {
            length: args.seconds,
            keep_free_bytes: args.keep_free,
            beside_bytes: beside.map(RawLog::file_bytes),
            subject,
        };
        record_and_watch(rig, &args.output, codec, &limits, &stop)
    })?;
    let report = Report::new(&args.output, &recorded, &codec).with_log(log);
    if args.json {
        print_json(&report)?;
    } else {
        print(&report.words())?;
    }
    let disconnected = recorded.recording.ending == EndingKind::DeviceGone;
    if disconnected {
        say("the device was disconnected: the take ends there");
    }
    let is_full = recorded.recording.ending == EndingKind::DiskFull;
    if is_full {
        say(&report.disk_full());
    }
    if let Some(words) = recorded.file.words() {
        say(&words);
    }
    if let Some(outages) = report.outages() {
        say(&outages);
    }
    if let Some(losses) = report.losses() {
        say(&format!("not in the take: {losses}"));
    }
    if let Some(why) = report.not_closing() {
        say(&why);
    }
    let ledger = &recorded.written.ledger;
    let was_away = disconnected || recorded.recording.outages > 0;
    let is_displaced = recorded.file.state != FileState::InPlace;
    Ok(Outcome::of(
        ledger.lost_anything()
            || !ledger.closes()
            || was_away
            || is_full
            || is_displaced
            || report.log_lost(),
    ))
}
