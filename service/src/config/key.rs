//! A configuration key: its type and default, how its value is read, and how it is written out.

use std::{
    net::{SocketAddr, SocketAddrV4},
    ops::RangeInclusive,
    path::PathBuf,
    time::Duration,
};

use mocapd_store::without_secrets;
use serde::Serialize;
use serde_json::{Value as Json, json};
use toml::de::DeValue;

use super::{
    Config,
    problem::{ConfigProblem, SourceLocation, excerpt},
    publishers::group,
};
use crate::units::{self, duration_text, size_text};

/// Longest path in bytes: Linux allows no more.
pub(super) const PATH_BYTES_MAX: usize = 4096;

/// Longest reason in a message, in characters: a reason may quote a text of any length.
const REASON_MAX: usize = 300;

/// A key of mocapd.toml.
#[derive(Debug)]
pub struct Key {
    /// Section and name, such as `arm.pre_roll`.
    pub path: &'static str,
    /// What the key does, in one sentence.
    pub what: &'static str,
    /// Why it exists or why it has this default, in one sentence.
    pub why: &'static str,
    /// The type and range of its values.
    pub values: ValueType,
    /// The value if the key is left out.
    pub default: DefaultValue,
    /// When a running service applies a new value.
    pub when: ReloadPolicy,
    pub(super) field: Field,
}

/// The type and range of a key's values.
#[derive(Debug)]
pub enum ValueType {
    /// `true` or `false`.
    Flag,
    /// A duration with a unit, and its range.
    Time(RangeInclusive<Duration>),
    /// A number of bytes with a unit, and its range.
    Size(RangeInclusive<u64>),
    /// A frame rate in Hz.
    Rate,
    /// A distance with a unit.
    Distance,
    /// A whole number, and its range.
    Integer(RangeInclusive<u64>),
    /// A text; the description says what it must be.
    Text(&'static str),
    /// A list of texts.
    List {
        /// What each entry must be.
        of: &'static str,
        /// Maximum number of entries.
        max: usize,
    },
}

/// The value of a key that is left out.
#[derive(Debug, Clone, Copy)]
pub enum DefaultValue {
    /// This text.
    Text(&'static str),
    /// This flag.
    Flag(bool),
    /// This number.
    Integer(u64),
    /// An empty list; the text is an example of an entry.
    EmptyList(&'static str),
    /// No value; the text is an example in TOML.
    Absent(&'static str),
    /// A value that depends on the environment in which mocapd runs.
    Dynamic {
        /// What it depends on.
        description: &'static str,
        /// An example in TOML.
        example: &'static str,
    },
}

/// When a running service applies a new value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ReloadPolicy {
    /// Immediately, even while a take is recorded.
    Now,
    /// With the next take.
    NextTake,
    /// The next time the service is armed.
    NextArm,
    /// After a restart of the service.
    Restart,
}

impl ReloadPolicy {
    /// A short text for tables and logs.
    #[must_use]
    pub fn description(self) -> &'static str {
        match self {
            Self::Now => "at once",
            Self::NextTake => "with the next take",
            Self::NextArm => "when next armed",
            Self::Restart => "after a restart",
        }
    }
}

impl Key {
    /// The section that contains the key.
    #[must_use]
    pub fn section(&self) -> &'static str {
        self.path.rsplit_once('.').map_or("", |(section, _)| section)
    }

    /// The key's name within its section.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.path.rsplit_once('.').map_or(self.path, |(_, name)| name)
    }

    /// An example value in TOML: the default if there is one.
    #[must_use]
    pub fn example(&self) -> String {
        match self.default {
            DefaultValue::Text(text) => format!("\"{text}\""),
            DefaultValue::Flag(flag) => flag.to_string(),
            DefaultValue::Integer(number) => number.to_string(),
            DefaultValue::EmptyList(_) => "[]".into(),
            DefaultValue::Absent(example) | DefaultValue::Dynamic { example, .. } => example.into(),
        }
    }

    /// Whether [`example`](Self::example) is also the default.
    pub(super) fn has_default(&self) -> bool {
        !matches!(self.default, DefaultValue::Absent(_) | DefaultValue::Dynamic { .. })
    }

