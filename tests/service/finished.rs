//! Finished takes: rating and notes, rename, trash and restore, and what a crash leaves of them.

use std::{
    fs::{self, File},
    io::Read,
    path::{Path, PathBuf},
    sync::OnceLock,
    time::Duration,
};

use mocapd_acquire::{files::TakeFile, ledger::TakeHealth, threads::Heartbeat};
use mocapd_service::{
    control::{Control, Refusal, RefusalKind},
    engine::Engine,
    finished::{EditNotes, Rename, Restore, TakeRating, Trash},
    status::{ServiceEventKind, TakeSummary},
    take_files::{self, trash::remove_expired},
};

use super::engine::options;
use crate::support::assert_mentions;

/// A take, always the same.
fn take() -> Vec<u8> {
    static TAKE: OnceLock<Vec<u8>> = OnceLock::new();
    TAKE.get_or_init(super::http::take).clone()
}

/// An engine without a device, in a folder with takes.
struct Folder {
    folder: tempfile::TempDir,
    engine: Option<Engine>,
}

impl Folder {
    fn new(takes: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        for name in takes {
            fs::write(folder.path().join(format!("{name}.take")), take()).unwrap();
        }
        let mut new = Self { folder, engine: None };
        new.restart();
        new
    }

    fn restart(&mut self) -> &Engine {
        self.engine = None;
        let options = options(self.folder.path(), Path::new("/nowhere"));
        self.engine.insert(Engine::start(options, &Heartbeat::default()).unwrap())
    }

