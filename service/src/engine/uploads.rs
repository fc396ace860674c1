//! Uploads finished takes to object storage, on its own thread at the lowest priority and at a limited rate, so that it does not
//! disturb a recording.
//!
//! What was uploaded is in a file beside the takes, so that a restart continues. An upload can be repeated at any time: an
//! object of the same name and content counts as done. Errors are retried, less and less often.

mod uploaded;

#[cfg(test)]
mod tests;

use std::{
    collections::{HashMap, HashSet},
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use mocapd_acquire::{files, ledger::TakeHealth, pipeline::lock};
use mocapd_store::{ObjectUrl, Store, StoreError};

pub(super) use self::uploaded::restore_set_aside;
use self::uploaded::{Journal, JournalEntry, check_apart};
use super::{Inner, session::unix_ms};
use crate::{
    config::ArchiveConfig,
    process,
    status::{ArchiveStatus, ServiceEventKind, TakeSummary, TakeUpload, UploadState},
};

/// Newest takes of the folder that are uploaded: as many summaries are cached.
const TAKES_MAX: usize = 4000;

/// Time between two looks at the folder.
const SCAN_INTERVAL: Duration = Duration::from_secs(5);

/// Wait after the first failure; each further one doubles it.
const RETRY_MIN: Duration = Duration::from_secs(5);

/// Longest wait between two attempts: a store that comes back is found within minutes.
const RETRY_MAX: Duration = Duration::from_secs(600);

/// Interval at which a paused upload checks whether the service stops.
const PAUSE_STEP: Duration = Duration::from_millis(100);

/// The same between two looks at the folder: an idle service should wake rarely.
const IDLE_STEP: Duration = Duration::from_millis(500);

/// The states of uploads, for the list of takes and the status.
#[derive(Debug, Default)]
pub(super) struct Uploads {
    /// By name of the take.
    states: Mutex<HashMap<String, TakeUpload>>,
    /// Why nothing can be uploaded at present.
    error: Mutex<Option<String>>,
    sent_bytes: AtomicU64,
    retries: AtomicU64,
}

impl Uploads {
    /// Adds the state of its upload to each take.
    pub(super) fn complete(&self, takes: &mut [TakeSummary]) {
        let states = lock(&self.states);
        for take in takes {
            take.upload = states.get(&take.name).cloned();
        }
    }

    /// The figures of the status; `None` without an archive.
    pub(super) fn status(&self, config: &ArchiveConfig) -> Option<ArchiveStatus> {
        let url = config.url.as_ref()?;
        let states = lock(&self.states);
        let count = |wanted: UploadState| {
            states.values().filter(|upload| upload.state == wanted).count() as u64
        };
        Some(ArchiveStatus {
            url: url.to_string(),
            waiting: count(UploadState::Waiting) + count(UploadState::Uploading),
            uploaded: count(UploadState::Uploaded),
            failed: count(UploadState::Failed),
            sent_bytes: self.sent_bytes.load(Ordering::Relaxed),
            retries: self.retries.load(Ordering::Relaxed),
            error: lock(&self.error).clone(),
        })
    }

    /// Forgets what is known of another archive.
    fn forget(&self) {
        lock(&self.states).clear();
        *lock(&self.error) = None;
    }

    /// Forgets a take that has left the folder.
    pub(super) fn forget_take(&self, name: &str) {
        lock(&self.states).remove(name);
    }

    fn set(&self, name: &str, state: UploadState, url: &ObjectUrl, message: String) {
        let upload = TakeUpload { state, url: url.to_string(), message };
        lock(&self.states).insert(name.to_owned(), upload);
    }
}

/// When to try again.
#[derive(Debug, Clone, Copy)]
struct Retry {
    at: Instant,
    delay: Duration,
}

impl Retry {
    fn after(before: Option<Self>) -> Self {
        let delay = before.map_or(RETRY_MIN, |before| (2 * before.delay).min(RETRY_MAX));
        Self { at: Instant::now() + delay, delay }
    }
}

/// The state of the thread.
#[derive(Debug, Default)]
struct Uploader {
    /// The folder and the archive that the rest is about.
    of: Option<(PathBuf, ObjectUrl)>,
    journal: Journal,
    /// Whether the store can be asked again.
    store_retry: Option<Retry>,
    /// Takes whose upload or removal failed for a reason of their own.
    take_retries: HashMap<String, Retry>,
    /// Takes whose objects disappeared.
    gone: HashSet<String>,
}

/// The ids of takes that were uploaded from a folder and removed there: they need no recovery.
pub(super) fn removed_ids(directory: &Path) -> HashSet<String> {
    Journal::read(directory).removed_ids()
}

/// Notes that a take was renamed: its object keeps its name, also after a restart. Returns a remark about it. The caller
/// keeps names from changing.
pub(super) fn note_rename(inner: &Inner, directory: &Path, from: &str, to: &str) -> Option<String> {
    let mut states = lock(&inner.uploads.states);
    states.remove(to);
    if let Some(state) = states.remove(from) {
        states.insert(to.to_owned(), state);
    }
    drop(states);
    let mut journal = Journal::read(directory);
    let url = journal.rename(from, to)?;
    // If it cannot be stored, the take is uploaded once more after a restart.
    journal.write(directory).ok();
    Some(format!("the archive keeps it as {url}"))
}

/// Whether an error is that of one take: others can be uploaded meanwhile.
fn is_of_take(error: &StoreError) -> bool {
    matches!(
        error,
        StoreError::Exists(_)
            | StoreError::NotFound(_)
            | StoreError::Changed(_)
            | StoreError::Source(_)
            | StoreError::InvalidUrl { .. }
            | StoreError::Unsupported { .. }
    )
}

/// Uploads takes until the service stops.
pub(super) fn run(inner: &Arc<Inner>) {
    process::lower_thread_priority();
    let mut uploader = Uploader::default();
    while !inner.is_stopping() {
        let options = Arc::clone(&inner.core().options);
        let has_more = match &options.archive.url {
            Some(url) => uploader.step(inner, url, &options.archive, &options.take.directory),
            None => {
                uploader = Uploader::default();
                inner.uploads.forget();
                inner.forget_renames();
                false
            }
        };
        let until = Instant::now() + SCAN_INTERVAL;
        while !has_more && Instant::now() < until && !inner.is_stopping() {
            std::thread::sleep(IDLE_STEP);
        }
    }
}

impl Uploader {
    /// Uploads or removes one take. Returns whether there may be more to do.
    fn step(
        &mut self,
        inner: &Inner,
        url: &ObjectUrl,
        config: &ArchiveConfig,
        directory: &Path,
    ) -> bool {
        let of = (directory.to_owned(), url.clone());
        if self.of.as_ref() != Some(&of) {
            *self = Self { of: Some(of), journal: Journal::read(directory), ..Self::default() };
            inner.uploads.forget();
            restore_set_aside(inner, directory);
        }
        let changes = inner.claims.changes();
        let listed = inner.list_takes(TAKES_MAX);
        // A name has changed meanwhile: look again.
        let Some(renamed) = inner.claims.renames_up_to(changes) else { return true };
        for (from, to) in &renamed {
            self.journal.rename(from, to);
        }
        if !renamed.is_empty() {
            self.save_journal(inner);
        }
        let Ok(takes) = listed else { return false };
        self.forget_missing(inner, &takes);
        let next = self.next(inner, &takes, url);
        if self.store_retry.is_some_and(|retry| retry.at > Instant::now()) {
            return false;
        }
        match next {
            Some((take, object)) => self.upload(inner, take, (directory, &object), config),
            None => self.remove_local(inner, &takes, url, config),
        }
    }

    /// The oldest take to upload. Notes the states of all.
    fn next<'a>(
        &self,
        inner: &Inner,
        takes: &'a [TakeSummary],
        url: &ObjectUrl,
    ) -> Option<(&'a TakeSummary, ObjectUrl)> {
        let mut next = None;
        for take in takes.iter().rev().filter(|take| !take.is_open) {
            let object = url.join(&format!("{}.take", take.name));
            match take.health {
                TakeHealth::Complete | TakeHealth::Lossy => {}
                // Of one whose health is unknown the file could not be read.
                TakeHealth::Damaged | TakeHealth::Unreadable | TakeHealth::Unknown => {
                    refuse(inner, take, &object);
                    continue;
                }
                // It is uploaded once it is recovered.
                TakeHealth::CutOff => continue,
            }
            if let Some(uploaded) = self.journal.object(take, &object) {
                inner.uploads.set(&take.name, UploadState::Uploaded, &uploaded, String::new());
            } else if let Some(retry) = self.take_retries.get(&take.name) {
                next = next.or((retry.at <= Instant::now()).then_some((take, object)));
            } else {
                let known = lock(&inner.uploads.states).contains_key(&take.name);
                if !known {
                    inner.uploads.set(&take.name, UploadState::Waiting, &object, String::new());
                }
                next = next.or(Some((take, object)));
            }
        }
        next
    }

    /// Forgets takes that are no longer in the folder, or not among its newest.
    fn forget_missing(&mut self, inner: &Inner, takes: &[TakeSummary]) {
        self.journal.forget_missing(takes, takes.len() < TAKES_MAX);
        let names: HashSet<&str> = takes.iter().map(|take| take.name.as_str()).collect();
        self.take_retries.retain(|name, _| names.contains(name.as_str()));
        self.gone.retain(|name| names.contains(name.as_str()));
        lock(&inner.uploads.states).retain(|name, _| names.contains(name.as_str()));
    }

    fn upload(
        &mut self,
        inner: &Inner,
        take: &TakeSummary,
        (directory, object): (&Path, &ObjectUrl),
        config: &ArchiveConfig,
    ) -> bool {
        let name = &take.name;
        // It is being renamed or trashed: it is looked at again.
        let Some(_claim) = inner.claims.claim(name, "uploaded") else { return false };
        inner.uploads.set(name, UploadState::Uploading, object, String::new());
        let sent = || -> Result<bool, StoreError> {
            let unreadable = |error: String| StoreError::Source(error);
            let path = directory.join(format!("{name}.take"));
            check_apart(&path, object)?;
            let mut file = files::open(&path).map_err(|error| unreadable(format!("{error:#}")))?;
            let mut pace = Pace::new(inner, (directory, object), config);
            Store::of(object)?.upload(object, &mut file, &mut |n| pace.wait(n, true))
        };
        match sent() {
            Ok(is_new) => {
                self.succeeded(inner, name);
                self.journal.insert(name, JournalEntry::of(take, object, unix_ms()));
                self.save_journal(inner);
                inner.uploads.set(name, UploadState::Uploaded, object, String::new());
                let how = if is_new { "uploaded to" } else { "was in the archive already:" };
                inner.publish(
                    ServiceEventKind::State,
                    &format!("{name} {how} {object}"),
                    Some(name),
                );
                true
            }
            Err(StoreError::Stopped(_)) => false,
            Err(error) => self.failed(inner, name, object, &error),
        }
    }

    fn succeeded(&mut self, inner: &Inner, name: &str) {
        self.take_retries.remove(name);
        self.store_retry = None;
        *lock(&inner.uploads.error) = None;
    }

    /// Notes a failure. Returns whether another take can be tried.
    fn failed(&mut self, inner: &Inner, name: &str, url: &ObjectUrl, error: &StoreError) -> bool {
        inner.uploads.retries.fetch_add(1, Ordering::Relaxed);
        let message = error.to_string();
        if is_of_take(error) {
            let retry = Retry::after(self.take_retries.get(name).copied());
            let is_known = self.take_retries.insert(name.to_owned(), retry).is_some();
            inner.uploads.set(name, UploadState::Failed, url, message.clone());
            if !is_known {
                let message = format!("{name} cannot be uploaded: {message}; retrying");
                inner.publish(ServiceEventKind::Warning, &message, Some(name));
            }
            return true;
        }
        self.store_retry = Some(Retry::after(self.store_retry));
        // A take that failed for a reason of its own has not got rid of it.
        let has_own_reason = self.take_retries.contains_key(name);
        let state = if has_own_reason { UploadState::Failed } else { UploadState::Waiting };
        inner.uploads.set(name, state, url, message.clone());
        let before = lock(&inner.uploads.error).replace(message.clone());
        if before.is_none() {
            let message = format!("takes cannot be uploaded: {message}; retrying");
            inner.publish(ServiceEventKind::Warning, &message, None);
        }
        false
    }

    fn save_journal(&self, inner: &Inner) {
        let Some((directory, _)) = &self.of else { return };
        if let Err(error) = self.journal.write(directory) {
            let message = format!(
                "cannot store what was uploaded ({error:#}): after a restart, takes are compared with the archive again"
            );
            inner.publish(ServiceEventKind::Warning, &message, None);
        }
    }
}

