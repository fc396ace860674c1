//! Messages of NatNet, in both directions: an id, a size and content (`docs/natnet.md`).

use std::{fmt, net::Ipv4Addr, str::FromStr};

use crate::bytes::{Cursor, WireValue};

/// Bytes of a message's header: its id and the size of its content.
pub const HEADER_BYTES: usize = 4;

/// Largest datagram of UDP over IPv4, which is a message.
pub const MESSAGE_BYTES_MAX: usize = 65_507;

/// Bytes of the field that has a program's name.
const NAME_BYTES: usize = 256;

macro_rules! kinds {
    ($($(#[$doc:meta])+ $kind:ident = $code:literal)+) => {
        /// The id of a message.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[repr(u16)]
        pub enum MessageKind { $($(#[$doc])+ $kind = $code,)+ }

        impl MessageKind {
            /// All of them, in the order of their ids.
            pub const ALL: &[Self] = &[$(Self::$kind),+];
        }
    };
}

impl MessageKind {
    /// Whether only servers send it.
    #[must_use]
    pub fn is_of_servers(self) -> bool {
        use MessageKind::{
            DisconnectByTimeout, EchoReply, Frame, Model, Response, ServerInfo, Text, Unrecognized,
        };
        matches!(
            self,
            ServerInfo
                | Response
                | Model
                | Frame
                | Text
                | DisconnectByTimeout
                | EchoReply
                | Unrecognized
        )
    }
}

kinds! {
    /// A client asks who is there; a server that does not use multicast sends it frames from then on.
    Connect = 0
    /// The reply to it: program, versions, clock and how frames are sent.
    ServerInfo = 1
    /// A text that asks for something.
    Request = 2
    /// The reply to it: four bytes or a text.
    Response = 3
    /// A client asks for the model definitions.
    RequestModel = 4
    /// The reply to it.
    Model = 5
    /// A client asks for one frame.
    RequestFrame = 6
    /// A frame of data.
    Frame = 7
    /// A text from the server.
    Text = 8
    /// A client leaves.
    Disconnect = 9
    /// A client that gets frames of its own is still there.
    KeepAlive = 10
    /// The server sends no more frames to a client that was silent.
    DisconnectByTimeout = 11
    /// A client's time, to be sent back.
    Echo = 12
    /// The reply to it: the client's time, and the server's clock.
    EchoReply = 13
    /// A client looks for servers.
    Discovery = 14
    /// The server does not know a request.
    Unrecognized = 100
}

/// A message without its header.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Message<'a> {
    /// Its id; `None` for one that is not known.
    pub kind: Option<MessageKind>,
    /// Its content.
    pub body: &'a [u8],
}

impl<'a> Message<'a> {
    /// Reads a datagram; `None` when it has fewer bytes than it states. What some clients append is left out.
    #[must_use]
    pub fn of(bytes: &'a [u8]) -> Option<Self> {
        let mut cursor = Cursor::new(bytes);
        let (code, size) = (cursor.get::<u16>()?, cursor.get::<u16>()?);
        let kind = MessageKind::ALL.iter().copied().find(|kind| *kind as u16 == code);
        Some(Self { kind, body: cursor.bytes(size.into())? })
    }

    /// The content as text, up to its first NUL.
    #[must_use]
    pub fn text(&self) -> String {
        text_of(self.body.split(|byte| *byte == 0).next().unwrap_or_default()).trim().to_owned()
    }
}

/// Appends a message whose content `write` appends. One whose content exceeds 65 535 bytes fits no datagram, either.
pub fn put_message(kind: MessageKind, out: &mut Vec<u8>, write: impl FnOnce(&mut Vec<u8>)) {
    let start = out.len();
    (kind as u16).put(out);
    0_u16.put(out);
    write(out);
    let size = u16::try_from(out.len() - start - HEADER_BYTES).unwrap_or(u16::MAX);
    if let Some(field) = out.get_mut(start + 2..start + HEADER_BYTES) {
        field.copy_from_slice(&size.to_le_bytes());
    }
}

/// Appends a message of text, terminated by a NUL.
pub fn put_text(kind: MessageKind, text: &str, out: &mut Vec<u8>) {
    put_message(kind, out, |out| {
        out.extend_from_slice(text.as_bytes());
        out.push(0);
    });
}

/// Bytes of a client's request to connect in front of the version that it wants: `Ping` in place of a name, versions and a flag.
const WANTED_VERSION_AT: usize = NAME_BYTES + 4 + 4 + 1;

/// Bytes of a client's request to connect from the SDK of Motive 3 on.
const CONNECT_BYTES: usize = 271;

/// Appends a client's request to connect, with the version of the bitstream that it wants, or `None` for any. `Ping` stands
/// where older clients have the sender's name, which some servers of others need, and the versions behind it.
pub fn put_connect(wanted: Option<Bitstream>, out: &mut Vec<u8>) {
    put_message(MessageKind::Connect, out, |out| {
        let start = out.len();
        out.extend_from_slice(b"Ping");
        out.resize(start + WANTED_VERSION_AT, 0);
        if let Some(version) = wanted {
            out.extend_from_slice(&[version.major, version.minor]);
        }
        out.resize(start + CONNECT_BYTES, 0);
    });
}

/// The version of the bitstream that a client wants with its request to connect: from the SDK of Motive 3 on, with zeros for
/// any.
#[must_use]
pub fn read_wanted_version(body: &[u8]) -> Option<Bitstream> {
    let [major, minor, _, _] = Cursor::new(body.get(WANTED_VERSION_AT..)?).array()?;
    (major != 0).then_some(Bitstream::new(major, minor))
}

/// A client's time, and in a reply the server's clock.
pub fn put_echo(client_time: u64, server_ticks: Option<u64>, out: &mut Vec<u8>) {
    let kind = if server_ticks.is_some() { MessageKind::EchoReply } else { MessageKind::Echo };
    put_message(kind, out, |out| {
        client_time.put(out);
        if let Some(ticks) = server_ticks {
            ticks.put(out);
        }
    });
}

/// Reads the reply to an Echo: the client's time, and the server's clock.
#[must_use]
pub fn read_echo_reply(body: &[u8]) -> Option<(u64, u64)> {
    let mut body = Cursor::new(body);
    let reply = (body.get()?, body.get()?);
    body.end(reply)
}

/// Appends a search for servers by a program of this name, whose newest bitstream is `version`.
pub fn put_discovery(name: &str, app_version: [u8; 4], version: Bitstream, out: &mut Vec<u8>) {
    put_message(MessageKind::Discovery, out, |out| put_sender(name, app_version, version, out));
}

/// Who a message is from: name, version, and the version of the bitstream.
fn put_sender(name: &str, app_version: [u8; 4], version: Bitstream, out: &mut Vec<u8>) {
    // The last byte of the field is a NUL.
    let mut field = [0; NAME_BYTES];
    let bytes = field.iter_mut().take(NAME_BYTES - 1).zip(name.bytes());
    bytes.for_each(|(to, from)| *to = from);
    out.extend_from_slice(&field);
    out.extend_from_slice(&app_version);
    out.extend_from_slice(&[version.major, version.minor, 0, 0]);
}

/// A name as frames and definitions have it, terminated by a NUL and without others.
pub(super) fn put_name(name: &str, out: &mut Vec<u8>) {
    out.extend(name.bytes().filter(|byte| *byte != 0));
    out.push(0);
}

/// Longest text of a server's that is kept, in characters.
const TEXT_CHARS_MAX: usize = 160;

/// A text as names and messages have it: one line, not too long.
pub(super) fn text_of(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(bytes);
    let one_line = text.chars().map(|c| if c.is_control() { ' ' } else { c });
    one_line.take(TEXT_CHARS_MAX).collect()
}

/// The version of a bitstream: of the layout of frames and model definitions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Bitstream {
    /// The number in front of the point.
    pub major: u8,
    /// The number behind it.
    pub minor: u8,
}

impl Bitstream {
    /// The oldest whose layout is known.
    pub const OLDEST: Self = Self::new(2, 10);
    /// The newest whose layout is known.
    pub const NEWEST: Self = Self::new(4, 2);

    /// A version.
    #[must_use]
    pub const fn new(major: u8, minor: u8) -> Self {
        Self { major, minor }
    }

    /// Whether sections state their size.
    #[must_use]
    pub fn has_sizes(self) -> bool {
        self >= Self::new(4, 1)
    }

    /// Whether frames have the samples of devices.
    #[must_use]
    pub fn has_devices(self) -> bool {
        self >= Self::new(2, 11)
    }

    /// Whether frames have stamps of the server's clock, and clients can ask for it.
    #[must_use]
    pub fn has_ticks(self) -> bool {
        self.major >= 3
    }

    /// Whether a server of this version can be asked for another one, unless it uses multicast.
    #[must_use]
    pub fn can_change(self) -> bool {
        self.major >= 4
    }
}

impl fmt::Display for Bitstream {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.major, self.minor)
    }
}

impl FromStr for Bitstream {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        // Clients may append more parts than count.
        let mut parts = text.split('.').map(str::parse);
        let parsed = match (parts.next(), parts.next()) {
            (Some(Ok(major)), Some(Ok(minor))) => Some(Self::new(major, minor)),
            _ => None,
        };
        parsed.ok_or_else(|| format!("'{text}' is not a version: give one such as 4.1"))
    }
}

