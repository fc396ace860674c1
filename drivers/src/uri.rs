//! Device URIs: `serial:PATH[@BAUD]`, `usb:VID:PID[:SERIAL]`, `qtm:HOST[:PORT][?transport=udp]`,
//! `natnet:HOST[:PORT][?local=IF&mode=multicast]` or `lsl:NAME[?...]`, with an optional `?driver=NAME`.

use std::{fmt, path::PathBuf, str::FromStr};

/// The port, USB address or network address of a device.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Location {
    /// A serial port.
    Serial {
        /// The device file, or a link to it.
        path: PathBuf,
        /// Baud rate; `None` for [`BAUD_DEFAULT`](crate::transport::serial::BAUD_DEFAULT).
        baud: Option<u32>,
    },
    /// A USB device.
    Usb {
        /// Vendor id.
        vid: u16,
        /// Product id.
        pid: u16,
        /// Serial number, needed where several devices share the ids.
        serial: Option<String>,
    },
    /// A device on the network.
    Network(NetworkAddress),
    /// Streams of the Lab Streaming Layer, which are found by name.
    Streams(StreamQuery),
}

/// Families whose devices are on the network, each with the port that a URI may omit. A family's name is the scheme.
pub const NETWORK_FAMILIES: &[(&str, u16)] = &[("qtm", 22_223), ("natnet", 1510)];

/// Those of them whose commands travel by UDP, too: they have no connection.
const DATAGRAM_FAMILIES: &[&str] = &["natnet"];

/// Whether everything that a family's devices send travels by UDP.
#[must_use]
pub fn is_datagram_family(family: &str) -> bool {
    DATAGRAM_FAMILIES.contains(&family)
}

/// The network address of a device, and how its frames travel.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct NetworkAddress {
    /// Name of the family, one of [`NETWORK_FAMILIES`].
    pub family: &'static str,
    /// Name of the machine, or its IP address without brackets.
    pub host: String,
    /// Port of its commands: TCP, or UDP for a [datagram family](is_datagram_family).
    pub port: u16,
    /// Whether frames arrive as UDP datagrams.
    pub datagrams: bool,
    /// The interface of this machine that datagrams use, by its name or address; `None` for the one that leads to the
    /// device.
    pub local: Option<String>,
    /// How a datagram family's frames are to travel; `None` for the way that the device states.
    pub mode: Option<StreamMode>,
}

/// How datagrams of frames travel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum StreamMode {
    /// To all that joined a group.
    Multicast,
    /// To this machine alone.
    Unicast,
}

impl StreamMode {
    /// Its name in URIs.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Multicast => "multicast",
            Self::Unicast => "unicast",
        }
    }
}

impl NetworkAddress {
    /// An address without options.
    #[must_use]
    pub fn new(family: &'static str, host: &str, port: u16) -> Self {
        let datagrams = is_datagram_family(family);
        Self { family, host: host.to_owned(), port, datagrams, local: None, mode: None }
    }

    /// The options that a URI has behind its `?`.
    fn options(&self) -> Vec<String> {
        let mut options = Vec::new();
        if is_datagram_family(self.family) {
            options.extend(self.local.as_ref().map(|local| format!("local={local}")));
            options.extend(self.mode.map(|mode| format!("mode={}", mode.name())));
        } else if self.datagrams {
            options.push("transport=udp".to_owned());
        }
        options
    }

    /// `HOST:PORT`, with brackets around an IPv6 address.
    #[must_use]
    pub fn host_and_port(&self) -> String {
        format!("{}:{}", bracketed(&self.host), self.port)
    }
}

/// A host as URIs write it.
pub(crate) fn bracketed(host: &str) -> String {
    if host.contains(':') { format!("[{host}]") } else { host.to_owned() }
}

/// Location of a device, and optionally the family whose protocol it speaks.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct DeviceUri {
    /// Serial port, USB address or network address.
    pub location: Location,
    /// Name of the family; `None` selects the family that claims the device.
    pub driver: Option<String>,
}

/// Error of parsing a device URI.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "invalid device URI '{text}': {reason}: write serial:PATH[@BAUD], usb:VID:PID[:SERIAL], qtm:HOST[:PORT][?transport=udp] or \
     natnet:HOST[:PORT][?local=IF&mode=multicast|unicast] or lsl:NAME, with ?driver=NAME where needed"
)]
pub struct UriError {
    text: String,
    reason: String,
}

impl FromStr for DeviceUri {
    type Err = UriError;

    fn from_str(text: &str) -> Result<Self, UriError> {
        parse(text).map_err(|reason| UriError { text: text.to_owned(), reason })
    }
}

