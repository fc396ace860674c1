//! A recording that shows how it goes, and that Ctrl-C finishes.

use std::{
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use mocapd_acquire::{
    record::{RecordOptions, Recorded, record},
    rig::Rig,
    setting::{self, Setting, SettingRefused},
};
use mocapd_codec::Settings;
use mocapd_service::subject::strangers;
use mocapd_take::record::Subject;

use crate::cli::{
    output::Progress,
    output::say,
    values::{bytes, thousands},
};

/// When a recording ends by itself, and whose it is.
#[derive(Debug)]
pub(crate) struct Limits {
    /// After so long.
    pub(crate) length: Option<Duration>,
    /// When no more than so much of the disk is free.
    pub(crate) keep_free_bytes: u64,
    /// Bytes of what grows beside the take, on its disk.
    pub(crate) beside_bytes: Option<Arc<AtomicU64>>,
    /// Who is captured.
    pub(crate) subject: Option<Subject>,
}

/// Records `rig` into `take`, showing how it goes.
pub(crate) fn record_and_watch(
    rig: Rig,
    take: &Path,
    codec: Settings,
    limits: &Limits,
    stop: &AtomicBool,
) -> anyhow::Result<Recorded> {
    let mut watching = None;
    let mut started = |progress: &Arc<mocapd_acquire::pipeline::Progress>| {
        let progress = Arc::clone(progress);
        if let Some(beside) = &limits.beside_bytes {
            // Nobody set it before: the pipeline is this recording's.
            progress.beside_bytes.set(Arc::clone(beside)).ok();
        }
        watching = Some(Progress::status(move || {
            let get = |n: &AtomicU64| n.load(Ordering::Relaxed);
            format!(
                "recording: {} frames, {} lost, {} on disk{}{}",
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
    // A device that announces no marker yet may do so later.
    if !labels.is_empty() {
        strangers(limits.subject.as_ref(), &labels).iter().for_each(|words| say(words));
    }
    let mut options = RecordOptions {
        take,
        codec,
        subject: limits.subject.as_ref(),
        length,
        keep_free_bytes,
        stop,
        say: &say,
        how_to_end: "; Ctrl-C finishes the take",
        how_to_set: with_option,
        started: &mut started,
    };
    let recorded = record(rig, &mut options);
    drop(watching);
    recorded.map_err(in_options)
}

/// A refusal with the option that helps against it.
pub(super) fn in_options(error: anyhow::Error) -> anyhow::Error {
    if !error.is::<SettingRefused>() {
        return error;
    }
    anyhow::Error::msg(setting::words(&error, with_option))
}

fn with_option(setting: Setting) -> String {
    match setting {
        Setting::Rate(Some(rate_hz)) => format!("record with --rate {rate_hz}"),
        Setting::Rate(None) => "leave --rate out".to_owned(),
        Setting::KeepFree => "lower --keep-free".to_owned(),
    }
}

/// How long the disk will do at this rate, in hours and minutes, once that is known.
fn disk_left(left_s: u64) -> String {
    const LONG_H: u64 = 1000;
    let (hours, minutes) = (left_s / 3600, left_s / 60 % 60);
    match left_s {
        u64::MAX => String::new(),
        _ if hours >= LONG_H => format!(", room for more than {LONG_H} h"),
        _ => format!(", room for {hours}:{minutes:02} h"),
    }
}

/// How the clocks run, once that is known.
fn clock(progress: &mocapd_acquire::pipeline::Progress) -> String {
    let p99_us = progress.jitter_p99_us.load(Ordering::Relaxed);
    if p99_us == 0 {
        return String::new();
    }
    let drift_ppm = progress.drift_ppb.load(Ordering::Relaxed) as f64 / 1e3;
    format!(", drift {drift_ppm:+.1} ppm, jitter {:.1} ms (p99)", p99_us as f64 * 1e-3)
}
