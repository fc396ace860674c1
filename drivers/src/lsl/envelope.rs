//! The one stream of bytes between a line to several streams and the protocol: messages of a kind, the number of a stream, and
//! a size. It never leaves the process, but for raw logs, which can show it.

/// Bytes in front of a message's content: kind, stream, size.
pub(super) const HEADER_BYTES: usize = 1 + 1 + 4;

/// Bytes in front of the bytes of a feed: when they were read.
pub(crate) const DATA_HEADER_BYTES: usize = HEADER_BYTES + 8;

/// Longest content: the description of a stream.
pub(super) const CONTENT_BYTES_MAX: usize = super::description::DESCRIPTION_BYTES_MAX;

mod kind {
    pub(super) const DESCRIPTION: u8 = 1;
    pub(super) const FOUND: u8 = 2;
    pub(super) const FEED: u8 = 3;
    pub(super) const STARTED: u8 = 4;
    pub(super) const DATA: u8 = 5;
    pub(super) const TIME: u8 = 6;
    pub(super) const ENDED: u8 = 7;
    pub(super) const LOST: u8 = 8;
    pub(super) const CHANGED: u8 = 9;
}

/// What the line reports.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum StreamMessage<'a> {
    /// The whole description of a stream, as XML.
    Description {
        /// Number of the stream.
        stream: u8,
        /// The document.
        xml: &'a str,
    },
    /// All streams were found and described.
    Found,
    /// The feed of a stream is open: its samples follow.
    Feed {
        /// Number of the stream.
        stream: u8,
        /// Whether its numbers have their most significant byte first.
        is_big_endian: bool,
    },
    /// All feeds are open.
    Started,
    /// Bytes of a feed.
    Data {
        /// Number of the stream.
        stream: u8,
        /// The host's monotonic clock when they were read, in nanoseconds.
        read_ns: u64,
        /// The bytes.
        bytes: &'a [u8],
    },
    /// Reply to a time probe.
    Time {
        /// The host's clock that the probe carried, in nanoseconds.
        host_ns: u64,
        /// The sender's clock between the arrival of the probe and its reply, in seconds.
        sender_s: f64,
        /// The host's clock when the reply was read, in nanoseconds.
        read_ns: u64,
    },
    /// All feeds are closed.
    Ended,
    /// The feed of a stream is over, and those of the others go on. A [`Feed`](Self::Feed) follows when it is back.
    Lost {
        /// Number of the stream.
        stream: u8,
    },
    /// A stream that was lost is back with another description: it is not read any more.
    Changed {
        /// Number of the stream.
        stream: u8,
    },
}

/// Appends a message.
pub fn put_message(message: StreamMessage<'_>, out: &mut Vec<u8>) {
    let mut put = |kind: u8, stream: u8, parts: &[&[u8]]| {
        let n: usize = parts.iter().map(|part| part.len()).sum();
        out.extend([kind, stream]);
        out.extend((n as u32).to_le_bytes());
        parts.iter().for_each(|part| out.extend_from_slice(part));
    };
    match message {
        StreamMessage::Description { stream, xml } => {
            put(kind::DESCRIPTION, stream, &[xml.as_bytes()]);
        }
        StreamMessage::Found => put(kind::FOUND, 0, &[]),
        StreamMessage::Feed { stream, is_big_endian } => {
            put(kind::FEED, stream, &[&[u8::from(is_big_endian)]]);
        }
        StreamMessage::Started => put(kind::STARTED, 0, &[]),
        StreamMessage::Data { stream, read_ns, bytes } => {
            put(kind::DATA, stream, &[&read_ns.to_le_bytes(), bytes]);
        }
        StreamMessage::Time { host_ns, sender_s, read_ns } => put(
            kind::TIME,
            0,
            &[&host_ns.to_le_bytes(), &sender_s.to_le_bytes(), &read_ns.to_le_bytes()],
        ),
        StreamMessage::Ended => put(kind::ENDED, 0, &[]),
        StreamMessage::Lost { stream } => put(kind::LOST, stream, &[]),
        StreamMessage::Changed { stream } => put(kind::CHANGED, stream, &[]),
    }
}

/// The bytes in front of `n` bytes of a feed.
pub(crate) fn data_header(stream: u8, read_ns: u64, n: usize) -> [u8; DATA_HEADER_BYTES] {
    let mut header = [0; DATA_HEADER_BYTES];
    let (head, time) = header.split_at_mut(HEADER_BYTES);
    head[0] = kind::DATA;
    head[1] = stream;
    head[2..].copy_from_slice(&((n + 8) as u32).to_le_bytes());
    time.copy_from_slice(&read_ns.to_le_bytes());
    header
}

fn decode(kind: u8, stream: u8, content: &[u8]) -> Option<StreamMessage<'_>> {
    let number =
        |at: usize| content.get(at..)?.first_chunk().map(|bytes| u64::from_le_bytes(*bytes));
    Some(match kind {
        kind::DESCRIPTION => {
            StreamMessage::Description { stream, xml: std::str::from_utf8(content).ok()? }
        }
        kind::FOUND => StreamMessage::Found,
        kind::FEED => StreamMessage::Feed { stream, is_big_endian: content.first().copied()? != 0 },
        kind::STARTED => StreamMessage::Started,
        kind::DATA => StreamMessage::Data { stream, read_ns: number(0)?, bytes: content.get(8..)? },
        kind::TIME => StreamMessage::Time {
            host_ns: number(0)?,
            sender_s: f64::from_bits(number(8)?),
            read_ns: number(16)?,
        },
        kind::ENDED => StreamMessage::Ended,
        kind::LOST => StreamMessage::Lost { stream },
        kind::CHANGED => StreamMessage::Changed { stream },
        _ => return None,
    })
}