fn parse(text: &str) -> Result<DeviceUri, String> {
    let (base, query) = text.split_once('?').map_or((text, None), |(base, q)| (base, Some(q)));
    if let Some(names) = base.strip_prefix("lsl:") {
        return parse_streams(names, query);
    }
    let network = base.split_once(':').and_then(|(scheme, rest)| {
        let (family, port) = NETWORK_FAMILIES.iter().find(|(family, _)| *family == scheme)?;
        Some((*family, *port, rest))
    });
    let family = network.map(|(family, ..)| family);
    let Query { driver, datagrams, local, mode } = Query::parse(query, family)?;
    if let Some((family, port, rest)) = network {
        let (host, port) = parse_host(rest, port)?;
        let datagrams = datagrams || is_datagram_family(family);
        let address = NetworkAddress { family, host, port, datagrams, local, mode };
        return Ok(DeviceUri { location: Location::Network(address), driver });
    }
    let location = match base.split_once(':') {
        Some(("serial", rest)) => parse_serial(rest),
        Some(("usb", rest)) => parse_usb(rest),
        _ if base.starts_with('/') => Err(format!("a path needs a scheme: serial:{base}")),
        Some((scheme, _)) => {
            Err(format!("unknown scheme '{scheme}', expected serial, usb, qtm, natnet or lsl"))
        }
        None => Err("the scheme is missing".to_owned()),
    };
    Ok(DeviceUri { location: location?, driver })
}

/// Parses the names of LSL streams and what follows the `?`.
fn parse_streams(names: &str, query: Option<&str>) -> Result<DeviceUri, String> {
    let parts = query.into_iter().flat_map(|query| query.split('&'));
    let (drivers, rest): (Vec<&str>, Vec<&str>) =
        parts.partition(|part| part.starts_with("driver="));
    let driver = drivers.last().and_then(|part| part.strip_prefix("driver="));
    if driver == Some("") {
        return Err("expected driver=NAME after '?', found 'driver='".to_owned());
    }
    let location = Location::Streams(StreamQuery::parse(names, &rest)?);
    Ok(DeviceUri { location, driver: driver.map(str::to_owned) })
}

/// What follows the `?` of a URI.
#[derive(Debug, Default)]
struct Query {
    driver: Option<String>,
    datagrams: bool,
    local: Option<String>,
    mode: Option<StreamMode>,
}

impl Query {
    fn parse(query: Option<&str>, family: Option<&str>) -> Result<Self, String> {
        let by_udp = family.is_some_and(is_datagram_family);
        let by_tcp = family.is_some() && !by_udp;
        let mut parsed = Self::default();
        for part in query.into_iter().flat_map(|query| query.split('&')) {
            match part.split_once('=') {
                Some(("driver", name)) if !name.is_empty() => parsed.driver = Some(name.to_owned()),
                Some(("transport", "udp")) if by_tcp => parsed.datagrams = true,
                Some(("transport", "tcp")) if by_tcp => parsed.datagrams = false,
                Some(("transport", _)) if by_tcp => {
                    return Err(format!("expected transport=tcp or transport=udp, found '{part}'"));
                }
                Some(("mode", "multicast")) if by_udp => parsed.mode = Some(StreamMode::Multicast),
                Some(("mode", "unicast")) if by_udp => parsed.mode = Some(StreamMode::Unicast),
                Some(("mode", _)) if by_udp => {
                    return Err(format!("expected mode=multicast or mode=unicast, found '{part}'"));
                }
                Some(("local", local)) if by_udp && is_interface(local) => {
                    parsed.local = Some(local.to_owned());
                }
                Some(("local", _)) if by_udp => {
                    return Err(format!(
                        "expected local=INTERFACE or local=ADDRESS, found '{part}'"
                    ));
                }
                _ => return Err(format!("expected driver=NAME after '?', found '{part}'")),
            }
        }
        Ok(parsed)
    }
}

/// Whether a text can be the name of an interface, which has 15 characters at most, or an IPv4 address, which has as many.
fn is_interface(text: &str) -> bool {
    (1..=15).contains(&text.len())
        && text.chars().all(|c| c.is_ascii_graphic() && !"/&?".contains(c))
}

/// Parses `HOST[:PORT]`; an IPv6 address needs brackets if a port follows.
fn parse_host(rest: &str, default_port: u16) -> Result<(String, u16), String> {
    let (host, port) = match rest.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        Some((host, after)) => match after.strip_prefix(':') {
            Some(port) => (host, Some(port)),
            None if after.is_empty() => (host, None),
            None => return Err(format!("expected ':PORT' after ']', found '{after}'")),
        },
        None if rest.matches(':').count() > 1 => (rest, None),
        None => rest.split_once(':').map_or((rest, None), |(host, port)| (host, Some(port))),
    };
    let is_host_char = |c: char| c.is_alphanumeric() || "-._:%".contains(c);
    if host.is_empty() || !host.chars().all(is_host_char) {
        return Err(format!("'{host}' is not the name or address of a machine"));
    }
    let port = match port.map(|port| (port, port.parse())) {
        None => default_port,
        Some((_, Ok(port @ 1..))) => port,
        Some((port, _)) => return Err(format!("'{port}' is not a port, 1 to 65535")),
    };
    Ok((host.to_owned(), port))
}

