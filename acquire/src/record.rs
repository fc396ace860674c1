//! Records one take: starts a pipeline for a rig, and reads the rig until the take ends.

use std::{
    path::Path,
    sync::{Arc, atomic::AtomicBool},
    time::Duration,
};

use anyhow::anyhow;
use mocapd_codec::Settings;
use mocapd_take::{
    motion::frame_at,
    record::{EndingKind, Subject},
};

use crate::{
    files::{FileState, SettledFile, TakeFile},
    pipeline::{
        NewTake, NothingRecorded, Pipeline, PipelineProgress, TakeAccount, TakeFailed, TakeOutput,
        check_disk_space,
    },
    rig::{ReadOptions, ReaderOutcome, Rig},
    setting::Setting,
};

/// What to record, and how to report progress.
#[expect(missing_debug_implementations, reason = "closures have none")]
pub struct RecordOptions<'a> {
    /// Path of the take. The file has its final name from the first byte. A divided recording does not use it: its
    /// names are in [`SeriesOptions`](crate::series::SeriesOptions).
    pub take: &'a Path,
    /// Resampler and tolerance.
    pub codec: Settings,
    /// The captured subject.
    pub subject: Option<&'a Subject>,
    /// Length of the take; `None` records until the replay ends or `stop` is set.
    pub length: Option<Duration>,
    /// Bytes of the disk to leave free: the take is closed when it would need them.
    pub keep_free_bytes: u64,
    /// Set to stop recording.
    pub stop: &'a AtomicBool,
    /// Receives messages for the user while the recording runs.
    pub notify: &'a dyn Fn(&str),
    /// How the user can stop, appended to messages that say that the recording waits; may be empty.
    pub how_to_end: &'a str,
    /// Formats advice on the setting that an error names.
    pub how_to_set: fn(Setting) -> String,
    /// Called once the pipeline runs, with its live counters.
    pub started: &'a mut dyn FnMut(&Arc<PipelineProgress>),
}

impl RecordOptions<'_> {
    /// What the reader needs of them.
    pub(crate) fn read_options(&self, rate_hz: f64) -> ReadOptions<'_> {
        ReadOptions {
            stop: self.stop,
            rows_max: self.length.map(|length| frame_at(length, rate_hz)),
            length: self.length,
            single_take: true,
            notify: self.notify,
            how_to_end: self.how_to_end,
            how_to_set: self.how_to_set,
        }
    }
}

/// A finished recording.
#[derive(Debug)]
pub struct Recorded {
    /// What is on disk.
    pub written: TakeAccount,
    /// What the reader counted.
    pub recording: ReaderOutcome,
    /// Where the take file is now.
    pub file: SettledFile,
    /// Rows per second.
    pub rate_hz: f64,
    /// Markers announced at the start.
    pub markers: usize,
}

/// Records until the device ends, the length is reached, or `stop` is set.
///
/// # Errors
/// When nothing was recorded (the empty take file is removed then), or the take could not be written to its end.
pub fn record(rig: Rig, options: &mut RecordOptions<'_>) -> anyhow::Result<Recorded> {
    check_disk_space(options.take, options.keep_free_bytes)?;
    let config = rig.pipeline_config(options.codec);
    let header = rig.take_header(&config)?;
    let (rate_hz, markers) = (config.rate_hz, config.channels.len());

    let file = TakeFile::create(options.take)?;
    let id = file.id();
    let take = NewTake {
        subject: options.subject.cloned().map(Arc::new),
        keep_free_bytes: options.keep_free_bytes,
        ..NewTake::new(file, header)
    };
    let opened = Pipeline::start(&config, take);
    let outcome = opened.map(|(intake, pipeline)| {
        (options.started)(pipeline.progress());
        let recording = rig.read(intake, &options.read_options(rate_hz));
        (recording, pipeline.finish())
    });
    let name = options.take.display();
    // A take without a frame is useless.
    let remove_empty = |error: anyhow::Error| match id.remove(options.take) {
        Ok(()) => error,
        Err(e) => error.context(format!("cannot remove the empty file {name} ({e})")),
    };
    let is_empty = |failed: &TakeFailed| failed.error.is::<NothingRecorded>();
    match outcome {
        Err(error) => Err(remove_empty(error)),
        Ok((Err(error), written)) => Err(match written {
            Ok((written, _)) if written.ledger.recorded == 0 => remove_empty(error),
            Ok((_, mut file)) => explain_early_end(options.take, error, Some(&mut *file)),
            Err(failed) if is_empty(&failed) => remove_empty(error),
            Err(mut failed) => explain_early_end(options.take, error, failed.output.as_deref_mut()),
        }),
        Ok((Ok(_), Err(failed))) if is_empty(&failed) => Err(remove_empty(failed.error)),
        Ok((Ok(_), Err(mut failed))) => {
            Err(explain_early_end(options.take, failed.error, failed.output.as_deref_mut()))
        }
        Ok((Ok(recording), Ok((written, mut file)))) => {
            if written.ledger.recorded == 0 {
                return Err(remove_empty(nothing_recorded(recording.ending)));
            }
            Ok(Recorded { written, recording, file: file.settle(), rate_hz, markers })
        }
    }
}

/// The error of a recording that ended before its first frame.
pub(crate) fn nothing_recorded(ending: EndingKind) -> anyhow::Error {
    let why = match ending {
        EndingKind::DeviceGone => "the device was disconnected before its first frame",
        EndingKind::DiskFull => "the disk is full: free some space",
        EndingKind::Stopped | EndingKind::Length => {
            "the recording was stopped before the first frame arrived"
        }
        _ => "the device sent no frame: check that it is capturing",
    };
    anyhow!("nothing was recorded: {why}")
}

/// Adds to an error where the unfinished take is, and saves a copy if the file was removed.
pub(crate) fn explain_early_end(
    take: &Path,
    error: anyhow::Error,
    file: Option<&mut (dyn TakeOutput + 'static)>,
) -> anyhow::Error {
    let take = take.display();
    let settled = file.map(TakeOutput::settle);
    let text = match settled.as_ref().and_then(SettledFile::message) {
        Some(what) => format!("the take {take} ends early; {what}"),
        None if settled.is_some_and(|file| file.state == FileState::InPlace) => {
            format!("the take {take} ends early; what was recorded can be read")
        }
        None => format!("the take {take} ends early"),
    };
    error.context(text)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn a_take_that_was_removed_is_saved_when_the_device_fails() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.take");
        let mut file = TakeFile::create(&path).unwrap();
        file.write_all(b"frames").unwrap();
        let error = || anyhow!("the device fails");
        let lost = explain_early_end(&path, error(), None).to_string();
        let message = explain_early_end(&path, error(), Some(&mut file)).to_string();
        assert!(message.contains("a.take") && lost.contains("a.take"), "{message}; {lost}");
        assert_ne!(message, lost, "what is in its place can be read");
        std::fs::remove_file(&path).unwrap();
        let message = explain_early_end(&path, error(), Some(&mut file)).to_string();
        let saved = dir.path().join("a.saved.take");
        assert!(message.contains("a.saved.take"), "{message}");
        assert_eq!(std::fs::read(saved).unwrap(), b"frames");
    }
}
