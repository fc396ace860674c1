//! `bench`: what this machine can do.

mod codec;
mod device;
mod in_process;
mod pipeline;
mod reference;

use clap::Subcommand;
use mocapd::outcome::Outcome;

#[derive(Debug, Subcommand)]
pub(crate) enum Bench {
    /// Sizes, errors and speeds of the resamplers on your own files, one core
    Codec(codec::Args),
    /// The whole way from a simulated device through a pty to disk, and the pipeline alone
    Pipeline(pipeline::Args),
    /// The device that `bench pipeline` records, in a process of its own
    #[command(hide = true)]
    Device(device::Args),
}

pub(crate) fn run(bench: &Bench) -> anyhow::Result<Outcome> {
    match bench {
        Bench::Codec(args) => codec::run(args),
        Bench::Pipeline(args) => pipeline::run(args),
        Bench::Device(args) => device::run(args),
    }
}

/// The middle one; of an even number the lower of the two.
fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut sorted: Vec<_> = values.into_iter().collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len().saturating_sub(1) / 2).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_one() {
        assert!((median([3.0, 1.0, 2.0]) - 2.0).abs() < 1e-9);
        assert!((median([4.0, 1.0, 2.0, 3.0]) - 2.0).abs() < 1e-9);
        assert!(median([]).is_nan());
    }
}
