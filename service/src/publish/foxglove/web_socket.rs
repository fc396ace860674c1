//! The web socket of a client (RFC 6455), sans-io: its bytes go in, its messages and the bytes for it come out.
//!
//! The handshake, frames, masks and limits are tungstenite's, which finds no input and no output here but buffers.

use std::io::{self, ErrorKind, Read, Write};

use tungstenite::{
    Message,
    handshake::{
        machine::TryParse,
        server::{Request, create_response, write_response},
    },
    http::{HeaderValue, StatusCode},
    protocol::{
        Role, WebSocketConfig, WebSocketContext,
        frame::{
            FrameHeader,
            coding::{Data, OpCode},
        },
    },
};

/// Bytes of a handshake: several times that of a browser with its cookies.
const HANDSHAKE_BYTES_MAX: usize = 16 << 10;

/// Bytes of a message: subscriptions to many more channels than there can be.
const MESSAGE_BYTES_MAX: usize = 64 << 10;

/// Why a handshake is refused: the HTTP status, and what to do.
pub(super) type RefusedHandshake = (StatusCode, String);

/// What a client sent.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Received {
    /// Its handshake was accepted: it may be sent messages from now on.
    Opened,
    /// A message of text.
    Text(String),
    /// A binary message.
    Binary,
    /// It is to be disconnected, once it has what it was sent: it closed the connection, or did not keep to the protocol.
    Closed,
}

/// The web socket of a client.
#[derive(Debug)]
pub(super) struct WebSocket {
    state: SocketState,
    buffers: Buffers,
}

#[derive(Debug)]
enum SocketState {
    /// The bytes of its request so far.
    Handshake(Vec<u8>),
    Open(Box<WebSocketContext>),
    Closed,
}

/// What tungstenite reads and writes.
#[derive(Debug, Default)]
struct Buffers {
    input: Vec<u8>,
    read: usize,
    output: Vec<u8>,
}

impl Default for WebSocket {
    fn default() -> Self {
        Self { state: SocketState::Handshake(Vec::new()), buffers: Buffers::default() }
    }
}

impl WebSocket {
    /// Whether it is open.
    pub(super) fn is_open(&self) -> bool {
        matches!(self.state, SocketState::Open(_))
    }

    /// Takes bytes of the client; `accept` chooses the subprotocol of its request. What is to be sent to it is appended to `out`.
    pub(super) fn receive(
        &mut self,
        bytes: &[u8],
        accept: impl FnOnce(&Request) -> Result<&'static str, RefusedHandshake>,
        out: &mut Vec<u8>,
    ) -> Vec<Received> {
        let mut received = Vec::new();
        match &mut self.state {
            SocketState::Handshake(request) => {
                request.extend_from_slice(bytes);
                match handshake(request, accept, out) {
                    Ok(None) => return received,
                    Ok(Some(size)) => {
                        received.push(Received::Opened);
                        self.buffers.input = request.split_off(size);
                        self.state = SocketState::Open(Box::new(context()));
                    }
                    Err((status, text)) => {
                        refuse(status, &text, out);
                        self.state = SocketState::Closed;
                        received.push(Received::Closed);
                        return received;
                    }
                }
            }
            SocketState::Open(_) => self.buffers.input.extend_from_slice(bytes),
            SocketState::Closed => return received,
        }
        self.read(&mut received);
        out.append(&mut self.buffers.output);
        received
    }

    /// Reads the messages that have arrived whole. Pings and a close are answered.
    fn read(&mut self, received: &mut Vec<Received>) {
        let SocketState::Open(context) = &mut self.state else { return };
        loop {
            match context.read(&mut self.buffers) {
                Ok(Message::Text(text)) => received.push(Received::Text(text.as_str().to_owned())),
                Ok(Message::Binary(_)) => received.push(Received::Binary),
                Ok(Message::Ping(_) | Message::Pong(_) | Message::Close(_) | Message::Frame(_)) => {
                }
                Err(tungstenite::Error::Io(error)) if error.kind() == ErrorKind::WouldBlock => {
                    break;
                }
                Err(_) => {
                    // The answer to a close is written.
                    self.state = SocketState::Closed;
                    received.push(Received::Closed);
                    return;
                }
            }
        }
        // A pong may wait for the next read.
        if context.flush(&mut self.buffers).is_err() {
            self.state = SocketState::Closed;
            received.push(Received::Closed);
        }
    }
}

