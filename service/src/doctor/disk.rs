//! The disk for takes: its file system, free space, write speed and sync time.

use std::{
    fs::File,
    io::{self, Write},
    path::Path,
    time::{Duration, Instant},
};

use mocapd_acquire::{host_clock::LatencyHistogram, pipeline::RESERVE_MIN_BYTES};
use rustix::fs::{statfs, statvfs};

use super::Finding;

/// Bytes written to measure the speed: more than a cache absorbs at first, few enough for a memory card.
const WRITTEN_BYTES: usize = 32 << 20;
const BLOCK_BYTES: usize = 1 << 20;

/// Half a second of a large rig, synced twice a second as in a recording.
const STRETCH_BYTES: usize = 64 << 10;
const SYNCS: usize = 40;

/// Time limit for each measurement: a disk that needs longer is slow enough to be reported.
const TIME_LIMIT: Duration = Duration::from_secs(10);

/// Slowest acceptable speed: 200 markers x 1000 Hz uncompressed are 2.4 MB/s; this is twice as much.
const BYTES_PER_S_MIN: f64 = 5e6;

/// One hour of 64 markers x 240 Hz at half a millimetre, at 60 kB/s.
const HOUR_BYTES: u64 = 216_000_000;

/// Longest acceptable sync in nanoseconds: the time between two syncs.
const SYNC_NS_MAX: u64 = 500_000_000;

pub(super) fn examine(folder: &Path, keep_free_bytes: u64, report: &mut dyn FnMut(Finding)) {
    match statvfs(folder) {
        Err(error) => {
            let seen = format!("{}: {}", folder.display(), io::Error::from(error));
            report(Finding::failure("disk", seen, "choose another folder with --dir"));
        }
        Ok(disk) => {
            let free_bytes = disk.f_bavail.saturating_mul(disk.f_frsize);
            report(space(free_bytes, keep_free_bytes));
            if let Ok(disk) = statfs(folder) {
                // The number is signed in some kernels.
                report(kind(disk.f_type as u64 & 0xffff_ffff));
            }
            // Space that a recording would not use is not used for measurements, either.
            let spare = free_bytes.saturating_sub(keep_free_bytes);
            if spare < RESERVE_MIN_BYTES {
                return;
            }
            match measure(folder, spare / 2) {
                Ok(measured) => measured.into_iter().for_each(report),
                Err(error) => report(cannot_write(folder, &error)),
            }
        }
    }
}

fn cannot_write(folder: &Path, error: &io::Error) -> Finding {
    let seen = format!("cannot write to {}: {error}", folder.display());
    let remedy = match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "delete some files, or choose another folder with --dir"
        }
        _ => "choose another folder with --dir, or correct its permissions",
    };
    Finding::failure("disk", seen, remedy)
}

fn space(free_bytes: u64, keep_free_bytes: u64) -> Finding {
    let mb = |bytes: u64| bytes as f64 / 1e6;
    let what = "disk space";
    let left = free_bytes.saturating_sub(keep_free_bytes);
    let seen = format!(
        "{:.0} MB free, {:.0} MB of which are kept free",
        mb(free_bytes),
        mb(keep_free_bytes)
    );
    if left < RESERVE_MIN_BYTES {
        Finding::failure(what, seen, "delete some files, or record to another disk")
    } else if left < HOUR_BYTES {
        Finding::warning(what, seen, "delete some files: an hour of a large rig may not fit")
    } else {
        Finding::good(what, seen)
    }
}

/// Checks the type number of the file system, see statfs(2).
fn kind(f_type: u64) -> Finding {
    let what = "file system";
    let network = "record to a local disk and copy the take afterwards";
    match f_type {
        0xef53 => Finding::good(what, "ext4"),
        0x9123_683e => Finding::good(what, "btrfs"),
        0x5846_5342 => Finding::good(what, "XFS"),
        0xf2f5_2010 => Finding::good(what, "F2FS"),
        0x2fc1_2fc1 => Finding::good(what, "ZFS"),
        0x794c_7630 => Finding::note(what, "overlay: takes may be deleted with their container"),
        0x0102_1994 | 0x8584_58f6 => {
            Finding::warning(what, "in memory: a power cut loses all takes", "record to a disk")
        }
        0x6969 => Finding::warning(what, "NFS: fails when the network fails", network),
        0xff53_4d42 | 0xfe53_4d42 | 0x517b => {
            Finding::warning(what, "SMB: fails when the network fails", network)
        }
        0x4d44 => {
            let seen = "FAT: files are limited to 4 GiB, and a power cut may damage all of them";
            Finding::warning(what, seen, "record to ext4, XFS or btrfs")
        }
        0x6573_5546 => Finding::note(what, "FUSE: its program decides whether a sync is effective"),
        0x0102_1997 | 0x786f_4256 => {
            let seen = "a folder of another machine, shared with a virtual machine";
            Finding::warning(what, seen, network)
        }
        0x2011_bab0 => Finding::note(what, "exFAT: a power cut may damage all files"),
        other => Finding::note(what, format!("unknown type {other:#x}")),
    }
}

