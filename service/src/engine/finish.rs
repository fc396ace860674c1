//! Closes takes and reports how they ended.

use std::path::Path;

use mocapd_acquire::{
    files::{FileState, SettledFile},
    pipeline::{NothingRecorded, TakeAccount, TakeFailed, TakeOutput, TakeResult},
};
use mocapd_take::record::EndingKind;

use super::{
    Inner,
    folder::summary_of,
    session::{Core, KEPT_OPEN_MAX, NamedTake},
};
use crate::{
    control::{Refusal, RefusalKind, Stopped},
    status::{ServiceEventKind, TakeSummary},
};

impl Inner {
    /// Closes the current take, or reports that it could not be closed.
    pub(super) fn finish_take(&self, end: TakeResult) -> Result<Stopped, Refusal> {
        let mut core = self.core();
        let Some(take) = core.take.take() else {
            return Err(Refusal::conflict("the take has already been stopped: check the status"));
        };
        let _closing = self.closing(&mut core);
        // While this take is being closed, clients must not mistake the previous one for it.
        let before = core.last_take.take();
        drop(core);
        self.changed.notify_all();
        let closed = self.closed(end, &take.named, take.rate_hz);
        // If the take left no file, the previous one is still the last.
        let mut core = self.core();
        if core.last_take.is_none() {
            core.last_take = before;
        }
        drop(core);
        closed
    }

    /// Handles a take whose end will not be reported: the pipeline ended before the take began, or its writer died.
    pub(super) fn finish_unanswered(&self) -> Result<Stopped, Refusal> {
        let path = self.core().take.as_ref().map(|take| take.named.path.clone());
        let is_empty = path.and_then(|path| path.metadata().ok()).is_some_and(|f| f.len() == 0);
        if !is_empty {
            let error = anyhow::anyhow!("the writer thread has ended");
            return self.finish_take(Err(TakeFailed::without_output(error)));
        }
        if let Some(take) = self.core().take.take() {
            take.named.discard();
        }
        Err(Refusal::device("the device disconnected before the take began: try again"))
    }

    /// Handles the end of a take: written completely, or failed.
    pub(super) fn closed(
        &self,
        end: TakeResult,
        take: &NamedTake,
        rate_hz: f64,
    ) -> Result<Stopped, Refusal> {
        let (written, mut output) = end.map_err(|failed| self.write_failed(failed, take))?;
        if written.ledger.recorded == 0 {
            return Err(self.discard_empty(written.ending.kind, take));
        }
        let name = &take.name;
        let settled = output.settle();
        if let Some(message) = settled.message() {
            self.publish(ServiceEventKind::Warning, &message, Some(name));
        }
        let stopped = stopped(&written, take, &settled, rate_hz);
        self.remember(&written, &settled, &stopped);
        if settled.path.is_none() {
            return Err(self.vanished(name, &settled, output));
        }
        let ending = written.ending.kind;
        // The ledger counts what was written, which the truncated file no longer contains.
        let lost = if ending == EndingKind::Truncated || settled.state == FileState::Truncated {
            "all frames after the cut are lost: `mocapd recover` keeps those before it".to_owned()
        } else {
            format!("{} frames lost", written.ledger.frames_lost())
        };
        let Stopped { name: name_now, seconds, bytes, .. } = &stopped;
        let message =
            format!("{name_now} closed ({ending}): {seconds:.3} s, {bytes} bytes, {lost}");
        let kind = match ending {
            EndingKind::Saved => ServiceEventKind::TakeSaved,
            _ => ServiceEventKind::TakeStopped,
        };
        self.publish(kind, &message, Some(name));
        if ending == EndingKind::DiskFull {
            let message = "the disk is full: delete something before starting another take";
            self.publish(ServiceEventKind::Warning, message, None);
        }
        Ok(stopped)
    }

