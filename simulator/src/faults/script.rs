//! Parses fault scripts: TOML, checked key by key. Errors name the line and say what to write there.

use serde::Deserialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::{Fault, KINDS, KeySpec, Kind, KindSpec, WINDOW};

/// Maximum number of bytes in a script; the longest that ships has 2 kB.
pub const SCRIPT_BYTES_MAX: usize = 256 << 10;

/// Maximum number of faults in a script.
pub const FAULTS_MAX: usize = 64;

/// A fault script. The same script and motion give the same damage.
#[derive(Debug, Clone, PartialEq)]
pub struct Script {
    /// Seed of all random numbers.
    pub seed: u64,
    /// The faults, in the script's order.
    pub faults: Vec<ScheduledFault>,
    /// The expected result of a recording. Tests read it; the device does not.
    pub expect: Option<ExpectedRecording>,
}

/// A fault and the window in which it acts.
#[derive(Debug, Clone, PartialEq)]
pub struct ScheduledFault {
    /// The fault.
    pub fault: Fault,
    /// Start of the window, nanoseconds since the first Start.
    pub from_ns: u64,
    /// End of the window (exclusive), nanoseconds since the first Start.
    pub to_ns: u64,
}

impl ScheduledFault {
    /// Whether the window contains this time.
    #[must_use]
    pub fn is_on(&self, since_ns: u64) -> bool {
        (self.from_ns..self.to_ns).contains(&since_ns)
    }
}

/// An error in a script, in one line of text.
#[derive(Debug, thiserror::Error)]
#[error("{name} line {line}: {message}")]
pub struct ScriptError {
    /// The script's name.
    pub name: String,
    /// Line number, from 1.
    pub line: usize,
    /// What is wrong and what to write.
    pub message: String,
}

#[derive(Deserialize)]
struct ScriptFile {
    seed: u64,
    #[serde(default)]
    fault: Vec<FaultTable>,
    expect: Option<ExpectedRecording>,
}

#[derive(Deserialize)]
struct FaultTable {
    #[serde(flatten)]
    fault: Fault,
    #[serde(default)]
    from_s: f64,
    to_s: Option<f64>,
}

impl Script {
    /// Parses a script; errors call it `name`.
    ///
    /// # Errors
    /// When the text is not TOML, a key is unknown or missing, or a value is out of range.
    pub fn parse(name: &str, text: &str) -> Result<Self, ScriptError> {
        let refused = |at: usize, message: String| {
            let line = 1 + text.bytes().take(at).filter(|byte| *byte == b'\n').count();
            let message = message.split('\n').collect::<Vec<_>>().join(", ");
            ScriptError { name: name.to_owned(), line, message }
        };
        if text.len() > SCRIPT_BYTES_MAX {
            return Err(refused(0, format!("the script is longer than {SCRIPT_BYTES_MAX} bytes")));
        }
        check(text).map_err(|(at, message)| refused(at, message))?;
        let written: ScriptFile = toml::from_str(text).map_err(|error| {
            refused(error.span().map_or(0, |span| span.start), error.message().to_owned())
        })?;
        let scheduled = |FaultTable { fault, from_s, to_s }| ScheduledFault {
            fault,
            from_ns: nanoseconds(from_s),
            to_ns: to_s.map_or(u64::MAX, nanoseconds),
        };
        let faults = written.fault.into_iter().map(scheduled).collect();
        Ok(Self { seed: written.seed, faults, expect: written.expect })
    }

    /// Whether the script has a fault of this kind.
    #[must_use]
    pub fn has(&self, kind: Kind) -> bool {
        self.faults.iter().any(|scheduled| scheduled.fault.kind() == kind)
    }

    /// Whether the script pulls the cable, which needs a line that can come back under the same name.
    #[must_use]
    pub fn unplugs(&self) -> bool {
        self.faults.iter().any(|ScheduledFault { fault, .. }| {
            matches!(fault, Fault::Unplug { .. } | Fault::PowerLoss { keeps_port: false, .. })
        })
    }

    /// The faults that are on, with their indices.
    pub(crate) fn active(&self, since_ns: u64) -> impl Iterator<Item = (usize, &ScheduledFault)> {
        self.faults.iter().enumerate().filter(move |(_, scheduled)| scheduled.is_on(since_ns))
    }

    /// The most ghost markers that can be visible at once.
    #[must_use]
    pub fn n_ghosts(&self) -> usize {
        let counts = self.faults.iter().map(|scheduled| match scheduled.fault {
            Fault::Ghosts { count } => usize::from(count),
            _ => 0,
        });
        counts.sum()
    }
}

/// Converts a checked time, which fits.
pub(super) fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

