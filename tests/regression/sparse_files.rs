//! A sparse file that claims a huge size costs neither memory nor time, and a large file costs no memory.
//!
//! Each `cargo test` does it with half a gigabyte; docs/reliability.md has the command for more.

use std::{
    fs::File,
    io::{Seek, SeekFrom, Write},
    path::Path,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use mocapd_take::chunk::{MAGIC, types};
use mocapd_testkit::random::Random;
use serde_json::Value;

use super::negative_residuals::words;
use crate::{
    cli::{Folder, Ran, devices::Simulated, service::Service},
    support::{assert_mentions, c3d_file::C3dFile, config, dense, jump, places, record},
};

/// Places that are damaged.
const DAMAGED: usize = 20;

/// The size that a file claims, with its holes.
fn claimed_bytes() -> u64 {
    let mib = std::env::var("MOCAPD_SPARSE_MIB").ok().and_then(|mib| mib.parse().ok());
    mib.unwrap_or(512_u64) << 20
}

/// Address space of the program, which has libraries, stacks of threads and a binary with all that tests need in it:
/// far less than the file claims.
const ADDRESSES_KIB: u64 = 400 << 10;

/// Maximum resident memory: the decoders of fifteen markers need very little.
const RESIDENT_MAX_BYTES: u64 = 64 << 20;

/// Size of a file that has to be read as a stream: more than the program may hold, by an eighth.
const STREAMED_BYTES: usize = RESIDENT_MAX_BYTES as usize / 8 * 9;

/// Thirty seconds of a recording, in stretches of half a second.
fn recording() -> Vec<u8> {
    let motion = jump(5, 60.0, 30.0);
    record(&motion, &config(&motion, dense(0.5)), 0..motion.n_frames()).1
}

/// Writes `take` with holes in it, each within a chunk, seeded.
fn write_sparse(path: &Path, take: &[u8], seed: u64) {
    let mut random = Random::new(seed);
    let mut numbers = |n: usize| random.below(n);
    let chunks: Vec<_> = places(take).into_iter().skip(1).map(|place| place.1).collect();
    let mut place = |_| {
        let chunk = &chunks[numbers(chunks.len())];
        chunk.start + 1 + numbers(chunk.len() - 1)
    };
    let mut holes: Vec<usize> = (0..DAMAGED).map(&mut place).collect();
    holes.sort_unstable();
    let hole_bytes = claimed_bytes() / DAMAGED as u64;
    let mut file = File::create(path).unwrap();
    let mut from = 0;
    for at in holes {
        file.write_all(&take[from..at]).unwrap();
        file.seek(SeekFrom::Current(hole_bytes as i64)).unwrap();
        from = at;
    }
    file.write_all(&take[from..]).unwrap();
}

/// Runs the program with little memory; also returns its peak memory.
pub(super) fn run(folder: &Folder, args: &[&str]) -> (Ran, u64) {
    let child = limited(folder, args);
    let pid = child.id();
    // Its output may exceed the buffer of a pipe.
    std::thread::scope(|scope| {
        let output = scope.spawn(|| child.wait_with_output().unwrap());
        let resident = watch(pid, || false);
        (output.join().unwrap().into(), resident)
    })
}

fn limited(folder: &Folder, args: &[&str]) -> Child {
    let mut command = Command::new("sh");
    let limit = format!("ulimit -v {ADDRESSES_KIB} && exec \"$0\" \"$@\"");
    command.args(["-c", &limit, env!("CARGO_BIN_EXE_mocapd")]).args(args);
    command.current_dir(folder.path(".")).env("MALLOC_ARENA_MAX", "2");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command.spawn().unwrap()
}

/// Polls a process until it ends or `is_done`.
fn watch(pid: u32, mut is_done: impl FnMut() -> bool) -> u64 {
    let status = format!("/proc/{pid}/status");
    let mut most = 0;
    loop {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let kib = text.lines().find_map(|line| line.strip_prefix("VmHWM:")?.strip_suffix("kB"));
        // An ended process has no memory.
        let Some(kib) = kib.and_then(|kib| kib.trim().parse::<u64>().ok()) else { return most };
        most = most.max(kib << 10);
        if is_done() {
            return most;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[expect(clippy::print_stdout, reason = "the documented command says what was measured")]
pub(super) fn assert_small(what: &str, resident: u64) {
    println!("{what}: {} MiB in memory at most", resident >> 20);
    assert!(resident < RESIDENT_MAX_BYTES, "{what}: {resident} bytes in memory");
}

#[test]
fn holes_cost_no_memory_and_the_data_between_them_is_found() {
    let folder = Folder::new();
    let take = recording();
    folder.write("whole.take", &take);
    let whole = folder.run(&["info", "whole.take", "--json"]).with_code(0).json();
    write_sparse(&folder.path("holes.take"), &take, 11);
    let (info, resident) = run(&folder, &["info", "holes.take", "--json"]);
    assert_small("info", resident);
    let info = info.with_code(3).json();
    let n = |report: &Value, key: &str| report[key].as_u64().unwrap();
    assert_eq!(n(&info, "frames"), n(&whole, "frames"));
    let (verify, resident) = run(&folder, &["verify", "holes.take", "--json"]);
    assert_small("verify", resident);
    let verify = verify.with_code(3).json();
    assert_eq!(n(&verify, "frames"), n(&whole, "frames"));
    assert!(n(&verify, "samples") > 0);
    let (export, resident) = run(&folder, &["export", "holes.take", "-o", "holes.csv"]);
    assert_small("export", resident);
    export.with_code(3);
    assert_eq!(folder.text("holes.csv").lines().count() as u64, n(&whole, "frames") + 1);
    let recover = ["recover", "holes.take", "-o", "again.take", "--json"];
    let (recover, resident) = run(&folder, &recover);
    assert_small("recover", resident);
    let recover = recover.with_code(3).json();
    // As much as without the holes, each of which is two cuts within a chunk.
    assert_eq!(n(&recover, "samples"), n(&verify, "samples"));
    let again = folder.run(&["verify", "again.take", "--json"]).json();
    assert_eq!(
        (&again["intact"], n(&again, "samples")),
        (&Value::Bool(true), n(&verify, "samples"))
    );
}

/// A file with more analog samples than the program may hold: 5 points, of which one is not a marker and one has
/// residuals, and at times coordinates under gaps.
fn file_with_analog_samples() -> C3dFile {
    const ANALOG: (usize, usize) = (64, 100);
    let n_frames = STREAMED_BYTES.div_ceil(ANALOG.0 * ANALOG.1 * 4);
    let frame = |frame: usize| {
        let i = frame as f32;
        let fourth = if frame % 8 > 5 { -1.0 } else { i };
        let mut words = vec![i, 2.0, 1000.5, 0.0, -i, 40.0, 30.0, fourth];
        words.extend([90.0, i, 5.0, 0.0, 1.0, 2.0, i, 0.0, 4.0, i, 3.0, 0.0]);
        words.extend((0..ANALOG.0 * ANALOG.1).map(|sample| (frame / 50 + sample % 64) as f32));
        words
    };
    let mut file = C3dFile::new(5, (0..n_frames).map(frame).collect());
    file.analog = ANALOG;
    file.texts(1, "LABELS", &["A", "B", "Knee", "C", "D"]);
    file.texts(1, "ANGLES", &["Knee"]);
    file.texts(1, "Y_SCREEN", &["+Z"]);
    file.records.extend(file.group(2, "ANALOG"));
    file.words(2, "USED", &[ANALOG.0 as u16]);
    file.floats(2, "RATE", &[100.0 * ANALOG.1 as f32]);
    file
}

#[test]
fn data_other_than_markers_are_imported_and_exported_as_a_stream() {
    let folder = Folder::new();
    let file = file_with_analog_samples();
    let n_frames = file.frames.len();
    let n_words = n_frames * file.frames[0].len();
    folder.write("a.c3d", file.bytes());
    drop(file);
    let (import, resident) = run(&folder, &["import", "a.c3d", "-o", "a.take", "--lossless"]);
    assert_small("import with analog samples", resident);
    import.with_code(0);
    let (verify, resident) = run(&folder, &["verify", "a.take", "--against", "a.c3d", "--json"]);
    assert_small("verify against a file with analog samples", resident);
    assert_eq!(verify.with_code(0).json()["against"]["bits_differing"], 0);
    let source = words(&folder.read("a.c3d"), n_words);
    let (export, resident) = run(&folder, &["export", "a.take", "-o", "b.c3d"]);
    assert_small("export with analog samples", resident);
    export.with_code(0);
    assert!(words(&folder.read("b.c3d"), n_words) == source, "the words are not the same");
    // A failure of the temporary folder is reported as such, not as damage of the take.
    let mut command = Command::new(env!("CARGO_BIN_EXE_mocapd"));
    command.args(["export", "a.take", "-o", "d.c3d"]).env("TMPDIR", folder.path("nowhere"));
    command.current_dir(folder.path("."));
    let line = folder.refused(command, 1);
    let nowhere = folder.path("nowhere").display().to_string();
    assert_mentions(&line, &[&nowhere, "TMPDIR"]);
    // From the middle on, and rotated.
    let part = ["export", "a.take", "-o", "c.c3d", "--from", "0.5s", "--up", "y"];
    let (export, resident) = run(&folder, &part);
    assert_small("export of a part, turned", resident);
    export.with_code(0);
    // The points of each frame are rotated, the analog samples are not.
    let frame_words = n_words / n_frames;
    let part = words(&folder.read("c.c3d"), n_words - 50 * frame_words);
    let analog = |words: &[u32]| -> Vec<u32> {
        words.chunks(frame_words).flat_map(|frame| &frame[20..]).copied().collect()
    };
    assert_eq!(part.len(), n_words - 50 * frame_words);
    assert!(analog(&part) == analog(&source[50 * frame_words..]), "analog samples differ");
    assert_ne!(part[..20], source[50 * frame_words..][..20]);
}

/// Trajectories alone, more than the program may hold, of more markers than a group has.
#[test]
fn trajectories_are_imported_and_compared_as_a_stream() {
    const MARKERS: usize = 80;
    let folder = Folder::new();
    let n_frames = STREAMED_BYTES.div_ceil(16 * MARKERS);
    let frame = |frame: usize| {
        let words = (0..MARKERS).flat_map(|marker| {
            let turns = (frame + 7 * marker) as f32 / 300.0;
            let missing = (frame + 31 * marker) % 500 < 20;
            let at = [300.0 * turns.sin(), 400.0 * turns.cos(), 900.0 + 10.0 * turns.sin()];
            if missing { [0.0, 0.0, 0.0, -1.0] } else { [at[0], at[1], at[2], 0.0] }
        });
        words.collect()
    };
    let mut file = C3dFile::new(MARKERS, (0..n_frames).map(frame).collect());
    file.floats(1, "LONG_FRAMES", &[n_frames as f32]);
    folder.write("a.c3d", file.bytes());
    drop(file);
    let import = ["import", "a.c3d", "-o", "a.take", "--resampler", "fast", "--threads", "2"];
    let (import, resident) = run(&folder, &import);
    assert_small("import of trajectories", resident);
    import.with_code(0);
    let (verify, resident) = run(&folder, &["verify", "a.take", "--against", "a.c3d", "--json"]);
    assert_small("verify against trajectories", resident);
    let against = &verify.with_code(0).json()["against"];
    assert_eq!((&against["frames"], &against["frames_missing"]), (&n_frames.into(), &0.into()));
}

/// An intact header and a hole: it killed the service, again at each start.
#[test]
fn the_service_starts_where_a_file_is_a_header_and_a_hole() {
    let folder = Folder::new();
    let take = recording();
    let header = places(&take)[0].1.end;
    std::fs::create_dir(folder.path("takes")).unwrap();
    let path = folder.path("takes/hole.take");
    let mut file = File::create(&path).unwrap();
    file.write_all(&take[..header]).unwrap();
    // A stretch of the maximum size, with no data.
    file.write_all(&[types::STRETCH, 0x80, 0x80, 0x80, 0x80, 0x04, 2]).unwrap();
    file.set_len(claimed_bytes()).unwrap();
    drop(file);
    assert_eq!(take[..8], MAGIC);
    folder.write(
        "rig.toml",
        "[device]\nuri = \"serial:nowhere\"\n[take]\ndirectory = \"takes\"\n[http]\nsocket = \"rig.sock\"\n",
    );
    let mut child = limited(&folder, &["run", "--config", "rig.toml"]);
    let recovered = folder.path("takes/hole.recovered.take");
    let begun = Instant::now();
    let resident =
        watch(child.id(), || recovered.exists() || begun.elapsed() > Duration::from_secs(120));
    child.kill().ok();
    let ran: Ran = child.wait_with_output().unwrap().into();
    assert!(recovered.exists(), "{}{}", ran.stdout, ran.stderr);
    assert_small("the service", resident);
    let name = "takes/hole.recovered.take";
    let verify = folder.run(&["verify", name, "--json"]).with_code(3).json();
    assert_eq!(verify["intact"], true);
}

/// Bytes that a process has read from files and sockets.
fn read_bytes(pid: u32) -> u64 {
    let io = std::fs::read_to_string(format!("/proc/{pid}/io")).unwrap();
    io.lines().find_map(|line| line.strip_prefix("rchar: ")).unwrap().parse().unwrap()
}

#[test]
fn the_service_verifies_a_take_without_reading_its_holes() {
    let folder = Folder::new();
    let device = Simulated::endless(jump(1, 120.0, 1.0));
    let service = Service::start(&folder, &device, "", "");
    let take = recording();
    write_sparse(&folder.path("takes/holes.take"), &take, 11);
    let before = read_bytes(service.pid());
    let (status, check) = service.post("/v1/takes/holes/verify", "{}");
    assert_eq!((status, &check["health"]), (200, &"damaged".into()), "{check}");
    let read = read_bytes(service.pid()) - before;
    // Data from the device, and other reads of the service, count as well.
    assert!(read < claimed_bytes() / 8, "{read} bytes were read");
}
