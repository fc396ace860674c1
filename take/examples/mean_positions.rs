//! Reads a take frame by frame and prints the mean position of each marker.
//!
//!     cargo run -p mocapd-take --example mean_positions -- run.take

#![expect(clippy::print_stdout, clippy::print_stderr, reason = "an example shows what it does")]

use std::{env, error::Error, fs::File, io::BufReader};

use mocapd_take::{
    TakeFrames,
    motion::{FrameSource, GAP, is_gap},
};

fn main() -> Result<(), Box<dyn Error>> {
    let path = env::args().nth(1).ok_or("name a take: mean_positions run.take")?;
    let mut frames = TakeFrames::open(BufReader::new(File::open(path)?))?;
    let info = frames.info().clone();
    println!("{} frames of {} markers at {} Hz", info.n_frames, info.markers.len(), info.rate_hz);
    let mut row = vec![GAP; info.markers.len()];
    let mut sums = vec![(0_u64, [0.0_f64; 3]); info.markers.len()];
    while frames.next_frame(&mut row)? {
        for (position, (n, sum)) in row.iter().zip(&mut sums).filter(|(at, _)| !is_gap(**at)) {
            *n += 1;
            sum.iter_mut().zip(position).for_each(|(sum, value)| *sum += f64::from(*value));
        }
    }
    for (marker, (n, sum)) in info.markers.iter().zip(&sums).filter(|(_, (n, _))| *n > 0) {
        let [x, y, z] = sum.map(|sum| sum / *n as f64);
        println!("{:12} {x:9.1} {y:9.1} {z:9.1} mm, {n} samples", marker.label);
    }
    for problem in frames.problems() {
        eprintln!("{problem}");
    }
    Ok(())
}