    /// Removes a take that has only a header.
    fn discard_empty(&self, ending: EndingKind, take: &NamedTake) -> Refusal {
        take.discard();
        if ending == EndingKind::Saved {
            return Refusal::conflict("no frames are held for that time: ask for more seconds");
        }
        let name = &take.name;
        let message =
            format!("no frame arrived, so there is no take {name}: is the device capturing?");
        self.publish(ServiceEventKind::Warning, &message, Some(name));
        Refusal::device(message)
    }

    /// Stores the take as the last one in the status.
    fn remember(&self, written: &TakeAccount, settled: &SettledFile, stopped: &Stopped) {
        let ending = &written.ending;
        // The same summary as in the list; if no name leads to the file, the data of the writer.
        let listed = settled.path.as_deref().and_then(summary_of);
        let mut summary = listed.unwrap_or_else(|| TakeSummary {
            name: stopped.name.clone(),
            bytes: written.file_bytes,
            modified_unix_ms: super::session::unix_ms(),
            seconds: stopped.seconds,
            markers: self.core().device.markers,
            take_id: stopped.take_id.clone(),
            ..TakeSummary::default()
        });
        // A truncated file cannot store its ending.
        summary.ending = Some(ending.kind);
        summary.ending_detail.clone_from(&ending.detail);
        let has_lost = settled.path.is_none()
            || settled.state.ends_take()
            || matches!(ending.kind, EndingKind::Truncated | EndingKind::Unmounted);
        let lost = || {
            let ended = || format!("the take {} has ended ({})", stopped.name, ending.kind);
            settled.message().unwrap_or_else(ended)
        };
        let mut core = self.core();
        core.last_take = Some(summary);
        core.data_lost = has_lost.then(lost);
    }

    /// The take has ended, but its file has no name any more.
    fn vanished(&self, name: &str, settled: &SettledFile, file: Box<dyn TakeOutput>) -> Refusal {
        let message = self.keep_open(settled, file);
        let mut core = self.core();
        core.failure = Some(message.clone());
        core.data_lost = Some(message.clone());
        drop(core);
        self.changed.notify_all();
        self.publish(ServiceEventKind::Failure, &message, Some(name));
        Refusal::new(RefusalKind::Vanished, message)
    }

    /// Keeps a file without a name open if that helps, and returns the message about it.
    fn keep_open(&self, settled: &SettledFile, file: Box<dyn TakeOutput>) -> String {
        let message = settled.message().unwrap_or_default();
        // An unmounted file system waits for the file to be closed.
        let displaced = settled.displaced.as_ref();
        let Some(displaced) = displaced.filter(|_| settled.state != FileState::Unmounted) else {
            return message;
        };
        let mut core = self.core();
        let is_full = core.kept_open.len() == KEPT_OPEN_MAX;
        let oldest = is_full.then(|| core.kept_open.remove(0));
        core.kept_open.push(file);
        drop(core);
        if let Some(oldest) = oldest {
            let left = oldest.displaced().map(|oldest| oldest.created_as.display().to_string());
            let message = format!(
                "{KEPT_OPEN_MAX} removed takes are already kept open: giving up the oldest, {}",
                left.unwrap_or_default()
            );
            // Closing a large file without a name takes time.
            drop(oldest);
            self.publish(ServiceEventKind::Warning, &message, None);
        }
        let open_at = displaced.open_at.display();
        format!(
            "{message}; it stays open until the next take has begun or the service stops: cp {open_at} NEW.take"
        )
    }

    /// Handles a take that could not be completed. What was written of it is kept.
    fn write_failed(&self, failed: TakeFailed, take: &NamedTake) -> Refusal {
        let NamedTake { name, path, file, .. } = take;
        let TakeFailed { error, output } = failed;
        let message = if error.is::<NothingRecorded>() {
            let left = match file.remove(path) {
                Ok(()) => format!("there is no take {name}"),
                Err(e) => format!("cannot remove the empty file {} ({e})", path.display()),
            };
            format!("{error:#}: {left}; check the disk, and try again")
        } else {
            format!("the take {name} ended early: {error:#}; {}", self.remains(output))
        };
        let mut core = self.core();
        core.failure = Some(message.clone());
        // The pipeline continues without a take, and writes the keys that the pre-roll needs. A failed save does not
        // affect the take in progress.
        if core.take.is_none()
            && let Some(session) = &mut core.session
        {
            session.takes.end(EndingKind::CutOff).ok();
        }
        drop(core);
        self.changed.notify_all();
        self.publish(ServiceEventKind::Failure, &message, Some(name));
        Refusal::new(RefusalKind::Disk, message)
    }