fn parse_serial(rest: &str) -> Result<Location, String> {
    // The last '@' that no '/' follows: udev's by-path links contain '@' too.
    let (path, baud) = match rest.rsplit_once('@') {
        Some((path, baud)) if !baud.contains('/') => (path, Some(parse_baud(baud)?)),
        _ => (rest, None),
    };
    if path.is_empty() {
        return Err("the path is missing".to_owned());
    }
    Ok(Location::Serial { path: path.into(), baud })
}

fn parse_baud(baud: &str) -> Result<u32, String> {
    match baud.parse() {
        Ok(0) | Err(_) => Err(format!("'{baud}' is not a baud rate")),
        Ok(baud) => Ok(baud),
    }
}

fn parse_usb(rest: &str) -> Result<Location, String> {
    let mut parts = rest.splitn(3, ':');
    let mut hex = |what| {
        let part = parts.next().unwrap_or_default();
        if part.len() == 4 && part.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return u16::from_str_radix(part, 16).map_err(|error| error.to_string());
        }
        Err(format!("expected four hexadecimal digits as the {what} id, found '{part}'"))
    };
    let (vid, pid) = (hex("vendor")?, hex("product")?);
    match parts.next() {
        Some("") => Err("the serial number after the last ':' is missing".to_owned()),
        serial => Ok(Location::Usb { vid, pid, serial: serial.map(str::to_owned) }),
    }
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial { path, baud } => {
                write!(f, "serial:{}", path.display())?;
                baud.map_or(Ok(()), |baud| write!(f, "@{baud}"))
            }
            Self::Usb { vid, pid, serial } => {
                write!(f, "usb:{vid:04x}:{pid:04x}")?;
                serial.as_ref().map_or(Ok(()), |serial| write!(f, ":{serial}"))
            }
            Self::Network(address) => {
                let NetworkAddress { family, host, port, .. } = address;
                write!(f, "{family}:{}", bracketed(host))?;
                if !NETWORK_FAMILIES.contains(&(family, *port)) {
                    write!(f, ":{port}")?;
                }
                let options = address.options();
                if options.is_empty() { Ok(()) } else { write!(f, "?{}", options.join("&")) }
            }
            Self::Streams(query) => write!(f, "{query}"),
        }
    }
}

impl fmt::Display for DeviceUri {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let location = self.location.to_string();
        let joint = if location.contains('?') { '&' } else { '?' };
        write!(f, "{location}")?;
        self.driver.as_ref().map_or(Ok(()), |driver| write!(f, "{joint}driver={driver}"))
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::uri::LengthUnit;

    fn serial(path: &str, baud: Option<u32>) -> Location {
        Location::Serial { path: path.into(), baud }
    }

