//! Polled lines: which commands are executed, in which order, and when.

use mocapd_drivers::transport::{
    Transport, TransportError,
    polled::{
        LINE_COMMANDS_MAX, LineCommand, PolledTransport, REQUEST_BYTES_MAX, Request,
        line_command_channel,
    },
};
use mocapd_testkit::memory::pair;

#[cfg(test)]
fn write(bytes: &[u8], not_before_ns: u64) -> LineCommand {
    LineCommand::Write { request: Request::new(bytes).unwrap(), not_before_ns }
}

#[test]
fn executes_in_order_and_waits() {
    let (host, mut device) = pair(64);
    let (sender, receiver) = line_command_channel();
    let mut line = PolledTransport::new(Box::new(host), receiver);
    assert!(sender.send(LineCommand::Baud(115_200)) && sender.send(LineCommand::Break));
    assert!(sender.send(write(b"one", 0)) && sender.send(write(b"two", 30_000_000)));
    let mut buf = [0; 16];
    assert_eq!(line.read(&mut buf).unwrap(), 0, "its time has not come");
    assert_eq!(device.read(&mut buf).unwrap(), 3);
    assert_eq!(line.read(&mut buf).unwrap(), 0);
    assert!(sender.now_ns() >= 30_000_000, "{}", sender.now_ns());
    assert_eq!(device.read(&mut buf).unwrap(), 3);
    assert_eq!(&buf[..3], b"two");
    device.write_all(b"answer").unwrap();
    assert_eq!(line.read(&mut buf).unwrap(), 6);
    assert!(sender.send(LineCommand::Fail("pull the plug".to_owned())));
    let error = line.read(&mut buf).unwrap_err();
    assert!(matches!(&error, TransportError::Refused(why) if why == "pull the plug"), "{error:?}");
}

#[test]
fn sends_goodbye_and_bounds_its_queue() {
    let (host, mut device) = pair(64);
    let (sender, receiver) = line_command_channel();
    let mut line = PolledTransport::new(Box::new(host), receiver);
    let goodbye = [b"stop\r", b"slow\r"].map(|bytes| Request::new(bytes).unwrap());
    assert!(sender.send(LineCommand::Goodbye(goodbye.to_vec())));
    line.read(&mut [0; 4]).unwrap();
    device.write_all(b"OK\r").unwrap();
    drop(line);
    let mut got = Vec::new();
    let mut buf = [0; 16];
    while let Ok(n) = device.read(&mut buf) {
        got.extend_from_slice(&buf[..n]);
    }
    assert_eq!(got, b"stop\rslow\r");
    assert!(!sender.send(LineCommand::Break), "the line is gone");
    assert!(Request::new(&[0; REQUEST_BYTES_MAX + 1]).is_none());
    let (sender, _receiver) = line_command_channel();
    assert_eq!((0..20).filter(|_| sender.send(LineCommand::Break)).count(), LINE_COMMANDS_MAX);
}