/// The expected result of a recording under the script.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub struct ExpectedRecording {
    /// The recorder's exit code.
    pub exit: u8,
    /// How closely its ledger matches the device's log.
    #[serde(default)]
    pub ledger: LedgerMatch,
    /// A part of each contradiction in its ledger; there must be no others.
    #[serde(default)]
    pub contradictions: Vec<String>,
    /// A part of each event in the take; there must be no others.
    #[serde(default)]
    pub events: Vec<String>,
    /// Minimum number of missing or duplicate frames, which shows that the script has an effect.
    #[serde(default)]
    pub at_least: u64,
}

/// How closely a ledger matches the device's log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum LedgerMatch {
    /// Every count equals the log's.
    #[default]
    Exact,
    /// Counter and clock restarted: the frames due meanwhile are estimated from the host's clock, all other counts
    /// equal the log's.
    ByHostClock,
}

/// Byte offset and message of an error.
type CheckError = (usize, String);

/// The tables and keys at the top level.
const TOP: &[&str] = &["seed", "fault", "expect"];
const LEDGER: &[&str] = &["exact", "by-host-clock"];
const EXPECT: &[&str] = &["exit", "ledger", "contradictions", "events", "at_least"];

fn check(text: &str) -> Result<(), CheckError> {
    let document = DeTable::parse(text)
        .map_err(|error| (error.span().map_or(0, |span| span.start), error.message().to_owned()))?;
    let table = document.get_ref();
    check_keys(table, TOP, "a script")?;
    let Some(seed) = table.get("seed") else {
        let message = "missing seed: add `seed = 1` at the top, so that runs are repeatable";
        return Err((0, message.to_owned()));
    };
    check_whole("seed", seed, i64::MAX)?;
    if let Some(value) = table.get("expect") {
        check_expect(value)?;
    }
    let Some(faults) = table.get("fault") else { return Ok(()) };
    let Some(list) = faults.get_ref().as_array() else {
        return Err((faults.span().start, "expected [[fault]], in double brackets".to_owned()));
    };
    if list.len() > FAULTS_MAX {
        let message = format!("{} faults are more than the {FAULTS_MAX} of a script", list.len());
        return Err((faults.span().start, message));
    }
    list.iter().try_for_each(check_fault)
}

fn check_keys(table: &DeTable<'_>, known: &[&str], where_: &str) -> Result<(), CheckError> {
    let Some(key) = table.keys().find(|key| !known.contains(&key.get_ref().as_ref())) else {
        return Ok(());
    };
    let word = key.get_ref();
    let hint = hint(word, known);
    Err((key.span().start, format!("unknown key '{}' in {where_}: {hint}", word.escape_debug())))
}

/// The nearest known word, or all of them.
fn hint(word: &str, known: &[&str]) -> String {
    match nearest(word, known.iter().copied()) {
        Some(name) => format!("did you mean '{name}'?"),
        None => format!("expected one of {}", known.join(", ")),
    }
}

fn check_expect(value: &Spanned<DeValue<'_>>) -> Result<(), CheckError> {
    let at = value.span().start;
    let Some(table) = value.get_ref().as_table() else {
        return Err((at, "expected [expect], in brackets".to_owned()));
    };
    check_keys(table, EXPECT, "[expect]")?;
    for (key, max) in [("exit", i64::from(u8::MAX)), ("at_least", i64::MAX)] {
        match table.get(key) {
            Some(value) => check_whole(key, value, max)?,
            None if key == "exit" => {
                return Err((at, "[expect] needs 'exit' (an exit code)".to_owned()));
            }
            None => {}
        }
    }
    if let Some(ledger) = table.get("ledger")
        && !ledger.get_ref().as_str().is_some_and(|word| LEDGER.contains(&word))
    {
        return Err((ledger.span().start, format!("ledger must be one of {}", LEDGER.join(", "))));
    }
    for key in ["contradictions", "events"] {
        let Some(list) = table.get(key) else { continue };
        let texts = list.get_ref().as_array();
        if !texts.is_some_and(|texts| texts.iter().all(|text| text.get_ref().is_str())) {
            return Err((list.span().start, format!("{key} is not a list of strings [\"...\"]")));
        }
    }
    Ok(())
}

fn check_whole(name: &str, value: &Spanned<DeValue<'_>>, max: i64) -> Result<(), CheckError> {
    if integer(value.get_ref()).is_some_and(|n| (0..=max).contains(&n)) {
        return Ok(());
    }
    let wrong = wrong_type(value, name, "a number").unwrap_or(format!("{name} is out of range"));
    Err((value.span().start, format!("{wrong}: expected a whole number from 0 to {max}")))
}