    fn engine(&self) -> &Engine {
        self.engine.as_ref().unwrap()
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The names of all files but hidden ones, and of those in the trash without their times.
    fn files(&self) -> Vec<String> {
        let names = |folder: &Path, skip: usize| -> Vec<String> {
            let entries = folder.read_dir().into_iter().flatten().map(Result::unwrap);
            let names = entries.map(|entry| entry.file_name().into_string().unwrap());
            names
                .filter(|name| !name.starts_with('.'))
                .map(|name| name[skip..].to_owned())
                .collect()
        };
        let trashed =
            names(&self.path(".trash"), 28).into_iter().map(|name| format!("trash/{name}"));
        let mut files: Vec<_> = names(self.folder.path(), 0).into_iter().chain(trashed).collect();
        files.sort();
        files
    }

    fn rate(&self, name: &str, rating: TakeRating, text: &str) {
        self.engine().edit_notes(name, &edit(rating, text)).unwrap();
    }

    fn listed(&self, name: &str) -> TakeSummary {
        let takes = self.engine().takes(100).unwrap();
        takes.into_iter().find(|take| take.name == name).unwrap()
    }

    fn rename(&self, name: &str, to: &str) -> Result<String, Refusal> {
        let rename = Rename { to: to.to_owned(), ..Rename::default() };
        self.engine().rename(name, &rename).map(|moved| moved.name)
    }
}

fn edit(rating: TakeRating, text: &str) -> EditNotes {
    EditNotes { rating: Some(rating), text: Some(text.to_owned()), ..EditNotes::default() }
}

fn request() -> Trash {
    Trash::default()
}

#[test]
fn a_rating_and_notes_are_kept_beside_the_take_and_its_bytes_stay() {
    let mut folder = Folder::new(&["a"]);
    assert_eq!(folder.listed("a").notes, None);
    folder.rate("a", TakeRating::Good, "left shoe\n\tsecond \"line\"");
    // What is not sent stays.
    let only_rating = EditNotes { rating: Some(TakeRating::Bad), ..EditNotes::default() };
    let notes = folder.engine().edit_notes("a", &only_rating).unwrap();
    assert_eq!(
        (notes.rating, notes.text.as_str()),
        (TakeRating::Bad, "left shoe\n\tsecond \"line\"")
    );
    assert_eq!(folder.listed("a").notes, Some(notes.clone()));
    folder.restart();
    assert_eq!(folder.listed("a").notes, Some(notes));
    assert_eq!(fs::read(folder.path("a.take")).unwrap(), take());
    assert_eq!(folder.files(), ["a.notes.json", "a.take"]);
    let refused = |edit: EditNotes| folder.engine().edit_notes("a", &edit).unwrap_err().kind;
    assert_eq!(refused(EditNotes::default()), RefusalKind::Invalid);
    assert_eq!(refused(edit(TakeRating::Unknown, "")), RefusalKind::Invalid);
    assert_eq!(refused(edit(TakeRating::Good, &"x".repeat(4097))), RefusalKind::Invalid);
    assert_eq!(refused(edit(TakeRating::Good, "a\0")), RefusalKind::Invalid);
    for text in ["\u{1}", "\u{1b}[2J", "a\rb"] {
        assert_eq!(refused(edit(TakeRating::Good, text)), RefusalKind::Invalid, "{text:?}");
    }
    folder.rate("a", TakeRating::None, "a\r\nb");
    assert_eq!(folder.listed("a").notes.unwrap().text, "a\nb");
    folder.rate("a", TakeRating::None, &"\n".repeat(4096));
    assert_eq!(folder.listed("a").notes.unwrap().text.len(), 4096);
    for name in ["none", "../a", "", ".a"] {
        folder.engine().edit_notes(name, &edit(TakeRating::Good, "")).unwrap_err();
    }
    assert_eq!(folder.files(), ["a.notes.json", "a.take"]);
}

#[test]
fn notes_of_another_take_and_damaged_ones_are_told_and_never_replaced() {
    let folder = Folder::new(&["a", "b"]);
    folder.rate("a", TakeRating::Good, "of a");
    let good = fs::read_to_string(folder.path("a.notes.json")).unwrap();
    // Another take, of the same length.
    let mut other = take();
    let middle = other.len() / 2;
    other[middle] ^= 1;
    fs::write(folder.path("b.take"), &other).unwrap();
    for (bytes, words) in [
        (good.clone().into_bytes(), &["another take"][..]),
        (b"{}".to_vec(), &["not a file of notes"]),
        (Vec::new(), &["damaged"]),
        (good.as_bytes()[..good.len() / 2].to_vec(), &["damaged"]),
        (good.replace("\"version\": 1", "\"version\": 2").into_bytes(), &["another version"]),
        (good.replace("\"good\"", "\"excellent\"").into_bytes(), &["damaged"]),
        (vec![b' '; 1 << 20], &["more than"]),
    ] {
        fs::write(folder.path("b.notes.json"), &bytes).unwrap();
        let listed = folder.listed("b").notes.unwrap();
        assert_mentions(listed.problem.as_ref().unwrap(), &["b.notes.json"]);
        assert_mentions(listed.problem.as_ref().unwrap(), words);
        assert_eq!((listed.rating, listed.text.as_str()), (TakeRating::None, ""));
        let refused = folder.engine().edit_notes("b", &edit(TakeRating::Bad, "x")).unwrap_err();
        assert_eq!(refused.kind, RefusalKind::Conflict);
        assert_eq!(fs::read(folder.path("b.notes.json")).unwrap(), bytes, "it is as it was");
    }
    // Neither a link nor a folder is followed.
    fs::remove_file(folder.path("b.notes.json")).unwrap();
    std::os::unix::fs::symlink("a.notes.json", folder.path("b.notes.json")).unwrap();
    folder.engine().edit_notes("b", &edit(TakeRating::Bad, "x")).unwrap_err();
    assert_eq!(fs::read_to_string(folder.path("a.notes.json")).unwrap(), good);
}

#[test]
fn a_take_and_its_notes_are_renamed_trashed_and_restored_together() {
    let folder = Folder::new(&["a", "b", "plain"]);
    folder.rate("a", TakeRating::Good, "of a");
    let events = folder.engine().events();
    assert_eq!(folder.rename("a", "jump 1.take").unwrap(), "jump 1");
    assert_eq!(folder.files(), ["b.take", "jump 1.notes.json", "jump 1.take", "plain.take"]);
    assert_eq!(folder.listed("jump 1").notes.unwrap().text, "of a");
    let event = events.next(Duration::from_secs(5)).unwrap();
    assert_eq!(event.kind, ServiceEventKind::TakeChanged);
    assert_mentions(&event.message, &["a", "jump 1"]);
    assert_eq!(folder.rename("jump 1", "b").unwrap_err().kind, RefusalKind::Exists);
    assert_eq!(folder.rename("jump 1", "jump 1").unwrap_err().kind, RefusalKind::Exists);
    assert_eq!(folder.rename("a", "c").unwrap_err().kind, RefusalKind::NotFound);
    for to in ["", "../c", "/etc/x", ".c", "-c", "a/b", "NUL", "c\0", "c.", &"x".repeat(201)] {
        assert_eq!(folder.rename("b", to).unwrap_err().kind, RefusalKind::Invalid, "{to:?}");
    }
    // Notes that lie where no take is belong to somebody.
    fs::write(folder.path("c.notes.json"), "whose?").unwrap();
    assert_eq!(folder.rename("b", "c").unwrap_err().kind, RefusalKind::Exists);
    assert!(folder.path("b.take").exists());
    fs::remove_file(folder.path("c.notes.json")).unwrap();

    let trashed = folder.engine().trash("jump 1", &request()).unwrap();
    assert_eq!((trashed.name.as_str(), trashed.bytes), ("jump 1", take().len() as u64));
    assert_eq!(trashed.removed_unix_ms - trashed.trashed_unix_ms, 3_600_000);
    assert_eq!(
        folder.files(),
        ["b.take", "plain.take", "trash/jump 1.notes.json", "trash/jump 1.take"]
    );
    assert_eq!(folder.engine().trashed(10), std::slice::from_ref(&trashed));
    assert_eq!(
        folder.engine().trash("jump 1", &request()).unwrap_err().kind,
        RefusalKind::NotFound
    );
    // A second one of the same name, and its return under another.
    assert_eq!(folder.rename("b", "jump 1").unwrap(), "jump 1");
    let restore = |id: &str, to: Option<&str>| {
        let restore = Restore { to: to.map(str::to_owned), ..Restore::default() };
        folder.engine().restore(id, &restore).map(|moved| moved.name)
    };
    assert_eq!(restore("jump 1", None).unwrap_err().kind, RefusalKind::Exists);
    let second = folder.engine().trash("jump 1", &request()).unwrap();
    assert_eq!(restore("jump 1", Some("b")).unwrap(), "b", "the newest of the name");
    assert_eq!(restore(&second.id, None).unwrap_err().kind, RefusalKind::NotFound);
    for id in ["../../x", "1.x", "", ".", &format!("{}/../x", trashed.id)] {
        assert_eq!(restore(id, None).unwrap_err().kind, RefusalKind::NotFound, "{id:?}");
    }
    assert_eq!(restore(&trashed.id, Some("../x")).unwrap_err().kind, RefusalKind::Invalid);
    assert_eq!(restore(&trashed.id, None).unwrap(), "jump 1");
    assert_eq!(folder.files(), ["b.take", "jump 1.notes.json", "jump 1.take", "plain.take"]);
    assert_eq!(folder.listed("jump 1").notes.unwrap().text, "of a");
    assert_eq!(fs::read(folder.path("jump 1.take")).unwrap(), take());
}

#[test]
fn a_take_that_has_got_the_name_meanwhile_is_left_alone() {
    let folder = Folder::new(&["a"]);
    let id = Some(folder.listed("a").take_id);
    let other = Some("0".repeat(32));
    let trash = |take_id: &Option<String>| {
        let trash = Trash { take_id: take_id.clone(), ..Trash::default() };
        folder.engine().trash("a", &trash)
    };
    let rename = |take_id: &Option<String>, to: &str| {
        let rename = Rename { take_id: take_id.clone(), to: to.to_owned(), ..Rename::default() };
        folder.engine().rename("a", &rename)
    };
    let rate = |take_id: &Option<String>| {
        let edit = EditNotes { take_id: take_id.clone(), ..edit(TakeRating::Bad, "") };
        folder.engine().edit_notes("a", &edit)
    };
    assert_eq!(trash(&other).unwrap_err().kind, RefusalKind::Conflict);
    assert_eq!(rename(&other, "b").unwrap_err().kind, RefusalKind::Conflict);
    assert_eq!(rate(&other).unwrap_err().kind, RefusalKind::Conflict);
    assert_eq!(folder.files(), ["a.take"]);
    rate(&id).unwrap();
    rename(&id, "b").unwrap();
    folder.rename("b", "a").unwrap();
    trash(&id).unwrap();
}

#[test]
fn a_request_id_is_of_one_take() {
    let folder = Folder::new(&["a", "b"]);
    let request = Trash { request_id: Some("1".to_owned()), ..Trash::default() };
    let trashed = folder.engine().trash("a", &request).unwrap();
    assert_eq!(folder.engine().trash("a", &request).unwrap(), trashed, "executed once");
    let refused = folder.engine().trash("b", &request).unwrap_err();
    assert_eq!(refused.kind, RefusalKind::Invalid);
    assert!(folder.path("b.take").exists());
}

#[test]
fn renames_and_starts_at_once_replace_nothing() {
    let names: Vec<String> = (0..8).map(|n| format!("t{n}")).collect();
    let folder = Folder::new(&names.iter().map(String::as_str).collect::<Vec<_>>());
    for (n, name) in names.iter().enumerate() {
        folder.rate(name, TakeRating::Good, &n.to_string());
    }
    let done: Vec<_> = std::thread::scope(|scope| {
        let threads: Vec<_> =
            names.iter().map(|name| scope.spawn(|| folder.rename(name, "one").is_ok())).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    assert_eq!(done.iter().filter(|is_done| **is_done).count(), 1, "{done:?}");
    assert_eq!(folder.files().len(), 16);
    let winner = done.iter().position(|is_done| *is_done).unwrap();
    assert_eq!(folder.listed("one").notes.unwrap().text, winner.to_string());
}

#[test]
fn a_take_that_is_being_written_is_left_alone() {
    let folder = Folder::new(&["a"]);
    // By another recorder.
    let writing = TakeFile::create(&folder.path("theirs.take")).unwrap();
    let refusals = [
        folder.rename("theirs", "x").unwrap_err(),
        folder.engine().trash("theirs", &request()).unwrap_err(),
        folder.engine().edit_notes("theirs", &edit(TakeRating::Good, "")).unwrap_err(),
    ];
    for refusal in refusals {
        assert_eq!(refusal.kind, RefusalKind::Conflict);
        assert_mentions(&refusal.message, &["theirs", "being written"]);
    }
    assert_eq!(folder.files(), ["a.take", "theirs.take"]);
    drop(writing);
    assert_eq!(folder.rename("theirs", "x").unwrap(), "x");
    // A take that is being read goes on being read.
    let reading = File::open(folder.path("a.take")).unwrap();
    folder.engine().trash("a", &request()).unwrap();
    let mut read = Vec::new();
    (&reading).read_to_end(&mut read).unwrap();
    assert_eq!(read, take());
    // A trash that leads elsewhere is not used.
    fs::rename(folder.path(".trash"), folder.path("elsewhere")).unwrap();
    std::os::unix::fs::symlink("elsewhere", folder.path(".trash")).unwrap();
    assert_eq!(folder.engine().trash("x", &request()).unwrap_err().kind, RefusalKind::Conflict);
    assert!(folder.path("x.take").exists());
}

#[test]
fn a_crash_between_two_renames_is_repaired_by_the_next_start() {
    let mut folder = Folder::new(&["a", "b"]);
    let mut other = take();
    let middle = other.len() / 2;
    other[middle] ^= 1;
    fs::write(folder.path("b.take"), other).unwrap();
    folder.rate("a", TakeRating::Good, "of a");
    let text = |folder: &Folder, name: &str| folder.listed(name).notes.map(|notes| notes.text);
    // A rename, of which only the first half was done.
    folder.engine = None;
    fs::rename(folder.path("a.take"), folder.path("c.take")).unwrap();
    folder.restart();
    assert_eq!(folder.files(), ["b.take", "c.notes.json", "c.take"]);
    assert_eq!(text(&folder, "c").as_deref(), Some("of a"));
    // On the way to the trash, and back.
    let in_trash = "1796000000000-0000000000000.c";
    fs::create_dir(folder.path(".trash")).unwrap();
    folder.engine = None;
    fs::rename(folder.path("c.take"), folder.path(&format!(".trash/{in_trash}.take"))).unwrap();
    folder.restart();
    assert_eq!(folder.files(), ["b.take", "trash/c.notes.json", "trash/c.take"]);
    folder.engine = None;
    fs::rename(folder.path(&format!(".trash/{in_trash}.take")), folder.path("d.take")).unwrap();
    // What a killed write of notes leaves.
    fs::write(folder.path(".mocapd-new-x1"), "{").unwrap();
    folder.restart();
    assert_eq!(folder.files(), ["b.take", "d.notes.json", "d.take"]);
    assert_eq!(text(&folder, "d").as_deref(), Some("of a"));
    assert!(!folder.path(".mocapd-new-x1").exists());
    // Notes whose take is gone are told, and stay; no other take gets them.
    fs::remove_file(folder.path("d.take")).unwrap();
    fs::write(folder.path("e.notes.json"), "damaged").unwrap();
    let messages = take_files::repair(folder.folder.path());
    assert_eq!(messages.len(), 2, "{messages:?}");
    assert_mentions(&messages.join("\n"), &["d.notes.json", "e.notes.json", "has no take"]);
    assert_eq!(folder.files(), ["b.take", "d.notes.json", "e.notes.json"]);
}

#[test]
fn of_copies_of_a_take_the_one_that_was_moved_gets_its_notes() {
    for (moved, others) in [("a", ["b", "c"]), ("b", ["a", "c"]), ("c", ["a", "b"])] {
        let mut folder = Folder::new(&["a", "b", "c"]);
        folder.rate(moved, TakeRating::Good, "of this one");
        folder.engine = None;
        // The time of a change has steps of some milliseconds.
        std::thread::sleep(Duration::from_millis(30));
        fs::rename(folder.path(&format!("{moved}.take")), folder.path("m.take")).unwrap();
        folder.restart();
        assert_eq!(folder.listed("m").notes.unwrap().text, "of this one");
        assert!(others.iter().all(|name| folder.listed(name).notes.is_none()), "{moved}");
    }
}

#[test]
fn takes_leave_the_trash_after_their_time_and_an_event_says_so() {
    let mut folder = Folder::new(&["new", "old"]);
    folder.rate("old", TakeRating::Bad, "");
    folder.engine().trash("old", &request()).unwrap();
    folder.engine().trash("new", &request()).unwrap();
    let trash = folder.path(".trash");
    fs::write(trash.join("readme.txt"), "not a take").unwrap();
    fs::write(trash.join("2026.11.x.take"), "not from here").unwrap();
    folder.engine = None;
    // As if the service had run for two hours since.
    let now = jiff::Timestamp::now().as_millisecond();
    let clock = format!("{{\"age_ms\":7200000,\"unix_ms\":{now}}}");
    fs::write(trash.join(".mocapd-trash.json"), clock).unwrap();
    fs::remove_file(folder.path(".trash").join("readme.txt")).unwrap();
    let mut options = options(folder.folder.path(), Path::new("/nowhere"));
    options.take.trash_keep = Duration::from_secs(3 * 3600);
    let engine = Engine::start(options.clone(), &Heartbeat::default()).unwrap();
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(engine.trashed(9).len(), 2);
    let events = engine.events();
    options.take.trash_keep = Duration::from_secs(3600);
    engine.reload(options);
    super::engine::wait_until("the removal", || engine.trashed(9).is_empty());
    let mut messages = String::new();
    while let Some(event) = events.next(Duration::from_millis(200)) {
        if event.kind == ServiceEventKind::TakeChanged {
            messages += &event.message;
        }
    }
    assert_mentions(&messages, &["old", "new", "removed from the trash"]);
    drop(engine);
    let left: Vec<_> = trash.read_dir().unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left.len(), 2, "the clock, and what is not from here: {left:?}");
    let keep = Duration::from_secs(3600);
    folder.restart();
    fs::write(folder.path("a.take"), take()).unwrap();
    let trashed = folder.engine().trash("a", &request()).unwrap();
    assert_eq!(folder.engine().trashed(9), [trashed]);
    let removed = remove_expired(folder.folder.path(), now + 3_000_000, keep);
    assert_eq!((removed.takes.len(), removed.problem), (0, None), "its time is not over");
    let removed = remove_expired(folder.folder.path(), now + 3_800_000, keep);
    assert_eq!(removed.takes, [("a".to_owned(), take().len() as u64)]);
}

#[test]
fn a_recovered_take_that_was_renamed_or_trashed_is_not_recovered_again() {
    let mut folder = Folder::new(&[]);
    let whole = take();
    fs::write(folder.path("cut.take"), &whole[..whole.len() / 2]).unwrap();
    folder.restart();
    let recovered = folder.path("cut.recovered.take");
    super::engine::wait_until("the recovery", || recovered.exists());
    super::engine::wait_until("its end", || folder.rename("cut.recovered", "good").is_ok());
    folder.restart();
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(folder.files(), ["cut.take", "good.take"]);
    assert_eq!(folder.listed("cut").health, TakeHealth::CutOff);
    folder.engine().trash("good", &request()).unwrap();
    folder.restart();
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(folder.files(), ["cut.take", "trash/good.take"]);
}