    /// States what remains of a take that could not be completed, and where.
    fn remains(&self, output: Option<Box<dyn TakeOutput>>) -> String {
        let recover = "`mocapd recover` writes a complete take from it";
        let Some(mut file) = output else { return recover.to_owned() };
        let settled = file.settle();
        match (settled.message(), &settled.path) {
            (None, _) => format!("its content can be read, and {recover}"),
            (Some(message), Some(_)) => format!("{message}, and {recover}"),
            (Some(_), None) => self.keep_open(&settled, file),
        }
    }

    /// Keeps the service from ending until the returned guard is dropped: a removed take is being copied.
    pub(super) fn closing(&self, core: &mut Core) -> Closing<'_> {
        core.closing += 1;
        Closing(self)
    }
}

/// Counts a take as being closed until it is dropped.
pub(super) struct Closing<'a>(&'a Inner);

impl Drop for Closing<'_> {
    fn drop(&mut self) {
        self.0.core().closing -= 1;
        self.0.changed.notify_all();
    }
}

fn stopped(written: &TakeAccount, take: &NamedTake, file: &SettledFile, rate_hz: f64) -> Stopped {
    let ledger = &written.ledger;
    let rows = ledger.recorded + ledger.frames_lost();
    // The reply has the current name, under which the take can be requested. Events have the name it started with.
    let stem = file.path.as_deref().and_then(Path::file_stem);
    Stopped {
        take_id: take.id.clone(),
        name: stem.map_or(take.name.clone(), |stem| stem.to_string_lossy().into_owned()),
        path: file.path.clone().unwrap_or_default(),
        file: file.state,
        rows,
        seconds: rows as f64 / rate_hz,
        bytes: written.file_bytes,
        ending: Some(written.ending.kind),
        ledger: ledger.into(),
        short_by_s: 0.0,
        remarks: file.message().into_iter().collect(),
    }
}

#[cfg(test)]
mod tests {
    use std::{
        io::{self, Write},
        sync::{Arc, Mutex},
        time::{Duration, Instant},
    };

    use mocapd_codec::{ResamplerKind, Settings, Tolerance};

    use super::{
        super::{Engine, EngineOptions, session::OpenTake},
        *,
    };
    use crate::config::{
        ArchiveConfig, ArmConfig, DeviceChoice, DeviceConfig, NameTemplate, TakeConfig,
    };
    use mocapd_acquire::{
        files::{FileId, TakeFile},
        threads::Heartbeat,
    };

    /// An engine without a device.
    fn engine(directory: &Path) -> Engine {
        let options = EngineOptions {
            rig: "test".to_owned(),
            device: DeviceConfig {
                uri: DeviceChoice::At("serial:/nowhere".parse().unwrap()),
                ..DeviceConfig::default()
            },
            take: TakeConfig {
                directory: directory.to_owned(),
                name: NameTemplate::parse("take-{count}").unwrap(),
                codec: Settings {
                    kind: ResamplerKind::Dense,
                    tolerance: Tolerance::from_mm(1.0).unwrap(),
                },
                angle_degrees: None,
                residuals: false,
                up_axis: mocapd_take::motion::UpAxis::Unknown,
                stretch: Duration::from_millis(500),
                sync: Duration::from_millis(500),
                keep_free_bytes: 0,
                reconnect: Duration::ZERO,
                max_length: None,
                trash_keep: Duration::from_secs(3600),
            },
            subject: None,
            arm: ArmConfig { memory_max_bytes: 1 << 20, ..ArmConfig::default() },
            archive: ArchiveConfig::default(),
            publishers: Vec::new(),
        };
        Engine::start(options, &Heartbeat::default()).unwrap()
    }

