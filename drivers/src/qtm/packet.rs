//! Packets of the QTM RT protocol, in both directions: a size, a type and content (`docs/qtm.md`).

use std::borrow::Cow;

/// The coordinates of a marker that is missing: "all their 32 bits set".
pub const MISSING: f32 = f32::from_bits(u32::MAX);

/// Bytes of a packet's header: its size and its type.
pub const HEADER_BYTES: usize = 8;

/// Largest packet that is accepted. The longest are settings: a camera takes 4 kB of them, and a thousand cameras are more
/// than a system has. A frame of 4096 markers with all that mocapd requests has 148 kB.
pub const PACKET_BYTES_MAX: usize = 4 << 20;

/// The type of a packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum PacketKind {
    /// The last command failed; text.
    Error = 0,
    /// A command, or the reply to one; text.
    Command = 1,
    /// Settings; text.
    Xml = 2,
    /// A frame.
    Data = 3,
    /// No measurement is running; empty.
    NoMoreData = 4,
    /// A C3D file.
    C3dFile = 5,
    /// A change of state; one byte.
    Event = 6,
    /// A search for servers.
    Discover = 7,
    /// A QTM file.
    QtmFile = 8,
}

impl PacketKind {
    fn of(code: u32) -> Option<Self> {
        Some(match code {
            0 => Self::Error,
            1 => Self::Command,
            2 => Self::Xml,
            3 => Self::Data,
            4 => Self::NoMoreData,
            5 => Self::C3dFile,
            6 => Self::Event,
            7 => Self::Discover,
            8 => Self::QtmFile,
            _ => return None,
        })
    }
}

/// A packet, without its header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Packet<'a> {
    /// Its type; `None` for one that the protocol does not have.
    pub kind: Option<PacketKind>,
    /// Its content.
    pub body: &'a [u8],
}

impl<'a> Packet<'a> {
    /// Reads bytes that are exactly one packet, as a datagram is.
    #[must_use]
    pub fn of(bytes: &'a [u8]) -> Option<Self> {
        let (header, body) = bytes.split_first_chunk::<HEADER_BYTES>()?;
        let (size, kind) = parse_header(*header);
        (size == bytes.len()).then_some(Self { kind, body })
    }

    /// The content as text, up to its first NUL. The protocol has ASCII; other bytes are replaced.
    #[must_use]
    pub fn text(&self) -> Cow<'a, str> {
        let end = self.body.iter().position(|byte| *byte == 0).unwrap_or(self.body.len());
        String::from_utf8_lossy(self.body.get(..end).unwrap_or_default())
    }
}

fn parse_header(header: [u8; HEADER_BYTES]) -> (usize, Option<PacketKind>) {
    let [a, b, c, d, rest @ ..] = header;
    let size = usize::try_from(u32::from_le_bytes([a, b, c, d])).unwrap_or(usize::MAX);
    (size, PacketKind::of(u32::from_le_bytes(rest)))
}

/// Appends a packet whose content `write` appends.
pub fn put_packet(kind: PacketKind, out: &mut Vec<u8>, write: impl FnOnce(&mut Vec<u8>)) {
    let start = out.len();
    out.extend_from_slice(&[0; 4]);
    out.extend_from_slice(&u32::from(kind as u8).to_le_bytes());
    write(out);
    // A caller that writes 4 GiB into one packet would exhaust the memory first.
    let size = u32::try_from(out.len() - start).unwrap_or(u32::MAX);
    if let Some(field) = out.get_mut(start..start + 4) {
        field.copy_from_slice(&size.to_le_bytes());
    }
}

/// Appends a packet of text, terminated by a NUL.
pub fn put_text(kind: PacketKind, text: &str, out: &mut Vec<u8>) {
    put_packet(kind, out, |out| {
        out.extend_from_slice(text.as_bytes());
        out.push(0);
    });
}

/// Appends an event.
pub fn put_event(event: Event, out: &mut Vec<u8>) {
    put_packet(PacketKind::Event, out, |out| out.push(event as u8));
}

