//! A value as it is written, with its place: nothing is known of what it should be.

use toml::{Spanned, de::DeValue};

use super::problem::Place;

/// A value of a file, or of an option of the command line.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Entry {
    pub(super) value: Value,
    pub(super) place: Place,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Value {
    Text(String),
    Whole(i64),
    Number(f64),
    Flag(bool),
    List(Vec<Entry>),
    /// What no key takes, in words.
    Other(&'static str),
}

impl Entry {
    /// What stands in a document; `place` tells where a byte of it is.
    pub(super) fn of(value: &Spanned<DeValue<'_>>, place: &dyn Fn(usize) -> Place) -> Self {
        let at = place(value.span().start);
        let value = match value.get_ref() {
            DeValue::String(text) => Value::Text(text.clone().into_owned()),
            DeValue::Integer(number) => i64::from_str_radix(number.as_str(), number.radix())
                .map_or(Value::Other("a whole number of too many digits"), Value::Whole),
            DeValue::Float(number) => {
                number.as_str().parse().map_or(Value::Other("a number"), Value::Number)
            }
            DeValue::Boolean(flag) => Value::Flag(*flag),
            // No list of lists is a value of ours: what is in it does not matter.
            DeValue::Array(items) => Value::List(
                items
                    .iter()
                    .map(|item| match item.get_ref() {
                        DeValue::Array(_) => {
                            Self { value: Value::Other("a list"), place: place(item.span().start) }
                        }
                        _ => Self::of(item, place),
                    })
                    .collect(),
            ),
            DeValue::Datetime(_) => Value::Other("a date or time of day"),
            DeValue::Table(_) => Value::Other("a table"),
        };
        Self { value, place: at }
    }
}

impl Value {
    /// What was found, in words of a bounded length.
    pub(super) fn found(&self) -> String {
        match self {
            Self::Text(text) => format!("\"{}\"", short(text)),
            Self::Whole(number) => format!("the number {number}"),
            Self::Number(number) => format!("the number {number}"),
            Self::Flag(flag) => flag.to_string(),
            Self::List(_) => "a list".to_owned(),
            Self::Other(words) => (*words).to_owned(),
        }
    }
}

/// Letters of a found text that a message repeats.
const SHOWN_MAX: usize = 60;

/// A text of anybody in a message: on its line, and no longer than a message bears.
pub(super) fn short(text: &str) -> String {
    let mut shown: String = text.chars().take(SHOWN_MAX).flat_map(char::escape_debug).collect();
    if text.chars().nth(SHOWN_MAX).is_some() {
        shown.push_str("...");
    }
    shown
}