/// The message for a value of another type; `None` when the type is right.
fn wrong_type(value: &Spanned<DeValue<'_>>, name: &str, wanted: &str) -> Option<String> {
    let found = match value.get_ref() {
        DeValue::String(_) => "a string",
        DeValue::Integer(_) | DeValue::Float(_) => "a number",
        DeValue::Boolean(_) => "a boolean",
        DeValue::Datetime(_) => "a date",
        DeValue::Array(_) => "a list",
        DeValue::Table(_) => "a table",
    };
    (found != wanted).then(|| format!("{name} is {found}, not {wanted}"))
}

fn check_fault(value: &Spanned<DeValue<'_>>) -> Result<(), CheckError> {
    let at = value.span().start;
    let Some(table) = value.get_ref().as_table() else {
        return Err((at, "expected [[fault]], in double brackets".to_owned()));
    };
    let kinds: Vec<_> = KINDS.iter().map(|keys| keys.name).collect();
    let all = || kinds.join(", ");
    let Some(written) = table.get("kind") else {
        return Err((at, format!("missing key 'kind': expected one of {}", all())));
    };
    if let Some(wrong) = wrong_type(written, "kind", "a string") {
        return Err((written.span().start, format!("{wrong}: expected one of {}", all())));
    }
    let word = written.get_ref().as_str().unwrap_or("");
    let Some(keys) = KINDS.iter().find(|keys| keys.name == word) else {
        let hint = hint(word, &kinds);
        let message = format!("unknown kind of fault '{}': {hint}", word.escape_debug());
        return Err((written.span().start, message));
    };
    check_fault_keys(table, keys, at)
}

fn check_fault_keys(table: &DeTable<'_>, kind: &KindSpec, at: usize) -> Result<(), CheckError> {
    let window: &[KeySpec] = if kind.windowed { WINDOW } else { &[] };
    let keys = || kind.keys.iter().chain(window);
    let known: Vec<&str> = std::iter::once("kind").chain(keys().map(|key| key.name)).collect();
    let what = format!("a fault of kind '{}'", kind.name);
    check_keys(table, &known, &what)?;
    for key in keys() {
        match table.get(key.name) {
            Some(value) => check_range(value, key)?,
            None if key.optional => {}
            None => return Err((at, format!("{what} needs '{}' ({})", key.name, key.unit))),
        }
    }
    let time = |name| table.get(name).and_then(|value| number(value.get_ref()));
    match (time("from_s"), time("to_s")) {
        (from, Some(to)) if to <= from.unwrap_or(0.0) => {
            Err((at, "to_s must be later than from_s".to_owned()))
        }
        _ => Ok(()),
    }
}

fn integer(value: &DeValue<'_>) -> Option<i64> {
    let integer = value.as_integer()?;
    i64::from_str_radix(integer.as_str(), integer.radix()).ok()
}

fn number(value: &DeValue<'_>) -> Option<f64> {
    match value {
        DeValue::Float(float) => float.as_str().parse().ok(),
        other => integer(other).map(|n| n as f64),
    }
}

fn check_range(value: &Spanned<DeValue<'_>>, key: &KeySpec) -> Result<(), CheckError> {
    let KeySpec { name, unit, min, max, .. } = key;
    let is_bool = *unit == "bool";
    let is_whole = ["frames", "markers", "bytes", "Hellos", "ms"].contains(unit);
    let fits = match value.get_ref() {
        DeValue::Boolean(_) => is_bool,
        DeValue::Float(_) if is_whole => false,
        other => !is_bool && number(other).is_some_and(|n| (*min..=*max).contains(&n)),
    };
    if fits {
        return Ok(());
    }
    let expected = match (is_bool, is_whole) {
        (true, _) => "true or false".to_owned(),
        (_, true) => format!("a whole number from {min} to {max} ({unit})"),
        _ => format!("{min} to {max} ({unit})"),
    };
    let expected_type = if is_bool { "a boolean" } else { "a number" };
    let wrong = wrong_type(value, name, expected_type).unwrap_or(format!("{name} is out of range"));
    Err((value.span().start, format!("{wrong}: expected {expected}")))
}

/// The nearest known word within an edit distance of 2, or of a third of a longer word's length.
fn nearest<'a>(word: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    known
        .map(|name| (strsim::levenshtein(word, name), name))
        .filter(|(distance, name)| *distance <= 2.max(name.len() / 3))
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, name)| name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_word() {
        assert_eq!(strsim::levenshtein("kitten", "sitting"), 3);
        assert_eq!(nearest("rat", ["rate", "run"].into_iter()), Some("rate"));
        assert_eq!(nearest("bitflips", ["bit-flips", "stall"].into_iter()), Some("bit-flips"));
        assert_eq!(nearest("seconds", ["rate", "run"].into_iter()), None);
    }
}
