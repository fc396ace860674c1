use std::sync::mpsc;

use crossbeam_channel::{Receiver, Sender};
use mocapd_drivers::{raw_log::records, transport::Transport};
use mocapd_testkit::memory;

use super::*;

/// A tap with a few blocks, which the test receives and returns in place of the writing thread.
fn tap(blocks: usize) -> (RawLogTap, Receiver<Block>, Sender<Block>) {
    let (full, written) = bounded(blocks);
    let (free, emptied) = bounded(blocks);
    (0..blocks).for_each(|_| free.send(Block::new()).unwrap());
    (RawLogTap::new(monotonic_ns(), full, emptied, Arc::default()), written, free)
}

#[test]
fn a_stalled_disk_costs_bytes_of_the_log_and_the_log_counts_them() {
    let (tap, written, free) = tap(2);
    let (mut device, line) = memory::pair(1 << 20);
    let mut line = tap.wrap("dvmc", Box::new(line));
    let mut buffer = vec![0; 1 << 16];
    let mut log = Vec::new();
    put_header(&mut log);
    let mut passed = 0;
    // Far more than two blocks hold, and nothing is written: every read returns nevertheless.
    for round in 0..20u8 {
        device.write_all(&vec![round; 40_000]).unwrap();
        let mut got = 0;
        while got < 40_000 {
            let n = line.read(&mut buffer).unwrap();
            assert!(buffer[..n].iter().all(|byte| *byte == round));
            got += n;
        }
        passed += got as u64;
    }
    line.write_all(b"ping").unwrap();
    passed += 4;
    // The disk is back.
    let mut counted = 0;
    let mut give_back = |mut block: Block| {
        log.extend_from_slice(&block.bytes);
        counted += block.line_bytes;
        block.clear();
        // At the end the tap that would receive it is gone.
        free.send(block).ok();
    };
    written.try_iter().for_each(&mut give_back);
    device.write_all(b"late").unwrap();
    assert_eq!(line.read(&mut buffer).unwrap(), 4);
    passed += 4;
    drop(line);
    let totals = tap.end();
    written.try_iter().for_each(&mut give_back);

    let (mut found, mut missing, mut last) = (0, 0, None);
    for record in records(&log).unwrap() {
        let entry = record.unwrap().entry;
        match entry {
            Entry::FromDevice(bytes) | Entry::ToDevice(bytes) => found += bytes.len() as u64,
            Entry::Missing(bytes) => missing += bytes,
            _ => {}
        }
        last = Some(entry);
    }
    assert_eq!(last, Some(Entry::End));
    assert!(missing > 0 && found > 80_000, "{found} and {missing}");
    assert_eq!(found + missing, passed);
    assert_eq!((totals.line_bytes.load(Ordering::Relaxed), counted), (passed, found));
}

#[test]
fn a_slow_line_fills_its_blocks_while_the_disk_stalls() {
    let (mut tap, written, _free) = tap(4);
    for byte in 0..100 {
        tap.put(Entry::FromDevice(&[byte]));
        tap.block_since_ns = 0;
        tap.tick();
    }
    let handed_over = written.try_iter().count();
    assert_eq!(handed_over, 2, "half of the blocks wait for the disk, and no block is lost");
    assert_eq!(tap.totals.unreported_bytes.load(Ordering::Relaxed), 0);
    assert_eq!(tap.block.line_bytes, 98);
}

/// A disk that reports the bytes written between its syncs, and has space for a given number of bytes.
struct Disk {
    space: usize,
    unsynced: usize,
    synced: mpsc::SyncSender<usize>,
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.space = self.space.checked_sub(bytes.len()).ok_or(io::ErrorKind::StorageFull)?;
        self.unsynced += bytes.len();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl LogOutput for Disk {
    fn sync(&mut self) -> io::Result<()> {
        self.synced.send(std::mem::take(&mut self.unsynced)).unwrap();
        Ok(())
    }
}

/// A log on a [`Disk`]: what was synced, a function that submits blocks of a given size, and the result.
fn start_log(
    space: usize,
    sync_every: Duration,
) -> (mpsc::Receiver<usize>, impl Fn(usize), impl FnOnce() -> WriterOutcome) {
    let (synced_in, synced) = mpsc::sync_channel(100);
    let (full, blocks) = bounded(BLOCKS);
    let (free, emptied) = bounded(BLOCKS);
    let disk = Disk { space, unsynced: 0, synced: synced_in };
    let work = move || write_blocks(disk, &AtomicU64::new(0), sync_every, &blocks, &free);
    let thread = threads::spawn("test", work).unwrap();
    let hand_over = full.clone();
    let put = move |n: usize| {
        let _keep = &emptied;
        hand_over.send(Block { bytes: vec![7; n], line_bytes: n as u64 - 1 }).unwrap();
    };
    (synced, put, move || {
        drop(full);
        threads::join(thread).unwrap()
    })
}

#[test]
fn written_blocks_are_synced_in_time_and_at_the_end() {
    let (synced, put, finish) = start_log(1000, Duration::from_millis(100));
    // The head is synced, though nothing follows.
    assert_eq!(synced.recv_timeout(Duration::from_secs(20)).unwrap(), 0);
    put(10);
    put(20);
    let mut first = 0;
    while first < 30 {
        first += synced.recv_timeout(Duration::from_secs(20)).unwrap();
    }
    std::thread::sleep(Duration::from_millis(300));
    assert!(synced.try_recv().is_err(), "nothing new was there to sync");
    put(30);
    drop(put);
    let written = finish();
    assert_eq!((written.line_bytes, written.error.is_none()), (57, true));
    assert_eq!(synced.iter().sum::<usize>(), 30);
}

#[test]
fn a_disk_that_fills_up_ends_the_log_and_its_bytes_are_counted_as_missing() {
    let (_synced, put, finish) = start_log(100, Duration::ZERO);
    (0..BLOCKS * 3).for_each(|_| put(40));
    drop(put);
    let written = finish();
    assert_eq!(written.line_bytes, 2 * 39, "those of whole blocks");
    assert_eq!(written.error.unwrap().kind(), io::ErrorKind::StorageFull);
}
