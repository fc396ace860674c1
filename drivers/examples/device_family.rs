//! How to write a driver: a device family for an invented device, step by step.
//!
//! The Beacon tracks unlabelled markers at one fixed rate. It speaks lines of ASCII over a serial port. Each
//! line ends with `*`, the XOR of the bytes before it in two hexadecimal digits, and a line feed.
//!
//! | command | reply | meaning |
//! |---|---|---|
//! | `I` | `I MODEL SERIAL HERTZ` | identity |
//! | `S` | `S`, then `F COUNTER MILLISECONDS ID:X:Y:Z...` per frame, in millimetres | start |
//! | `P HOST_NS` | `P HOST_NS MILLISECONDS` | ping |
//! | `X` | `E PRODUCED DROPPED` | stop |
//!
//!     cargo run -p mocapd-drivers --example device_family

use std::str::{FromStr, SplitAsciiWhitespace};

use mocapd_drivers::{
    device::{
        Command, DeviceEvent, Frame, Hello, LinkBudget, LinkCounters, MarkerSample, Pong, Protocol,
        Status,
    },
    registry::{Candidate, Claim, Family},
    uri::Location,
};

/// Step 1: the family. In the crate it is an entry of `registry::FAMILIES`, and `?driver=beacon` selects it.
const FAMILY: Family = Family {
    name: "beacon",
    claims: |candidate| match (&candidate.location, &candidate.product) {
        (Location::Serial { .. }, Some(product)) if product.contains("Beacon") => Claim::Certain,
        (Location::Serial { .. }, _) => Claim::Possible,
        (Location::Usb { .. } | Location::Network(_) | Location::Streams(_), _) => Claim::No,
    },
    protocol: |_| Box::new(Beacon::default()),
};

/// Longest line, in bytes. It bounds the memory that a damaged stream can occupy.
const LINE_BYTES_MAX: usize = 4096;

/// Step 2: the state. It owns the memory for decoding, so that frames are decoded without allocating.
#[derive(Debug, Default)]
struct Beacon {
    /// The line so far, and how many bytes it has, including those beyond the longest.
    line: Vec<u8>,
    line_bytes: usize,
    hello: Hello,
    samples: Vec<MarkerSample>,
    rate_requested: Option<u32>,
    counters: LinkCounters,
}

