//! Which streams of the Lab Streaming Layer (LSL) a device URI names: `lsl:NAME[,NAME...][?type=...&source_id=...]`.

use std::fmt;

/// The unit of positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LengthUnit {
    /// Metres.
    Metres,
    /// Centimetres.
    Centimetres,
    /// Millimetres.
    Millimetres,
}

impl LengthUnit {
    const NAMES: [(&'static str, Self); 3] =
        [("m", Self::Metres), ("cm", Self::Centimetres), ("mm", Self::Millimetres)];

    fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(_, unit)| *unit == self).map_or("", |(name, _)| name)
    }

    /// Millimetres in one.
    #[must_use]
    pub fn mm(self) -> f64 {
        match self {
            Self::Metres => 1000.0,
            Self::Centimetres => 10.0,
            Self::Millimetres => 1.0,
        }
    }
}

/// Streams that are recorded together: of each name exactly one, which also has the other properties that are given.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct StreamQuery {
    /// Their names; empty for the one stream that has the other properties.
    pub names: Vec<String>,
    /// The type, such as `MoCap`.
    pub kind: Option<String>,
    /// The id of the source, which survives its restart.
    pub source_id: Option<String>,
    /// The sender's machine.
    pub hostname: Option<String>,
    /// Frames per second in thousandths, for markers whose stream states no rate.
    pub rate_millihertz: Option<u32>,
    /// The unit of positions, for a stream that states none.
    pub unit: Option<LengthUnit>,
}

/// Streams of one recording: as many as a device has groups of sampled channels, and one of markers.
pub const STREAMS_MAX: usize = 17;

impl StreamQuery {
    /// Parses what follows `lsl:`: the names, and what is behind the `?` without `driver=`.
    ///
    /// # Errors
    /// A phrase that names the invalid part.
    pub(crate) fn parse(names: &str, query: &[&str]) -> Result<Self, String> {
        let names = names.split(',').filter(|name| !name.is_empty());
        let mut parsed =
            Self { names: names.map(decoded).collect::<Result<_, _>>()?, ..Self::default() };
        for part in query {
            let (key, value) = part.split_once('=').unwrap_or((part, ""));
            let value = decoded(value)?;
            match key {
                _ if value.is_empty() => return Err(format!("'{part}' has no value")),
                "type" => parsed.kind = Some(value),
                "source_id" => parsed.source_id = Some(value),
                "hostname" => parsed.hostname = Some(value),
                "rate" => parsed.rate_millihertz = Some(rate_millihertz(&value)?),
                "unit" => {
                    let unit = LengthUnit::NAMES.iter().find(|(name, _)| *name == value);
                    let unit = unit.ok_or_else(|| format!("unit={value}: expected m, cm or mm"))?;
                    parsed.unit = Some(unit.1);
                }
                _ => {
                    return Err(format!(
                        "expected type=, source_id=, hostname=, rate=, unit= or driver= after '?', found '{part}'"
                    ));
                }
            }
        }
        parsed.check()?;
        Ok(parsed)
    }

    fn check(&self) -> Result<(), String> {
        let Self { names, kind, source_id, .. } = self;
        let has_property = kind.is_some() || source_id.is_some();
        if names.is_empty() && !has_property {
            return Err("the name of the stream is missing".to_owned());
        }
        if names.len() > STREAMS_MAX {
            return Err(format!(
                "{} streams, and at most {STREAMS_MAX} are recorded at once",
                names.len()
            ));
        }
        if names.len() > 1 && has_property {
            return Err(
                "type= and source_id= choose one stream: give one name with them".to_owned()
            );
        }
        let is_repeated = |(at, name)| names.iter().take(at).any(|earlier| earlier == name);
        match names.iter().enumerate().find(|(at, name)| is_repeated((*at, *name))) {
            Some((_, name)) => Err(format!("the name '{name}' is there twice")),
            None => Ok(()),
        }
    }
}

fn rate_millihertz(text: &str) -> Result<u32, String> {
    let rate_hz = text.parse().ok().filter(|hz: &f64| (0.001..=1e6).contains(hz));
    let rate_hz = rate_hz.ok_or_else(|| format!("rate={text}: expected Hz, such as rate=120"))?;
    Ok((rate_hz * 1000.0).round() as u32)
}

/// Characters that end a name in a URI, and the one that escapes them.
const ESCAPED: &str = "%,?&#=";

/// Replaces `%XX` by the byte with this number.
fn decoded(text: &str) -> Result<String, String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let Some((&first, after)) = rest.split_first() {
        rest = after;
        if first != b'%' {
            bytes.push(first);
            continue;
        }
        let digits = rest.get(..2).and_then(|digits| std::str::from_utf8(digits).ok());
        let byte = digits.and_then(|digits| u8::from_str_radix(digits, 16).ok());
        bytes.push(
            byte.ok_or_else(|| format!("'{text}': expected two hexadecimal digits after %"))?,
        );
        rest = rest.get(2..).unwrap_or_default();
    }
    let text = String::from_utf8(bytes).map_err(|_| format!("'{text}' is no UTF-8"))?;
    if text.chars().any(char::is_control) {
        return Err("a name has no control characters".to_owned());
    }
    Ok(text)
}

/// A name as URIs write it.
struct PercentEncoded<'a>(&'a str);

impl fmt::Display for PercentEncoded<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.chars().try_for_each(|c| match c {
            c if ESCAPED.contains(c) => write!(f, "%{:02X}", u32::from(c)),
            c => write!(f, "{c}"),
        })
    }
}

impl fmt::Display for StreamQuery {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "lsl:")?;
        for (at, name) in self.names.iter().enumerate() {
            write!(f, "{}{}", if at > 0 { "," } else { "" }, PercentEncoded(name))?;
        }
        let rate = self.rate_millihertz.map(|rate| (f64::from(rate) / 1000.0).to_string());
        let unit = self.unit.map(|unit| unit.name().to_owned());
        let properties = [
            ("type", self.kind.as_ref()),
            ("source_id", self.source_id.as_ref()),
            ("hostname", self.hostname.as_ref()),
            ("rate", rate.as_ref()),
            ("unit", unit.as_ref()),
        ];
        let given = properties.into_iter().filter_map(|(key, value)| Some((key, value?)));
        for (at, (key, value)) in given.enumerate() {
            write!(f, "{}{key}={}", if at > 0 { '&' } else { '?' }, PercentEncoded(value))?;
        }
        Ok(())
    }
}
