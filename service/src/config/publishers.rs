//! The sections of publishers: `[publish.qtm]` and so on.

use std::{
    net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, SocketAddrV4},
    path::PathBuf,
};

use mocapd_drivers::natnet::Bitstream;

use super::Network;

/// The section `[publish.qtm]`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct QtmPublishConfig {
    /// Whether it is published.
    pub enabled: bool,
    /// The TCP address.
    pub listen: SocketAddr,
    /// The other machines that may connect.
    pub allow_from: Vec<Network>,
    /// Limit on simultaneous clients.
    pub clients_max: usize,
    /// Whether a client may take control.
    pub control: bool,
    /// The file with the password for it.
    pub password_file: Option<PathBuf>,
}

impl Default for QtmPublishConfig {
    fn default() -> Self {
        Self {
            enabled: false,
            listen: (Ipv4Addr::LOCALHOST, 0).into(),
            allow_from: Vec::new(),
            clients_max: 0,
            control: false,
            password_file: None,
        }
    }
}

impl QtmPublishConfig {
    /// Remarks on the section, one line each.
    pub(super) fn notes(&self) -> Vec<String> {
        let Self { enabled: true, listen, allow_from, control, password_file, .. } = self else {
            return Vec::new();
        };
        let mut notes = reach_notes("publish.qtm", *listen, allow_from);
        if !is_local(listen.ip()) && *control {
            notes.push(
                "publish.qtm.control is on: the password is sent over the network unencrypted; use a network that you trust"
                    .to_owned(),
            );
        }
        if !control && password_file.is_some() {
            notes.push(
                "publish.qtm.password_file has no effect: publish.qtm.control is false".to_owned(),
            );
        }
        notes
    }
}

/// The section `[publish.natnet]`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NatNetPublishConfig {
    /// Whether it is published.
    pub enabled: bool,
    /// The UDP address of commands.
    pub listen: SocketAddr,
    /// The group that frames go to; to each client by default.
    pub multicast: Option<SocketAddrV4>,
    /// The UDP port of a client's machine that its frames go to as well.
    pub data_port: usize,
    /// The version of frames, unless a client asks for another one.
    pub bitstream: Bitstream,
    /// The other machines that may connect.
    pub allow_from: Vec<Network>,
    /// Limit on simultaneous clients.
    pub clients_max: usize,
}

impl Default for NatNetPublishConfig {
    fn default() -> Self {
        Self {
            enabled: false,
            listen: (Ipv4Addr::LOCALHOST, 0).into(),
            multicast: None,
            data_port: 0,
            bitstream: Bitstream::NEWEST,
            allow_from: Vec::new(),
            clients_max: 0,
        }
    }
}

impl NatNetPublishConfig {
    /// Remarks on the section, one line each.
    pub(super) fn notes(&self) -> Vec<String> {
        let Self { enabled: true, listen, multicast, allow_from, .. } = self else {
            return Vec::new();
        };
        let mut notes = reach_notes("publish.natnet", *listen, allow_from);
        if !is_local(listen.ip())
            && let Some(group) = multicast
        {
            notes.push(format!(
                "publish.natnet.multicast is {group}: every machine of that network can read the frames, whatever \
                 publish.natnet.allow_from says"
            ));
        }
        notes
    }

    /// What is wrong with the port of frames: commands and frames of a program on this machine would meet at one.
    pub(super) fn data_port_problem(&self) -> Option<String> {
        (self.data_port == usize::from(self.listen.port())).then(|| {
            format!(
                "{} is the port of publish.natnet.listen: frames for programs on this machine would come back to the service; \
                 choose another one",
                self.data_port
            )
        })
    }

    /// What is wrong with a group: frames leave by one interface, which the address tells.
    pub(super) fn multicast_problem(&self) -> Option<String> {
        let group = self.multicast?;
        match self.listen.ip() {
            IpAddr::V4(ip) if !ip.is_unspecified() => None,
            _ => Some(format!(
                "frames to the group {group} leave by one interface: set publish.natnet.listen to its IPv4 address, such as \
                 192.168.10.2:{}",
                self.listen.port()
            )),
        }
    }
}

/// The section `[publish.lsl]`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LslPublishConfig {
    /// Whether it is published.
    pub enabled: bool,
    /// The address of this machine at which streams are read.
    pub listen: Ipv4Addr,
    /// The other machines that may read.
    pub allow_from: Vec<Network>,
    /// Limit on simultaneous readers of streams.
    pub clients_max: usize,
}