    #[test]
    fn every_form_round_trips() {
        let usb = |serial: Option<&str>| Location::Usb {
            vid: 0x0403,
            pid: 0x6abc,
            serial: serial.map(str::to_owned),
        };
        let qtm = |host: &str, port, datagrams| {
            Location::Network(NetworkAddress {
                datagrams,
                ..NetworkAddress::new("qtm", host, port)
            })
        };
        let natnet = |host: &str, port, local: Option<&str>, mode| {
            let local = local.map(str::to_owned);
            let address = NetworkAddress::new("natnet", host, port);
            Location::Network(NetworkAddress { local, mode, ..address })
        };
        let (multicast, unicast) = (Some(StreamMode::Multicast), Some(StreamMode::Unicast));
        let streams = |names: &[&str]| {
            let names = names.iter().map(|&name| name.to_owned()).collect();
            Location::Streams(StreamQuery { names, ..StreamQuery::default() })
        };
        for (text, location, driver) in [
            ("serial:/dev/ttyUSB0", serial("/dev/ttyUSB0", None), None),
            ("serial:/dev/ttyUSB0@921600", serial("/dev/ttyUSB0", Some(921_600)), None),
            ("serial:/dev/by-path/a@b/port", serial("/dev/by-path/a@b/port", None), None),
            ("serial:rel/pty@9600?driver=dvmc", serial("rel/pty", Some(9600)), Some("dvmc")),
            ("usb:0403:6abc", usb(None), None),
            ("usb:0403:6abc:A:1?driver=dvmc", usb(Some("A:1")), Some("dvmc")),
            ("qtm:lab-pc", qtm("lab-pc", 22_223, false), None),
            ("qtm:192.168.0.7:22300?driver=qtm", qtm("192.168.0.7", 22_300, false), Some("qtm")),
            ("qtm:[::1]:9?transport=udp", qtm("::1", 9, true), None),
            ("qtm:[fe80::1]?transport=udp&driver=qtm", qtm("fe80::1", 22_223, true), Some("qtm")),
            ("natnet:motive-pc", natnet("motive-pc", 1510, None, None), None),
            ("natnet:10.0.0.5:1520?local=eth0", natnet("10.0.0.5", 1520, Some("eth0"), None), None),
            (
                "natnet:m?local=10.0.0.7&mode=multicast&driver=natnet",
                natnet("m", 1510, Some("10.0.0.7"), multicast),
                Some("natnet"),
            ),
            ("natnet:m?mode=unicast", natnet("m", 1510, None, unicast), None),
            ("lsl:Rig A,EMG%2C left", streams(&["Rig A", "EMG, left"]), None),
            (
                "lsl:?type=MoCap&hostname=lab&rate=119.88&unit=cm&driver=lsl",
                Location::Streams(StreamQuery {
                    kind: Some("MoCap".to_owned()),
                    hostname: Some("lab".to_owned()),
                    rate_millihertz: Some(119_880),
                    unit: Some(LengthUnit::Centimetres),
                    ..StreamQuery::default()
                }),
                Some("lsl"),
            ),
        ] {
            let uri: DeviceUri = text.parse().unwrap();
            assert_eq!(uri.location, location, "{text}");
            assert_eq!(uri.driver.as_deref(), driver, "{text}");
            assert_eq!(uri.to_string(), text);
        }
    }

    #[test]
    fn errors_name_the_invalid_part() {
        for (text, reason) in [
            ("/dev/ttyUSB0", "serial:/dev/ttyUSB0"),
            ("tcp:host:1", "'tcp'"),
            ("serial:/dev/ttyUSB0@fast", "'fast'"),
            ("serial:/dev/ttyUSB0@0", "'0'"),
            ("serial:/dev/ttyUSB0@4294967296", "'4294967296'"),
            ("usb:403:6abc", "'403'"),
            ("usb:0403", "''"),
            ("usb:0403:+abc", "'+abc'"),
            ("usb:0403:6abc:", "':'"),
            ("serial:/dev/ttyUSB0?baud=1", "'baud=1'"),
            ("serial:/dev/ttyUSB0?driver=", "'driver='"),
            ("serial:/dev/ttyUSB0?transport=udp", "'transport=udp'"),
            ("qtm:lab?transport=ip", "'transport=ip'"),
            ("qtm:lab?mode=unicast", "'mode=unicast'"),
            ("natnet:lab?transport=udp", "'transport=udp'"),
            ("natnet:lab?mode=both", "'mode=both'"),
            ("natnet:lab?local=", "'local='"),
            ("natnet:lab?local=a b", "'local=a b'"),
            ("qtm:", "''"),
            ("qtm:lab pc", "'lab pc'"),
            ("qtm:lab:0", "'0'"),
            ("qtm:lab:65536", "'65536'"),
            ("qtm:[::1]22223", "'22223'"),
            ("lsl:", "name"),
            ("lsl:A,A", "'A'"),
            ("lsl:A,B?type=EEG", "type="),
            ("lsl:A?rate=fast", "rate=fast"),
            ("lsl:A?unit=inch", "unit=inch"),
            ("lsl:A?port=1", "'port=1'"),
            ("lsl:A%G1", "%"),
            ("lsl:A?driver=", "'driver='"),
        ] {
            let error = text.parse::<DeviceUri>().unwrap_err();
            assert!(error.reason.contains(reason), "{text}: {error}");
            let message = error.to_string();
            for form in [
                "serial:PATH[@BAUD]",
                "usb:VID:PID[:SERIAL]",
                "qtm:HOST[:PORT]",
                "natnet:HOST[:PORT]",
                "?driver=NAME",
            ] {
                assert!(message.contains(form), "{message}");
            }
        }
    }

    #[test]
    fn errors_name_the_missing_part() {
        let reason = |text: &str| text.parse::<DeviceUri>().unwrap_err().reason;
        let (no_scheme, no_path) = (reason(""), reason("serial:"));
        assert_eq!(reason("ttyUSB0"), no_scheme);
        assert_eq!(reason("serial:@9600"), no_path);
        assert_ne!(no_scheme, no_path);
        let (vendor, product) = (reason("usb:403:6abc"), reason("usb:0403:403"));
        assert_ne!(vendor, product, "which of the two");
    }
}
