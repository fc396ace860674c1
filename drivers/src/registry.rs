//! The registry: all device families, the attached devices, and how to open them.

use std::path::Path;

use serialport::SerialPortType;

pub use crate::device::{Candidate, Claim, Family};
use crate::{
    device::Protocol,
    link, lsl, natnet, ndi, qtm,
    transport::{
        Access, Transport, TransportError, access,
        lsl::LslTransport,
        network,
        serial::SerialTransport,
        usb::{self, UsbDevice, UsbTransport},
    },
    uri::{DeviceUri, Location, NETWORK_FAMILIES, StreamQuery},
};

/// All device families. Register a new one here.
pub static FAMILIES: &[Family] =
    &[link::FAMILY, ndi::FAMILY, qtm::FAMILY, natnet::FAMILY, lsl::FAMILY];

/// Returns the family with the highest claim on a device; of two equal claims, the first in [`FAMILIES`].
#[must_use]
pub fn family_of(candidate: &Candidate) -> Option<(&'static Family, Claim)> {
    let claims = FAMILIES.iter().map(|family| (family, (family.claims)(candidate)));
    // Reversed, as `max_by_key` returns the last of equal claims.
    claims.filter(|(_, claim)| *claim > Claim::No).rev().max_by_key(|(_, claim)| *claim)
}