/// Appends a binary message in one frame.
pub(super) fn put_binary(parts: &[&[u8]], out: &mut Vec<u8>) {
    put_message(Data::Binary, parts, out);
}

/// Appends a message of text in one frame.
pub(super) fn put_text(text: &str, out: &mut Vec<u8>) {
    put_message(Data::Text, &[text.as_bytes()], out);
}

fn put_message(kind: Data, parts: &[&[u8]], out: &mut Vec<u8>) {
    let length: usize = parts.iter().map(|part| part.len()).sum();
    let header = FrameHeader { opcode: OpCode::Data(kind), ..FrameHeader::default() };
    // A vector takes every header.
    header.format(length as u64, out).ok();
    parts.iter().for_each(|part| out.extend_from_slice(part));
}

fn context() -> WebSocketContext {
    let config = WebSocketConfig::default()
        .read_buffer_size(4 << 10)
        .write_buffer_size(0)
        .max_write_buffer_size(MESSAGE_BYTES_MAX)
        .max_message_size(Some(MESSAGE_BYTES_MAX))
        .max_frame_size(Some(MESSAGE_BYTES_MAX));
    WebSocketContext::new(Role::Server, Some(config))
}

/// Answers a request that is complete; returns its size, or `None` if it is not.
fn handshake(
    bytes: &[u8],
    accept: impl FnOnce(&Request) -> Result<&'static str, RefusedHandshake>,
    out: &mut Vec<u8>,
) -> Result<Option<usize>, RefusedHandshake> {
    const WHAT_TO_DO: &str = "this port speaks the Foxglove WebSocket protocol: open it in Foxglove or Lichtblick as a connection";
    let invalid = |error: tungstenite::Error| {
        (StatusCode::BAD_REQUEST, format!("{WHAT_TO_DO} (no web socket: {error})"))
    };
    if bytes.len() > HANDSHAKE_BYTES_MAX {
        let text = format!("the request is longer than {HANDSHAKE_BYTES_MAX} bytes");
        return Err((StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE, text));
    }
    // Not parsed again with each of many short pieces.
    if !bytes.windows(4).any(|four| four == b"\r\n\r\n") {
        return Ok(None);
    }
    let Some((size, request)) = Request::try_parse(bytes).map_err(invalid)? else {
        return Ok(None);
    };
    let mut response = create_response(&request).map_err(invalid)?;
    let subprotocol = accept(&request)?;
    let value = HeaderValue::from_static(subprotocol);
    response.headers_mut().insert("Sec-WebSocket-Protocol", value);
    write_response(out, &response).map_err(invalid)?;
    Ok(Some(size))
}

/// Appends an HTTP response that refuses a connection.
pub(super) fn refuse(status: StatusCode, text: &str, out: &mut Vec<u8>) {
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: text/plain; charset=utf-8\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        text.len() + 1
    );
    out.extend_from_slice(head.as_bytes());
    out.extend_from_slice(text.as_bytes());
    out.push(b'\n');
}

impl Read for Buffers {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let rest = self.input.get(self.read..).unwrap_or_default();
        if rest.is_empty() {
            self.input.clear();
            self.read = 0;
            return Err(ErrorKind::WouldBlock.into());
        }
        let n = rest.len().min(out.len());
        out[..n].copy_from_slice(&rest[..n]);
        self.read += n;
        Ok(n)
    }
}

impl Write for Buffers {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.output.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const REQUEST: &str = "GET / HTTP/1.1\r\nHost: 127.0.0.1:8765\r\nUpgrade: websocket\r\nConnection: keep-alive, Upgrade\r\n\
        Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n";

    fn frame(opcode: u8, payload: &[u8]) -> Vec<u8> {
        let mask = [1, 2, 3, 4];
        let masked = payload.iter().zip(mask.iter().cycle()).map(|(byte, mask)| byte ^ mask);
        [0x80 | opcode, 0x80 | payload.len() as u8].into_iter().chain(mask).chain(masked).collect()
    }

