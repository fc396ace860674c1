//! A recording with a status display, ended by Ctrl-C or by its limits.

use std::{
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use mocapd_acquire::{
    pipeline::PipelineProgress,
    record::{RecordOptions, Recorded, record},
    rig::Rig,
    series::{RecordedSeries, SeriesOptions, record_series},
    setting::{self, Setting, SettingRefused},
};
use mocapd_codec::Settings;
use mocapd_service::subject::unused_part_notes;
use mocapd_take::record::Subject;

use crate::cli::{
    output::{Progress, notify},
    values::{bytes, thousands},
};

/// The limits that end a recording, and the subject of its take.
#[derive(Debug)]
pub(crate) struct Limits {
    /// End after this time.
    pub(crate) length: Option<Duration>,
    /// End when no more than this is free on the disk.
    pub(crate) keep_free_bytes: u64,
    /// Size of the raw log, if it grows on the same disk.
    pub(crate) raw_log_bytes: Option<Arc<AtomicU64>>,
    /// The subject to store in the take.
    pub(crate) subject: Option<Subject>,
}

/// Records `rig` to `take` and shows the progress on stderr.
pub(crate) fn record_and_watch(
    rig: Rig,
    take: &Path,
    codec: Settings,
    limits: &Limits,
    stop: &AtomicBool,
) -> anyhow::Result<Recorded> {
    watched(rig, take, codec, limits, stop, record)
}

/// Records `rig` to a series of takes and shows the progress on stderr.
pub(super) fn record_series_and_watch(
    rig: Rig,
    output: &Path,
    series: &SeriesOptions,
    codec: Settings,
    limits: &Limits,
    stop: &AtomicBool,
) -> anyhow::Result<RecordedSeries> {
    let record = |rig, options: &mut RecordOptions<'_>| record_series(rig, options, series);
    watched(rig, output, codec, limits, stop, record)
}

/// Runs a recording with a status display.
fn watched<T>(
    rig: Rig,
    take: &Path,
    codec: Settings,
    limits: &Limits,
    stop: &AtomicBool,
    record: impl FnOnce(Rig, &mut RecordOptions<'_>) -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    let mut display = None;
    let mut started = |progress: &Arc<PipelineProgress>| {
        let progress = Arc::clone(progress);
        if let Some(bytes) = &limits.raw_log_bytes {
            // This cannot fail: the pipeline is new, so the cell is empty.
            progress.raw_log_bytes.set(Arc::clone(bytes)).ok();
        }
        display = Some(Progress::status(move || {
            let get = |n: &AtomicU64| n.load(Ordering::Relaxed);
            format!(
                "recording{}: {} frames, {} lost, {} on disk{}{}",
                part(progress.takes_begun.load(Ordering::Relaxed)),
                thousands(get(&progress.frames)),
                thousands(get(&progress.lost)),
                bytes(get(&progress.file_bytes)),
                disk_left(get(&progress.disk_left_s)),
                clock(&progress)
            )
        }));
    };
    let &Limits { length, keep_free_bytes, .. } = limits;
    let channels = rig.pipeline_config(codec).channels;
    let labels: Vec<String> = channels.into_iter().map(|channel| channel.label).collect();
    // Without labels there is nothing to compare yet: the device may announce its markers later.
    if !labels.is_empty() {
        unused_part_notes(limits.subject.as_ref(), &labels).iter().for_each(|note| notify(note));
    }
    let mut options = RecordOptions {
        take,
        codec,
        subject: limits.subject.as_ref(),
        length,
        keep_free_bytes,
        stop,
        notify: &notify,
        how_to_end: "; Ctrl-C finishes the take",
        how_to_set: with_option,
        started: &mut started,
    };
    let recorded = record(rig, &mut options);
    drop(display);
    recorded.map_err(name_option)
}

/// Rewrites a refused setting to name the command-line option that solves it.
pub(super) fn name_option(error: anyhow::Error) -> anyhow::Error {
    if !error.is::<SettingRefused>() {
        return error;
    }
    anyhow::Error::msg(setting::message(&error, with_option))
}

fn with_option(setting: Setting) -> String {
    match setting {
        Setting::Rate(Some(rate_hz)) => format!("record with --rate {rate_hz}"),
        Setting::Rate(None) => "omit --rate".to_owned(),
        Setting::KeepFree => "lower --keep-free".to_owned(),
    }
}

/// The number of the take that is being written, if the recording is divided.
fn part(takes_begun: u32) -> String {
    if takes_begun == 0 { String::new() } else { format!(" part {takes_begun}") }
}

/// How long the free disk space lasts at the current rate, in hours and minutes; empty while unknown.
fn disk_left(left_s: u64) -> String {
    const LONG_H: u64 = 1000;
    let (hours, minutes) = (left_s / 3600, left_s / 60 % 60);
    match left_s {
        u64::MAX => String::new(),
        _ if hours >= LONG_H => format!(", disk space for more than {LONG_H} h"),
        _ => format!(", disk space for {hours}:{minutes:02} h"),
    }
}

/// Drift and jitter of the device's clock; empty while unknown.
fn clock(progress: &PipelineProgress) -> String {
    let p99_us = progress.jitter_p99_us.load(Ordering::Relaxed);
    if p99_us == 0 {
        return String::new();
    }
    let drift_ppm = progress.drift_ppb.load(Ordering::Relaxed) as f64 / 1e3;
    format!(", drift {drift_ppm:+.1} ppm, jitter {:.1} ms (p99)", p99_us as f64 * 1e-3)
}