    /// The default as a text for people.
    #[must_use]
    pub fn default_text(&self) -> String {
        match self.default {
            DefaultValue::Absent(_) => "none".to_owned(),
            DefaultValue::Dynamic { description, .. } => description.to_owned(),
            _ => format!("`{}`", self.example()),
        }
    }

    /// What to write instead of a value that was refused.
    pub(super) fn advice(&self) -> String {
        let example = match self.default {
            DefaultValue::EmptyList(item) => format!("[\"{item}\"]"),
            DefaultValue::Text("") => return format!("write {}", self.values.description()),
            _ => self.example(),
        };
        format!("write {}, such as {} = {example}", self.values.description(), self.name())
    }
}

impl ValueType {
    /// What a value must be, as a text for people.
    #[must_use]
    pub fn description(&self) -> String {
        match self {
            Self::Flag => "true or false".to_owned(),
            Self::Time(range) => {
                let [min, max] = [range.start(), range.end()].map(|time| duration_text(*time));
                format!("a duration with a unit, in quotes (ms, s, min, h), {min} to {max}")
            }
            Self::Size(range) => {
                let [min, max] = [range.start(), range.end()].map(|bytes| size_text(*bytes));
                format!("a size with a unit, in quotes (kB, MB, GB, KiB, MiB, GiB), {min} to {max}")
            }
            Self::Rate => "a frame rate in Hz, 1 to 10000".to_owned(),
            Self::Distance => {
                "a distance with a unit, in quotes (um, mm, cm, m), 0.0001mm to 1000m".to_owned()
            }
            Self::Integer(range) => format!("a whole number, {} to {}", range.start(), range.end()),
            Self::Text(description) => (*description).to_owned(),
            Self::List { of, max } => format!("a list of at most {max} entries, each {of}"),
        }
    }
}

/// Conversions of a key's value into and out of a configuration.
#[derive(Debug)]
pub(super) struct Field {
    /// Reads the value from the document into the configuration.
    pub(super) read: fn(&mut Config, &RawValue<'_>) -> Result<(), Vec<ConfigProblem>>,
    /// Gives the value, which has the same form in TOML and JSON; `None` if the key has none.
    pub(super) to_json: fn(&Config) -> Option<Json>,
}

/// A field whose type is a [`ConfigValue`], or a text or list of texts parsed by a function.
macro_rules! field {
    ($($name:ident).+) => {
        Field {
            read: |config, raw| ConfigValue::read(raw).map(|value| config.$($name).+ = value),
            to_json: |config| config.$($name).+.to_json(),
        }
    };
    ($($name:ident).+, $read:expr) => {
        Field {
            read: |config, raw| raw.text($read).map(|value| config.$($name).+ = value),
            to_json: |config| Some(json!(config.$($name).+.to_string())),
        }
    };
    ($($name:ident).+, each $read:expr) => {
        Field {
            read: |config, raw| raw.list($read).map(|items| config.$($name).+ = items),
            to_json: |config| {
                let items = config.$($name).+.iter().map(ToString::to_string);
                Some(json!(items.collect::<Vec<_>>()))
            },
        }
    };
}
pub(super) use field;

/// A parsed value, or why it was refused; the reason is `None` if the value merely has the wrong type or range.
pub(super) type Read<T> = Result<T, Option<String>>;

/// A value of the document, or its problems.
type FieldResult<T> = Result<T, Vec<ConfigProblem>>;

/// The value of a key from the document, the command line or the default.
#[derive(Debug)]
pub(super) struct RawValue<'a> {
    pub(super) key: &'static Key,
    pub(super) value: &'a DeValue<'a>,
    pub(super) place: SourceLocation,
    /// The source text, to locate entries of a list.
    pub(super) text: &'a str,
}

impl<'a> RawValue<'a> {
    fn problem(&self, place: SourceLocation, message: String) -> ConfigProblem {
        ConfigProblem { place, key: Some(self.key.path), message }
    }

