//! Disk space: a reserve lets a take be closed when other programs fill the disk, and free space is monitored, so that
//! the take is closed in time.

use std::{
    io,
    path::Path,
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

use rustix::fs::statvfs;

use super::PipelineProgress;
use crate::{
    files::{TakeOutput, folder_of},
    setting::{Setting, SettingRefused},
};

/// The smallest reserve: enough for a ledger, the index of a take of days and a few stretches.
pub const RESERVE_MIN_BYTES: u64 = 4 << 20;

/// Seconds of data to reserve: the stretches in memory after a stall of the disk, and those until the device stops.
const RESERVE_S: f64 = 60.0;

/// Time between two checks of the disk.
const POLL_INTERVAL: Duration = Duration::from_secs(1);

/// Time constant of the mean data rate.
const TAU_S: f64 = 30.0;

/// Disk space allocated ahead of the take's end, and the state of the disk.
#[derive(Debug)]
pub(super) struct DiskReserve {
    keep_free_bytes: u64,
    /// Space is allocated to the file up to this byte.
    reserved_to: u64,
    /// Whether the file system can allocate ahead.
    can_reserve: bool,
    /// Whether the last allocation was refused although the disk reports enough free bytes, as under a quota.
    is_over_quota: bool,
    /// The last check: its time, the bytes of the take, and the bytes of the raw log.
    last_poll: Option<(Instant, u64, u64)>,
    bytes_per_s: f64,
    /// Data rate of the raw log on the same disk.
    raw_log_bytes_per_s: f64,
    state: DiskSpace,
}

/// Free space on the take's disk.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct DiskSpace {
    /// Free bytes, not counting the take's own reserve. `None` if the system does not report them.
    pub free_bytes: Option<u64>,
    /// Seconds until the disk is full, at the mean rate of the last 30 s. `None` before a rate is known.
    pub left_s: Option<f64>,
    /// Whether the take has to end, because less than `keep_free_bytes` would remain.
    pub is_full: bool,
}

impl DiskReserve {
    pub(super) fn new(keep_free_bytes: u64) -> Self {
        Self {
            keep_free_bytes,
            reserved_to: 0,
            can_reserve: true,
            is_over_quota: false,
            last_poll: None,
            bytes_per_s: 0.0,
            raw_log_bytes_per_s: 0.0,
            state: DiskSpace::default(),
        }
    }

    /// Checks the disk if a check is due; `written` is the length of the take in bytes.
    pub(super) fn poll(
        &mut self,
        output: &mut dyn TakeOutput,
        written: u64,
        progress: &PipelineProgress,
        now: Instant,
    ) {
        if self.last_poll.is_some_and(|(last, ..)| now.duration_since(last) < POLL_INTERVAL) {
            return;
        }
        let raw_log_bytes = progress.raw_log_bytes.get().map_or(0, |n| n.load(Ordering::Relaxed));
        if let Some((last, before, raw_log_before)) = self.last_poll {
            let elapsed_s = now.duration_since(last).as_secs_f64();
            // Before there is a mean, use the first second's rate.
            let weight = if self.bytes_per_s > 0.0 { (elapsed_s / TAU_S).min(1.0) } else { 1.0 };
            for (mean, now, before) in [
                (&mut self.bytes_per_s, written, before),
                (&mut self.raw_log_bytes_per_s, raw_log_bytes, raw_log_before),
            ] {
                *mean += (now.saturating_sub(before) as f64 / elapsed_s - *mean) * weight;
            }
        }
        self.last_poll = Some((now, written, raw_log_bytes));
        self.reserve(output, written);
        self.state.free_bytes = output.free_bytes();
        let reserved = self.reserved_to.saturating_sub(written);
        let available = match self.state.free_bytes {
            // The free bytes of a quota are unknown.
            Some(free) if !self.is_over_quota => free.saturating_sub(self.keep_free_bytes),
            Some(_) => 0,
            None => u64::MAX,
        };
        // The last `RESERVE_MIN_BYTES` are for closing the take.
        let left = available.saturating_add(reserved);
        self.state.is_full |= left < RESERVE_MIN_BYTES;
        let is_known = self.bytes_per_s > 0.0 && self.state.free_bytes.is_some();
        let both_per_s = self.bytes_per_s + self.raw_log_bytes_per_s;
        let left_s = left.saturating_sub(RESERVE_MIN_BYTES) as f64 / both_per_s;
        // The reserve belongs to the take alone, not to the raw log.
        let raw_log_s = available as f64 / self.raw_log_bytes_per_s;
        let left_s = if self.raw_log_bytes_per_s > 0.0 { left_s.min(raw_log_s) } else { left_s };
        self.state.left_s = is_known.then_some(left_s);
        progress.disk_full.store(self.state.is_full, Ordering::Relaxed);
        let left_s = self.state.left_s.map_or(u64::MAX, |left_s| left_s as u64);
        progress.disk_left_s.store(left_s, Ordering::Relaxed);
    }

