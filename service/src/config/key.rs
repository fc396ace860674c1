//! A key of mocapd.toml: what it takes, what holds without it, and how its value is read and written out.

use std::{net::SocketAddr, ops::RangeInclusive, path::PathBuf, time::Duration};

use serde::Serialize;
use serde_json::{Value as Json, json};
use toml::de::DeValue;

use super::{
    Config,
    problem::{Place, Problem, short},
};
use crate::units::{self, duration_text, size_text};

/// Bytes of a path: Linux takes no more.
const PATH_BYTES_MAX: usize = 4096;

/// Letters of a reason that are told: it may repeat a text of any length.
const REASON_MAX: usize = 300;

/// A key of mocapd.toml.
#[derive(Debug)]
pub struct Key {
    /// Its section and its name: `arm.pre_roll`.
    pub path: &'static str,
    /// What it does: one sentence.
    pub what: &'static str,
    /// Why it is there, or why the default is what it is: one sentence.
    pub why: &'static str,
    /// What may stand behind it.
    pub takes: Takes,
    /// What holds when it is left out.
    pub preset: Preset,
    /// When a running service takes a new value over.
    pub when: When,
    pub(super) field: Field,
}

/// What may stand behind a key.
#[derive(Debug)]
pub enum Takes {
    /// `true` or `false`.
    Flag,
    /// A time with its unit, from the shortest to the longest.
    Time(RangeInclusive<Duration>),
    /// A number of bytes with its unit, from the smallest to the largest.
    Size(RangeInclusive<u64>),
    /// A frame rate in Hz.
    Rate,
    /// A tolerance with its unit.
    Length,
    /// A whole number, from the smallest to the largest.
    Whole(RangeInclusive<u64>),
    /// A text, in these words.
    Text(&'static str),
    /// A list of texts.
    List {
        /// What each item is, in words.
        of: &'static str,
        /// How many there may be.
        max: usize,
    },
}

/// What holds when a key is left out.
#[derive(Debug, Clone, Copy)]
pub enum Preset {
    /// This text.
    Text(&'static str),
    /// This.
    Flag(bool),
    /// This number.
    Whole(u64),
    /// An empty list; what an item may look like.
    NoItems(&'static str),
    /// Nothing; what it may look like, as TOML.
    Absent(&'static str),
    /// It depends on where mocapd runs.
    Told {
        /// On what, in words.
        words: &'static str,
        /// What it may look like, as TOML.
        example: &'static str,
    },
}

/// When a running service takes a new value over.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum When {
    /// At once, also while a take is recorded.
    Now,
    /// With the next take.
    NextTake,
    /// When it is armed the next time.
    NextArm,
    /// When the service is started again.
    Restart,
}

impl When {
    /// In words.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Now => "at once",
            Self::NextTake => "with the next take",
            Self::NextArm => "when it is armed again",
            Self::Restart => "when the service is started again",
        }
    }
}

impl Key {
    /// The section that it stands in.
    #[must_use]
    pub fn section(&self) -> &'static str {
        self.path.split_once('.').map_or("", |(section, _)| section)
    }

    /// Its name in its section.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.path.split_once('.').map_or(self.path, |(_, name)| name)
    }

    /// What an example of it looks like, as TOML: the default where that is a value.
    #[must_use]
    pub fn example(&self) -> String {
        match self.preset {
            Preset::Text(text) => format!("\"{text}\""),
            Preset::Flag(flag) => flag.to_string(),
            Preset::Whole(number) => number.to_string(),
            Preset::NoItems(_) => "[]".to_owned(),
            Preset::Absent(example) | Preset::Told { example, .. } => example.to_owned(),
        }
    }

    /// Whether the example has a value that holds when the key is left out.
    pub(super) fn has_default(&self) -> bool {
        !matches!(self.preset, Preset::Absent(_) | Preset::Told { .. })
    }

    /// The default, in words.
    #[must_use]
    pub fn default_words(&self) -> String {
        match self.preset {
            Preset::Absent(_) => "none".to_owned(),
            Preset::Told { words, .. } => words.to_owned(),
            _ => format!("`{}`", self.example()),
        }
    }

    /// What to write: for whoever wrote something else.
    pub(super) fn advice(&self) -> String {
        let example = match self.preset {
            Preset::NoItems(item) => format!("[\"{item}\"]"),
            Preset::Text("") => return format!("write {}", self.takes.words()),
            _ => self.example(),
        };
        format!("write {}, such as {} = {example}", self.takes.words(), self.name())
    }
}

