//! Fault scripts: TOML as written, checked key by key, into faults.

use serde::Deserialize;

use super::check;
use super::expect::Expect;
use super::fault::Fault;
use super::kinds::Kind;

/// Bytes of a script: the longest that ships has 2 kB.
pub const SCRIPT_BYTES_MAX: usize = 256 << 10;

/// Faults in a script.
pub const FAULTS_MAX: usize = 64;

/// What goes wrong, and when. The same script and motion give the same damage.
#[derive(Debug, Clone, PartialEq)]
pub struct Script {
    /// What all that is random comes from.
    pub seed: u64,
    /// Every fault, as written.
    pub faults: Vec<Windowed>,
    /// What a recording of it comes to: for tests, the device does not look at it.
    pub expect: Option<Expect>,
}

/// A fault and when it is there.
#[derive(Debug, Clone, PartialEq)]
pub struct Windowed {
    /// Which one.
    pub fault: Fault,
    /// From this time on, in nanoseconds since the first Start.
    pub from_ns: u64,
    /// Until before this time.
    pub to_ns: u64,
}

impl Windowed {
    /// Whether it is there at this time.
    #[must_use]
    pub fn is_on(&self, since_ns: u64) -> bool {
        (self.from_ns..self.to_ns).contains(&since_ns)
    }
}

/// Why a script is none: one line.
#[derive(Debug, thiserror::Error)]
#[error("{name} line {line}: {message}")]
pub struct ScriptError {
    /// The script.
    pub name: String,
    /// Where, from 1.
    pub line: usize,
    /// What cannot be meant, and what to write.
    pub message: String,
}

#[derive(Deserialize)]
struct Written {
    seed: u64,
    #[serde(default)]
    fault: Vec<toml::Table>,
    expect: Option<Expect>,
}

#[derive(Deserialize)]
struct Window {
    #[serde(default)]
    from_s: f64,
    to_s: Option<f64>,
}

impl Script {
    /// Reads a script; errors call it `name`.
    ///
    /// # Errors
    /// With the line, and what to write there.
    pub fn parse(name: &str, text: &str) -> Result<Self, ScriptError> {
        let refused = |at: usize, message: String| {
            let line = 1 + text.bytes().take(at).filter(|byte| *byte == b'\n').count();
            let message = message.split('\n').collect::<Vec<_>>().join(", ");
            ScriptError { name: name.to_owned(), line, message }
        };
        if text.len() > SCRIPT_BYTES_MAX {
            return Err(refused(0, format!("a script has at most {SCRIPT_BYTES_MAX} bytes")));
        }
        check::check(text).map_err(|(at, message)| refused(at, message))?;
        let of_toml = |error: toml::de::Error| {
            refused(error.span().map_or(0, |span| span.start), error.message().to_owned())
        };
        let written: Written = toml::from_str(text).map_err(of_toml)?;
        let mut faults = Vec::new();
        for table in written.fault {
            let fault: Fault = table.clone().try_into().map_err(of_toml)?;
            let window: Window = table.try_into().map_err(of_toml)?;
            faults.push(Windowed {
                fault,
                from_ns: nanoseconds(window.from_s),
                to_ns: window.to_s.map_or(u64::MAX, nanoseconds),
            });
        }
        Ok(Self { seed: written.seed, faults, expect: written.expect })
    }

    /// Whether a fault of this kind is in it.
    #[must_use]
    pub fn has(&self, kind: Kind) -> bool {
        self.faults.iter().any(|windowed| windowed.fault.kind() == kind)
    }

    /// Whether it needs a line that can be taken away and brought back under its name.
    #[must_use]
    pub fn unplugs(&self) -> bool {
        self.faults.iter().any(|windowed| {
            matches!(
                windowed.fault,
                Fault::Unplug { .. } | Fault::PowerLoss { keeps_port: false, .. }
            )
        })
    }

    /// The markers that are not there, at most at once.
    #[must_use]
    pub fn n_ghosts(&self) -> usize {
        let counts = self.faults.iter().map(|windowed| match windowed.fault {
            Fault::Ghosts { count } => usize::from(count),
            _ => 0,
        });
        counts.sum()
    }
}

/// Of a time that was checked.
pub(super) fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}
