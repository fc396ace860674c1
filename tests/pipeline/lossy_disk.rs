//! The writer on a disk that forgets: after a power cut any unsynced write may be missing, completely or in part, in
//! any order. Everything synced must be read back, and nothing that was not sent.

use std::{
    io::{self, Write},
    ops::Range,
    sync::{Arc, Mutex},
    time::Duration,
};

use mocapd_acquire::pipeline::{PipelineConfig, TakeOutput};
use mocapd_codec::Settings;
use mocapd_take::motion::{Motion, Position, is_gap};

use crate::support::{Seeded, config, dense, fast, feed, jump, lossless, rows, start};

/// The unit that a disk writes completely or not at all.
const SECTOR_BYTES: usize = 512;

/// Seeded power cuts of every run. `MOCAPD_SEED` selects a single one.
const SEEDS: Range<u64> = 0..1_000;
/// Those of long runs.
const LONG_SEEDS: Range<u64> = 1_000..20_000;

/// Everything written, the ends of the writes, and the number of writes and bytes at each sync.
#[derive(Debug, Default, Clone)]
struct WriteLog {
    bytes: Vec<u8>,
    ends: Vec<usize>,
    syncs: Vec<(usize, usize)>,
}

/// Records every write and sync in order.
#[derive(Debug, Default, Clone)]
struct Journal(Arc<Mutex<WriteLog>>);

impl Write for Journal {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut written = self.0.lock().unwrap();
        written.bytes.extend_from_slice(bytes);
        let end = written.bytes.len();
        written.ends.push(end);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl TakeOutput for Journal {
    fn sync(&mut self) -> io::Result<()> {
        let mut written = self.0.lock().unwrap();
        let now = (written.ends.len(), written.bytes.len());
        written.syncs.push(now);
        Ok(())
    }
}

/// A recording and its rows.
struct Recorded {
    written: WriteLog,
    rows: Vec<Vec<Position>>,
}

/// Records with losses, markers that come and go, and regular syncs.
fn recorded(codec: Settings, sync_every: Duration, motion: &Motion) -> Recorded {
    let journal = Journal::default();
    let config = PipelineConfig {
        sync_every,
        stretch: Duration::from_millis(100),
        first_stretch: Duration::from_millis(30),
        key_every: Duration::from_secs(1),
        ..config(motion, codec)
    };
    let (mut intake, pipeline) = start(&config, journal.clone());
    for seq in (0..motion.n_frames()).filter(|seq| seq % 97 != 13 && !(400..430).contains(seq)) {
        while intake.is_full() {
            std::thread::yield_now();
        }
        feed(&mut intake, motion, seq);
    }
    intake.finish();
    pipeline.finish().unwrap();
    let written = journal.0.lock().unwrap().clone();
    let (rows, problems) = rows(&written.bytes);
    assert!(problems.is_empty(), "{problems:?}");
    Recorded { written, rows }
}

impl Recorded {
    /// The possible content of a disk after a power cut, and the number of bytes that were synced.
    fn cut(&self, random: &mut Seeded) -> (Vec<u8>, usize) {
        let WriteLog { bytes, ends, syncs } = &self.written;
        let writes = random.below(ends.len() + 1);
        let written = if writes == 0 { 0 } else { ends[writes - 1] };
        let synced = syncs.iter().rfind(|sync| sync.0 <= writes).map_or(0, |sync| sync.1);
        // The last write may be torn.
        let torn = ends.get(writes).map_or(written, |end| written + random.below(end - written));
        // The length of the file and its content are lost independently.
        let len = synced + random.below(torn - synced + 1);
        let mut disk = bytes[..len].to_vec();
        let kept_of_ten = random.below(11);
        let mut at = synced;
        while at < len {
            let end = (at / SECTOR_BYTES * SECTOR_BYTES + SECTOR_BYTES).min(len);
            if random.below(10) >= kept_of_ten {
                disk[at..end].fill(0);
            }
            at = end;
        }
        (disk, synced)
    }

    fn check(&self, disk: &[u8], synced: usize) {
        // Before the first sync nothing is promised, and the file may not open as a take.
        if mocapd_take::TakeFrames::open(io::Cursor::new(disk)).is_err() {
            assert_eq!(synced, 0, "a synced take cannot be opened");
            return;
        }
        let n_promised = if synced == 0 { 0 } else { rows(&self.written.bytes[..synced]).0.len() };
        let (found, problems) = rows(disk);
        assert!(found.len() >= n_promised, "{} of {n_promised} rows", found.len());
        assert!(found.len() <= self.rows.len());
        for (index, (row, sent)) in found.iter().zip(&self.rows).enumerate() {
            for (&position, &expected) in row.iter().zip(sent) {
                let is_same = position == expected || (is_gap(position) && is_gap(expected));
                assert!(is_same || is_gap(position), "{index}: {position:?} was never sent");
                assert!(is_same || index >= n_promised, "{index}: {expected:?} was synced");
            }
        }
        assert!(problems.is_empty() == (disk == self.written.bytes), "{problems:?}");
    }
}

#[test]
fn synced_data_is_read_back_and_nothing_is_invented() {
    let one = std::env::var("MOCAPD_SEED").ok().and_then(|seed| seed.parse::<u64>().ok());
    cut_power(one.map_or(SEEDS, |seed| seed..seed + 1));
}

#[test]
#[ignore = "minutes: nineteen thousand power cuts"]
fn synced_data_is_read_back_after_thousands_of_power_cuts() {
    cut_power(LONG_SEEDS);
}

fn cut_power(seeds: Range<u64>) {
    let motion = jump(21, 200.0, 3.0);
    let recordings: Vec<Recorded> = [
        (dense(1.0), Duration::ZERO),
        (fast(1.0), Duration::from_millis(2)),
        (lossless(), Duration::from_millis(5)),
    ]
    .into_iter()
    .map(|(codec, sync_every)| recorded(codec, sync_every, &motion))
    .collect();
    for seed in seeds {
        let recording = &recordings[seed as usize % recordings.len()];
        let (disk, synced) = recording.cut(&mut Seeded::new(seed));
        let checked = std::panic::catch_unwind(|| recording.check(&disk, synced));
        assert!(checked.is_ok(), "run it again with MOCAPD_SEED={seed}");
    }
}