impl Takes {
    /// In words.
    #[must_use]
    pub fn words(&self) -> String {
        match self {
            Self::Flag => "true or false".to_owned(),
            Self::Time(range) => format!(
                "a time with its unit in quotes (ms, s, min, h), {} to {}",
                duration_text(*range.start()),
                duration_text(*range.end())
            ),
            Self::Size(range) => format!(
                "a size with its unit in quotes (kB, MB, GB, KiB, MiB, GiB), {} to {}",
                size_text(*range.start()),
                size_text(*range.end())
            ),
            Self::Rate => "a frame rate in Hz, 1 to 10000".to_owned(),
            Self::Length => {
                "a distance with its unit in quotes (um, mm, cm, m), 0.0001mm to 1000m".to_owned()
            }
            Self::Whole(range) => format!("a whole number, {} to {}", range.start(), range.end()),
            Self::Text(words) => (*words).to_owned(),
            Self::List { of, max } => format!("a list of at most {max}, each {of}"),
        }
    }
}

/// Where the value of a key is in a configuration.
#[derive(Debug)]
pub(super) struct Field {
    /// Reads it from what is given.
    pub(super) read: fn(&mut Config, &Given<'_>) -> Result<(), Vec<Problem>>,
    /// As TOML and JSON alike; `None` where it is left out.
    pub(super) written: fn(&Config) -> Option<Json>,
}

/// A field whose type is a [`Setting`], or a text or a list of texts that a function reads.
macro_rules! field {
    ($($name:ident).+) => {
        Field {
            read: |config, given| Setting::read(given).map(|value| config.$($name).+ = value),
            written: |config| config.$($name).+.written(),
        }
    };
    ($($name:ident).+, $read:expr) => {
        Field {
            read: |config, given| given.text($read).map(|value| config.$($name).+ = value),
            written: |config| Some(json!(config.$($name).+.to_string())),
        }
    };
    ($($name:ident).+, each $read:expr) => {
        Field {
            read: |config, given| given.list($read).map(|items| config.$($name).+ = items),
            written: |config| {
                let items = config.$($name).+.iter().map(ToString::to_string);
                Some(json!(items.collect::<Vec<_>>()))
            },
        }
    };
}
pub(super) use field;

/// A value, or what is wrong with one of the right type; nothing where that is the type.
pub(super) type Read<T> = Result<T, Option<String>>;

/// The value of a key, in a document, on the command line, or by default.
#[derive(Debug)]
pub(super) struct Given<'a> {
    pub(super) key: &'static Key,
    pub(super) value: &'a DeValue<'a>,
    pub(super) place: Place,
    /// The document, for places of items.
    pub(super) text: &'a str,
}

impl<'a> Given<'a> {
    fn problem(&self, place: Place, message: String) -> Problem {
        Problem { place, key: Some(self.key.path), message }
    }

    fn read<T>(&self, read: impl FnOnce(&'a DeValue<'a>) -> Read<T>) -> Result<T, Vec<Problem>> {
        read(self.value).map_err(|why| {
            let why = why.map(|why| format!("{}; ", line(&why))).unwrap_or_default();
            let (path, found, advice) = (self.key.path, found(self.value), self.key.advice());
            vec![self.problem(self.place, format!("{path} is {found}: {why}{advice}"))]
        })
    }

    /// A text as `read` has it.
    pub(super) fn text<T>(&self, read: impl FnOnce(&str) -> Read<T>) -> Result<T, Vec<Problem>> {
        self.read(|value| read(value.as_str().ok_or(None)?))
    }

