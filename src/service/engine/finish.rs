//! What a take came to.

use std::path::Path;

use mocapd_take::record::EndingKind;

use super::Inner;
use crate::{
    files::{FileId, FileState, Settled, TakeFile},
    health::TakeHealth,
    pipeline::{NothingRecorded, TakeEnd, Written},
    service::{
        control::{Refusal, RefusalKind, Stopped},
        status::TakeSummary,
    },
};

impl Inner {
    /// The take that was recorded is closed, or cannot be.
    pub(super) fn finish_take(&self, end: TakeEnd<TakeFile>) -> Result<Stopped, Refusal> {
        let Some(take) = self.core().take.take() else {
            let words = "the take was ended by somebody else: look at the status";
            return Err(Refusal::new(RefusalKind::Conflict, words));
        };
        self.changed.notify_all();
        self.closed(end, &take.id, &take.name, (&take.path, take.file), take.rate_hz)
    }

    /// Nobody will tell what became of the take: the pipeline ended before it was begun there, or its writer is gone.
    pub(super) fn finish_unanswered(&self) -> Result<Stopped, Refusal> {
        let path = self.core().take.as_ref().map(|take| take.path.clone());
        let is_empty = path.and_then(|path| path.metadata().ok()).is_some_and(|f| f.len() == 0);
        if !is_empty {
            return self.finish_take(Err(anyhow::anyhow!("the writer is gone")));
        }
        let take = self.core().take.take();
        if let Some(take) = take {
            take.file.remove(&take.path).ok();
        }
        let words = "the device went away before the take began: try again";
        Err(Refusal::new(RefusalKind::Device, words))
    }

    pub(super) fn closed(
        &self,
        end: TakeEnd<TakeFile>,
        take_id: &str,
        name: &str,
        (path, file): (&Path, FileId),
        rate_hz: f64,
    ) -> Result<Stopped, Refusal> {
        let (written, mut output) = match end {
            Ok(end) => end,
            Err(error) => return Err(self.broken(&error, name, (path, file))),
        };
        let ending = written.ending.kind;
        if written.ledger.recorded == 0 && ending == EndingKind::Saved {
            file.remove(path).ok();
            let words = "nothing of that time is held: the device was away or sent nothing; ask for more seconds";
            return Err(Refusal::new(RefusalKind::Conflict, words));
        }
        if written.ledger.recorded == 0 {
            // Only the header was written: an empty take helps nobody.
            file.remove(path).ok();
            let words =
                format!("no frame came, so there is no take {name}: is the device capturing?");
            self.say_event("warning", &words, Some(name));
            return Err(Refusal::new(RefusalKind::Device, words));
        }
        let settled = output.settle();
        if let Some(words) = settled.words() {
            self.say_event("warning", &words, Some(name));
        }
        // What it is called now is what it can be asked for by.
        let stem = settled.path.as_deref().and_then(Path::file_stem);
        let name = &stem.map_or(name.to_owned(), |stem| stem.to_string_lossy().into_owned());
        let stopped = stopped(&written, take_id, name, &settled, rate_hz);
        let summary = TakeSummary {
            name: name.to_owned(),
            bytes: written.file_bytes,
            modified_unix_ms: super::status::unix_ms(),
            is_open: false,
            health: match settled.state {
                _ if settled.path.is_none() => TakeHealth::Unknown,
                FileState::Truncated => TakeHealth::CutOff,
                _ => TakeHealth::of_closed(&written.ledger, Some(&written.ending)),
            },
            seconds: stopped.seconds,
            markers: self.core().device.markers,
            take_id: take_id.to_owned(),
            ending: ending.word().to_owned(),
            ending_detail: written.ending.detail.clone(),
        };
        self.core().last_take = Some(summary);
        if settled.path.is_none() {
            return Err(self.vanished(name, &settled, output));
        }
        let lost = written.ledger.frames_lost();
        let words = format!(
            "{name} is closed ({}): {:.1} s, {} bytes, {lost} frames lost",
            ending.word(),
            stopped.seconds,
            stopped.bytes
        );
        let kind = if ending == EndingKind::Saved { "take-saved" } else { "take-stopped" };
        self.say_event(kind, &words, Some(name));
        if ending == EndingKind::DiskFull {
            let words = "the disk is full: no take is begun before something is deleted";
            self.say_event("warning", words, None);
        }
        Ok(stopped)
    }

    /// The take has ended, and no name leads to its file.
    fn vanished(&self, name: &str, settled: &Settled, file: TakeFile) -> Refusal {
        let mut words = settled.words().unwrap_or_default();
        let mut core = self.core();
        // A file system that was unmounted waits for the file to be closed.
        if settled.state != FileState::Unmounted
            && let Some(displaced) = &settled.displaced
        {
            let open_at = displaced.open_at.display();
            words += &format!(
                "; it stays open until the next take begins or the service ends: cp {open_at} NEW.take"
            );
            core.kept_open = Some(file);
        }
        core.failure = Some(words.clone());
        drop(core);
        self.changed.notify_all();
        self.say_event("failure", &words, Some(name));
        Refusal::new(RefusalKind::Vanished, words)
    }

    /// The take could not be written to its end. What is in it stays.
    fn broken(&self, error: &anyhow::Error, name: &str, (path, file): (&Path, FileId)) -> Refusal {
        let words = if error.downcast_ref::<NothingRecorded>().is_some() {
            let left = match file.remove(path) {
                Ok(()) => format!("there is no take {name}"),
                Err(e) => format!("{} holds nothing and cannot be removed ({e})", path.display()),
            };
            format!("{error:#}: {left}; look at the disk, and try again")
        } else {
            format!(
                "the take {name} ends early: {error:#}; what is in it can be read, and `mocapd recover` closes it"
            )
        };
        let mut core = self.core();
        core.failure = Some(words.clone());
        // The pipeline goes on without a take, and its pre-roll with keys as often as that needs. A save that failed
        // leaves the take beside it alone.
        if core.take.is_none()
            && let Some(session) = &mut core.session
        {
            session.takes.end(EndingKind::CutOff).ok();
        }
        drop(core);
        self.changed.notify_all();
        self.say_event("failure", &words, Some(name));
        Refusal::new(RefusalKind::Disk, words)
    }
}

fn stopped(written: &Written, take_id: &str, name: &str, file: &Settled, rate_hz: f64) -> Stopped {
    let ledger = &written.ledger;
    let rows = ledger.recorded + ledger.frames_lost();
    Stopped {
        take_id: take_id.to_owned(),
        name: name.to_owned(),
        path: file.path.clone().unwrap_or_default(),
        file: file.state,
        rows,
        seconds: rows as f64 / rate_hz,
        bytes: written.file_bytes,
        ending: written.ending.kind.word().to_owned(),
        ledger: ledger.into(),
        short_by_s: 0.0,
        remarks: file.words().into_iter().collect(),
    }
}
