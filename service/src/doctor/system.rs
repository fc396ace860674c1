//! The machine itself: processors and memory.

use std::fs;

use super::Finding;

/// The rings, coded stretches and a stall of 30 s at 200 markers x 1000 Hz, and as much for everything else.
const MEMORY_MIB_LEAST: u64 = 600;

pub(super) fn examine(tell: &mut dyn FnMut(Finding)) {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    tell(processors(cores));
    if let Some(finding) = fs::read_to_string("/proc/meminfo").ok().and_then(|text| memory(&text)) {
        tell(finding);
    }
}

fn processors(cores: usize) -> Finding {
    let what = "processors";
    match cores {
        1 => Finding::warning(
            what,
            "one: reading, coding and writing share it",
            "record with --resampler fast",
        ),
        n => Finding::good(what, format!("{n}")),
    }
}

fn memory(text: &str) -> Option<Finding> {
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let mib = line.split_whitespace().next()?.parse::<u64>().ok()? / 1024;
    let seen = format!("{mib} MiB available");
    Some(if mib < MEMORY_MIB_LEAST {
        Finding::warning("memory", seen, "close what else runs here")
    } else {
        Finding::good("memory", seen)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::Verdict;

    #[test]
    fn what_is_found_of_the_machine() {
        assert_eq!(processors(1).verdict, Verdict::Warning);
        assert_eq!(processors(4).verdict, Verdict::Good);
        let text = "MemTotal:  8000000 kB\nMemAvailable:  4000000 kB\n";
        assert_eq!(memory(text).unwrap().seen, "3906 MiB available");
        assert_eq!(memory("MemAvailable: 100000 kB\n").unwrap().verdict, Verdict::Warning);
        assert_eq!(memory(""), None);
    }
}