    /// A number with a unit: who reads the file next year cannot guess it.
    pub(super) fn quantity<T>(
        &self,
        read: impl FnOnce(&str) -> Read<T>,
    ) -> Result<T, Vec<Problem>> {
        self.text(|text| match text.trim().parse::<f64>() {
            Ok(number) if number != 0.0 => Err(Some("its unit is missing".to_owned())),
            _ => read(text),
        })
    }

    /// A list, each item as `read` has it; each that is wrong is told.
    pub(super) fn list<T: PartialEq>(
        &self,
        read: impl Fn(&str) -> Result<T, String>,
    ) -> Result<Vec<T>, Vec<Problem>> {
        let Takes::List { max, .. } = self.key.takes else { return Ok(Vec::new()) };
        let items = self.read(|value| match value.as_array() {
            Some(items) if items.len() > max => Err(Some(format!("it has {} items", items.len()))),
            items => items.ok_or(None),
        })?;
        let (path, mut good, mut problems) = (self.key.path, Vec::new(), Vec::new());
        for item in &items[..] {
            let (value, at) = (item.get_ref(), Place::of_byte(self.text, item.span().start));
            let found = found(value);
            let read = match value.as_str() {
                Some(text) => read(text).map_err(|why| format!("{why}; ")),
                None => Err(String::new()),
            };
            let message = match read {
                Ok(item) if !good.contains(&item) => {
                    good.push(item);
                    continue;
                }
                Ok(_) => format!("{path} has {found} twice: take one out"),
                Err(why) => format!("{path} has {found}: {why}{}", self.key.advice()),
            };
            problems.push(self.problem(at, message));
        }
        if problems.is_empty() { Ok(good) } else { Err(problems) }
    }
}

/// What was found, in words of a bounded length.
pub(super) fn found(value: &DeValue<'_>) -> String {
    match value {
        DeValue::String(text) => format!("\"{}\"", short(text)),
        DeValue::Integer(_) => whole(value).map_or_else(
            || "a whole number of too many digits".to_owned(),
            |number| format!("the number {number}"),
        ),
        DeValue::Float(number) => number
            .as_str()
            .parse::<f64>()
            // With its point or its exponent, and never with hundreds of zeros.
            .map_or_else(|_| "a number".to_owned(), |number| format!("the number {number:?}")),
        DeValue::Boolean(flag) => flag.to_string(),
        DeValue::Array(_) => "a list".to_owned(),
        DeValue::Datetime(_) => "a date or time of day".to_owned(),
        DeValue::Table(_) => "a table".to_owned(),
    }
}

fn whole(value: &DeValue<'_>) -> Option<i64> {
    let number = value.as_integer()?;
    i64::from_str_radix(number.as_str(), number.radix()).ok()
}

/// A reason on one line of a bounded length.
fn line(why: &str) -> String {
    let shown = |c: char| if c.is_control() { char::REPLACEMENT_CHARACTER } else { c };
    why.chars().take(REASON_MAX).map(shown).collect()
}

/// A type whose values stand behind keys. What is written out is read as exactly the same again.
pub(super) trait Setting: Serialize + Sized {
    fn read(given: &Given<'_>) -> Result<Self, Vec<Problem>>;

    /// Nothing, or the text, number or flag that it is.
    fn written(&self) -> Option<Json> {
        serde_json::to_value(self).ok()
    }
}

impl Setting for bool {
    fn read(given: &Given<'_>) -> Result<Self, Vec<Problem>> {
        given.read(|value| value.as_bool().ok_or(None))
    }
}

impl Setting for usize {
    fn read(given: &Given<'_>) -> Result<Self, Vec<Problem>> {
        given.read(|value| {
            if matches!(value, DeValue::Float(_)) {
                return Err(Some("a whole number has no decimal point and no exponent".to_owned()));
            }
            let number = whole(value).and_then(|number| u64::try_from(number).ok()).ok_or(None)?;
            let in_range =
                matches!(&given.key.takes, Takes::Whole(range) if range.contains(&number));
            Self::try_from(number).ok().filter(|_| in_range).ok_or(None)
        })
    }
}

/// A frame rate in Hz.
impl Setting for f64 {
    fn read(given: &Given<'_>) -> Result<Self, Vec<Problem>> {
        given.read(|value| {
            let text = match value {
                DeValue::String(text) => text.to_string(),
                DeValue::Integer(_) => whole(value).ok_or(None)?.to_string(),
                DeValue::Float(number) => {
                    number.as_str().parse::<Self>().map_err(|_| None)?.to_string()
                }
                _ => return Err(None),
            };
            units::rate_hz(&text).map_err(Some)
        })
    }
}

impl Setting for Duration {
    fn read(given: &Given<'_>) -> Result<Self, Vec<Problem>> {
        given.quantity(|text| {
            let time = units::duration(text).map_err(Some)?;
            let in_range = matches!(&given.key.takes, Takes::Time(range) if range.contains(&time));
            if in_range { Ok(time) } else { Err(None) }
        })
    }

