//! Fault scripts: TOML as written, checked key by key, into faults. What is refused has its place, and what to write.

use serde::Deserialize;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::kinds::{Fault, KINDS, Key, Kind, KindKeys, WINDOW};

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
    fault: Vec<WrittenFault>,
    expect: Option<Expect>,
}

#[derive(Deserialize)]
struct WrittenFault {
    #[serde(flatten)]
    fault: Fault,
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
        check(text).map_err(|(at, message)| refused(at, message))?;
        let written: Written = toml::from_str(text).map_err(|error| {
            refused(error.span().map_or(0, |span| span.start), error.message().to_owned())
        })?;
        let windowed = |WrittenFault { fault, from_s, to_s }| Windowed {
            fault,
            from_ns: nanoseconds(from_s),
            to_ns: to_s.map_or(u64::MAX, nanoseconds),
        };
        let faults = written.fault.into_iter().map(windowed).collect();
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

/// What a recording under the script comes to.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub struct Expect {
    /// The recorder's exit code.
    pub exit: u8,
    /// What its ledger agrees with.
    #[serde(default)]
    pub ledger: Agreement,
    /// A piece of each contradiction that its ledger tells; no other may be told.
    #[serde(default)]
    pub contradictions: Vec<String>,
    /// A piece of each event that stands in the take; no other may.
    #[serde(default)]
    pub events: Vec<String>,
    /// Frames that must be missing or double, so that the script is not one that does nothing.
    #[serde(default)]
    pub at_least: u64,
}

/// How far a ledger agrees with the device's log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum Agreement {
    /// Every count is the log's.
    #[default]
    Exact,
    /// Counter and clock began anew: frames that were due meanwhile are by the host's clock, all else is the log's.
    ByHostClock,
}

/// What is wrong, and at which byte.
type Wrong = (usize, String);

/// The tables and keys beside the faults.
const TOP: &[&str] = &["seed", "fault", "expect"];
const LEDGER: &[&str] = &["exact", "by-host-clock"];
const EXPECT: &[&str] = &["exit", "ledger", "contradictions", "events", "at_least"];

fn check(text: &str) -> Result<(), Wrong> {
    let document = DeTable::parse(text)
        .map_err(|error| (error.span().map_or(0, |span| span.start), error.message().to_owned()))?;
    let table = document.get_ref();
    only(table, TOP, "a script")?;
    match table.get("seed") {
        None => {
            return Err((
                0,
                "no seed: write `seed = 1` in front, so that it can be repeated".to_owned(),
            ));
        }
        Some(seed) => whole("seed", seed, i64::MAX)?,
    }
    if let Some(value) = table.get("expect") {
        expect(value)?;
    }
    let Some(faults) = table.get("fault") else { return Ok(()) };
    let Some(list) = faults.get_ref().as_array() else {
        return Err((faults.span().start, "write [[fault]], in double brackets".to_owned()));
    };
    if list.len() > FAULTS_MAX {
        return Err((faults.span().start, format!("a script has at most {FAULTS_MAX} faults")));
    }
    list.iter().try_for_each(fault)
}

fn only(table: &DeTable<'_>, known: &[&str], where_: &str) -> Result<(), Wrong> {
    for key in table.keys() {
        if !known.contains(&key.get_ref().as_ref()) {
            return Err(unknown(key, known, where_));
        }
    }
    Ok(())
}

fn unknown(key: &Spanned<std::borrow::Cow<'_, str>>, known: &[&str], where_: &str) -> Wrong {
    let word = key.get_ref();
    let meant = match nearest(word, known.iter().copied()) {
        Some(name) => format!("did you mean '{name}'?"),
        None => format!("it has {}", known.join(", ")),
    };
    (key.span().start, format!("unknown key '{}' in {where_}: {meant}", word.escape_debug()))
}

/// What a script says of a recording of it.
fn expect(value: &Spanned<DeValue<'_>>) -> Result<(), Wrong> {
    let Some(table) = value.get_ref().as_table() else {
        return Err((value.span().start, "write [expect], in brackets".to_owned()));
    };
    only(table, EXPECT, "[expect]")?;
    for (key, max) in [("exit", i64::from(u8::MAX)), ("at_least", i64::MAX)] {
        match table.get(key) {
            Some(value) => whole(key, value, max)?,
            None if key == "exit" => {
                return Err((
                    value.span().start,
                    "[expect] needs 'exit' (an exit code)".to_owned(),
                ));
            }
            None => {}
        }
    }
    if let Some(ledger) = table.get("ledger")
        && !ledger.get_ref().as_str().is_some_and(|word| LEDGER.contains(&word))
    {
        return Err((ledger.span().start, format!("ledger is one of {}", LEDGER.join(", "))));
    }
    for key in ["contradictions", "events"] {
        let Some(list) = table.get(key) else { continue };
        let texts = list.get_ref().as_array();
        if !texts.is_some_and(|texts| texts.iter().all(|text| text.get_ref().is_str())) {
            return Err((list.span().start, format!("{key} is a list of texts: give [\"...\"]")));
        }
    }
    Ok(())
}

