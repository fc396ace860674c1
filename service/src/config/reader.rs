//! One key after another: its value in the file or its default, checked for its type, its unit and its range.

use std::{collections::BTreeMap, net::SocketAddr, path::PathBuf, time::Duration};

use mocapd_codec::Tolerance;

use super::{
    keys::{Key, Preset, Takes},
    problem::{Place, Problem},
    value::{Entry, Value, short},
};
use crate::units;

/// Bytes of a path: Linux takes no more.
const PATH_BYTES_MAX: usize = 4096;

/// What is wrong goes into `problems`; what is asked for is `None` then.
#[derive(Debug)]
pub(super) struct Reader {
    pub(super) entries: BTreeMap<&'static str, Entry>,
    pub(super) problems: Vec<Problem>,
}

impl Reader {
    /// Whether it stands in the file or on the command line.
    pub(super) fn is_given(&self, key: &Key) -> bool {
        self.entries.contains_key(key.path)
    }

    /// Where it stands.
    pub(super) fn place(&self, key: &Key) -> Place {
        self.entries.get(key.path).map_or(Place::Nowhere, |entry| entry.place)
    }

    /// Says what is wrong with a key.
    pub(super) fn refuse(&mut self, key: &Key, message: String) {
        self.refuse_at(key, self.place(key), message);
    }

    fn refuse_at(&mut self, key: &Key, place: Place, message: String) {
        self.problems.push(Problem { place, key: Some(key.path), message });
    }

    fn value(&self, key: &Key) -> Option<Value> {
        match (self.entries.get(key.path), key.preset) {
            (Some(entry), _) => Some(entry.value.clone()),
            (None, Preset::Text(text)) => Some(Value::Text(text.to_owned())),
            (None, Preset::Flag(flag)) => Some(Value::Flag(flag)),
            (None, Preset::Whole(number)) => i64::try_from(number).ok().map(Value::Whole),
            (None, Preset::NoItems(_)) => Some(Value::List(Vec::new())),
            (None, Preset::Absent(_) | Preset::Told { .. }) => None,
        }
    }

    /// The value as `read` has it; its error says what is wrong with a value of the right type, or nothing
    /// when that is the type.
    fn read<T>(
        &mut self,
        key: &Key,
        read: impl FnOnce(&Value) -> Result<T, Option<String>>,
    ) -> Option<T> {
        let value = self.value(key)?;
        match read(&value) {
            Ok(value) => Some(value),
            Err(why) => {
                // It may repeat a text of any length.
                let why = why.map(|why| format!("{}; ", line(&why))).unwrap_or_default();
                let found = value.found();
                self.refuse(key, format!("{} is {found}: {why}{}", key.path, key.advice()));
                None
            }
        }
    }

    pub(super) fn flag(&mut self, key: &Key) -> Option<bool> {
        self.read(key, |value| match value {
            Value::Flag(flag) => Ok(*flag),
            _ => Err(None),
        })
    }

    pub(super) fn whole(&mut self, key: &Key) -> Option<u64> {
        let Takes::Whole { min, max } = key.takes else { return None };
        self.read(key, |value| match value {
            Value::Whole(number) => {
                u64::try_from(*number).ok().filter(|n| (min..=max).contains(n)).ok_or(None)
            }
            _ => Err(None),
        })
    }

    pub(super) fn rate_hz(&mut self, key: &Key) -> Option<f64> {
        self.read(key, |value| match value {
            Value::Text(text) => units::rate_hz(text).map_err(Some),
            Value::Whole(number) => units::rate_hz(&number.to_string()).map_err(Some),
            Value::Number(number) => units::rate_hz(&number.to_string()).map_err(Some),
            _ => Err(None),
        })
    }

    pub(super) fn time(&mut self, key: &Key) -> Option<Duration> {
        let Takes::Time { min, max } = key.takes else { return None };
        self.quantity(key, |text| {
            let time = units::duration(text).map_err(Some)?;
            if (min..=max).contains(&time) { Ok(time) } else { Err(None) }
        })
    }