    fn written(&self) -> Option<Json> {
        Some(json!(duration_text(*self)))
    }
}

/// A number of bytes.
impl Setting for u64 {
    fn read(given: &Given<'_>) -> Result<Self, Vec<Problem>> {
        given.quantity(|text| {
            let bytes = units::size_bytes(text).map_err(Some)?;
            let in_range = matches!(&given.key.takes, Takes::Size(range) if range.contains(&bytes));
            if in_range { Ok(bytes) } else { Err(None) }
        })
    }

    fn written(&self) -> Option<Json> {
        Some(json!(size_text(*self)))
    }
}

/// A path, which is not looked at.
impl Setting for PathBuf {
    fn read(given: &Given<'_>) -> Result<Self, Vec<Problem>> {
        given.text(|text| match text {
            "" => Err(None),
            _ => path(text, PATH_BYTES_MAX).map_err(Some),
        })
    }
}

impl<T: Setting> Setting for Option<T> {
    fn read(given: &Given<'_>) -> Result<Self, Vec<Problem>> {
        T::read(given).map(Some)
    }

    fn written(&self) -> Option<Json> {
        self.as_ref().and_then(T::written)
    }
}

/// An address with its port; `""` for none.
impl Setting for Option<SocketAddr> {
    fn read(given: &Given<'_>) -> Result<Self, Vec<Problem>> {
        given.text(|text| match text {
            "" => Ok(None),
            _ => address(text).map(Some).map_err(Some),
        })
    }

    fn written(&self) -> Option<Json> {
        Some(json!(self.map_or_else(String::new, |address| address.to_string())))
    }
}

pub(super) fn path(text: &str, bytes_max: usize) -> Result<PathBuf, String> {
    if text.len() > bytes_max {
        return Err(format!("it has more than {bytes_max} bytes"));
    }
    if text.contains(char::is_control) {
        return Err("it has control characters in it".to_owned());
    }
    if text == "~" || text.starts_with("~/") {
        return Err("'~' is a shell's word: write the whole path".to_owned());
    }
    Ok(PathBuf::from(text))
}

/// `127.0.0.1:7060`, `[::1]:7060`; names are not looked up, since a name server that is away would keep a rig
/// from recording.
pub(super) fn address(text: &str) -> Result<SocketAddr, String> {
    text.parse().map_err(|_| match text.rsplit_once(':') {
        Some(("localhost", port)) => {
            format!("names are not looked up: write 127.0.0.1:{} or [::1]:{0}", short(port))
        }
        Some((host, _)) if host.parse::<std::net::Ipv6Addr>().is_ok() => {
            "an IPv6 address stands in brackets before its port, as in [::1]:7060".to_owned()
        }
        Some((host, _)) if host.contains(char::is_alphabetic) && !host.contains([':', '[']) => {
            format!("names are not looked up: write the address of {}", short(host))
        }
        _ if text.parse::<std::net::IpAddr>().is_ok() => "its port is missing".to_owned(),
        _ => "it is no address with a port".to_owned(),
    })
}
