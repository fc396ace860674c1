//! Uploads of an engine without a device, to a folder.

use std::{fs, os::unix::fs::symlink};

use mocapd_acquire::threads::Heartbeat;

use super::{uploaded::JOURNAL, *};
use crate::{
    config::{Config, Environment, Overrides},
    control::Control,
    engine::{Engine, EngineOptions, folder::summary_of},
    finished::{EditNotes, Rename, Restore, Trash},
};

/// A finished take.
const TAKE: &[u8] = include_bytes!("../../../../take/tests/golden/v6/fast-1mm.mtake");

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
        let folder = self.path("archive");
        EngineOptions::load(&self.config(&self.path("takes"), &folder, archive)).unwrap()
    }

    fn config(&self, takes: &Path, folder: &Path, archive: &str) -> Config {
        let text = format!(
            "[device]\nuri = 'serial:/nowhere'\n[take]\ndirectory = '{}'\n[arm]\nat_start = false\n\
             [archive]\nurl = 'file://{}'\n{archive}",
            takes.display(),
            folder.display()
        );
        let config = Config::parse(
            "rig.toml",
            text.as_bytes(),
            &Environment::default(),
            &Overrides::default(),
        );
        config.unwrap()
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
    let idle = [("cut", UploadState::Unknown), ("text", UploadState::Failed)];
    let (uploaded, recovered) = (UploadState::Uploaded, "cut.recovered");
    let all = [("a", uploaded), idle[0], (recovered, uploaded), idle[1]];
    rig.wait(&all);
    assert_eq!(fs::read(rig.path("archive/a.take")).unwrap(), TAKE);
    let status = rig.engine().status().archive.unwrap();
    assert_eq!((status.uploaded, status.waiting, status.failed), (2, 0, 1));
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
fn an_error_of_a_former_archive_is_forgotten() {
    let mut rig = Rig::new();
    // A file where the folder should be.
    fs::write(rig.path("archive"), b"").unwrap();
    rig.add("a");
    rig.start("");
    while rig.engine().status().archive.unwrap().error.is_none() {
        std::thread::sleep(PAUSE_STEP);
    }
    let elsewhere = rig.config(&rig.path("takes"), &rig.path("elsewhere"), "");
    rig.engine().reload(EngineOptions::load(&elsewhere).unwrap());
    rig.wait(&[("a", UploadState::Uploaded)]);
    let status = rig.engine().status().archive.unwrap();
    assert!(status.error.is_none(), "{status:?}");
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

#[test]
fn an_archive_that_is_the_takes_folder_is_refused() {
    let rig = Rig::new();
    let takes = rig.path("takes");
    symlink(&takes, rig.path("link")).unwrap();
    symlink(rig.path("link"), rig.path("link-of-link")).unwrap();
    // The same folder from here.
    let here = std::env::current_dir().unwrap().canonicalize().unwrap();
    let up = "../".repeat(here.components().count() - 1);
    let relative = PathBuf::from(up).join(takes.strip_prefix("/").unwrap());
    assert!(relative.is_dir());
    let slashes = PathBuf::from(format!("{}//", takes.display()));
    let dots = takes.join("../takes/.");
    for takes in [&takes, &relative, &slashes, &dots, &rig.path("link")] {
        for archive in ["takes", "takes/", "link", "link-of-link/"] {
            let config = rig.config(takes, &rig.path(archive), "");
            let error = EngineOptions::load(&config).unwrap_err().to_string();
            assert!(error.contains("the takes' folder itself"), "{takes:?} {archive}: {error}");
        }
    }
    // Neither exists yet.
    let config = rig.config(&rig.path("link/new/folder"), &rig.path("takes/new/folder/"), "");
    assert!(EngineOptions::load(&config).is_err());
    for archive in ["archive", "takes/archive", "new"] {
        EngineOptions::load(&rig.config(&takes, &rig.path(archive), "")).unwrap();
    }
}

#[test]
fn a_take_whose_object_is_its_own_file_stays() {
    let mut rig = Rig::new();
    fs::create_dir(rig.path("elsewhere")).unwrap();
    symlink(rig.path("elsewhere"), rig.path("archive")).unwrap();
    rig.add("a");
    rig.start("");
    rig.wait(&[("a", UploadState::Uploaded)]);
    // The link is changed while the service runs.
    fs::remove_file(rig.path("archive")).unwrap();
    symlink(rig.path("takes"), rig.path("archive")).unwrap();
    // The check of the configuration would refuse it now.
    let options = Arc::clone(&rig.engine().inner.core().options);
    let mut options = EngineOptions::clone(&options);
    options.archive.remove_local_after = Some(Duration::ZERO);
    rig.engine().reload(options);
    rig.add("b");
    rig.wait(&[("a", UploadState::Uploaded), ("b", UploadState::Failed)]);
    std::thread::sleep(SCAN_INTERVAL + Duration::from_secs(1));
    assert_eq!(fs::read(rig.path("takes/a.take")).unwrap(), TAKE);
    assert_eq!(fs::read(rig.path("takes/b.take")).unwrap(), TAKE);
}

#[test]
fn an_object_that_disappeared_is_uploaded_again() {
    let mut rig = Rig::new();
    rig.add("a");
    rig.add("b");
    rig.start("");
    rig.wait(&[("a", UploadState::Uploaded), ("b", UploadState::Uploaded)]);
    fs::remove_file(rig.path("archive/a.take")).unwrap();
    fs::remove_file(rig.path("archive/b.take")).unwrap();
    rig.add("c");
    rig.engine().reload(rig.options("remove_local_after = '0s'"));
    rig.wait(&[]);
    for name in ["a", "b", "c"] {
        assert_eq!(fs::read(rig.path(&format!("archive/{name}.take"))).unwrap(), TAKE);
    }
    let status = rig.engine().status().archive.unwrap();
    assert!(status.error.is_none() && status.retries == 0, "{status:?}");
}

#[test]
fn a_take_that_was_recovered_and_removed_is_not_recovered_again() {
    let mut rig = Rig::new();
    fs::write(rig.path("takes/cut.take"), &TAKE[..TAKE.len() / 2]).unwrap();
    rig.start("remove_local_after = '0s'");
    let is_archived = || rig.path("archive/cut.recovered.take").exists();
    for _ in 0..300 {
        if is_archived() && !rig.path("takes/cut.recovered.take").exists() {
            break;
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    assert!(is_archived());
    rig.wait(&[("cut", UploadState::Unknown)]);
    // Also a restart without the archive does not recover it.
    for archive in ["remove_local_after = '0s'", ""] {
        rig.start(archive);
        std::thread::sleep(Duration::from_secs(1));
        rig.wait(&[("cut", UploadState::Unknown)]);
        assert_eq!(fs::read_dir(rig.path("archive")).unwrap().count(), 1);
    }
}

#[test]
fn a_damaged_take_is_reported() {
    let mut rig = Rig::new();
    rig.add("a");
    let path = rig.path("takes/damaged.take");
    let is_damaged = |at: &usize| {
        let mut bytes = TAKE.to_vec();
        bytes[*at] ^= 0x41;
        fs::write(&path, bytes).unwrap();
        summary_of(&path).unwrap().health == TakeHealth::Damaged
    };
    assert!((0..TAKE.len()).rev().find(is_damaged).is_some());
    rig.start("");
    rig.wait(&[("a", UploadState::Uploaded), ("damaged", UploadState::Failed)]);
    let takes = rig.engine().takes(9).unwrap();
    let take = takes.iter().find(|take| take.name == "damaged").unwrap();
    let message = &take.upload.as_ref().unwrap().message;
    assert!(message.starts_with("the take is damaged and is not uploaded"), "{message}");
    assert_eq!(rig.engine().status().archive.unwrap().failed, 1);
    assert!(!rig.path("archive/damaged.take").exists());
}

#[test]
fn an_error_of_one_take_does_not_delay_others() {
    let mut rig = Rig::new();
    rig.start("");
    let inner = &rig.engine().inner;
    let url = ObjectUrl::parse("s3://lab/a.take").unwrap();
    let text = || url.to_string();
    let mut uploader = Uploader::default();
    for error in [
        StoreError::Changed(text()),
        StoreError::NotFound(text()),
        StoreError::Exists(text()),
        StoreError::Source(text()),
    ] {
        assert!(uploader.failed(inner, "a", &url, &error), "{error}");
        assert!(uploader.store_retry.is_none() && uploader.take_retries.contains_key("a"));
    }
    for error in [StoreError::TimedOut(text()), StoreError::Replaces(text())] {
        assert!(!uploader.failed(inner, "b", &url, &error), "{error}");
        assert!(uploader.store_retry.take().is_some() && !uploader.take_retries.contains_key("b"));
    }
}

#[test]
fn a_removal_that_was_interrupted_is_undone() {
    let mut rig = Rig::new();
    rig.add("b");
    fs::write(rig.path("takes/.a.removing"), TAKE).unwrap();
    fs::write(rig.path("takes/.b.removing"), b"another").unwrap();
    rig.start("");
    let (uploaded, failed) = (UploadState::Uploaded, UploadState::Failed);
    rig.wait(&[("a", uploaded), ("b", uploaded), ("b-2", failed)]);
    assert_eq!(fs::read(rig.path("takes/b.take")).unwrap(), TAKE);
    assert_eq!(fs::read(rig.path("takes/b-2.take")).unwrap(), b"another");
}

#[test]
fn a_renamed_take_keeps_its_object_and_is_removed_by_it() {
    let mut rig = Rig::new();
    rig.add("a");
    rig.add("b");
    rig.start("");
    rig.wait(&[("a", UploadState::Uploaded), ("b", UploadState::Uploaded)]);
    let rename = |to: &str| Rename { to: to.to_owned(), ..Rename::default() };
    let moved = rig.engine().rename("a", &rename("c")).unwrap();
    assert!(moved.remarks[0].contains("archive/a.take"), "{moved:?}");
    rig.wait(&[("b", UploadState::Uploaded), ("c", UploadState::Uploaded)]);
    // A take that gets the old name is another one, and twice in a row is as once.
    rig.engine().rename("c", &rename("e")).unwrap();
    rig.engine().rename("b", &rename("c")).unwrap();
    let takes = rig.engine().takes(9).unwrap();
    let url = |name: &str| {
        let take = takes.iter().find(|take| take.name == name).unwrap();
        take.upload.clone().unwrap().url
    };
    assert!(url("e").ends_with("/a.take") && url("c").ends_with("/b.take"), "{takes:?}");
    rig.engine().rename("c", &rename("b")).unwrap();
    rig.engine().rename("e", &rename("c")).unwrap();
    // Also after a restart before the uploads have looked.
    rig.start("");
    rig.wait(&[("b", UploadState::Uploaded), ("c", UploadState::Uploaded)]);
    rig.engine().rename("c", &rename("d")).unwrap();
    rig.wait(&[("b", UploadState::Uploaded), ("d", UploadState::Uploaded)]);
    let takes = rig.engine().takes(9).unwrap();
    let upload = takes.iter().find(|take| take.name == "d").unwrap().upload.clone().unwrap();
    assert!(upload.url.ends_with("/a.take"), "{upload:?}");
    let archived = || fs::read_dir(rig.path("archive")).unwrap().count();
    assert_eq!(archived(), 2, "nothing was uploaded twice");
    // The local copy is compared with that object.
    rig.engine().reload(rig.options("remove_local_after = '0s'"));
    rig.wait(&[]);
    assert_eq!(archived(), 2);
}

#[test]
fn a_trashed_take_is_not_uploaded_until_it_is_restored() {
    let mut rig = Rig::new();
    rig.add("a");
    rig.start("rate_max = '1KiB'");
    rig.wait(&[("a", UploadState::Uploading)]);
    // Not while it is being uploaded.
    let refused = rig.engine().trash("a", &Trash::default()).unwrap_err();
    assert!(refused.message.contains("uploaded"), "{refused}");
    rig.engine().rename("a", &Rename { to: "b".to_owned(), ..Rename::default() }).unwrap_err();
    rig.engine().reload(rig.options(""));
    rig.wait(&[("a", UploadState::Uploaded)]);
    rig.engine().trash("a", &Trash::default()).unwrap();
    rig.wait(&[]);
    rig.add("b");
    rig.wait(&[("b", UploadState::Uploaded)]);
    rig.engine().restore("a", &Restore::default()).unwrap();
    rig.wait(&[("a", UploadState::Uploaded), ("b", UploadState::Uploaded)]);
    assert_eq!(fs::read_dir(rig.path("archive")).unwrap().count(), 2);
}

#[test]
fn notes_go_to_the_archive_with_the_local_copy() {
    let mut rig = Rig::new();
    rig.add("a");
    rig.add("b");
    rig.start("");
    rig.wait(&[("a", UploadState::Uploaded), ("b", UploadState::Uploaded)]);
    let rate = |name: &str, text: &str| {
        let edit = EditNotes { text: Some(text.to_owned()), ..EditNotes::default() };
        rig.engine().edit_notes(name, &edit).unwrap();
    };
    rate("a", "left shoe");
    rate("b", "right shoe");
    let notes = fs::read(rig.path("takes/a.notes.json")).unwrap();
    // Other notes of that name are in the archive: nothing is replaced, and the take stays.
    fs::write(rig.path("archive/b.notes.json"), "others").unwrap();
    rig.engine().reload(rig.options("remove_local_after = '0s'"));
    rig.wait(&[("b", UploadState::Uploaded)]);
    assert_eq!(fs::read(rig.path("archive/a.notes.json")).unwrap(), notes);
    assert!(!rig.path("takes/a.notes.json").exists());
    std::thread::sleep(Duration::from_secs(1));
    assert!(rig.path("takes/b.take").exists() && rig.path("takes/b.notes.json").exists());
    assert_eq!(fs::read(rig.path("archive/b.notes.json")).unwrap(), b"others");
}
