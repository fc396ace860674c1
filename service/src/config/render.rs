//! Checked values as they are written: read again, each is exactly itself.

use std::{fmt::Write, path::Path, time::Duration};

use serde_json::{Value as Json, json};

use super::{
    Config,
    keys::{KEYS, SECTIONS},
};

impl Config {
    /// Every key that has a value, as a file that is read as this configuration again, wherever mocapd runs.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let mut out = String::new();
        for (section, _) in SECTIONS {
            // Writing into a String does not fail.
            writeln!(out, "[{section}]").ok();
            for key in KEYS.iter().filter(|key| key.section() == *section) {
                if let Some(value) = (key.written)(self) {
                    // Texts, numbers, booleans and lists of texts are the same in JSON and TOML.
                    writeln!(out, "{} = {value}", key.name()).ok();
                }
            }
        }
        out
    }

    /// Every key with its value; `None` where it has none.
    pub fn values(&self) -> impl Iterator<Item = (&'static str, Option<Json>)> + '_ {
        KEYS.iter().map(|key| (key.path, (key.written)(self)))
    }
}

pub(super) fn duration(time: Duration) -> Option<Json> {
    Some(json!(duration_text(time)))
}

pub(super) fn size(bytes: u64) -> Option<Json> {
    Some(json!(size_text(bytes)))
}

/// Paths come from texts and are texts.
pub(super) fn path(path: &Path) -> Option<Json> {
    path.to_str().map(|text| json!(text))
}

/// In the largest unit that needs no fraction, and otherwise in seconds with every digit.
pub(super) fn duration_text(time: Duration) -> String {
    let (s, ns) = (time.as_secs(), time.subsec_nanos());
    match (s, ns) {
        (0, 0) => "0s".to_owned(),
        (s, 0) if s % 3600 == 0 => format!("{}h", s / 3600),
        (s, 0) if s % 60 == 0 => format!("{}min", s / 60),
        (s, 0) => format!("{s}s"),
        (0, ns) if ns % 1_000_000 == 0 => format!("{}ms", ns / 1_000_000),
        _ => format!("{}s", format!("{s}.{ns:09}").trim_end_matches('0')),
    }
}

/// In the largest binary unit that needs no fraction.
pub(super) fn size_text(bytes: u64) -> String {
    let units = [(40, "TiB"), (30, "GiB"), (20, "MiB"), (10, "KiB")];
    let fits = |shift: u32| bytes > 0 && bytes.trailing_zeros() >= shift;
    match units.into_iter().find(|&(shift, _)| fits(shift)) {
        Some((shift, unit)) => format!("{}{unit}", bytes >> shift),
        None => format!("{bytes}B"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units;

    #[test]
    fn times_and_sizes_are_read_back_exactly() {
        for (ms, text) in [
            (0, "0s"),
            (250, "250ms"),
            (1500, "1.5s"),
            (10_000, "10s"),
            (90_000, "90s"),
            (600_000, "10min"),
            (7_200_000, "2h"),
        ] {
            assert_eq!(duration_text(Duration::from_millis(ms)), text);
        }
        // Up to the longest that a key takes, to the nanosecond.
        let mut time = Duration::from_nanos(1);
        while time < Duration::from_secs(744 * 3600) {
            assert_eq!(units::duration(&duration_text(time)), Ok(time), "{time:?}");
            time = time * 17 / 10 + Duration::from_nanos(3);
        }
        let mut bytes = 1_u64;
        while bytes < 1 << 50 {
            assert_eq!(units::size_bytes(&size_text(bytes)), Ok(bytes), "{bytes}");
            bytes = bytes * 17 / 10 + 3;
        }
        assert_eq!(size_text(256 << 20), "256MiB");
        assert_eq!(size_text(0), "0B");
    }
}
