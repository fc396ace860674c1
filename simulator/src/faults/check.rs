//! What a script may say: unknown keys, kinds and values out of range, each with its place and what to write.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::keys::{KINDS, Key, KindKeys, WINDOW};
use super::nearest::nearest;
use super::script::FAULTS_MAX;

/// What is wrong, and at which byte.
type Wrong = (usize, String);

/// The tables and keys beside the faults.
const TOP: &[&str] = &["seed", "fault", "expect"];
const LEDGER: &[&str] = &["exact", "by-host-clock"];
const EXPECT: &[&str] = &["exit", "ledger", "contradictions", "events", "at_least"];

pub(super) fn check(text: &str) -> Result<(), Wrong> {
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
