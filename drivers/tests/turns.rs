//! Lines on which the host speaks first: what is carried out, in which order, and when.

use mocapd_drivers::transport::{
    Transport, TransportError,
    turns::{self, ORDERS_MAX, Order, REQUEST_BYTES_MAX, Request, TurnTransport, desk},
};
use mocapd_testkit::memory::pair;

#[cfg(test)]
fn write(bytes: &[u8], not_before_ns: u64) -> Order {
    Order::Write { request: Request::new(bytes).unwrap(), not_before_ns }
}

#[test]
fn carries_out_in_order_and_waits() {
    let (host, mut device) = pair(64);
    let (desk, orders) = desk();
    let mut line = TurnTransport::new(Box::new(host), orders);
    assert!(desk.order(Order::Baud(115_200)) && desk.order(Order::Break));
    assert!(desk.order(write(b"one", 0)) && desk.order(write(b"two", 30_000_000)));
    let mut buf = [0; 16];
    assert_eq!(line.read(&mut buf).unwrap(), 0, "its time has not come");
    assert_eq!(device.read(&mut buf).unwrap(), 3);
    assert_eq!(line.read(&mut buf).unwrap(), 0);
    assert!(desk.now_ns() >= 30_000_000, "{}", desk.now_ns());
    assert_eq!(device.read(&mut buf).unwrap(), 3);
    assert_eq!(&buf[..3], b"two");
    device.write_all(b"answer").unwrap();
    assert_eq!(line.read(&mut buf).unwrap(), 6);
    assert!(desk.order(Order::Fail("pull the plug".to_owned())));
    let error = line.read(&mut buf).unwrap_err();
    assert!(matches!(&error, TransportError::Refused(why) if why == "pull the plug"), "{error:?}");
}

#[test]
fn takes_leave_and_keeps_to_its_bounds() {
    let (host, mut device) = pair(64);
    let (desk, orders) = desk();
    let mut line = TurnTransport::new(Box::new(host), orders);
    let bye = [b"stop\r", b"slow\r"].map(|bytes| Request::new(bytes).unwrap());
    assert!(desk.order(Order::Farewell(bye.to_vec())));
    line.read(&mut [0; 4]).unwrap();
    device.write_all(b"OK\r").unwrap();
    drop(line);
    let mut got = Vec::new();
    let mut buf = [0; 16];
    while let Ok(n) = device.read(&mut buf) {
        got.extend_from_slice(&buf[..n]);
    }
    assert_eq!(got, b"stop\rslow\r");
    assert!(!desk.order(Order::Break), "the line is gone");
    assert!(Request::new(&[0; REQUEST_BYTES_MAX + 1]).is_none());
    let (desk, _orders) = turns::desk();
    assert_eq!((0..20).filter(|_| desk.order(Order::Break)).count(), ORDERS_MAX);
}