    /// The final state, after the take was closed and its reserve released.
    pub(super) fn close(&mut self, output: &dyn TakeOutput) -> DiskSpace {
        self.state.free_bytes = output.free_bytes();
        self.state
    }

    fn reserve(&mut self, output: &mut dyn TakeOutput, written: u64) {
        let target = RESERVE_MIN_BYTES.max((self.bytes_per_s * RESERVE_S) as u64);
        // Topping up at half the reserve saves a system call every second.
        if self.state.is_full || !self.can_reserve || self.reserved_to >= written + target / 2 {
            return;
        }
        let from = self.reserved_to.max(written);
        // Do not reserve any of `keep_free_bytes`.
        let spare =
            output.free_bytes().map_or(u64::MAX, |free| free.saturating_sub(self.keep_free_bytes));
        let end = (written + target).min(from.saturating_add(spare));
        for to in [end, (written + RESERVE_MIN_BYTES).min(end)] {
            if to <= from {
                return;
            }
            match output.allocate(from, to - from) {
                Ok(()) => {
                    (self.reserved_to, self.is_over_quota) = (to, false);
                    return;
                }
                // The earlier reserve remains, and a smaller one may be granted.
                Err(error) if is_full(&error) => self.is_over_quota = true,
                Err(_) => {
                    self.can_reserve = false;
                    return;
                }
            }
        }
    }
}

fn is_full(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded)
}

/// Checks that a take can be started at `path` with `keep_free_bytes` left free.
///
/// # Errors
/// When the disk is too full. The message states free and required space, and what to do.
pub fn check_disk_space(path: &Path, keep_free_bytes: u64) -> anyhow::Result<()> {
    // If free space is unknown, creating the file decides.
    let Ok(disk) = statvfs(folder_of(path)) else { return Ok(()) };
    let free_bytes = disk.f_bavail.saturating_mul(disk.f_frsize);
    if free_bytes < keep_free_bytes.saturating_add(RESERVE_MIN_BYTES) {
        let why = format!(
            "the disk is nearly full: {:.0} MB are free for {}, but {:.0} MB have to stay free, and closing \
             a take needs {:.0} MB",
            mb(free_bytes),
            path.display(),
            mb(keep_free_bytes),
            mb(RESERVE_MIN_BYTES)
        );
        let alternative = ", free some space, or record to another disk";
        return Err(SettingRefused { why, setting: Setting::KeepFree, alternative }.into());
    }
    Ok(())
}

fn mb(bytes: u64) -> f64 {
    bytes as f64 / 1e6
}

#[cfg(test)]
mod tests {
    use std::{
        io::Write,
        sync::{Arc, atomic::AtomicU64},
    };

    use super::*;

    /// A disk with `free` bytes, which may be unable to reserve space.
    struct Disk {
        free: u64,
        holds: Result<(), io::ErrorKind>,
    }

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    impl TakeOutput for Disk {
        fn sync(&mut self) -> io::Result<()> {
            Ok(())
        }

        fn allocate(&mut self, _from: u64, bytes: u64) -> io::Result<()> {
            self.holds?;
            self.free = self.free.checked_sub(bytes).ok_or(io::ErrorKind::StorageFull)?;
            Ok(())
        }

        fn free_bytes(&self) -> Option<u64> {
            Some(self.free)
        }
    }

    const MIB: u64 = 1 << 20;