/// What a server says of itself.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServerInfo {
    /// The program's name.
    pub name: String,
    /// The program's version.
    pub app_version: [u8; 4],
    /// The version of its bitstream.
    pub bitstream: Bitstream,
    /// What servers from bitstream 3.0 on add.
    pub stream: Option<StreamInfo>,
}

/// How a server measures time, and sends frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamInfo {
    /// Ticks of its clock per second.
    pub clock_hz: u64,
    /// UDP port of frames.
    pub port: u16,
    /// Whether frames go to the group.
    pub is_multicast: bool,
    /// The group.
    pub group: Ipv4Addr,
}

/// Bytes of what servers from bitstream 3.0 on add.
const STREAM_INFO_BYTES: usize = 15;

impl ServerInfo {
    /// Reads a message's content.
    #[must_use]
    pub fn read(body: &[u8]) -> Option<Self> {
        let mut body = Cursor::new(body);
        let name = body.bytes(NAME_BYTES)?.split(|byte| *byte == 0).next().unwrap_or_default();
        let app_version = body.array()?;
        let [major, minor, _, _] = body.array()?;
        let has_more = body.len() >= STREAM_INFO_BYTES;
        let stream = if has_more { Some(StreamInfo::read(&mut body)?) } else { None };
        let bitstream = Bitstream::new(major, minor);
        Some(Self { name: text_of(name), app_version, bitstream, stream })
    }

    /// Appends the message.
    pub fn put(&self, out: &mut Vec<u8>) {
        put_message(MessageKind::ServerInfo, out, |out| {
            put_sender(&self.name, self.app_version, self.bitstream, out);
            if let Some(stream) = self.stream {
                stream.clock_hz.put(out);
                stream.port.put(out);
                out.push(stream.is_multicast.into());
                out.extend_from_slice(&stream.group.octets());
            }
        });
    }

    /// The program's version, without its zeros at the end.
    #[must_use]
    pub fn app_version_text(&self) -> String {
        let [major, minor, build, revision] = self.app_version;
        match (build, revision) {
            (0, 0) => format!("{major}.{minor}"),
            (_, 0) => format!("{major}.{minor}.{build}"),
            _ => format!("{major}.{minor}.{build}.{revision}"),
        }
    }
}

impl StreamInfo {
    fn read(body: &mut Cursor<'_>) -> Option<Self> {
        Some(Self {
            clock_hz: body.get()?,
            port: body.get()?,
            is_multicast: body.get::<u8>()? != 0,
            group: Ipv4Addr::from(body.array::<4>()?),
        })
    }
}
