//! Polled lines: which commands are executed, in which order, and when.

use mocapd_drivers::transport::{
    Transport, TransportError,
    turns::{LINE_COMMANDS_MAX, Order, PolledTransport, REQUEST_BYTES_MAX, Request, desk},
};
use mocapd_testkit::memory::pair;

#[cfg(test)]
fn write(bytes: &[u8], not_before_ns: u64) -> Order {
    Order::Write { request: Request::new(bytes).unwrap(), not_before_ns }
}

#[test]
fn executes_in_order_and_waits() {
    let (host, mut device) = pair(64);
    let (sender, receiver) = desk();
    let mut line = PolledTransport::new(Box::new(host), receiver);
    assert!(sender.order(Order::Baud(115_200)) && sender.order(Order::Break));
    assert!(sender.order(write(b"one", 0)) && sender.order(write(b"two", 30_000_000)));
    let mut buf = [0; 16];
    assert_eq!(line.read(&mut buf).unwrap(), 0, "its time has not come");
    assert_eq!(device.read(&mut buf).unwrap(), 3);
    assert_eq!(line.read(&mut buf).unwrap(), 0);
    assert!(sender.now_ns() >= 30_000_000, "{}", sender.now_ns());
    assert_eq!(device.read(&mut buf).unwrap(), 3);
    assert_eq!(&buf[..3], b"two");
    device.write_all(b"answer").unwrap();
    assert_eq!(line.read(&mut buf).unwrap(), 6);
    assert!(sender.order(Order::Fail("pull the plug".to_owned())));
    let error = line.read(&mut buf).unwrap_err();
    assert!(matches!(&error, TransportError::Refused(why) if why == "pull the plug"), "{error:?}");
}

#[test]
fn sends_goodbye_and_bounds_its_queue() {
    let (host, mut device) = pair(64);
    let (sender, receiver) = desk();
    let mut line = PolledTransport::new(Box::new(host), receiver);
    let goodbye = [b"stop\r", b"slow\r"].map(|bytes| Request::new(bytes).unwrap());
    assert!(sender.order(Order::Farewell(goodbye.to_vec())));
    line.read(&mut [0; 4]).unwrap();
    device.write_all(b"OK\r").unwrap();
    drop(line);
    let mut got = Vec::new();
    let mut buf = [0; 16];
    while let Ok(n) = device.read(&mut buf) {
        got.extend_from_slice(&buf[..n]);
    }
    assert_eq!(got, b"stop\rslow\r");
    assert!(!sender.order(Order::Break), "the line is gone");
    assert!(Request::new(&[0; REQUEST_BYTES_MAX + 1]).is_none());
    let (sender, _receiver) = desk();
    assert_eq!((0..20).filter(|_| sender.order(Order::Break)).count(), LINE_COMMANDS_MAX);
}