impl Default for LslPublishConfig {
    fn default() -> Self {
        let (enabled, listen) = (false, Ipv4Addr::LOCALHOST);
        Self { enabled, listen, allow_from: Vec::new(), clients_max: 0 }
    }
}

impl LslPublishConfig {
    /// Remarks on the section, one line each.
    pub(super) fn notes(&self) -> Vec<String> {
        let Self { enabled: true, listen, allow_from, .. } = self else {
            return Vec::new();
        };
        // Its ports are those of LSL's configuration.
        let texts = [listen.to_string(), Ipv4Addr::UNSPECIFIED.to_string()];
        notes_on_reach("publish.lsl", &texts, listen.is_loopback(), allow_from)
    }
}

/// The section `[publish.foxglove]`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FoxglovePublishConfig {
    /// Whether it is published.
    pub enabled: bool,
    /// The TCP address.
    pub listen: SocketAddr,
    /// The other machines that may connect.
    pub allow_from: Vec<Network>,
    /// The web pages whose scripts may connect.
    pub origins: Vec<String>,
    /// Limit on simultaneous clients.
    pub clients_max: usize,
}

impl Default for FoxglovePublishConfig {
    fn default() -> Self {
        Self {
            enabled: false,
            listen: (Ipv4Addr::LOCALHOST, 0).into(),
            allow_from: Vec::new(),
            origins: Vec::new(),
            clients_max: 0,
        }
    }
}

impl FoxglovePublishConfig {
    /// What to do where the service has no server for Foxglove.
    const NOT_BUILT: &str = "publish.foxglove.enabled is true, but this build cannot publish for Foxglove: use the \
        Debian package, or build with `cargo build --release --features full`";

    /// Remarks on the section, one line each.
    pub(super) fn notes(&self) -> Vec<String> {
        match self {
            Self { enabled: false, .. } => Vec::new(),
            _ if cfg!(not(feature = "full")) => vec![Self::NOT_BUILT.to_owned()],
            Self { listen, allow_from, .. } => reach_notes("publish.foxglove", *listen, allow_from),
        }
    }
}

fn is_local(listen: IpAddr) -> bool {
    listen.to_canonical().is_loopback()
}

/// Remarks on a section whose address and networks contradict each other.
fn reach_notes(section: &str, listen: SocketAddr, allow_from: &[Network]) -> Vec<String> {
    let all: IpAddr = match listen.ip() {
        IpAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
        IpAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
    };
    let texts = [listen.to_string(), SocketAddr::new(all, listen.port()).to_string()];
    notes_on_reach(section, &texts, is_local(listen.ip()), allow_from)
}

/// The same with the address, and that of all networks, as they are to be written.
fn notes_on_reach(
    section: &str,
    [listen, all]: &[String; 2],
    is_local: bool,
    allow_from: &[Network],
) -> Vec<String> {
    match (is_local, allow_from.is_empty()) {
        (true, false) => vec![format!(
            "{section}.allow_from has no effect: only this machine can reach {section}.listen = {listen}; listen on {all} \
             for others"
        )],
        (false, true) => vec![format!(
            "{section}.listen is {listen}, but no other machine may connect: list those that may in \
             {section}.allow_from, such as allow_from = [\"192.168.10.0/24\"]"
        )],
        _ => Vec::new(),
    }
}

/// Reads a group and its port.
pub(super) fn group(text: &str) -> Result<SocketAddrV4, String> {
    let parsed: SocketAddrV4 = text
        .parse()
        .map_err(|_| "it is not an IPv4 group with a port, as 239.255.42.99:1511".to_owned())?;
    match parsed {
        group if !group.ip().is_multicast() => {
            Err("it is no multicast group: those begin with 224 to 239".to_owned())
        }
        group if group.port() == 0 => Err("the port is 0".to_owned()),
        group => Ok(group),
    }
}

/// Reads a version of the bitstream.
pub(super) fn bitstream(text: &str) -> Result<Bitstream, String> {
    let version: Bitstream = text.parse()?;
    if (Bitstream::OLDEST..=Bitstream::NEWEST).contains(&version) {
        return Ok(version);
    }
    Err(format!("{} to {} are known", Bitstream::OLDEST, Bitstream::NEWEST))
}
