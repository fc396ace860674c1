//! The network transport against a peer on this machine.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::{
    io::{Read, Write},
    net::{Ipv4Addr, TcpListener, TcpStream, UdpSocket},
    time::{Duration, Instant},
};

use mocapd_drivers::{
    transport::{
        DatagramSource, Transport, TransportError,
        network::{NetworkTransport, UdpTransport, multicast_sender, search},
    },
    uri::NetworkAddress,
};

fn connected(datagrams: bool) -> (NetworkTransport, TcpStream) {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let port = listener.local_addr().unwrap().port();
    let address = NetworkAddress { datagrams, ..NetworkAddress::new("qtm", "localhost", port) };
    let transport = NetworkTransport::open(&address).unwrap();
    (transport, listener.accept().unwrap().0)
}

/// Reads until something arrives.
fn read(transport: &mut dyn Transport) -> Result<Vec<u8>, TransportError> {
    let mut buf = [0; 1 << 16];
    let began = Instant::now();
    loop {
        let n = transport.read(&mut buf)?;
        if n > 0 {
            return Ok(buf[..n].to_vec());
        }
        assert!(began.elapsed() < Duration::from_secs(10), "nothing arrives");
    }
}

#[test]
fn bytes_travel_in_both_directions_and_an_end_is_a_lost_connection() {
    let (mut transport, mut peer) = connected(false);
    assert_eq!(transport.read(&mut [0; 8]).unwrap(), 0, "a read without bytes is none");
    transport.write_all(b"Version 1.28").unwrap();
    let mut received = [0; 12];
    peer.read_exact(&mut received).unwrap();
    assert_eq!(&received, b"Version 1.28");
    peer.write_all(b"reply").unwrap();
    drop(peer);
    assert_eq!(read(&mut transport).unwrap(), b"reply");
    assert!(!transport.arrival().is_datagram);
    let error = read(&mut transport).unwrap_err();
    assert!(
        matches!(&error, TransportError::ConnectionLost { cause, .. } if cause.contains("closed"))
    );
    assert!(error.is_gone());
}

#[test]
fn a_read_has_either_the_stream_or_one_datagram() {
    let (mut transport, mut peer) = connected(true);
    let port = transport.datagram_port().unwrap();
    assert!(transport.describe().contains(&port.to_string()));
    let sender = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    for k in 0..3 {
        peer.write_all(b"stream").unwrap();
        sender.send_to(&[k; 40], (Ipv4Addr::LOCALHOST, port)).unwrap();
    }
    let (mut stream, mut datagrams) = (0, Vec::new());
    while stream < 18 || datagrams.len() < 3 {
        let bytes = read(&mut transport).unwrap();
        let arrival = transport.arrival();
        assert_eq!(arrival.is_datagram, bytes.len() == 40 && bytes[0] < 3);
        if arrival.is_datagram {
            assert!(arrival.host_ns.is_some());
            datagrams.push(bytes[0]);
        } else {
            stream += bytes.len();
        }
    }
    assert_eq!((stream, datagrams), (18, vec![0, 1, 2]));
}

#[test]
fn the_last_datagrams_are_read_behind_the_end_of_the_stream() {
    let (mut transport, peer) = connected(true);
    let port = transport.datagram_port().unwrap();
    let sender = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    drop(peer);
    for _ in 0..5 {
        assert_eq!(transport.read(&mut [0; 64]).unwrap(), 0);
    }
    sender.send_to(b"last", (Ipv4Addr::LOCALHOST, port)).unwrap();
    assert_eq!(read(&mut transport).unwrap(), b"last");
    // A peer that keeps sending does not hide that the connection is gone.
    let began = Instant::now();
    let error = loop {
        sender.send_to(b"more", (Ipv4Addr::LOCALHOST, port)).unwrap();
        match transport.read(&mut [0; 64]) {
            Ok(_) => assert!(began.elapsed() < Duration::from_secs(5)),
            Err(error) => break error,
        }
    };
    assert!(error.is_gone());
}

#[test]
fn a_peer_that_reads_nothing_does_not_hang_the_writer() {
    let (mut transport, _peer) = connected(false);
    let began = Instant::now();
    let error = loop {
        if let Err(error) = transport.write_all(&[0; 1 << 16]) {
            break error;
        }
        assert!(began.elapsed() < Duration::from_secs(20));
    };
    assert!(error.to_string().contains("reads no commands"), "{error}");
}