    #[test]
    fn the_service_does_not_end_while_a_take_is_copied() {
        let dir = tempfile::tempdir().unwrap();
        let engine = engine(dir.path());
        let mut core = engine.inner.core();
        let closing = engine.inner.closing(&mut core);
        drop(core);
        std::thread::scope(|scope| {
            let stopped = scope.spawn(|| engine.stop_service());
            std::thread::sleep(Duration::from_millis(200));
            assert!(!stopped.is_finished());
            drop(closing);
        });
        assert_eq!(engine.inner.core().closing, 0);
    }

    #[test]
    fn a_few_removed_takes_are_kept_open() {
        let dir = tempfile::tempdir().unwrap();
        let engine = engine(dir.path());
        let mut places = Vec::new();
        for number in 0..=KEPT_OPEN_MAX {
            let folder = dir.path().join(number.to_string());
            std::fs::create_dir(&folder).unwrap();
            let mut file = TakeFile::create(&folder.join("a.take")).unwrap();
            std::fs::remove_dir_all(&folder).unwrap();
            let settled = file.settle();
            assert_eq!((settled.state, &settled.path), (FileState::Removed, &None));
            places.push(settled.displaced.as_ref().unwrap().created_as.clone());
            let refusal = engine.inner.vanished("a", &settled, Box::new(file));
            assert_eq!(refusal.kind, RefusalKind::Vanished);
        }
        let core = engine.inner.core();
        let kept = core.kept_open.iter().map(|file| file.displaced().unwrap().created_as);
        assert_eq!(kept.collect::<Vec<_>>(), places[1..], "the oldest is given up");
        drop(core);
    }

    /// Records the last take in the status while this one is being closed.
    struct SeenWhileClosing(Arc<Inner>, Arc<Mutex<Option<TakeSummary>>>);

    impl Write for SeenWhileClosing {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl TakeOutput for SeenWhileClosing {
        fn sync(&mut self) -> io::Result<()> {
            Ok(())
        }

        fn settle(&mut self) -> SettledFile {
            self.1.lock().unwrap().clone_from(&self.0.core().last_take);
            let path = Some("now.take".into());
            SettledFile { path, ..SettledFile::default() }
        }
    }

    #[test]
    fn a_closing_take_is_not_reported_as_the_previous_one() {
        let dir = tempfile::tempdir().unwrap();
        let engine = engine(dir.path());
        let seen = Arc::new(Mutex::new(Some(TakeSummary::default())));
        let begin = || {
            let mut core = engine.inner.core();
            core.last_take =
                Some(TakeSummary { name: "before".to_owned(), ..TakeSummary::default() });
            core.take = Some(OpenTake {
                named: NamedTake {
                    id: String::new(),
                    name: "now".to_owned(),
                    path: dir.path().join("now.take"),
                    file: FileId::of(&dir.path().metadata().unwrap()),
                },
                requested_unix_ms: 0,
                begun: Instant::now(),
                rate_hz: 100.0,
                length: None,
                first: None,
                ended: crossbeam_channel::never(),
                changes_reported: 0,
                ending: None,
            });
        };
        let end = |recorded| {
            let mut written = TakeAccount::default();
            written.ledger.recorded = recorded;
            let output = SeenWhileClosing(Arc::clone(&engine.inner), Arc::clone(&seen));
            engine.inner.finish_take(Ok((written, Box::new(output))))
        };
        let last_take = || engine.inner.core().last_take.clone().unwrap().name;

        begin();
        end(0).unwrap_err();
        assert_eq!(last_take(), "before", "nothing came of the one that ended");

        begin();
        end(1).unwrap();
        assert!(seen.lock().unwrap().is_none());
        assert_eq!(last_take(), "now");
    }
}
