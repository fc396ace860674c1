//! Uploads finished takes to object storage, on a thread of its own at a limited rate, so that a recording does not notice.
//!
//! What was uploaded is in a file beside the takes, so that a restart continues. An upload can be repeated at any time: an
//! object of the same name and content counts as done. Errors are retried, less and less often.

use std::{
    collections::{BTreeMap, HashMap},
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use anyhow::Context;
use mocapd_acquire::{files, health::TakeHealth, pipeline::lock};
use mocapd_store::{ObjectUrl, Store, StoreError};
use serde::{Deserialize, Serialize};

use super::{Inner, status::unix_ms};
use crate::{
    config::ArchiveConfig,
    status::{ArchiveStatus, ServiceEventKind, TakeSummary, TakeUpload, UploadState},
};

/// The file that lists what was uploaded, in the takes' folder.
const JOURNAL: &str = ".mocapd-archive.json";

/// Longest journal that is read: twice the entries of [`TAKES_MAX`] takes, of at most 1 KiB each.
const JOURNAL_BYTES_MAX: usize = 8 << 20;

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

    fn set(&self, name: &str, state: UploadState, url: &ObjectUrl, message: String) {
        let upload = TakeUpload { state, url: url.to_string(), message };
        lock(&self.states).insert(name.to_owned(), upload);
    }
}

/// A take that was uploaded.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct JournalEntry {
    url: String,
    bytes: u64,
    modified_unix_ms: i64,
    uploaded_unix_ms: i64,
}