/// A device that is reached by datagrams: its transport, and its own socket.
fn by_datagrams(local: Option<&str>) -> (UdpTransport, UdpSocket) {
    let device = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let port = device.local_addr().unwrap().port();
    let local = local.map(str::to_owned);
    let address = NetworkAddress { local, ..NetworkAddress::new("natnet", "127.0.0.1", port) };
    (UdpTransport::open(&address).unwrap(), device)
}

const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 42, 98);

#[test]
fn commands_go_to_the_device_and_frames_come_from_its_group() {
    for local in [None, Some("lo"), Some("127.0.0.1")] {
        let (mut transport, device) = by_datagrams(local);
        transport.write_all(b"hello").unwrap();
        let mut buf = [0; 64];
        let (n, from) = device.recv_from(&mut buf).unwrap();
        assert_eq!((&buf[..n], Some(from.port())), (&b"hello"[..], transport.datagram_port()));
        device.send_to(b"reply", from).unwrap();
        assert_eq!(read(&mut transport).unwrap(), b"reply");
        // Another group's port is free for this test.
        let port = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap().local_addr().unwrap().port();
        let source = DatagramSource { group: Some(GROUP), port };
        transport.listen(source).unwrap();
        assert!(transport.describe().contains(&format!("{GROUP}:{port}")));
        let sender = multicast_sender(Ipv4Addr::LOCALHOST, 1).unwrap();
        sender.send_to(b"frame", (GROUP, port)).unwrap();
        assert_eq!(read(&mut transport).unwrap(), b"frame");
        assert!(transport.arrival().is_datagram && transport.arrival().host_ns.is_some());
        // Two programs may listen, and one that sends to the same group is another server.
        let (mut other, _device) = by_datagrams(local);
        other.listen(source).unwrap();
        let stranger = multicast_sender(Ipv4Addr::LOCALHOST, 1).unwrap();
        stranger.send_to(b"strange", (GROUP, port)).unwrap();
        sender.send_to(b"second", (GROUP, port)).unwrap();
        assert_eq!(read(&mut transport).unwrap(), b"second");
        let port_of = |socket: &UdpSocket| socket.local_addr().unwrap().port();
        assert_eq!(transport.stranger().map(|from| from.port()), Some(port_of(&stranger)));
        assert_eq!(read(&mut other).unwrap(), b"strange");
        transport.stop_listening();
        sender.send_to(b"third", (GROUP, port)).unwrap();
        assert_eq!(transport.read(&mut [0; 64]).unwrap(), 0);
    }
}

#[test]
fn a_receive_buffer_that_the_system_does_not_grant_is_remarked() {
    let (transport, _device) = by_datagrams(None);
    let max = std::fs::read_to_string("/proc/sys/net/core/rmem_max").unwrap();
    let is_less = max.trim().parse::<usize>().unwrap() < 4 << 20;
    assert_eq!(transport.remark().is_some(), is_less);
    if let Some(remark) = transport.remark() {
        assert!(remark.contains("sudo sysctl -w net.core.rmem_max=4194304"), "{remark}");
    }
}

#[test]
fn an_interface_or_address_that_is_missing_is_explained() {
    let address = NetworkAddress::new("natnet", "127.0.0.1", 1);
    for (address, part) in [
        (
            NetworkAddress { local: Some("eth99".to_owned()), ..address.clone() },
            "no interface 'eth99'",
        ),
        (NetworkAddress::new("natnet", "::1", 1), "no IPv4 address"),
        (NetworkAddress::new("natnet", "no-such-machine.invalid", 1), "no machine named"),
    ] {
        let error = UdpTransport::open(&address).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    }
    let (mut transport, _peer) = connected(false);
    let source = DatagramSource { group: Some(GROUP), port: 9 };
    assert!(transport.listen(source).unwrap_err().to_string().contains("239.255.42.98:9"));
}

#[test]
fn a_search_finds_who_answers() {
    let server = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let address = server.local_addr().unwrap();
    let answer = std::thread::Builder::new()
        .spawn(move || {
            let mut buf = [0; 64];
            let (n, from) = server.recv_from(&mut buf).unwrap();
            for _ in 0..3 {
                server.send_to(&buf[..n], from).unwrap();
            }
        })
        .unwrap();
    let found =
        search(|_| b"who is there".to_vec(), address.port(), Duration::from_millis(500)).unwrap();
    answer.join().unwrap();
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!((found[0].0.port(), &*found[0].1), (address.port(), &b"who is there"[..]));
}