    /// A take of 1 MiB a second on a disk of 40 MiB, with 10 MiB kept free: the second at which it has to end, the
    /// minimum of free bytes, and the estimates of the time left.
    fn run_until_full(holds: Result<(), io::ErrorKind>) -> (u64, u64, Vec<f64>) {
        let mut disk = Disk { free: 40 * MIB, holds };
        let (mut reserve, progress, start) =
            (DiskReserve::new(10 * MIB), PipelineProgress::default(), Instant::now());
        let (mut left, mut least) = (Vec::new(), disk.free);
        for second in 0..100 {
            reserve.poll(&mut disk, second * MIB, &progress, start + Duration::from_secs(second));
            left.extend(reserve.state.left_s);
            least = least.min(disk.free);
            if progress.disk_full.load(Ordering::Relaxed) {
                return (second, least, left);
            }
            // Without a reserve the take uses the free bytes.
            if holds.is_err() {
                disk.free -= MIB;
            }
        }
        panic!("never full: {:?}", reserve.state);
    }

    #[test]
    fn a_take_continues_until_just_enough_space_is_left_to_close_it() {
        for holds in [Ok(()), Err(io::ErrorKind::Unsupported)] {
            let (seconds, least, left) = run_until_full(holds);
            // 30 MiB less the last 4, and nothing of the 10 that stay free.
            assert_eq!(seconds, 27, "{holds:?}");
            assert!(least >= 10 * MIB, "{holds:?}: {least}");
            assert!((left[4] - 21.0).abs() < 0.1, "{holds:?}: {left:?}");
        }
    }

    #[test]
    fn an_unreported_quota_ends_the_take_when_its_reserve_is_used() {
        let (seconds, ..) = run_until_full(Err(io::ErrorKind::QuotaExceeded));
        assert_eq!(seconds, 0);
        // The reserve lasts half a minute after the quota is reached.
        let mut disk = Disk { free: 1000 * MIB, holds: Ok(()) };
        let (mut reserve, progress, start) =
            (DiskReserve::new(0), PipelineProgress::default(), Instant::now());
        for second in 0..100 {
            if second == 5 {
                disk.holds = Err(io::ErrorKind::QuotaExceeded);
            }
            reserve.poll(&mut disk, second * MIB, &progress, start + Duration::from_secs(second));
            if reserve.state.is_full {
                assert!((50..64).contains(&second), "{second}");
                return;
            }
        }
        panic!("never full: {:?}", reserve.state);
    }

    #[test]
    fn the_time_left_includes_the_raw_log() {
        // With 3 MiB/s of raw log and 1 MiB/s of take, 950 MiB last for a quarter of the time.
        let mut disk = Disk { free: 1000 * MIB, holds: Ok(()) };
        let (mut reserve, progress, start) =
            (DiskReserve::new(50 * MIB), PipelineProgress::default(), Instant::now());
        let raw_log = Arc::new(AtomicU64::new(9));
        progress.raw_log_bytes.set(Arc::clone(&raw_log)).unwrap();
        for second in 0..10 {
            reserve.poll(&mut disk, second * MIB, &progress, start + Duration::from_secs(second));
            raw_log.fetch_add(3 * MIB, Ordering::Relaxed);
            disk.free -= 3 * MIB;
        }
        let left_s = reserve.state.left_s.unwrap();
        assert!((left_s - (950.0 - 4.0 - 4.0 * 9.0) / 4.0).abs() < 2.0, "{left_s}");
    }

    #[test]
    fn the_time_left_includes_the_reserve() {
        let mut disk = Disk { free: 1000 * MIB, holds: Ok(()) };
        let (mut reserve, progress, start) =
            (DiskReserve::new(0), PipelineProgress::default(), Instant::now());
        for second in 0..10 {
            reserve.poll(&mut disk, second * MIB, &progress, start + Duration::from_secs(second));
        }
        let left_s = reserve.state.left_s.unwrap();
        assert!((left_s - 987.0).abs() < 1.0, "{left_s}");
        assert_eq!(progress.disk_left_s.load(Ordering::Relaxed), left_s as u64);
        assert!(disk.free < 950 * MIB && !reserve.state.is_full);
    }
}
