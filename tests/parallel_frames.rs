//! Recorded takes, decoded by several threads: the same frames as by one, including lost ones.

use std::{fs::File, io::BufReader};

use mocapd_acquire::parallel_frames::ParallelFrames;
use mocapd_take::{
    TakeFrames,
    motion::{FrameSource, GAP, Position, is_gap},
};

use crate::support::{config, crowd, dense, fast, jump, lossless, record};

fn bits(position: Position) -> [u32; 3] {
    if is_gap(position) { [u32::MAX; 3] } else { position.map(f32::to_bits) }
}

/// 25 s make three key stretches, with many others between them.
#[test]
fn several_threads_decode_the_same_frames_as_one() {
    let folder = tempfile::tempdir().unwrap();
    for (name, motion, codec) in [
        ("dense", jump(1, 60.0, 25.0), dense(0.5)),
        ("two groups", crowd(2, 30.0, 25.0), fast(1.0)),
        ("lossless", jump(3, 60.0, 25.0), lossless()),
    ] {
        // Some are lost, long runs among them.
        let n = motion.n_frames();
        let frames = (0..n).filter(|seq| seq % 97 != 50 && !(n / 2..n / 2 + 200).contains(seq));
        let (_, take, _) = record(&motion, &config(&motion, codec), frames);
        let path = folder.path().join(name);
        std::fs::write(&path, take).unwrap();
        let open = || TakeFrames::open(BufReader::new(File::open(&path).unwrap())).unwrap();
        let mut one = open();
        let mut parallel =
            ParallelFrames::start(&path, &open(), 0, 3).unwrap().expect("an intact take");
        assert_eq!(parallel.info(), one.info());
        let mut rows = [vec![GAP; motion.info.markers.len()], vec![GAP; motion.info.markers.len()]];
        let [mine, its] = &mut rows;
        let mut n_present = 0;
        for index in 0..one.info().n_frames {
            assert!(one.next_frame(mine).unwrap() && parallel.next_frame(its).unwrap());
            let same = mine.iter().zip(&*its).all(|(&a, &b)| bits(a) == bits(b));
            assert!(same, "{name}: frame {index}");
            n_present += mine.iter().filter(|&&position| !is_gap(position)).count();
        }
        assert!(!parallel.next_frame(its).unwrap() && !parallel.is_damaged());
        // From the middle on: at a key, after one, and in the rows that were lost.
        for first in [n as u64 / 3, n as u64 / 2 + 50, n as u64 - 1] {
            let mut whole = open();
            whole.seek(first).unwrap();
            let mut parallel =
                ParallelFrames::start(&path, &open(), first, 2).unwrap().expect("an intact take");
            while whole.next_frame(mine).unwrap() {
                assert!(parallel.next_frame(its).unwrap());
                assert!(
                    mine.iter().zip(&*its).all(|(&a, &b)| bits(a) == bits(b)),
                    "{name}: from {first}"
                );
            }
            assert!(!parallel.next_frame(its).unwrap());
        }
        assert!(n_present > motion.positions_mm.len() / 2, "{name}: {n_present}");
    }
}
