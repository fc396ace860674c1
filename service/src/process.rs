//! Resources that a process has used, from the kernel's accounting, and the priority of its threads.

use std::{fs, sync::Once};

/// Processor time and memory of a process.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Usage {
    /// Processor time in user and kernel mode, in seconds.
    pub cpu_s: f64,
    /// Peak resident memory in bytes.
    pub peak_memory_bytes: u64,
}

/// The usage of a process by its id, or of this one; `None` if /proc does not have it.
#[must_use]
pub fn usage(pid: Option<u32>) -> Option<Usage> {
    let folder = pid.map_or("/proc/self".to_owned(), |pid| format!("/proc/{pid}"));
    let stat = fs::read_to_string(format!("{folder}/stat")).ok()?;
    // The name, in brackets, may contain anything: fields are counted after it.
    let fields: Vec<_> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = fields.get(11)?.parse::<u64>().ok()? + fields.get(12)?.parse::<u64>().ok()?;
    let status = fs::read_to_string(format!("{folder}/status")).ok()?;
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: u64 = peak.trim().trim_end_matches("kB").trim().parse().ok()?;
    let ticks_per_s = rustix::param::clock_ticks_per_second() as f64;
    Some(Usage { cpu_s: ticks as f64 / ticks_per_s, peak_memory_bytes: kib * 1024 })
}

/// The lowest priority of normal threads. Beside a thread that records it gets a seventieth of a core, and all of a core that
/// is idle.
///
/// Not `SCHED_IDLE`, which gets less still: a thread that holds a lock, such as one of the allocator, must go on in a moment,
/// since a thread that records may wait for it. Not `SCHED_BATCH`, which has the same share as the threads that record.
const NICE_LOWEST: i32 = 19;

/// Gives the calling thread, and those that it starts, the lowest priority: for work that must not delay a recording.
/// If the system refuses, the thread goes on as it is.
pub(crate) fn lower_thread_priority() {
    static REFUSED: Once = Once::new();
    // On Linux this is the calling thread alone, not the process.
    if let Err(error) = rustix::process::setpriority_process(None, NICE_LOWEST) {
        REFUSED.call_once(|| {
            tracing::debug!(
                "work beside recordings runs at normal priority: setpriority was refused ({error})"
            );
        });
    }
}

#[cfg(test)]
mod tests {
    use mocapd_acquire::threads;

    use super::*;

    #[test]
    fn only_the_calling_thread_is_lowered() {
        let nice = || rustix::process::getpriority_process(None).unwrap();
        let own = nice();
        let lowered = threads::spawn("lowered", move || {
            lower_thread_priority();
            (nice(), threads::spawn("started", nice).unwrap().join().unwrap())
        });
        assert_eq!(lowered.unwrap().join().unwrap(), (NICE_LOWEST, NICE_LOWEST));
        assert_eq!(nice(), own);
    }

    #[test]
    fn this_process_has_used_something() {
        let usage = usage(None).unwrap();
        assert!(usage.peak_memory_bytes > 100_000, "{usage:?}");
        assert!(usage.cpu_s < 1e6);
        assert_eq!(super::usage(Some(u32::MAX)), None);
    }
}