    fn read<T>(&self, read: impl FnOnce(&'a DeValue<'a>) -> Read<T>) -> FieldResult<T> {
        read(self.value).map_err(|why| {
            let why = why.map(|why| format!("{}; ", line(&why))).unwrap_or_default();
            let (path, found, advice) = (self.key.path, found(self.value), self.key.advice());
            vec![self.problem(self.place, format!("{path} is {found}: {why}{advice}"))]
        })
    }

    /// A text, parsed by `read`.
    pub(super) fn text<T>(&self, read: impl FnOnce(&str) -> Read<T>) -> FieldResult<T> {
        self.read(|value| read(value.as_str().ok_or(None)?))
    }

    /// A number with a unit. The unit is required because a reader of the file cannot guess it.
    pub(super) fn quantity<T>(&self, read: impl FnOnce(&str) -> Read<T>) -> FieldResult<T> {
        self.text(|text| match text.trim().parse::<f64>() {
            Ok(number) if number != 0.0 => Err(Some("the unit is missing".to_owned())),
            _ => read(text),
        })
    }

    /// A list whose entries are parsed by `read`; every wrong entry is reported.
    pub(super) fn list<T: PartialEq>(
        &self,
        read: impl Fn(&str) -> Result<T, String>,
    ) -> Result<Vec<T>, Vec<ConfigProblem>> {
        let ValueType::List { max, .. } = self.key.values else { return Ok(Vec::new()) };
        let items = self.read(|value| match value.as_array() {
            Some(items) if items.len() > max => Err(Some(format!("{} are too many", items.len()))),
            items => items.ok_or(None),
        })?;
        let (path, mut good, mut problems) = (self.key.path, Vec::new(), Vec::new());
        for item in &items[..] {
            let (value, at) =
                (item.get_ref(), SourceLocation::of_byte(self.text, item.span().start));
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
                Ok(_) => format!("{path} contains {found} twice: remove one"),
                Err(why) => format!("{path} contains {found}: {why}{}", self.key.advice()),
            };
            problems.push(self.problem(at, message));
        }
        if problems.is_empty() { Ok(good) } else { Err(problems) }
    }
}