macro_rules! events {
    ($($event:ident = $code:literal, $name:literal)+) => {
        /// A change of QTM's state.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[repr(u8)]
        #[expect(missing_docs, reason = "each has its name in the protocol's documents")]
        pub enum Event { $($event = $code,)+ }

        impl Event {
            /// The event with this number.
            #[must_use]
            pub fn of(code: u8) -> Option<Self> {
                match code { $($code => Some(Self::$event),)+ _ => None }
            }

            /// Its name in the protocol's documents.
            #[must_use]
            pub fn name(self) -> &'static str {
                match self { $(Self::$event => $name,)+ }
            }
        }
    };
}

events! {
    Connected = 1, "Connected"
    ConnectionClosed = 2, "Connection Closed"
    CaptureStarted = 3, "Capture Started"
    CaptureStopped = 4, "Capture Stopped"
    FetchingFinished = 5, "Fetching Finished"
    CalibrationStarted = 6, "Calibration Started"
    CalibrationStopped = 7, "Calibration Stopped"
    RtFromFileStarted = 8, "RT From File Started"
    RtFromFileStopped = 9, "RT From File Stopped"
    WaitingForTrigger = 10, "Waiting For Trigger"
    CameraSettingsChanged = 11, "Camera Settings Changed"
    ShuttingDown = 12, "QTM Shutting Down"
    CaptureSaved = 13, "Capture Saved"
    ReprocessingStarted = 14, "Reprocessing Started"
    ReprocessingStopped = 15, "Reprocessing Stopped"
    Trigger = 16, "Trigger"
}

/// Why bytes cannot be packets. The connection is out of step for good: nothing marks where the next packet begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OutOfStep {
    /// The header is in the other byte order.
    BigEndian,
    /// Text without a header.
    Text,
    /// A size below that of the header, or above [`PACKET_BYTES_MAX`].
    Size(u32),
}

/// Divides a stream into packets. Memory is bounded by twice [`PACKET_BYTES_MAX`] and one read, and grows with the bytes that
/// arrive, never with a size that they state.
#[derive(Debug)]
pub struct PacketReader {
    bytes: Vec<u8>,
    start: usize,
    packet_bytes_max: usize,
}

impl Default for PacketReader {
    fn default() -> Self {
        Self::with_limit(PACKET_BYTES_MAX)
    }
}

impl PacketReader {
    /// A reader for packets of at most so many bytes.
    #[must_use]
    pub fn with_limit(packet_bytes_max: usize) -> Self {
        Self { bytes: Vec::new(), start: 0, packet_bytes_max }
    }

    /// Adds received bytes.
    pub fn extend(&mut self, bytes: &[u8]) {
        if self.start == self.bytes.len() {
            self.bytes.clear();
            self.start = 0;
        } else if self.start > self.bytes.len() / 2 {
            // Amortised: moves at most as many bytes as were consumed.
            self.bytes.drain(..self.start);
            self.start = 0;
        }
        self.bytes.extend_from_slice(bytes);
    }

    /// The next packet that is complete.
    ///
    /// # Errors
    /// When what follows is no packet; the reader is of no use then, until [`clear`](Self::clear).
    pub fn next_packet(&mut self) -> Result<Option<Packet<'_>>, OutOfStep> {
        let rest = self.bytes.get(self.start..).unwrap_or_default();
        let Some(header) = rest.first_chunk::<HEADER_BYTES>() else { return Ok(None) };
        let (size, kind) = parse_header(*header);
        if !(HEADER_BYTES..=self.packet_bytes_max).contains(&size) {
            return Err(out_of_step(header));
        }
        let Some(packet) = rest.get(HEADER_BYTES..size) else { return Ok(None) };
        self.start += size;
        Ok(Some(Packet { kind, body: packet }))
    }

    /// Bytes that wait for the rest of their packet.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.bytes.len() - self.start
    }

    /// Forgets what was received: another connection begins.
    pub fn clear(&mut self) {
        self.bytes.clear();
        self.start = 0;
    }
}