    pub(super) fn size_bytes(&mut self, key: &Key) -> Option<u64> {
        let Takes::Size { min, max } = key.takes else { return None };
        self.quantity(key, |text| {
            let bytes = units::size_bytes(text).map_err(Some)?;
            if (min..=max).contains(&bytes) { Ok(bytes) } else { Err(None) }
        })
    }

    pub(super) fn tolerance(&mut self, key: &Key) -> Option<Tolerance> {
        self.quantity(key, |text| {
            // The words are those of the command line.
            units::tolerance(text).map_err(|why| Some(why.replace("--lossless", "lossless = true")))
        })
    }

    /// A number with a unit: who reads the file next year cannot guess it.
    fn quantity<T>(
        &mut self,
        key: &Key,
        read: impl FnOnce(&str) -> Result<T, Option<String>>,
    ) -> Option<T> {
        self.read(key, |value| match value {
            Value::Text(text) if text.trim().parse::<f64>().is_ok_and(|number| number != 0.0) => {
                Err(Some("its unit is missing".to_owned()))
            }
            Value::Text(text) => read(text),
            _ => Err(None),
        })
    }

    /// A text as `read` has it.
    pub(super) fn text<T>(
        &mut self,
        key: &Key,
        read: impl FnOnce(&str) -> Result<T, Option<String>>,
    ) -> Option<T> {
        self.read(key, |value| match value {
            Value::Text(text) => read(text),
            _ => Err(None),
        })
    }

    /// A path, which is not looked at.
    pub(super) fn path(&mut self, key: &Key) -> Option<PathBuf> {
        self.text(key, |text| match text {
            "" => Err(None),
            _ => path(text, PATH_BYTES_MAX).map_err(Some),
        })
    }

    /// The same, or `Some(None)` for `""`.
    pub(super) fn path_or_none(&mut self, key: &Key, bytes_max: usize) -> Option<Option<PathBuf>> {
        self.text(key, |text| match text {
            "" => Ok(None),
            _ => path(text, bytes_max).map(Some).map_err(Some),
        })
    }

    /// An address with its port; `Some(None)` for `""`.
    pub(super) fn address(&mut self, key: &Key) -> Option<Option<SocketAddr>> {
        self.text(key, |text| match text {
            "" => Ok(None),
            _ => address(text).map(Some).map_err(Some),
        })
    }

    /// A list, each item as `read` has it; each that is wrong is told.
    pub(super) fn list<T: PartialEq>(
        &mut self,
        key: &Key,
        read: impl Fn(&str) -> Result<T, String>,
    ) -> Option<Vec<T>> {
        let Takes::List { max, .. } = key.takes else { return None };
        let items = self.read(key, |value| match value {
            Value::List(items) if items.len() <= max => Ok(items.clone()),
            Value::List(items) => Err(Some(format!("it has {} items", items.len()))),
            _ => Err(None),
        })?;
        let n_items = items.len();
        let mut found = Vec::new();
        for item in items {
            let read = match &item.value {
                Value::Text(text) => read(text).map_err(|why| format!("{why}; ")),
                _ => Err(String::new()),
            };
            match read {
                Ok(value) if found.contains(&value) => {
                    let message =
                        format!("{} has {} twice: take one out", key.path, item.value.found());
                    self.refuse_at(key, item.place, message);
                }
                Ok(value) => found.push(value),
                Err(why) => {
                    let found = item.value.found();
                    let message = format!("{} has {found}: {why}{}", key.path, key.advice());
                    self.refuse_at(key, item.place, message);
                }
            }
        }
        (found.len() == n_items).then_some(found)
    }
}

fn path(text: &str, bytes_max: usize) -> Result<PathBuf, String> {
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

/// Letters of a reason that are told.
const REASON_MAX: usize = 300;

/// A reason on one line of a bounded length.
fn line(why: &str) -> String {
    let shown = |c: char| if c.is_control() { char::REPLACEMENT_CHARACTER } else { c };
    why.chars().take(REASON_MAX).map(shown).collect()
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