/// An attached device.
#[derive(Debug)]
pub struct AttachedDevice {
    /// The device as the operating system describes it.
    pub candidate: Candidate,
    /// Name of the family with the highest claim, and that claim.
    pub family: Option<(&'static str, Claim)>,
    /// Whether it can be opened, or the error that opening would return.
    pub access: Access,
}

/// Lists serial ports, then USB devices that are not serial ports. Opens none of them.
///
/// # Errors
/// `Io` when the operating system's device lists cannot be read.
pub fn devices() -> Result<Vec<AttachedDevice>, TransportError> {
    let serial = serial_candidates()?;
    let usb = usb::devices()?;
    let mut listed = Vec::new();
    for device in &usb {
        if !serial.iter().any(|port| is_port_of(port, device)) {
            listed.push(list_device(usb_candidate(device), usb::usb_access(device)));
        }
    }
    let ports = serial.into_iter().map(|candidate| {
        let access = match &candidate.location {
            Location::Serial { path, .. } => access(path),
            Location::Usb { .. } | Location::Network(_) | Location::Streams(_) => {
                Access::Accessible
            }
        };
        list_device(candidate, access)
    });
    Ok(ports.chain(listed).collect())
}

/// Lists devices that answer a search on the networks of this machine, which takes two thirds of a second.
#[must_use]
pub fn network_devices() -> Vec<AttachedDevice> {
    let found = natnet::candidates().into_iter().chain(qtm::discovery::candidates());
    found.map(|candidate| list_device(candidate, Access::Accessible)).collect()
}

/// Serial ports, sorted by name.
fn serial_candidates() -> Result<Vec<Candidate>, TransportError> {
    const SYSFS: &str = "/sys/class/tty";
    // serialport panics without this folder.
    if !Path::new(SYSFS).exists() {
        return Ok(Vec::new());
    }
    let mut ports = serialport::available_ports().map_err(|error| TransportError::Io {
        device: SYSFS.to_owned(),
        action: "listing serial ports",
        source: error.into(),
    })?;
    ports.sort_by(|a, b| a.port_name.cmp(&b.port_name));
    let candidates = ports.into_iter().map(|port| {
        let location = Location::Serial { path: port.port_name.into(), baud: None };
        match port.port_type {
            SerialPortType::UsbPort(usb) => Candidate {
                location,
                usb_ids: Some((usb.vid, usb.pid)),
                serial: usb.serial_number,
                manufacturer: usb.manufacturer,
                product: usb.product,
            },
            _ => Candidate::at(location),
        }
    });
    Ok(candidates.collect())
}

fn usb_candidate(device: &UsbDevice) -> Candidate {
    let UsbDevice { vid, pid, serial, manufacturer, product, .. } = device.clone();
    Candidate {
        location: device.location(),
        usb_ids: Some((vid, pid)),
        serial,
        manufacturer,
        product,
    }
}

fn is_port_of(port: &Candidate, device: &UsbDevice) -> bool {
    port.usb_ids == Some((device.vid, device.pid)) && port.serial == device.serial
}

fn list_device(candidate: Candidate, access: Access) -> AttachedDevice {
    let family = family_of(&candidate).map(|(family, claim)| (family.name, claim));
    AttachedDevice { candidate, family, access }
}

/// An open device and its protocol.
#[derive(Debug)]
pub struct OpenedDevice {
    /// Byte stream to the device, as returned by [`Protocol::attach`].
    pub transport: Box<dyn Transport>,
    /// Decoder and encoder of that stream.
    pub protocol: Box<dyn Protocol>,
    /// Name of the family.
    pub family: &'static str,
    /// Identity of the device, to find it after a replug.
    pub identity: Candidate,
}

/// Reasons why a device was not opened.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OpenError {
    /// No family has the name in `?driver=NAME`.
    #[error("unknown driver '{name}': use one of {}", family_names())]
    UnknownDriver {
        /// Name in the URI.
        name: String,
    },
    /// No family claims the device.
    #[error("no driver recognises {location}: choose one with ?driver=NAME: {}", family_names())]
    Unclaimed {
        /// Location of the device.
        location: String,
    },
    /// The family named by `?driver=NAME` does not use such a line.
    #[error("the driver {name} cannot use {location}: {}", line_of(name))]
    WrongLine {
        /// Name in the URI.
        name: &'static str,
        /// Location of the device.
        location: String,
    },
    /// The transport could not be opened.
    #[error(transparent)]
    Transport(#[from] TransportError),
}

/// Opens a device without writing to it.
///
/// # Errors
/// `UnknownDriver`, `Unclaimed`, and the transport's error.
pub fn open(uri: &DeviceUri) -> Result<OpenedDevice, OpenError> {
    open_with_wrapper(uri, &mut |_, line| line)
}

/// Opens a device with a wrapper around its transport, such as a raw log: `wrap` gets the family's name
/// and the transport, and returns the transport to give to the protocol.
///
/// # Errors
/// `UnknownDriver`, `Unclaimed`, and the transport's error.
pub fn open_with_wrapper(
    uri: &DeviceUri,
    wrap: &mut dyn FnMut(&'static str, Box<dyn Transport>) -> Box<dyn Transport>,
) -> Result<OpenedDevice, OpenError> {
    let named = uri.driver.as_deref().map(family_named).transpose()?;
    if let Some(family) = named.filter(|family| !uses(family.name, &uri.location)) {
        let location = uri.location.to_string();
        return Err(OpenError::WrongLine { name: family.name, location });
    }
    let mut identity = candidate_at(&uri.location);
    let transport = match &uri.location {
        Location::Streams(query) => {
            let line = LslTransport::open(query)?;
            identity.serial = line.only_source_id();
            Box::new(line) as Box<dyn Transport>
        }
        location => open_transport(location)?,
    };
    let unclaimed = || OpenError::Unclaimed { location: uri.location.to_string() };
    let family = match named {
        Some(family) => family,
        None => family_of(&identity).ok_or_else(unclaimed)?.0,
    };
    let mut protocol = (family.protocol)(&uri.location);
    let transport = protocol.attach(wrap(family.name, transport));
    Ok(OpenedDevice { transport, protocol, family: family.name, identity })
}

/// Whether a family can be at a location: one on the network has a scheme of its own.
fn uses(family: &str, location: &Location) -> bool {
    match location {
        Location::Network(address) => address.family == family,
        Location::Streams(_) => family == lsl::FAMILY.name,
        Location::Serial { .. } | Location::Usb { .. } => !is_on_network(family),
    }
}

fn is_on_network(family: &str) -> bool {
    family == lsl::FAMILY.name || NETWORK_FAMILIES.iter().any(|(name, _)| *name == family)
}

/// The form of a family's URIs, for an error.
fn line_of(family: &str) -> String {
    if family == lsl::FAMILY.name {
        return "give lsl:NAME".to_owned();
    }
    if is_on_network(family) {
        return format!("give {family}:HOST[:PORT]");
    }
    "it needs serial:PATH or usb:VID:PID".to_owned()
}

/// Reopens a device after a disconnect, also when a replug gave its port another name.
///
/// # Errors
/// The transport's error.
pub fn reopen(uri: &DeviceUri, identity: &Candidate) -> Result<Box<dyn Transport>, TransportError> {
    open_transport(&current_location(&uri.location, identity))
}

/// Returns the current URI of a device that was open before.
#[must_use]
pub fn current_uri(uri: &DeviceUri, identity: &Candidate) -> DeviceUri {
    DeviceUri { location: current_location(&uri.location, identity), driver: uri.driver.clone() }
}

/// The current location of a device. USB devices are found by serial number, among any others of that kind.
fn current_location(location: &Location, identity: &Candidate) -> Location {
    match *location {
        Location::Usb { vid, pid, ref serial } => {
            let serial = identity.serial.clone().or_else(|| serial.clone());
            Location::Usb { vid, pid, serial }
        }
        Location::Serial { ref path, baud } if identity.serial.is_some() && !path.exists() => {
            let ports = serial_candidates().unwrap_or_default().into_iter();
            let mut same = ports.filter(|port| is_same(port, identity));
            match (same.next().map(|port| port.location), same.next()) {
                (Some(Location::Serial { path, .. }), None) => Location::Serial { path, baud },
                _ => location.clone(),
            }
        }
        // The stream that was recorded: another of its name may have come meanwhile.
        Location::Streams(ref query) if query.names.len() == 1 && query.source_id.is_none() => {
            let source_id = identity.serial.clone();
            Location::Streams(StreamQuery { source_id, ..query.clone() })
        }
        Location::Serial { .. } | Location::Network(_) | Location::Streams(_) => location.clone(),
    }
}

fn is_same(port: &Candidate, identity: &Candidate) -> bool {
    (port.usb_ids, &port.serial) == (identity.usb_ids, &identity.serial)
}

fn family_named(name: &str) -> Result<&'static Family, OpenError> {
    let found = FAMILIES.iter().find(|family| family.name.eq_ignore_ascii_case(name));
    found.ok_or_else(|| OpenError::UnknownDriver { name: name.to_owned() })
}

fn family_names() -> String {
    FAMILIES.iter().map(|family| family.name).collect::<Vec<_>>().join(", ")
}

fn open_transport(location: &Location) -> Result<Box<dyn Transport>, TransportError> {
    match location {
        Location::Serial { path, baud } => Ok(Box::new(SerialTransport::open(path, *baud)?)),
        Location::Usb { vid, pid, serial } => {
            Ok(Box::new(UsbTransport::open(*vid, *pid, serial.as_deref())?))
        }
        Location::Network(address) => network::open(address),
        Location::Streams(query) => Ok(Box::new(LslTransport::open(query)?)),
    }
}

/// Describes the device at a location. A link to a port counts as the port.
fn candidate_at(location: &Location) -> Candidate {
    let unknown = || Candidate::at(location.clone());
    let path = match location {
        Location::Serial { path, .. } => path,
        Location::Usb { vid, pid, serial } => {
            let same = usb::devices().unwrap_or_default().into_iter().find(|device| {
                (device.vid, device.pid) == (*vid, *pid)
                    && (serial.is_none() || device.serial == *serial)
            });
            return same.as_ref().map_or_else(unknown, usb_candidate);
        }
        Location::Network(_) | Location::Streams(_) => return unknown(),
    };
    let Ok(real_path) = path.canonicalize() else { return unknown() };
    let ports = serial_candidates().unwrap_or_default();
    let is_at_path = |port: &&Candidate| matches!(&port.location, Location::Serial { path, .. } if *path == real_path);
    let Some(mut found) = ports.iter().find(is_at_path).cloned() else { return unknown() };
    if ports.iter().filter(|port| is_same(port, &found)).count() > 1 {
        // Several ports of one adapter, or adapters without individual numbers: the number identifies nothing.
        found.serial = None;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_fit_into_a_uri() {
        for (index, family) in FAMILIES.iter().enumerate() {
            assert!(
                family.name.bytes().all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit())
            );
            assert!(FAMILIES[..index].iter().all(|other| other.name != family.name));
        }
    }

    #[test]
    fn after_an_outage_a_stream_is_that_of_the_source_that_was_recorded() {
        let found = |uri: &str, source_id: Option<&str>| {
            let uri: DeviceUri = uri.parse().unwrap();
            let serial = source_id.map(str::to_owned);
            let identity = Candidate { serial, ..Candidate::at(uri.location.clone()) };
            current_uri(&uri, &identity).to_string()
        };
        assert_eq!(found("lsl:Rig?type=MoCap", Some("A")), "lsl:Rig?type=MoCap&source_id=A");
        assert_eq!(found("lsl:Rig?source_id=B", Some("A")), "lsl:Rig?source_id=B");
        assert_eq!(found("lsl:Rig", None), "lsl:Rig");
        assert_eq!(found("lsl:Rig,EMG", Some("A")), "lsl:Rig,EMG");
    }

    #[test]
    fn a_device_that_names_itself_is_certain_and_a_bare_port_is_possible() {
        let port = Candidate::at("serial:/dev/ttyUSB0".parse::<DeviceUri>().unwrap().location);
        assert_eq!(family_of(&port).unwrap().1, Claim::Possible);
        let named = Candidate { product: Some("DVMC-8820".to_owned()), ..port.clone() };
        assert_eq!(family_of(&named).unwrap().1, Claim::Certain);
        let adapter = Candidate { product: Some("NDI Host USB Converter".to_owned()), ..named };
        let (family, claim) = family_of(&adapter).unwrap();
        assert_eq!((family.name, claim), ("ndi", Claim::Certain));
        let mouse = Candidate {
            product: Some("Optical Mouse".to_owned()),
            ..Candidate::at(Location::Usb { vid: 0x046d, pid: 0xc077, serial: None })
        };
        assert!(family_of(&mouse).is_none());
    }

    #[test]
    fn listing_works_with_and_without_a_usb_stack() {
        for listed in devices().unwrap() {
            assert!(listed.candidate.location.to_string().contains(':'), "{listed:?}");
        }
    }

    #[test]
    fn an_adapter_is_listed_once() {
        let device = UsbDevice {
            vid: 0x0403,
            pid: 0x6001,
            serial: Some("A1".to_owned()),
            manufacturer: None,
            product: None,
            node: "/dev/bus/usb/001/002".into(),
            sysfs: "/sys/bus/usb/devices/1-1".into(),
        };
        let port = Candidate {
            location: Location::Serial { path: "/dev/ttyUSB0".into(), baud: None },
            ..usb_candidate(&device)
        };
        assert!(is_port_of(&port, &device));
        let other = UsbDevice { serial: Some("A2".to_owned()), ..device };
        assert!(!is_port_of(&port, &other));
    }

    fn error_of(uri: &str) -> OpenError {
        open(&uri.parse().unwrap()).unwrap_err()
    }

    #[test]
    fn errors_say_what_to_do() {
        let unknown = error_of("serial:/dev/null?driver=vicon");
        assert!(matches!(&unknown, OpenError::UnknownDriver { name } if name == "vicon"));
        assert!(unknown.to_string().contains(&family_names()), "{unknown}");
        // A driver name in capitals is accepted: the fault is the port.
        for uri in ["serial:/dev/null?driver=NDI", "serial:/dev/null", "serial:/etc/hostname"] {
            let not_a_port = error_of(uri);
            let device = uri.trim_start_matches("serial:").trim_end_matches("?driver=NDI");
            assert!(
                matches!(&not_a_port, OpenError::Transport(TransportError::Unsupported(text)) if text.contains(device)),
                "{uri}: {not_a_port:?}"
            );
        }
        for (uri, name) in [
            ("usb:1209:0001:none", "usb:1209:0001:none"),
            ("serial:/dev/mocapd-none", "/dev/mocapd-none"),
        ] {
            let missing = error_of(uri);
            assert!(
                matches!(&missing, OpenError::Transport(TransportError::NotFound { device }) if device == name),
                "{missing:?}"
            );
            assert!(missing.to_string().contains("`mocapd devices`"), "{missing}");
        }
    }
}
