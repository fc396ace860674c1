//! Counts notes and refusals of whole generated bodies in every pose: none of them is justified.
//!
//!     cargo run --release -p mocapd-body --features measure --example doubts [-- FIRST_SEED LAST_SEED]
//!
//! A line is printed for each body that is refused or gets a note, and a line of counts for each pose.
#![expect(clippy::print_stdout, reason = "what an example is for")]

use std::collections::BTreeMap;
use std::error::Error;

use mocapd_body::ScanAnalysis;
use mocapd_body::skeleton::Method;
use mocapd_testkit::synthetic_body::{BodyOptions, Pose, body};

/// Seeds that were not used to choose any threshold.
const SEEDS: [u64; 2] = [100, 160];

fn main() -> Result<(), Box<dyn Error>> {
    let mut seeds = SEEDS;
    for (given, seed) in std::env::args().skip(1).zip(&mut seeds) {
        *seed = given.parse()?;
    }
    for pose in Pose::ALL {
        let mut count = BTreeMap::<&str, u32>::new();
        for seed in seeds[0]..=seeds[1] {
            let (mesh, _) = body(seed, pose, BodyOptions::default());
            let codes = match ScanAnalysis::new(&mesh, Method::Default) {
                Ok(analysis) => analysis.notes.iter().map(|note| note.code).collect(),
                Err(refusal) => vec!["refused", refusal.code()],
            };
            if !codes.is_empty() {
                println!("{pose:?} {seed}: {}", codes.join(", "));
            }
            for code in if codes.is_empty() { vec!["no doubt"] } else { codes } {
                *count.entry(code).or_default() += 1;
            }
        }
        println!("{pose:?}: {count:?}");
    }
    Ok(())
}