/// States that a take is not uploaded because of its condition.
fn refuse(inner: &Inner, take: &TakeSummary, object: &ObjectUrl) {
    let health = take.health.name();
    let message = format!(
        "the take is {health} and is not uploaded: check it with mocapd verify, then recover it or copy it yourself"
    );
    let state = |states: &HashMap<String, TakeUpload>| states.get(&take.name).map(|it| it.state);
    let is_known = state(&lock(&inner.uploads.states)) == Some(UploadState::Failed);
    inner.uploads.set(&take.name, UploadState::Failed, object, message);
    if !is_known {
        let message =
            format!("{} is {health} and is not uploaded: check it with mocapd verify", take.name);
        inner.publish(ServiceEventKind::Warning, &message, Some(&take.name));
    }
}

/// Limits the rate of an upload or of reading back, by the configuration of the moment.
struct Pace<'a> {
    inner: &'a Inner,
    directory: &'a Path,
    object: &'a ObjectUrl,
    config: &'a ArchiveConfig,
    /// When what has passed is due at the rate. Time that was lost to a slow store is not made up for.
    due: Instant,
}

impl<'a> Pace<'a> {
    fn new(
        inner: &'a Inner,
        (directory, object): (&'a Path, &'a ObjectUrl),
        config: &'a ArchiveConfig,
    ) -> Self {
        Self { inner, directory, object, config, due: Instant::now() }
    }

    /// Waits until `n` more bytes may pass. Ends with the service, and where the configuration names another archive or
    /// folder, or no longer removes local copies as it did.
    fn wait(&mut self, n: usize, is_sent: bool) -> Result<(), StoreError> {
        self.due = self.due.max(Instant::now());
        let mut left_bytes = n as f64;
        while left_bytes > 0.0 {
            let options = Arc::clone(&self.inner.core().options);
            let now = &options.archive;
            if self.inner.is_stopping()
                || now.url != self.config.url
                || now.remove_local_after != self.config.remove_local_after
                || options.take.directory != self.directory
            {
                return Err(StoreError::Stopped(self.object.to_string()));
            }
            let bytes_per_s = now.rate_max_bytes_per_s.max(1) as f64;
            let step_bytes = left_bytes.min(bytes_per_s * PAUSE_STEP.as_secs_f64());
            self.due += Duration::from_secs_f64(step_bytes / bytes_per_s);
            left_bytes -= step_bytes;
            std::thread::sleep(self.due.saturating_duration_since(Instant::now()));
        }
        if is_sent {
            self.inner.uploads.sent_bytes.fetch_add(n as u64, Ordering::Relaxed);
        }
        Ok(())
    }
}