/// Describes the value that was found, with a bounded length.
pub(super) fn found(value: &DeValue<'_>) -> String {
    match value {
        // A URL may have a password, although none is accepted.
        DeValue::String(text) => format!("\"{}\"", excerpt(&without_secrets(text))),
        DeValue::Integer(_) => whole(value).map_or_else(
            || "a whole number with too many digits".to_owned(),
            |number| format!("the number {number}"),
        ),
        DeValue::Float(number) => number
            .as_str()
            .parse::<f64>()
            // Debug format keeps the point or exponent and never prints hundreds of zeros.
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

/// A reason on one line of bounded length.
fn line(why: &str) -> String {
    let shown = |c: char| if c.is_control() { char::REPLACEMENT_CHARACTER } else { c };
    why.chars().take(REASON_MAX).map(shown).collect()
}

/// A type of configuration values. What `to_json` writes, `read` parses to exactly the same value.
pub(super) trait ConfigValue: Serialize + Sized {
    fn read(raw: &RawValue<'_>) -> Result<Self, Vec<ConfigProblem>>;

    /// The value as JSON: a text, number or flag, or `None`.
    fn to_json(&self) -> Option<Json> {
        serde_json::to_value(self).ok()
    }
}

impl ConfigValue for bool {
    fn read(raw: &RawValue<'_>) -> Result<Self, Vec<ConfigProblem>> {
        raw.read(|value| value.as_bool().ok_or(None))
    }
}

impl ConfigValue for usize {
    fn read(raw: &RawValue<'_>) -> Result<Self, Vec<ConfigProblem>> {
        raw.read(|value| {
            if matches!(value, DeValue::Float(_)) {
                return Err(Some(
                    "write a whole number without a decimal point or exponent".to_owned(),
                ));
            }
            let number = whole(value).and_then(|number| u64::try_from(number).ok()).ok_or(None)?;
            let ValueType::Integer(range) = &raw.key.values else { return Err(None) };
            Self::try_from(number).ok().filter(|_| range.contains(&number)).ok_or(None)
        })
    }
}

/// A frame rate in Hz.
impl ConfigValue for f64 {
    fn read(raw: &RawValue<'_>) -> Result<Self, Vec<ConfigProblem>> {
        raw.read(|value| {
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

impl ConfigValue for Duration {
    fn read(raw: &RawValue<'_>) -> Result<Self, Vec<ConfigProblem>> {
        raw.quantity(|text| {
            let time = units::duration(text).map_err(Some)?;
            let ValueType::Time(range) = &raw.key.values else { return Err(None) };
            if range.contains(&time) { Ok(time) } else { Err(None) }
        })
    }

    fn to_json(&self) -> Option<Json> {
        Some(json!(duration_text(*self)))
    }
}

/// A number of bytes.
impl ConfigValue for u64 {
    fn read(raw: &RawValue<'_>) -> Result<Self, Vec<ConfigProblem>> {
        raw.quantity(|text| {
            let bytes = units::size_bytes(text).map_err(Some)?;
            let ValueType::Size(range) = &raw.key.values else { return Err(None) };
            if range.contains(&bytes) { Ok(bytes) } else { Err(None) }
        })
    }

    fn to_json(&self) -> Option<Json> {
        Some(json!(size_text(*self)))
    }
}

/// A path; whether it exists is not checked.
impl ConfigValue for PathBuf {
    fn read(raw: &RawValue<'_>) -> Result<Self, Vec<ConfigProblem>> {
        raw.text(|text| match text {
            "" => Err(None),
            _ => path(text, PATH_BYTES_MAX).map_err(Some),
        })
    }
}

impl<T: ConfigValue> ConfigValue for Option<T> {
    fn read(raw: &RawValue<'_>) -> Result<Self, Vec<ConfigProblem>> {
        T::read(raw).map(Some)
    }

    fn to_json(&self) -> Option<Json> {
        self.as_ref().and_then(T::to_json)
    }
}

/// A socket address; `""` means none.
impl ConfigValue for Option<SocketAddr> {
    fn read(raw: &RawValue<'_>) -> Result<Self, Vec<ConfigProblem>> {
        raw.text(|text| match text {
            "" => Ok(None),
            _ => address(text).map(Some).map_err(Some),
        })
    }

    fn to_json(&self) -> Option<Json> {
        Some(json!(self.map_or_else(String::new, |address| address.to_string())))
    }
}

/// A multicast group and a port.
impl ConfigValue for SocketAddrV4 {
    fn read(raw: &RawValue<'_>) -> Result<Self, Vec<ConfigProblem>> {
        raw.text(|text| group(text).map_err(Some))
    }
}

pub(super) fn path(text: &str, bytes_max: usize) -> Result<PathBuf, String> {
    if text.len() > bytes_max {
        return Err(format!("it is longer than {bytes_max} bytes"));
    }
    if text.contains(char::is_control) {
        return Err("it contains control characters".to_owned());
    }
    if text == "~" || text.starts_with("~/") {
        return Err("'~' is expanded by shells only: write the full path".to_owned());
    }
    Ok(PathBuf::from(text))
}

/// Parses `127.0.0.1:7060` or `[::1]:7060`. Names are not resolved, because an unreachable name server would then keep
/// a rig from recording.
pub(super) fn address(text: &str) -> Result<SocketAddr, String> {
    text.parse().map_err(|_| match text.rsplit_once(':') {
        Some(("localhost", port)) => {
            format!("host names are not resolved: write 127.0.0.1:{} or [::1]:{0}", excerpt(port))
        }
        Some((host, _)) if host.parse::<std::net::Ipv6Addr>().is_ok() => {
            "an IPv6 address needs brackets before the port, as in [::1]:7060".to_owned()
        }
        Some((host, _)) if host.contains(char::is_alphabetic) && !host.contains([':', '[']) => {
            format!("host names are not resolved: write the address of {}", excerpt(host))
        }
        _ if text.parse::<std::net::IpAddr>().is_ok() => "the port is missing".to_owned(),
        _ => "it is not an address with a port".to_owned(),
    })
}
