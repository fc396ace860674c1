//! Interfaces of this machine, and sockets of multicast groups on one of them.

use std::{
    io,
    net::{IpAddr, Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket},
};

use nix::ifaddrs::getifaddrs;
use socket2::{Domain, Protocol, Socket, Type};

/// A socket that gets the datagrams of all networks for a port, which several programs of this machine share.
///
/// # Errors
/// The system's.
pub(in crate::transport) fn shared_socket(port: u16) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_reuse_address(true)?;
    socket.set_broadcast(true)?;
    socket.set_nonblocking(true)?;
    socket.bind(&SocketAddr::from((Ipv4Addr::UNSPECIFIED, port)).into())?;
    Ok(socket.into())
}

/// An IPv4 address of an interface of this machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Interface {
    /// Its name, such as `eth0`.
    pub name: String,
    /// Its address.
    pub address: Ipv4Addr,
    /// The address of all machines on its network, if it has one.
    pub broadcast: Option<Ipv4Addr>,
    /// Whether it carries multicast.
    pub has_multicast: bool,
}

/// Interfaces that are up, one for each IPv4 address.
///
/// # Errors
/// The system's.
pub fn interfaces() -> io::Result<Vec<Interface>> {
    use nix::net::if_::InterfaceFlags;

    let mut found = Vec::new();
    for entry in getifaddrs()? {
        let v4 = |address: Option<nix::sys::socket::SockaddrStorage>| {
            address.and_then(|address| Some(Ipv4Addr::from(address.as_sockaddr_in()?.ip())))
        };
        let is_up = entry.flags.contains(InterfaceFlags::IFF_UP);
        let Some(address) = v4(entry.address).filter(|_| is_up) else { continue };
        // Without this flag the field has the other end of a point-to-point link.
        let can_broadcast = entry.flags.contains(InterfaceFlags::IFF_BROADCAST);
        let broadcast = v4(entry.broadcast).filter(|_| can_broadcast);
        let has_multicast = entry.flags.contains(InterfaceFlags::IFF_MULTICAST);
        found.push(Interface { name: entry.interface_name, address, broadcast, has_multicast });
    }
    Ok(found)
}

/// The address of the interface with this name or address.
///
/// # Errors
/// What to do, when there is none.
pub(super) fn interface_address(wanted: &str) -> Result<Ipv4Addr, String> {
    let all = interfaces().map_err(|error| format!("the interfaces cannot be listed: {error}"))?;
    let is_wanted = |one: &&Interface| one.name == wanted || one.address.to_string() == wanted;
    match all.iter().find(is_wanted) {
        Some(interface) => Ok(interface.address),
        None => {
            let known: Vec<_> =
                all.iter().map(|one| format!("{} ({})", one.name, one.address)).collect();
            Err(format!(
                "this machine has no interface '{wanted}' with an IPv4 address: give local={}",
                known.join(" or ")
            ))
        }
    }
}

/// The address of the interface that leads to a machine.
///
/// # Errors
/// The system's: no route leads there.
pub(super) fn address_towards(target: SocketAddrV4) -> io::Result<Ipv4Addr> {
    // Sends nothing: it only selects a route.
    let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
    socket.connect(target)?;
    match socket.local_addr()?.ip() {
        IpAddr::V4(address) => Ok(address),
        IpAddr::V6(_) => Err(io::ErrorKind::AddrNotAvailable.into()),
    }
}

/// A socket at which datagrams for a port arrive: those to a group on the interface with this address, or those to this
/// machine. Other programs may listen to a group, too.
///
/// # Errors
/// The system's.
pub(super) fn listening_socket(
    group: Option<Ipv4Addr>,
    port: u16,
    interface: Ipv4Addr,
) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    // Datagrams to a group reach all programs that joined it; those to this machine only the last one.
    socket.set_reuse_address(group.is_some())?;
    // Bound to the group, it gets no datagrams of other groups on this port.
    let address = group.unwrap_or(interface);
    socket.bind(&SocketAddr::from((address, port)).into())?;
    if let Some(group) = group {
        // Only what comes by this interface: by default a socket gets the groups that other programs joined on others, too.
        socket.set_multicast_all_v4(false)?;
        socket.join_multicast_v4(&group, &interface)?;
    }
    Ok(socket.into())
}

/// A socket that sends to groups on the interface with this address. Datagrams cross `hops - 1` routers, and reach programs
/// on this machine, too.
///
/// # Errors
/// The system's.
pub fn multicast_sender(interface: Ipv4Addr, hops: u32) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.bind(&SocketAddr::from((interface, 0)).into())?;
    socket.set_multicast_if_v4(&interface)?;
    socket.set_multicast_ttl_v4(hops)?;
    socket.set_multicast_loop_v4(true)?;
    Ok(socket.into())
}