/// A count.
fn whole(name: &str, value: &Spanned<DeValue<'_>>, max: i64) -> Result<(), Wrong> {
    let fits = match value.get_ref() {
        DeValue::Integer(integer) => i64::from_str_radix(integer.as_str(), integer.radix())
            .is_ok_and(|n| (0..=max).contains(&n)),
        _ => false,
    };
    if fits {
        return Ok(());
    }
    let wrong = wrong_type(value, name, "a number").unwrap_or(format!("{name} is out of range"));
    Err((value.span().start, format!("{wrong}: give a whole number from 0 to {max}")))
}

/// That a value is not even of the type that belongs there.
fn wrong_type(value: &Spanned<DeValue<'_>>, name: &str, wanted: &str) -> Option<String> {
    let found = match value.get_ref() {
        DeValue::String(_) => "a text",
        DeValue::Integer(_) | DeValue::Float(_) => "a number",
        DeValue::Boolean(_) => "true or false",
        DeValue::Datetime(_) => "a date",
        DeValue::Array(_) => "a list",
        DeValue::Table(_) => "a table",
    };
    (found != wanted).then(|| format!("{name} is {found}, not {wanted}"))
}

fn fault(value: &Spanned<DeValue<'_>>) -> Result<(), Wrong> {
    let at = value.span().start;
    let Some(table) = value.get_ref().as_table() else {
        return Err((at, "write [[fault]], in double brackets".to_owned()));
    };
    let kinds = || KINDS.iter().map(|keys| keys.name);
    let all = || kinds().collect::<Vec<_>>().join(", ");
    let Some(written) = table.get("kind") else {
        return Err((at, format!("a fault without a kind: it is one of {}", all())));
    };
    if let Some(wrong) = wrong_type(written, "kind", "a text") {
        return Err((written.span().start, format!("{wrong}: it is one of {}", all())));
    }
    let word = written.get_ref().as_str().unwrap_or("");
    let Some(keys) = KINDS.iter().find(|keys| keys.name == word) else {
        let meant = match nearest(word, kinds()) {
            Some(name) => format!("did you mean '{name}'?"),
            None => format!("it is one of {}", all()),
        };
        let message = format!("unknown kind of fault '{}': {meant}", word.escape_debug());
        return Err((written.span().start, message));
    };
    keys_of(table, keys, at)
}

fn keys_of(table: &DeTable<'_>, kind: &KindKeys, at: usize) -> Result<(), Wrong> {
    let window: &[Key] = if kind.windowed { WINDOW } else { &[] };
    let keys = || kind.keys.iter().chain(window);
    let known: Vec<&str> = std::iter::once("kind").chain(keys().map(|key| key.name)).collect();
    only(table, &known, &format!("a fault of kind '{}'", kind.name))?;
    for key in keys() {
        match table.get(key.name) {
            Some(value) => in_range(value, key)?,
            None if key.optional => {}
            None => {
                let message =
                    format!("a fault of kind '{}' needs '{}' ({})", kind.name, key.name, key.unit);
                return Err((at, message));
            }
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

fn number(value: &DeValue<'_>) -> Option<f64> {
    match value {
        DeValue::Integer(integer) => {
            i64::from_str_radix(integer.as_str(), integer.radix()).ok().map(|n| n as f64)
        }
        DeValue::Float(float) => float.as_str().parse().ok(),
        _ => None,
    }
}

fn in_range(value: &Spanned<DeValue<'_>>, key: &Key) -> Result<(), Wrong> {
    let Key { name, unit, min, max, .. } = key;
    let is_bool = *unit == "bool";
    let is_whole = ["frames", "markers", "bytes", "greetings", "ms"].contains(unit);
    let fits = match value.get_ref() {
        DeValue::Boolean(_) => is_bool,
        DeValue::Float(_) if is_whole => false,
        other => !is_bool && number(other).is_some_and(|n| (*min..=*max).contains(&n)),
    };
    if fits {
        return Ok(());
    }
    let wanted = match (is_bool, is_whole) {
        (true, _) => "true or false".to_owned(),
        (_, true) => format!("a whole number from {min} to {max} ({unit})"),
        _ => format!("{min} to {max} ({unit})"),
    };
    let type_wanted = if is_bool { "true or false" } else { "a number" };
    let wrong =
        wrong_type(value, name, type_wanted).unwrap_or_else(|| format!("{name} is out of range"));
    Err((value.span().start, format!("{wrong}: give {wanted}")))
}

/// The known word that is meant, when one is near: at most two letters away, or a third of a long word.
fn nearest<'a>(word: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    known
        .map(|name| (strsim::levenshtein(word, name), name))
        .filter(|(away, name)| *away <= 2.max(name.len() / 3))
        .min_by_key(|(away, _)| *away)
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
