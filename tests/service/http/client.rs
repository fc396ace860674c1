//! A minimal HTTP client, so that tests see every byte.

use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpStream},
    time::Duration,
};

use serde_json::Value;

/// An HTTP response.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) status: u16,
    headers: Vec<(String, String)>,
    pub(crate) body: Vec<u8>,
}

impl Answer {
    pub(crate) fn parse(bytes: &[u8]) -> Self {
        let end = bytes.windows(4).position(|window| window == b"\r\n\r\n");
        let end =
            end.unwrap_or_else(|| panic!("no response: {:?}", String::from_utf8_lossy(bytes)));
        let head = std::str::from_utf8(&bytes[..end]).unwrap();
        let mut lines = head.split("\r\n");
        let status = lines.next().unwrap().split(' ').nth(1).unwrap().parse().unwrap();
        let headers: Vec<_> = lines
            .map(|line| line.split_once(": ").unwrap())
            .map(|(name, value)| (name.to_lowercase(), value.to_owned()))
            .collect();
        let mut answer = Self { status, headers, body: bytes[end + 4..].to_vec() };
        if answer.header("transfer-encoding") == Some("chunked") {
            answer.body = unchunked(&answer.body);
        }
        answer
    }

    pub(crate) fn header(&self, name: &str) -> Option<&str> {
        self.headers.iter().find(|header| header.0 == name).map(|header| header.1.as_str())
    }

    pub(crate) fn json(&self) -> Value {
        serde_json::from_slice(&self.body)
            .unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(&self.body)))
    }

    /// Checks that the response is a problem document with this status and kind; returns its message.
    pub(crate) fn refused(&self, status: u16, kind: &str) -> String {
        let text = String::from_utf8_lossy(&self.body).into_owned();
        assert_eq!(self.status, status, "{text}");
        assert_eq!(self.header("content-type"), Some("application/problem+json"), "{text}");
        let problem = self.json();
        assert_eq!(problem["status"], status, "{text}");
        assert_eq!(problem["kind"], kind, "{text}");
        let message = problem["message"].as_str().unwrap();
        assert!(!message.is_empty() && !message.contains('\n'), "{text}");
        message.to_owned()
    }
}

/// Decodes a chunked body, including an incomplete last chunk.
pub(crate) fn unchunked(mut bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    while let Some(at) = bytes.windows(2).position(|window| window == b"\r\n") {
        let Ok(text) = std::str::from_utf8(&bytes[..at]) else { break };
        let Ok(len) = usize::from_str_radix(text, 16) else { break };
        let rest = &bytes[at + 2..];
        out.extend_from_slice(&rest[..len.min(rest.len())]);
        if len == 0 || rest.len() < len + 2 {
            break;
        }
        bytes = &rest[len + 2..];
    }
    out
}

pub(crate) fn connect(at: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(at).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    stream.set_write_timeout(Some(Duration::from_secs(20))).unwrap();
    stream
}

/// Sends bytes, and returns everything received until the server closes the connection.
pub(crate) fn exchange(at: SocketAddr, bytes: &[u8]) -> Vec<u8> {
    let mut stream = connect(at);
    // The server may refuse and close early; the response can still be read.
    stream.write_all(bytes).ok();
    let mut answer = Vec::new();
    // A reset after the response is harmless.
    stream.read_to_end(&mut answer).ok();
    answer
}

/// The bytes of a request with `connection: close`.
pub(crate) fn request(method: &str, path: &str, headers: &[(&str, &str)], body: &str) -> Vec<u8> {
    let mut text = format!("{method} {path} HTTP/1.1\r\nconnection: close\r\n");
    let has = |name: &str| headers.iter().any(|header| header.0.eq_ignore_ascii_case(name));
    if !has("host") {
        text += "host: localhost\r\n";
    }
    if method == "POST" && !has("content-length") && !has("transfer-encoding") {
        text += &format!("content-length: {}\r\n", body.len());
    }
    if method == "POST" && !has("content-type") {
        text += "content-type: application/json\r\n";
    }
    for (name, value) in headers {
        // An empty value omits the header.
        if !value.is_empty() {
            text += &format!("{name}: {value}\r\n");
        }
    }
    (text + "\r\n" + body).into_bytes()
}

pub(crate) fn ask(
    at: SocketAddr,
    method: &str,
    path: &str,
    headers: &[(&str, &str)],
    body: &str,
) -> Answer {
    Answer::parse(&exchange(at, &request(method, path, headers, body)))
}

pub(crate) fn get(at: SocketAddr, path: &str) -> Answer {
    ask(at, "GET", path, &[], "")
}

pub(crate) fn post(at: SocketAddr, path: &str, body: &str) -> Answer {
    ask(at, "POST", path, &[], body)
}
