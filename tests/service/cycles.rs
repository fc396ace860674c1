//! Repeated takes: each is complete, and no thread, file or memory is leaked. A thousand of them:
//!
//! ```text
//! cargo test --release --test integration -- --ignored --nocapture service::cycles::a_thousand
//! ```

use std::{
    fs,
    time::{Duration, Instant},
};

use mocapd_service::control::{Control, Request};

use super::engine::{Room, named, read, room, wait_until};

/// Resource use of this process: threads, open files, and resident memory in bytes.
fn resources() -> (usize, usize, u64) {
    let count = |folder: &str| fs::read_dir(folder).unwrap().count();
    let statm = fs::read_to_string("/proc/self/statm").unwrap();
    let pages: u64 = statm.split_whitespace().nth(1).unwrap().parse().unwrap();
    (count("/proc/self/task"), count("/proc/self/fd"), pages * 4096)
}

/// The resources after each of `n` takes, and the durations of the starts in milliseconds, sorted.
fn cycles(n: usize) -> (Vec<(usize, usize, u64)>, Vec<f64>) {
    let Room { directory: _directory, device: _device, engine } =
        room(|options| options.arm.at_start = true);
    wait_until("the pre-roll", || engine.status().pre_roll.held_s > 4.5);
    let mut first_ms = Vec::new();
    let mut all = Vec::new();
    for cycle in 0..n {
        let start = Instant::now();
        let started = engine.start(&named(&format!("take-{cycle}"))).unwrap();
        first_ms.push(start.elapsed().as_secs_f64() * 1e3);
        std::thread::sleep(Duration::from_millis(30));
        let stopped = engine.stop(&Request::default()).unwrap();
        assert!(stopped.ledger.closes && stopped.ledger.finished, "{stopped:?}");
        let summary = read(&started.path);
        assert_eq!(summary.take.ledger.unwrap().recorded, stopped.ledger.recorded);
        fs::remove_file(&started.path).unwrap();
        all.push(resources());
    }
    first_ms.sort_by(f64::total_cmp);
    (all, first_ms)
}

#[test]
fn repeated_takes_are_complete() {
    assert_eq!(cycles(10).0.len(), 10);
}

#[test]
#[ignore = "minutes: see the command above"]
fn a_thousand_takes_leak_no_threads_files_or_memory() {
    let (all, first_ms) = cycles(1000);
    println!(
        "1000 takes: start to first durable frame, median {:.0} ms, 99 of 100 within {:.0} ms, at most {:.0} ms",
        first_ms[500], first_ms[990], first_ms[999]
    );
    let (threads, files, bytes) = all[99];
    let (threads_now, files_now, bytes_now) = all[999];
    let grown = bytes_now.saturating_sub(bytes);
    println!(
        "threads {threads} -> {threads_now}, files {files} -> {files_now}, memory +{grown} bytes from the 100th on"
    );
    assert_eq!((threads_now, files_now), (threads, files));
    assert!(grown < 4 << 20, "{grown}");
}