    /// The bytes of a client in pieces of this size: what is received, and what is sent.
    fn talk(bytes: &[u8], size: usize) -> (Vec<Received>, Vec<u8>) {
        let (mut socket, mut out, mut received) = (WebSocket::default(), Vec::new(), Vec::new());
        for piece in bytes.chunks(size) {
            received.extend(socket.receive(piece, |_| Ok("x"), &mut out));
        }
        (received, out)
    }

    #[test]
    fn messages_come_through_in_pieces_of_any_size() {
        let mut bytes = REQUEST.as_bytes().to_vec();
        bytes.extend(frame(1, b"one"));
        bytes.extend(frame(9, b"ping"));
        bytes.extend(frame(2, b"two"));
        bytes.extend(frame(8, &1000_u16.to_be_bytes()));
        let (expected, sent) = talk(&bytes, bytes.len());
        let text = Received::Text("one".to_owned());
        assert_eq!(expected, [Received::Opened, text, Received::Binary, Received::Closed]);
        // The key and its answer are those of RFC 6455.
        let answer = String::from_utf8_lossy(&sent).to_lowercase();
        assert!(answer.starts_with("http/1.1 101 switching protocols\r\n"), "{answer}");
        assert!(answer.contains("sec-websocket-accept: s3pplmbitxaq9kygzzhzrbk+xoo=\r\n"));
        assert!(answer.contains("sec-websocket-protocol: x\r\n"));
        assert!(sent.ends_with(b"\x8a\x04ping\x88\x02\x03\xe8"), "{sent:?}");
        for size in 1..bytes.len() {
            let (received, answer) = talk(&bytes, size);
            assert_eq!((&received, &answer), (&expected, &sent), "pieces of {size}");
        }
    }

    #[test]
    fn other_requests_get_an_answer_that_says_what_to_do() {
        for request in [
            b"GET / HTTP/1.1\r\nHost: a\r\n\r\n".as_slice(),
            b"\x16\x03\x01\x02\0\x01\0\x01\xfc\x03\r\n\r\n",
        ] {
            let (received, sent) = talk(request, 7);
            assert_eq!(received, [Received::Closed]);
            let answer = String::from_utf8(sent).unwrap();
            assert!(answer.starts_with("HTTP/1.1 400 Bad Request\r\n"), "{answer}");
            assert!(answer.contains("open it in Foxglove"), "{answer}");
        }
        let long = format!("GET / HTTP/1.1\r\nX: {}", "x".repeat(HANDSHAKE_BYTES_MAX));
        let (received, sent) = talk(long.as_bytes(), 4096);
        assert_eq!(received, [Received::Closed]);
        assert!(sent.starts_with(b"HTTP/1.1 431 "), "{}", String::from_utf8_lossy(&sent));
    }

    #[test]
    fn a_long_message_and_frames_without_a_mask_close_the_connection() {
        let open = |frames: &[u8]| talk(&[REQUEST.as_bytes(), frames].concat(), 1000).0;
        // 2^63 - 1 bytes are announced.
        let long = [b"\x82\xff\x7f".as_slice(), &[0xff; 7], &[0; 4]].concat();
        for frames in [long.as_slice(), b"\x81\x01a", b"\xf1\x80\0\0\0\0"] {
            assert_eq!(open(frames), [Received::Opened, Received::Closed], "{frames:?}");
        }
        let many = frame(0, &[7; 100]).into_iter().map(|byte| if byte == 0x80 { 0 } else { byte });
        let first = frame(2, &[7; 100]).into_iter().map(|byte| if byte == 0x82 { 2 } else { byte });
        let many: Vec<u8> = first.chain((0..700).flat_map(|_| many.clone())).collect();
        assert_eq!(open(&many), [Received::Opened, Received::Closed], "fragments without an end");
    }

    #[test]
    fn messages_have_the_header_of_their_length() {
        for (n, header) in [(3, vec![0x82, 3]), (200, vec![0x82, 126, 0, 200])] {
            let mut out = Vec::new();
            put_binary(&[&vec![1; n - 1], &[2]], &mut out);
            assert_eq!((&out[..header.len()], out.len()), (&header[..], header.len() + n));
        }
        let mut out = Vec::new();
        put_text(&"x".repeat(70_000), &mut out);
        assert_eq!(out[..10], [0x81, 127, 0, 0, 0, 0, 0, 1, 0x11, 0x70]);
    }
}