/// Measures write speed and sync time with at most `bytes_max` bytes.
fn measure(folder: &Path, bytes_max: u64) -> io::Result<[Finding; 2]> {
    let bytes_max = usize::try_from(bytes_max).unwrap_or(usize::MAX);
    let syncs_max = SYNCS.min(bytes_max / 2 / STRETCH_BYTES).max(1);
    let mut file = tempfile_in(folder)?;
    let block: Vec<u8> =
        (0..BLOCK_BYTES).map(|i| (i as u32).wrapping_mul(2_654_435_761) as u8).collect();
    let begun = Instant::now();
    let mut written = 0;
    while written < WRITTEN_BYTES.min(bytes_max / 2) && begun.elapsed() < TIME_LIMIT {
        file.write_all(&block)?;
        written += BLOCK_BYTES;
    }
    file.sync_data()?;
    let bytes_per_s = written as f64 / begun.elapsed().as_secs_f64();
    let mut syncs = LatencyHistogram::default();
    let begun = Instant::now();
    for _ in 0..syncs_max {
        file.write_all(&block[..STRETCH_BYTES])?;
        let before = Instant::now();
        file.sync_data()?;
        syncs.add(before.elapsed().as_nanos() as u64);
        if begun.elapsed() > TIME_LIMIT {
            break;
        }
    }
    Ok([speed(bytes_per_s), sync(&syncs)])
}

/// Opens a file without a name, or removes its name immediately: nothing is left behind if this process is killed.
fn tempfile_in(folder: &Path) -> io::Result<File> {
    use rustix::fs::{CWD, Mode, OFlags, openat};

    let flags = OFlags::RDWR | OFlags::TMPFILE | OFlags::CLOEXEC;
    if let Ok(file) = openat(CWD, folder, flags, Mode::RUSR | Mode::WUSR) {
        return Ok(file.into());
    }
    let path = folder.join(format!(".mocapd-doctor.{}", std::process::id()));
    let file = File::options().write(true).create_new(true).open(&path)?;
    std::fs::remove_file(&path)?;
    Ok(file)
}

fn speed(bytes_per_s: f64) -> Finding {
    let seen = format!("writes {:.0} MB/s", bytes_per_s / 1e6);
    let remedy = "record to a faster disk, or with a tolerance";
    Finding::warning_if(bytes_per_s < BYTES_PER_S_MIN, "disk speed", seen, remedy)
}

fn sync(syncs: &LatencyHistogram) -> Finding {
    let ms = |ns: u64| ns as f64 * 1e-6;
    let (p50, max) = (syncs.quantile_ns(0.5), syncs.max_ns());
    let seen =
        format!("median {:.1} ms, maximum {:.1} ms of {} syncs", ms(p50), ms(max), syncs.count());
    let remedy = "record to another disk: a power cut may cost more than the last second";
    Finding::warning_if(max > SYNC_NS_MAX, "disk syncs", seen, remedy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::Verdict;

    #[test]
    fn findings_about_disks() {
        assert_eq!(space(10 << 30, 256 << 20).verdict, Verdict::Good);
        assert_eq!(space(300 << 20, 256 << 20).verdict, Verdict::Warning);
        assert_eq!(space(257 << 20, 256 << 20).verdict, Verdict::Failure);
        assert_eq!(kind(0xef53).verdict, Verdict::Good);
        assert!(kind(0x4d44).seen.contains("4 GiB"));
        assert!(kind(0x1234).seen.contains("0x1234"));
        assert_eq!(speed(1e6).verdict, Verdict::Warning);
        let mut syncs = LatencyHistogram::default();
        syncs.add(3_000_000);
        assert_eq!(sync(&syncs).verdict, Verdict::Good);
        syncs.add(900_000_000);
        let seen = sync(&syncs).seen;
        assert!(seen.contains("900.0 ms") && seen.contains('2'), "{seen}");
        assert_eq!(sync(&syncs).verdict, Verdict::Warning);
    }

    #[test]
    fn nothing_is_left_behind() {
        let folder = tempfile::tempdir().unwrap();
        let mut found = Vec::new();
        examine(folder.path(), 0, &mut |finding| found.push(finding));
        assert!(found.iter().any(|finding| finding.what == "disk speed"), "{found:?}");
        assert_eq!(folder.path().read_dir().unwrap().count(), 0);
        let missing = folder.path().join("no-such-folder");
        let mut failed = Vec::new();
        examine(&missing, 0, &mut |finding| failed.push(finding));
        assert_eq!(failed[0].verdict, Verdict::Failure, "{failed:?}");
    }
}
