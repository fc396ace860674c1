//! Finds a machine by its name and connects to it, both with a time-out. Each failure says what to do.

use std::{
    io::{self, ErrorKind},
    net::{IpAddr, SocketAddr, TcpStream, ToSocketAddrs},
    sync::mpsc::sync_channel,
    thread::Builder,
    time::Duration,
};

use rustix::io::Errno;

use crate::{
    transport::TransportError,
    uri::{NetworkAddress, bracketed},
};

/// Time-out of a connection attempt: a machine on a local network answers in a millisecond; two lost packets are
/// repeated after one second each.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);

/// Time-out of looking up a name. The system's resolver tries a silent name server for 5 s and more, which a reader
/// that must show signs of life every 10 s cannot wait for.
const RESOLVE_TIMEOUT: Duration = Duration::from_secs(3);

/// Addresses of one name that are tried: one for each version of the Internet Protocol.
const ADDRESSES_MAX: usize = 2;

/// Connects to the first address of a machine that answers.
///
/// # Errors
/// `Unreachable`, with the remedy.
pub(super) fn connect(address: &NetworkAddress) -> Result<TcpStream, TransportError> {
    let unreachable =
        |remedy: String| TransportError::Unreachable { device: address.host_and_port(), remedy };
    let mut problem = None;
    for target in resolve(address).map_err(unreachable)? {
        match TcpStream::connect_timeout(&target, CONNECT_TIMEOUT) {
            Ok(stream) => return Ok(stream),
            // The first address is the preferred one: its failure says most.
            Err(error) => problem = problem.or(Some((error, target.ip()))),
        }
    }
    Err(match problem {
        Some((error, ip)) => unreachable(remedy(&error, ip, address, "TCP")),
        None => unreachable(no_such_name(address)),
    })
}

/// The addresses of a machine, at most [`ADDRESSES_MAX`]: the first of each version.
pub(super) fn resolve(address: &NetworkAddress) -> Result<Vec<SocketAddr>, String> {
    if let Ok(ip) = address.host.parse::<IpAddr>() {
        return Ok(vec![SocketAddr::new(ip, address.port)]);
    }
    let (sender, receiver) = sync_channel(1);
    let name = (address.host.clone(), address.port);
    // The resolver cannot be cancelled: a thread that finds nobody waiting ends by itself. It gives up after some 20 s, so
    // that less than ten of them wait, however often a recorder tries.
    let thread = Builder::new().name("mocapd-resolve".to_owned()).spawn(move || {
        let found = name.to_socket_addrs().map(Iterator::collect::<Vec<_>>);
        sender.send(found).ok();
    });
    if let Err(error) = thread {
        return Err(format!(
            "no thread can be started to look up the name ({error}): end programs"
        ));
    }
    let found = match receiver.recv_timeout(RESOLVE_TIMEOUT) {
        Ok(Ok(found)) => found,
        Ok(Err(_)) => return Err(no_such_name(address)),
        Err(_) => {
            return Err(format!(
                "the name server does not answer: give the machine's address, such as {}:192.168.0.10",
                address.family
            ));
        }
    };
    let mut targets: Vec<SocketAddr> = Vec::new();
    for target in found {
        if targets.iter().all(|known| known.is_ipv4() != target.is_ipv4()) {
            targets.push(target);
        }
    }
    targets.truncate(ADDRESSES_MAX);
    Ok(targets)
}

fn no_such_name(address: &NetworkAddress) -> String {
    format!(
        "no machine named '{}' is known: check the spelling, or give its address, such as {}:192.168.0.10",
        address.host, address.family
    )
}

/// What to do about a failed connection attempt by this protocol.
pub(super) fn remedy(
    error: &io::Error,
    ip: IpAddr,
    address: &NetworkAddress,
    protocol: &str,
) -> String {
    let NetworkAddress { family, port, .. } = address;
    let host = bracketed(&address.host);
    if matches!(Errno::from_io_error(error), Some(Errno::PERM | Errno::AFNOSUPPORT)) {
        return format!(
            "this system does not let mocapd reach {ip}: under systemd, add `IPAddressAllow={ip}` to the unit, and \
             keep AF_INET and AF_INET6 in RestrictAddressFamilies"
        );
    }
    match error.kind() {
        ErrorKind::ConnectionRefused => format!(
            "the machine is there, but nothing listens on {protocol} port {port}: start the program there, or give its port, \
             {family}:{host}:PORT"
        ),
        ErrorKind::TimedOut | ErrorKind::WouldBlock => format!(
            "no answer in {} s: check that the machine is on, its address, and that no firewall blocks {protocol} port {port}",
            CONNECT_TIMEOUT.as_secs()
        ),
        ErrorKind::HostUnreachable | ErrorKind::NetworkUnreachable => {
            format!("no route leads to {ip}: check the cable, and the addresses of both machines")
        }
        // A link-local address without its interface.
        ErrorKind::InvalidInput => {
            format!("the address lacks the interface: give it, as in {family}:[{ip}%eth0]")
        }
        _ => format!("{error}: check the address and the network"),
    }
}