fn out_of_step(header: &[u8; HEADER_BYTES]) -> OutOfStep {
    let [a, b, c, d, e, f, g, h] = *header;
    let [size, kind] = [[a, b, c, d], [e, f, g, h]].map(u32::from_be_bytes);
    if (HEADER_BYTES..=PACKET_BYTES_MAX).contains(&(size as usize))
        && PacketKind::of(kind).is_some()
    {
        return OutOfStep::BigEndian;
    }
    if header.iter().all(|byte| matches!(byte, b'\t' | b'\r' | b'\n' | b' '..=b'~')) {
        return OutOfStep::Text;
    }
    OutOfStep::Size(u32::from_le_bytes([a, b, c, d]))
}

/// Longest text of QTM's that a message repeats.
const TEXT_CHARS_MAX: usize = 160;

/// A text of QTM's as a message repeats it: one line, not too long.
pub(super) fn printable(text: &str) -> String {
    let one_line = text.trim().chars().map(|c| if c.is_control() { ' ' } else { c });
    one_line.take(TEXT_CHARS_MAX).collect::<String>().trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_documents_examples() {
        // "Example of an error packet": 31 = 8 + 23.
        let mut error = Vec::new();
        put_text(PacketKind::Error, "Command not supported.", &mut error);
        assert_eq!(error[..8], [31, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(&error[8..], b"Command not supported.\0");
        // "Here is an example of a command": 20 = 8 + 12.
        let mut command = Vec::new();
        put_text(PacketKind::Command, "Version 1.2", &mut command);
        assert_eq!(command[..8], [20, 0, 0, 0, 1, 0, 0, 0]);
        assert_eq!(&command[8..], b"Version 1.2\0");
        // "Event packet": 9 bytes.
        let mut event = Vec::new();
        put_event(Event::CaptureStarted, &mut event);
        assert_eq!(event, [9, 0, 0, 0, 6, 0, 0, 0, 3]);
        // "No More Data packet": only the header is sent.
        let mut empty = Vec::new();
        put_packet(PacketKind::NoMoreData, &mut empty, |_| {});
        assert_eq!(empty, [8, 0, 0, 0, 4, 0, 0, 0]);
        for bytes in [&error, &command, &event, &empty] {
            assert_eq!(Packet::of(bytes).unwrap().body, &bytes[8..]);
        }
        assert_eq!(Packet::of(&command).unwrap().text(), "Version 1.2");
    }

    #[test]
    fn packets_arrive_in_any_pieces() {
        let mut wire = Vec::new();
        put_text(PacketKind::Command, "QTM RT Interface connected", &mut wire);
        put_event(Event::Connected, &mut wire);
        put_packet(PacketKind::NoMoreData, &mut wire, |_| {});
        for piece in 1..=wire.len() {
            let (mut reader, mut found) = (PacketReader::default(), Vec::new());
            for bytes in wire.chunks(piece) {
                reader.extend(bytes);
                while let Some(packet) = reader.next_packet().unwrap() {
                    found.push((packet.kind.unwrap(), packet.body.len()));
                }
            }
            let expected =
                [(PacketKind::Command, 27), (PacketKind::Event, 1), (PacketKind::NoMoreData, 0)];
            assert_eq!(found, expected, "{piece}");
            assert_eq!(reader.waiting(), 0);
        }
    }

    #[test]
    fn bytes_of_another_port_or_program_are_named() {
        let problem = |bytes: &[u8]| {
            let mut reader = PacketReader::default();
            reader.extend(bytes);
            reader.next_packet().unwrap_err()
        };
        assert_eq!(problem(&[0, 0, 0, 35, 0, 0, 0, 1]), OutOfStep::BigEndian);
        assert_eq!(problem(b"QTM RT Interface"), OutOfStep::Text);
        assert_eq!(problem(b"HTTP/1.1 400 Bad"), OutOfStep::Text);
        assert_eq!(problem(&[7, 0, 0, 0, 1, 0, 0, 0]), OutOfStep::Size(7));
        assert_eq!(problem(&[0xFF; 8]), OutOfStep::Size(u32::MAX));
    }
}