/// Puts messages together from bytes that are split at arbitrary points.
#[derive(Debug, Default)]
pub struct MessageReader {
    bytes: Vec<u8>,
    at: usize,
    /// Whether a size was read that no message has: nothing marks where the next one begins.
    is_over: bool,
}

/// What is next in the bytes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NextMessage<'a> {
    /// A message.
    Whole(StreamMessage<'a>),
    /// Bytes that are no message of this line.
    Unknown,
    /// A message that has not arrived in full.
    Partial,
}

impl MessageReader {
    /// Forgets everything.
    pub fn clear(&mut self) {
        self.bytes.clear();
        self.at = 0;
        self.is_over = false;
    }

    /// Takes bytes.
    pub fn extend(&mut self, bytes: &[u8]) {
        self.bytes.drain(..self.at);
        self.at = 0;
        if !self.is_over {
            self.bytes.extend_from_slice(bytes);
        }
    }

    /// The next message.
    pub fn next_message(&mut self) -> NextMessage<'_> {
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        let Some((head, content)) = rest.split_first_chunk::<HEADER_BYTES>() else {
            return NextMessage::Partial;
        };
        let [kind, stream, size @ ..] = *head;
        let n = u32::from_le_bytes(size) as usize;
        if n > CONTENT_BYTES_MAX {
            self.at = self.bytes.len();
            self.is_over = true;
            return NextMessage::Unknown;
        }
        let Some(content) = content.get(..n) else { return NextMessage::Partial };
        self.at += HEADER_BYTES + n;
        decode(kind, stream, content).map_or(NextMessage::Unknown, NextMessage::Whole)
    }
}

/// What the protocol asks of the line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LineRequest {
    /// Open the feeds.
    Begin,
    /// Close the feeds.
    End,
    /// Ask the sender for its time.
    Probe {
        /// The host's monotonic clock, in nanoseconds.
        host_ns: u64,
    },
}

/// Bytes of a request.
const REQUEST_BYTES: usize = 9;

impl LineRequest {
    /// Appends the request.
    pub fn put(self, out: &mut Vec<u8>) {
        let (kind, number) = match self {
            Self::Begin => (1, 0),
            Self::End => (2, 0),
            Self::Probe { host_ns } => (3, host_ns),
        };
        out.push(kind);
        out.extend(number.to_le_bytes());
    }

    /// The requests in what a protocol wrote.
    pub fn all(bytes: &[u8]) -> impl Iterator<Item = Self> {
        bytes.chunks_exact(REQUEST_BYTES).filter_map(|request| {
            let number = request.get(1..)?.first_chunk().map(|bytes| u64::from_le_bytes(*bytes))?;
            match request.first()? {
                1 => Some(Self::Begin),
                2 => Some(Self::End),
                3 => Some(Self::Probe { host_ns: number }),
                _ => None,
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_read_whole_and_in_pieces() {
        let messages = [
            StreamMessage::Description { stream: 1, xml: "<info/>" },
            StreamMessage::Found,
            StreamMessage::Feed { stream: 1, is_big_endian: true },
            StreamMessage::Started,
            StreamMessage::Data { stream: 1, read_ns: 7, bytes: &[1, 2, 3] },
            StreamMessage::Time { host_ns: 5, sender_s: 1.5, read_ns: 9 },
            StreamMessage::Lost { stream: 1 },
            StreamMessage::Ended,
        ];
        let mut bytes = Vec::new();
        messages.iter().for_each(|message| put_message(*message, &mut bytes));
        for size in [1, 3, 7, bytes.len()] {
            let mut reader = MessageReader::default();
            let mut at = 0;
            for piece in bytes.chunks(size) {
                reader.extend(piece);
                while let NextMessage::Whole(message) = reader.next_message() {
                    assert_eq!(message, messages[at], "in pieces of {size}");
                    at += 1;
                }
            }
            assert_eq!(at, messages.len());
        }
        let mut data = data_header(1, 7, 3).to_vec();
        data.extend([1, 2, 3]);
        let mut same = Vec::new();
        put_message(messages[4], &mut same);
        assert_eq!(data, same);
    }

    #[test]
    fn a_size_that_no_message_has_is_not_waited_for() {
        let mut reader = MessageReader::default();
        reader.extend(&[5, 0, 0xff, 0xff, 0xff, 0xff, 1]);
        assert_eq!(reader.next_message(), NextMessage::Unknown);
        assert_eq!(reader.next_message(), NextMessage::Partial);
        reader.extend(&[3, 0, 0, 0, 0, 0]);
        assert_eq!(reader.next_message(), NextMessage::Partial, "until it is cleared");
        reader.clear();
        reader.extend(&[99, 0, 0, 0, 0, 0]);
        assert_eq!(reader.next_message(), NextMessage::Unknown);
    }

    #[test]
    fn requests_round_trip() {
        let requests = [LineRequest::Begin, LineRequest::Probe { host_ns: 77 }, LineRequest::End];
        let mut bytes = Vec::new();
        requests.iter().for_each(|request| request.put(&mut bytes));
        assert_eq!(LineRequest::all(&bytes).collect::<Vec<_>>(), requests);
    }
}