impl Protocol for Beacon {
    /// Step 3: bytes to events. Reads split lines anywhere, so collect bytes up to the line feed.
    fn push(&mut self, bytes: &[u8], on_event: &mut dyn FnMut(DeviceEvent<'_>)) {
        self.counters.bytes += bytes.len() as u64;
        // `push` follows every read, even an empty one: a good moment for replies that the driver makes itself.
        if let Some(rate_millihertz) = self.rate_requested.take() {
            on_event(if rate_millihertz == self.hello.rate_millihertz {
                DeviceEvent::RateSet(rate_millihertz)
            } else {
                DeviceEvent::Refused(self.budget())
            });
        }
        for &byte in bytes {
            self.line_bytes += 1;
            if byte != b'\n' {
                if self.line.len() < LINE_BYTES_MAX {
                    self.line.push(byte);
                }
                continue;
            }
            let mut line = std::mem::take(&mut self.line);
            let line_bytes = std::mem::take(&mut self.line_bytes);
            let decoded = match checked_text(&line) {
                Some(text) if line_bytes <= LINE_BYTES_MAX => self.decode(text, on_event),
                _ => None,
            };
            // Damage costs one line, and every byte of it is counted: the next line feed resynchronises.
            if decoded.is_some() {
                self.counters.messages += 1;
            } else {
                self.counters.messages_damaged += 1;
                self.counters.bytes_skipped += line_bytes as u64;
            }
            line.clear();
            self.line = line;
        }
    }

    /// Step 4: commands to bytes.
    fn command(&mut self, command: Command, out: &mut Vec<u8>) {
        match command {
            Command::Identify => put_line("I", out),
            Command::Start { .. } => put_line("S", out),
            Command::Stop => put_line("X", out),
            Command::Ping { host_ns } => put_line(&format!("P {host_ns}"), out),
            // The device has no such command. The next `push` replies.
            Command::SetRate(rate_millihertz) => self.rate_requested = Some(rate_millihertz),
        }
    }

    fn counters(&self) -> LinkCounters {
        self.counters
    }
}

impl Beacon {
    /// Decodes a line without its checksum, and reports its event; `None` when the line is invalid.
    fn decode(&mut self, text: &str, on_event: &mut dyn FnMut(DeviceEvent<'_>)) -> Option<()> {
        let mut fields = text.split_ascii_whitespace();
        match fields.next()? {
            "I" => {
                let (model, serial) = (fields.next()?.to_owned(), fields.next()?.to_owned());
                let rate_millihertz = number::<u32>(&mut fields)?.checked_mul(1000)?;
                self.hello = Hello {
                    model,
                    serial,
                    rate_millihertz,
                    rate_min_millihertz: rate_millihertz,
                    rate_max_millihertz: rate_millihertz,
                    tick_hz: 1000,
                    markers_max: 32,
                    ..Hello::default()
                };
                on_event(DeviceEvent::Hello(&self.hello));
                // No marker has a label: the table is empty, and ids appear with the frames.
                on_event(DeviceEvent::Markers(&[]));
            }
            "S" => on_event(DeviceEvent::Started(self.budget())),
            "F" => {
                let (seq, device_ticks) = (number(&mut fields)?, number(&mut fields)?);
                self.samples.clear();
                for field in fields {
                    self.samples.push(sample(field)?);
                }
                let markers = self.samples.as_slice();
                on_event(DeviceEvent::Frame(Frame { seq, device_ticks, timecode: None, markers }));
            }
            "P" => {
                let (host_ns, device_ticks) = (number(&mut fields)?, number(&mut fields)?);
                on_event(DeviceEvent::Pong(Pong { host_ns, device_ticks }));
            }
            "E" => on_event(DeviceEvent::EndOfStream(Status {
                frames_produced: number(&mut fields)?,
                frames_dropped: number(&mut fields)?,
                temperature_c_100: i16::MIN,
            })),
            _ => return None,
        }
        Some(())
    }

    /// The link budget of a line that is always fast enough.
    fn budget(&self) -> LinkBudget {
        LinkBudget {
            needed_bytes_per_s: 0,
            available_bytes_per_s: u64::MAX,
            rate_fits_millihertz: self.hello.rate_millihertz,
        }
    }
}

/// The next field as a number.
fn number<T: FromStr>(fields: &mut SplitAsciiWhitespace<'_>) -> Option<T> {
    fields.next()?.parse().ok()
}

/// A marker from `ID:X:Y:Z`. Bytes from a line are never trusted: a coordinate must be finite.
fn sample(field: &str) -> Option<MarkerSample> {
    let mut parts = field.split(':');
    let id = parts.next()?.parse().ok()?;
    let mut coordinate =
        || -> Option<f32> { parts.next()?.parse::<f32>().ok().filter(|mm| mm.is_finite()) };
    let position_mm = [coordinate()?, coordinate()?, coordinate()?];
    Some(MarkerSample { id, position_mm, ..MarkerSample::default() })
}

fn checksum(bytes: &[u8]) -> u8 {
    bytes.iter().fold(0, |sum, byte| sum ^ byte)
}

/// The text of a line, when its checksum is right.
fn checked_text(line: &[u8]) -> Option<&str> {
    let (text, digits) = std::str::from_utf8(line).ok()?.rsplit_once('*')?;
    (u8::from_str_radix(digits, 16) == Ok(checksum(text.as_bytes()))).then_some(text)
}

fn put_line(text: &str, out: &mut Vec<u8>) {
    out.extend_from_slice(format!("{text}*{:02X}\n", checksum(text.as_bytes())).as_bytes());
}

/// Step 5: tests. A protocol needs no device for them: bytes go in, events come out.
fn main() {
    let port = Candidate::at(Location::Serial { path: "/dev/ttyUSB0".into(), baud: None });
    assert_eq!((FAMILY.claims)(&port), Claim::Possible);
    let mut protocol = (FAMILY.protocol)(&port.location);
    let mut commands = Vec::new();
    protocol.command(Command::Identify, &mut commands);
    assert_eq!(commands, b"I*49\n");

    let mut wire = Vec::new();
    put_line("I Beacon-1 0042 100", &mut wire);
    put_line("S", &mut wire);
    put_line("F 7 70 0:812.5:-40.25:1604 1:10:20:30", &mut wire);
    wire.extend_from_slice(b"F 8 80 0:1:2:3*FF\n");
    put_line("E 8 0", &mut wire);
    let mut events = Vec::new();
    for piece in wire.chunks(5) {
        protocol.push(piece, &mut |event| events.push(format!("{event:?}")));
    }
    let kinds: Vec<_> = events.iter().filter_map(|event| event.split('(').next()).collect();
    assert_eq!(kinds, ["Hello", "Markers", "Started", "Frame", "EndOfStream"]);
    let LinkCounters { messages, messages_damaged, bytes_skipped, .. } = protocol.counters();
    assert_eq!((messages, messages_damaged, bytes_skipped), (4, 1, 18));
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_example_works() {
        super::main();
    }
}