impl JournalEntry {
    fn is_of(&self, take: &TakeSummary, url: &ObjectUrl) -> bool {
        (self.bytes, self.modified_unix_ms) == (take.bytes, take.modified_unix_ms)
            && self.url == url.to_string()
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
    journal: BTreeMap<String, JournalEntry>,
    /// Whether the store can be asked again.
    store_retry: Option<Retry>,
    /// Takes whose upload failed for a reason of their own.
    take_retries: HashMap<String, Retry>,
}

/// Uploads takes until the service stops.
pub(super) fn run(inner: &Arc<Inner>) {
    let mut uploader = Uploader::default();
    while !inner.is_stopping() {
        let options = Arc::clone(&inner.core().options);
        let has_more = match &options.archive.url {
            Some(url) => uploader.step(inner, url, &options.archive, &options.take.directory),
            None => {
                uploader = Uploader::default();
                lock(&inner.uploads.states).clear();
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
            *self = Self { of: Some(of), journal: read_journal(directory), ..Self::default() };
            lock(&inner.uploads.states).clear();
        }
        let Ok(takes) = inner.list_takes(TAKES_MAX) else { return false };
        self.forget_missing(inner, &takes);
        let is_finished = |take: &&TakeSummary| {
            !take.is_open && matches!(take.health, TakeHealth::Complete | TakeHealth::Lossy)
        };
        let mut next = None;
        // The oldest is uploaded first.
        for take in takes.iter().rev().filter(is_finished) {
            let object = url.join(&format!("{}.take", take.name));
            if self.journal.get(&take.name).is_some_and(|entry| entry.is_of(take, &object)) {
                inner.uploads.set(&take.name, UploadState::Uploaded, &object, String::new());
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
        if self.store_retry.is_some_and(|retry| retry.at > Instant::now()) {
            return false;
        }
        match next {
            Some((take, object)) => self.upload(inner, take, &object, config),
            None => self.remove_local(inner, &takes, url, config),
        }
    }

    /// Forgets takes that are no longer in the folder.
    fn forget_missing(&mut self, inner: &Inner, takes: &[TakeSummary]) {
        let is_there = |name: &String| takes.iter().any(|take| take.name == *name);
        // Those beyond the list may still be there.
        if takes.len() < TAKES_MAX {
            self.journal.retain(|name, _| is_there(name));
            self.take_retries.retain(|name, _| is_there(name));
            lock(&inner.uploads.states).retain(|name, _| is_there(name));
        }
    }

    fn upload(
        &mut self,
        inner: &Inner,
        take: &TakeSummary,
        object: &ObjectUrl,
        config: &ArchiveConfig,
    ) -> bool {
        let name = &take.name;
        inner.uploads.set(name, UploadState::Uploading, object, String::new());
        let sent = || -> Result<bool, StoreError> {
            let unreadable = |error: String| StoreError::Source(error);
            let path = inner.path_of(name).map_err(|error| unreadable(error.message))?;
            let mut file = files::open(&path).map_err(|error| unreadable(format!("{error:#}")))?;
            let mut pace = Pace::new(inner, object, config.rate_max_bytes_per_s);
            Store::of(object)?.upload(object, &mut file, &mut |n| pace.wait(n, true))
        };
        match sent() {
            Ok(is_new) => {
                self.succeeded(inner, name);
                let entry = JournalEntry {
                    url: object.to_string(),
                    bytes: take.bytes,
                    modified_unix_ms: take.modified_unix_ms,
                    uploaded_unix_ms: unix_ms(),
                };
                self.journal.insert(name.clone(), entry);
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
        if self.store_retry.take().is_some() {
            *lock(&inner.uploads.error) = None;
        }
    }

    /// Notes a failure. Returns whether another take can be tried.
    fn failed(&mut self, inner: &Inner, name: &str, url: &ObjectUrl, error: &StoreError) -> bool {
        inner.uploads.retries.fetch_add(1, Ordering::Relaxed);
        let message = error.to_string();
        let is_of_take = matches!(
            error,
            StoreError::Exists(_) | StoreError::Source(_) | StoreError::Unsupported { .. }
        );
        if is_of_take {
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
        inner.uploads.set(name, UploadState::Waiting, url, message.clone());
        let before = lock(&inner.uploads.error).replace(message.clone());
        if before.is_none() {
            let message = format!("takes cannot be uploaded: {message}; retrying");
            inner.publish(ServiceEventKind::Warning, &message, None);
        }
        false
    }

    /// Removes the local copy of a take that was uploaded long enough ago, once its object was read back and compared.
    fn remove_local(
        &mut self,
        inner: &Inner,
        takes: &[TakeSummary],
        url: &ObjectUrl,
        config: &ArchiveConfig,
    ) -> bool {
        let Some(after) = config.remove_local_after else { return false };
        let after_ms = i64::try_from(after.as_millis()).unwrap_or(i64::MAX);
        let now = unix_ms();
        let due = takes.iter().rev().find_map(|take| {
            let object = url.join(&format!("{}.take", take.name));
            let entry = self.journal.get(&take.name).filter(|entry| entry.is_of(take, &object))?;
            let waits = self.take_retries.get(&take.name).is_some_and(|r| r.at > Instant::now());
            let is_due = entry.uploaded_unix_ms.saturating_add(after_ms) <= now;
            (is_due && !waits && !take.is_open).then_some((take, object))
        });
        let Some((take, object)) = due else { return false };
        let name = &take.name;
        match self.remove_verified(inner, name, &object, config) {
            Ok(true) => {
                self.succeeded(inner, name);
                self.journal.remove(name);
                self.save_journal(inner);
                let message = format!(
                    "the local copy of {name} was removed: {object} was read back and is the same"
                );
                inner.publish(ServiceEventKind::State, &message, Some(name));
                true
            }
            Ok(false) => {
                let error = StoreError::Exists(object.to_string());
                let message = format!(
                    "{object} differs from the take {name}, whose local copy is kept: compare them with mocapd diff"
                );
                inner.publish(ServiceEventKind::Failure, &message, Some(name));
                self.journal.remove(name);
                self.failed(inner, name, &object, &error)
            }
            Err(StoreError::Stopped(_)) => false,
            Err(error) => self.failed(inner, name, &object, &error),
        }
    }

    /// Removes the file of a take if its object has the same content; `false` if it has not.
    fn remove_verified(
        &self,
        inner: &Inner,
        name: &str,
        object: &ObjectUrl,
        config: &ArchiveConfig,
    ) -> Result<bool, StoreError> {
        let failed = |error: io::Error| StoreError::Source(error.to_string());
        let path = inner.path_of(name).map_err(|error| StoreError::Source(error.message))?;
        let mut file = File::open(&path).map_err(failed)?;
        let before = file.metadata().map_err(failed)?;
        let mut pace = Pace::new(inner, object, config.rate_max_bytes_per_s);
        let is_same =
            Store::of(object)?.has_content(object, &mut file, &mut |n| pace.wait(n, false))?;
        let now = fs::symlink_metadata(&path).map_err(failed)?;
        let stamp =
            |file: &fs::Metadata| (files::FileId::of(file), file.len(), file.modified().ok());
        if !is_same {
            return Ok(false);
        }
        if stamp(&now) != stamp(&before) {
            return Err(StoreError::Source("it changed while its object was compared".to_owned()));
        }
        fs::remove_file(&path).map_err(failed)?;
        Ok(true)
    }

    fn save_journal(&self, inner: &Inner) {
        let Some((directory, _)) = &self.of else { return };
        if let Err(error) = write_journal(directory, &self.journal) {
            let message = format!(
                "cannot store what was uploaded ({error:#}): after a restart, takes are compared with the archive again"
            );
            inner.publish(ServiceEventKind::Warning, &message, None);
        }
    }
}

/// What was uploaded, by name of the take. Without a readable journal the takes are compared with the archive again.
fn read_journal(directory: &Path) -> BTreeMap<String, JournalEntry> {
    let read = files::read_bounded(&directory.join(JOURNAL), JOURNAL_BYTES_MAX);
    read.ok().and_then(|bytes| serde_json::from_slice(&bytes).ok()).unwrap_or_default()
}

fn write_journal(directory: &Path, journal: &BTreeMap<String, JournalEntry>) -> anyhow::Result<()> {
    let path = directory.join(JOURNAL);
    let writing = || format!("cannot write {}", path.display());
    let mut file = tempfile::NamedTempFile::new_in(directory).with_context(writing)?;
    serde_json::to_writer(&mut file, journal).with_context(writing)?;
    file.flush().with_context(writing)?;
    file.as_file().sync_all().with_context(writing)?;
    file.persist(&path).with_context(writing)?;
    Ok(())
}

/// Limits the rate of an upload.
struct Pace<'a> {
    inner: &'a Inner,
    object: &'a ObjectUrl,
    bytes_per_s: u64,
    began: Instant,
    passed_bytes: u64,
}

impl<'a> Pace<'a> {
    fn new(inner: &'a Inner, object: &'a ObjectUrl, bytes_per_s: u64) -> Self {
        Self { inner, object, bytes_per_s, began: Instant::now(), passed_bytes: 0 }
    }

    /// Waits until `n` more bytes may pass; ends with the service.
    fn wait(&mut self, n: usize, is_sent: bool) -> Result<(), StoreError> {
        self.passed_bytes += n as u64;
        let due_s = self.passed_bytes as f64 / self.bytes_per_s.max(1) as f64;
        while self.began.elapsed().as_secs_f64() < due_s {
            if self.inner.is_stopping() {
                return Err(StoreError::Stopped(self.object.to_string()));
            }
            std::thread::sleep(PAUSE_STEP.min(Duration::from_secs_f64(due_s)));
        }
        if is_sent {
            self.inner.uploads.sent_bytes.fetch_add(n as u64, Ordering::Relaxed);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use mocapd_acquire::heartbeat::Heartbeat;

    use super::{
        super::{Engine, EngineOptions},
        *,
    };
    use crate::{
        config::{Config, Environment, Overrides},
        control::Control,
    };

    /// A finished take.
    const TAKE: &[u8] = include_bytes!("../../../take/tests/golden/v6/fast-1mm.mtake");

    struct Rig {
        folder: tempfile::TempDir,
        engine: Option<Engine>,
    }

    impl Rig {
        fn new() -> Self {
            let folder = tempfile::tempdir().unwrap();
            fs::create_dir(folder.path().join("takes")).unwrap();
            Self { folder, engine: None }
        }

        fn path(&self, name: &str) -> PathBuf {
            self.folder.path().join(name)
        }

        fn options(&self, archive: &str) -> EngineOptions {
            let text = format!(
                "[device]\nuri = 'serial:/nowhere'\n[take]\ndirectory = '{}'\n[arm]\nat_start = false\n\
                 [archive]\nurl = 'file://{}'\n{archive}",
                self.path("takes").display(),
                self.path("archive").display()
            );
            let config = Config::parse(
                "rig.toml",
                text.as_bytes(),
                &Environment::default(),
                &Overrides::default(),
            );
            EngineOptions::load(&config.unwrap()).unwrap()
        }

        fn start(&mut self, archive: &str) -> &Engine {
            self.engine = None;
            let engine = Engine::start(self.options(archive), &Heartbeat::default()).unwrap();
            self.engine.insert(engine)
        }

        fn engine(&self) -> &Engine {
            self.engine.as_ref().unwrap()
        }

        fn add(&self, name: &str) {
            fs::write(self.path(&format!("takes/{name}.take")), TAKE).unwrap();
        }

        /// Waits until the uploads of all takes are in these states.
        fn wait(&self, expected: &[(&str, UploadState)]) {
            let mut found = Vec::new();
            for _ in 0..600 {
                let mut takes = self.engine().takes(100).unwrap();
                takes.sort_by(|a, b| a.name.cmp(&b.name));
                let state = |take: TakeSummary| (take.name, take.upload.unwrap_or_default().state);
                found = takes.into_iter().map(state).collect();
                let found = found.iter().map(|(name, state): &(String, _)| (name.as_str(), *state));
                if found.eq(expected.iter().copied()) {
                    return;
                }
                std::thread::sleep(Duration::from_millis(50));
            }
            panic!("{found:?}, expected {expected:?}");
        }
    }

    #[test]
    fn finished_takes_are_uploaded_once_and_removed_when_asked() {
        let mut rig = Rig::new();
        rig.add("a");
        // Neither is finished; the service recovers the first.
        fs::write(rig.path("takes/cut.take"), &TAKE[..TAKE.len() / 2]).unwrap();
        fs::write(rig.path("takes/text.take"), b"hello").unwrap();
        rig.start("");
        let idle = [("cut", UploadState::Unknown), ("text", UploadState::Unknown)];
        let (uploaded, recovered) = (UploadState::Uploaded, "cut.recovered");
        let all = [("a", uploaded), idle[0], (recovered, uploaded), idle[1]];
        rig.wait(&all);
        assert_eq!(fs::read(rig.path("archive/a.take")).unwrap(), TAKE);
        let status = rig.engine().status().archive.unwrap();
        assert_eq!((status.uploaded, status.waiting, status.failed), (2, 0, 0));
        assert!(status.sent_bytes > TAKE.len() as u64);

        // After a restart it is known, without asking the archive.
        fs::remove_file(rig.path("archive/a.take")).unwrap();
        rig.start("");
        rig.wait(&all);
        assert!(!rig.path("archive/a.take").exists());

        // Without the journal it is uploaded again, and then removed.
        fs::remove_file(rig.path("takes").join(JOURNAL)).unwrap();
        rig.start("remove_local_after = '0s'");
        rig.wait(&idle);
        assert_eq!(fs::read(rig.path("archive/a.take")).unwrap(), TAKE);
    }

    #[test]
    fn a_store_that_comes_back_gets_the_takes() {
        let mut rig = Rig::new();
        // A file where the folder should be.
        fs::write(rig.path("archive"), b"").unwrap();
        rig.add("a");
        rig.add("b");
        rig.start("");
        let waiting = UploadState::Waiting;
        rig.wait(&[("a", waiting), ("b", waiting)]);
        let has_failed = || rig.engine().status().archive.unwrap().error.is_some();
        while !has_failed() {
            std::thread::sleep(PAUSE_STEP);
        }
        fs::remove_file(rig.path("archive")).unwrap();
        rig.wait(&[("a", UploadState::Uploaded), ("b", UploadState::Uploaded)]);
        let status = rig.engine().status().archive.unwrap();
        assert!(status.error.is_none() && status.retries >= 1, "{status:?}");
    }

    #[test]
    fn an_object_of_other_content_is_kept_and_so_is_the_take() {
        let mut rig = Rig::new();
        fs::create_dir(rig.path("archive")).unwrap();
        fs::write(rig.path("archive/a.take"), b"something else").unwrap();
        rig.add("a");
        rig.add("b");
        rig.start("");
        rig.wait(&[("a", UploadState::Failed), ("b", UploadState::Uploaded)]);
        // An object that changed after its upload, of the same length.
        let mut changed = TAKE.to_vec();
        changed[TAKE.len() / 2] ^= 1;
        fs::write(rig.path("archive/b.take"), &changed).unwrap();
        rig.engine().reload(rig.options("remove_local_after = '0s'"));
        rig.wait(&[("a", UploadState::Failed), ("b", UploadState::Failed)]);
        assert_eq!(fs::read(rig.path("takes/b.take")).unwrap(), TAKE);
        assert_eq!(fs::read(rig.path("archive/a.take")).unwrap(), b"something else");
        assert_eq!(fs::read(rig.path("archive/b.take")).unwrap(), changed);
    }

    #[test]
    fn the_rate_is_limited() {
        let mut rig = Rig::new();
        rig.add("a");
        let began = Instant::now();
        rig.start("rate_max = '4KiB'");
        rig.wait(&[("a", UploadState::Uploaded)]);
        assert!(began.elapsed().as_secs_f64() >= TAKE.len() as f64 / 4096.0);
    }
}
