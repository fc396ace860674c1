//! The network transport against a peer on this machine.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::{
    io::{Read, Write},
    net::{Ipv4Addr, TcpListener, TcpStream, UdpSocket},
    time::{Duration, Instant},
};

use mocapd_drivers::{
    transport::{Transport, TransportError, network::NetworkTransport},
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
fn read(transport: &mut NetworkTransport) -> Result<Vec<u8>, TransportError> {
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
