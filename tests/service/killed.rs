//! Kills `mocapd run` with SIGKILL while takes are rated, renamed, moved to the trash and restored: no take and no notes are
//! lost, what was acknowledged is done, and after the next start each take has its notes beside it.
//!
//! Each `cargo test` kills it a few times; this command five hundred times:
//!
//! ```text
//! cargo test --release --test integration -- --ignored --nocapture service::killed::five_hundred
//! ```

use std::{
    fs::{self, File},
    io::{Read, Write},
    os::unix::net::UnixStream,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use mocapd_testkit::random::Random;
use serde_json::{Value, json};

use crate::support::{config, dense, jump, record};

/// Longer than any step takes on the slowest machine.
const GIVE_UP: Duration = Duration::from_secs(60);

/// Takes, each with a client that changes it without a pause. The last two are copies of one file.
const TAKES: usize = 4;

/// Longest time from the first change to the kill.
const KILLED_WITHIN: Duration = Duration::from_millis(30);

/// Where a take is: in the folder under a name, or in the trash under an id.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Place {
    Folder(String),
    Trash(String),
}

impl Place {
    fn stem(&self) -> String {
        match self {
            Self::Folder(name) => name.clone(),
            Self::Trash(id) => format!(".trash/{id}"),
        }
    }
}

/// A take as its client knows it.
#[derive(Debug, Clone)]
struct Known {
    place: Place,
    text: String,
    /// The request that was not answered.
    pending: Option<Change>,
    n_changes: u64,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Change {
    Rate(String),
    Rename(String),
    Trash,
    Restore(String),
}

/// A service that runs in a folder.
struct Running {
    child: Child,
    socket: PathBuf,
}

impl Running {
    /// Starts it, and waits until it answers.
    fn start(folder: &Path) -> Self {
        let socket = folder.join("rig.sock");
        let config = format!(
            "[device]\nuri = 'serial:/nowhere'\n[arm]\nat_start = false\n[take]\ndirectory = '{}'\nkeep_free = '0B'\n\
             [http]\nlisten = ''\nsocket = '{}'\n",
            folder.join("takes").display(),
            socket.display()
        );
        fs::write(folder.join("rig.toml"), config).unwrap();
        let child = Command::new(env!("CARGO_BIN_EXE_mocapd"))
            .args(["run", "--config", "rig.toml"])
            .current_dir(folder)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(File::create(folder.join("rig.log")).unwrap())
            .spawn()
            .unwrap();
        let mut running = Self { child, socket };
        let begun = Instant::now();
        while running.ask("GET", "/v1/status", &Value::Null).is_none() {
            let ended = running.child.try_wait().unwrap();
            let log = || fs::read_to_string(folder.join("rig.log"));
            assert!(ended.is_none() && begun.elapsed() < GIVE_UP, "{ended:?}: {:?}", log());
            sleep(Duration::from_millis(2));
        }
        running
    }

    /// Status and document of a response; `None` without a complete one.
    fn ask(&self, method: &str, path: &str, body: &Value) -> Option<(u16, Value)> {
        let mut stream = UnixStream::connect(&self.socket).ok()?;
        let body = if body.is_null() { String::new() } else { body.to_string() };
        write!(
            stream,
            "{method} {path} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\
             content-type: application/json\r\ncontent-length: {}\r\n\r\n{body}",
            body.len()
        )
        .ok()?;
        let mut answer = String::new();
        stream.read_to_string(&mut answer).ok()?;
        let (head, body) = answer.split_once("\r\n\r\n")?;
        Some((head.split(' ').nth(1)?.parse().ok()?, serde_json::from_str(body).ok()?))
    }

    fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

/// Changes a take until the service does not answer.
fn change_until_killed(service: &Running, take: usize, known: &mut Known, random: &mut Random) {
    loop {
        known.n_changes += 1;
        let name = format!("t{take}-{}", known.n_changes);
        let (path, body, change) = match (&known.place, random.below(4)) {
            (Place::Folder(at), 0) => {
                let body = json!({ "rating": "good", "text": name });
                (format!("/v1/takes/{at}/notes"), body, Change::Rate(name))
            }
            (Place::Folder(at), 1) => (format!("/v1/takes/{at}/trash"), json!({}), Change::Trash),
            (Place::Folder(at), _) => {
                (format!("/v1/takes/{at}/rename"), json!({ "to": name }), Change::Rename(name))
            }
            (Place::Trash(id), _) => {
                (format!("/v1/trash/{id}/restore"), json!({ "to": name }), Change::Restore(name))
            }
        };
        known.pending = Some(change.clone());
        let Some((status, answer)) = service.ask("POST", &path, &body) else { return };
        assert_eq!(status, 200, "{change:?} of {known:?}: {answer}");
        known.pending = None;
        match change {
            Change::Rate(text) => known.text = text,
            Change::Rename(to) | Change::Restore(to) => known.place = Place::Folder(to),
            Change::Trash => known.place = Place::Trash(answer["id"].as_str().unwrap().to_owned()),
        }
    }
}

/// The files of a folder and of its trash, by their paths in it.
fn files(takes: &Path) -> Vec<String> {
    let names = |folder: &Path, prefix: &str| -> Vec<String> {
        let entries = folder.read_dir().into_iter().flatten().map(Result::unwrap);
        let files = entries.filter(|entry| entry.file_type().unwrap().is_file());
        files.map(|entry| format!("{prefix}{}", entry.file_name().to_str().unwrap())).collect()
    };
    let mut all = names(takes, "");
    all.extend(names(&takes.join(".trash"), ".trash/"));
    all.sort();
    all
}

/// The stem of the file of take `n` with this end: there is one.
fn stem_of(files: &[String], n: usize, end: &str) -> String {
    // In the trash the times are before the name.
    let is_of = |file: &&String| file.ends_with(end) && file.contains(&format!("t{n}-"));
    let found: Vec<_> = files.iter().filter(is_of).collect();
    assert_eq!(found.len(), 1, "{end} of take {n}: {files:?}");
    found[0].strip_suffix(end).unwrap().to_owned()
}

/// What the file of notes of take `n` says, wherever it is.
fn text_of(takes: &Path, files: &[String], n: usize) -> String {
    let stem = stem_of(files, n, ".notes.json");
    let bytes = fs::read(takes.join(format!("{stem}.notes.json"))).unwrap();
    let document: Value = serde_json::from_slice(&bytes).unwrap();
    document["text"].as_str().unwrap().to_owned()
}

/// Checks a take after a kill. Returns whether its notes are elsewhere.
fn check_killed(takes: &Path, n: usize, bytes: &[u8], known: &Known) -> bool {
    let files = files(takes);
    let stem = stem_of(&files, n, ".take");
    assert_eq!(fs::read(takes.join(format!("{stem}.take"))).unwrap(), bytes, "{known:?}");
    let is_pending = match &known.pending {
        Some(Change::Rename(to) | Change::Restore(to)) => stem == *to,
        Some(Change::Trash) => match &known.place {
            Place::Folder(name) => {
                stem.starts_with(".trash/") && stem.ends_with(&format!(".{name}"))
            }
            Place::Trash(_) => false,
        },
        Some(Change::Rate(_)) | None => false,
    };
    assert!(is_pending || stem == known.place.stem(), "{stem}: {known:?}");
    let notes = stem_of(&files, n, ".notes.json");
    assert!(notes == stem || notes == known.place.stem(), "{notes}: {known:?}");
    let text = text_of(takes, &files, n);
    let is_pending = known.pending == Some(Change::Rate(text.clone()));
    assert!(is_pending || text == known.text, "{text}: {known:?}");
    notes != stem
}

/// Kills the service `n` times. Returns how often a take and its notes were apart.
fn kills(n: u64, seed: u64) -> usize {
    let folder = tempfile::tempdir().unwrap();
    let takes = folder.path().join("takes");
    fs::create_dir(&takes).unwrap();
    let mut all = Vec::new();
    for take in 0..TAKES {
        let motion = jump(take.min(TAKES - 2) as u64, 60.0, 0.2);
        if take < TAKES - 1 {
            all.push(record(&motion, &config(&motion, dense(0.5)), 0..motion.n_frames()).1);
        } else {
            all.push(all[take - 1].clone());
        }
        fs::write(takes.join(format!("t{take}-0.take")), &all[take]).unwrap();
    }
    let known = |take: usize| Known {
        place: Place::Folder(format!("t{take}-0")),
        text: "first".to_owned(),
        pending: None,
        n_changes: 0,
    };
    let mut known: Vec<Known> = (0..TAKES).map(known).collect();
    let mut service = Running::start(folder.path());
    for take in 0..TAKES {
        let body = json!({ "rating": "bad", "text": "first" });
        let path = format!("/v1/takes/t{take}-0/notes");
        assert_eq!(service.ask("POST", &path, &body).unwrap().0, 200);
    }
    let mut apart = 0;
    for kill in 0..n {
        let mut random = Random::new(seed ^ kill << 8);
        kill_while_busy(service, &takes, &mut known, &mut random);
        for (take, known) in known.iter().enumerate() {
            apart += usize::from(check_killed(&takes, take, &all[take], known));
        }
        let before = files(&takes);
        let texts: Vec<_> = (0..TAKES).map(|take| text_of(&takes, &before, take)).collect();
        service = Running::start(folder.path());
        let after = files(&takes);
        for (take, known) in known.iter_mut().enumerate() {
            let stem = stem_of(&after, take, ".take");
            assert_eq!(stem_of(&before, take, ".take"), stem);
            assert_eq!(stem_of(&after, take, ".notes.json"), stem, "kill {kill}, {before:?}");
            let text = text_of(&takes, &after, take);
            assert_eq!(texts[take], text, "kill {kill}");
            let place = stem.strip_prefix(".trash/").map(str::to_owned);
            known.place = place.map_or_else(|| Place::Folder(stem.clone()), Place::Trash);
            (known.text, known.pending) = (text, None);
        }
        let expected = 2 * TAKES + usize::from(takes.join(".trash").exists());
        assert!(after.len() <= expected, "kill {kill}: files are left over: {after:?}");
        check_listed(&service, &known);
    }
    service.kill();
    apart
}

/// Changes all takes at once, and kills the service: half of the times at any instant, half of them as soon as a take has
/// moved.
fn kill_while_busy(service: Running, takes: &Path, known: &mut [Known], random: &mut Random) {
    let seeds: Vec<u64> = known.iter().map(|_| random.next_u64()).collect();
    let wait = KILLED_WITHIN.mul_f64(random.below(1000) as f64 / 1000.0);
    let on_move = random.below(2) == 0;
    std::thread::scope(|scope| {
        let clients = known.iter_mut().zip(seeds).enumerate();
        for (take, (known, seed)) in clients {
            let service = &service;
            scope.spawn(move || {
                change_until_killed(service, take, known, &mut Random::new(seed));
            });
        }
        sleep(wait);
        let before = files(takes);
        let begun = Instant::now();
        let is_moved =
            || files(takes).iter().any(|file| file.ends_with(".take") && !before.contains(file));
        while on_move && !is_moved() && begun.elapsed() < Duration::from_secs(1) {}
        let pid = rustix::process::Pid::from_child(&service.child);
        rustix::process::kill_process(pid, rustix::process::Signal::KILL).unwrap();
    });
    service.kill();
}

/// The service lists every take where it is, with its notes.
fn check_listed(service: &Running, known: &[Known]) {
    let list = |path: &str| service.ask("GET", path, &Value::Null).unwrap().1;
    let (listed, trashed) = (list("/v1/takes"), list("/v1/trash"));
    let has = |list: &Value, key: &str, value: &str| {
        list.as_array().unwrap().iter().find(|take| take[key] == value).cloned()
    };
    for known in known {
        match &known.place {
            Place::Folder(name) => {
                let take = has(&listed, "name", name).unwrap_or_else(|| panic!("{name}: {listed}"));
                assert_eq!(take["notes"]["text"], known.text, "{take}");
                assert_eq!(take["notes"]["problem"], Value::Null, "{take}");
            }
            Place::Trash(id) => assert!(has(&trashed, "id", id).is_some(), "{id}: {trashed}"),
        }
    }
}

#[test]
fn a_few_kills_part_no_take_from_its_notes() {
    kills(8, 1);
}

#[test]
#[ignore = "minutes: see the command above"]
fn five_hundred_kills_part_no_take_from_its_notes() {
    let apart = kills(500, 2);
    println!(
        "500 kills: {apart} times a take had moved without its notes, and got them at the next start"
    );
}
