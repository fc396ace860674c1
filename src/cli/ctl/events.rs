//! `events`: followed, and taken up again where the connection broke.

use std::{
    io::Write,
    path::{Path, PathBuf},
    time::Duration,
};

use anyhow::{Context, bail};
use hyper::{Method, body::Bytes};
use mocapd::outcome::Outcome;
use mocapd_acquire::files::NewFile;
use mocapd_service::status::ServiceEvent;
use serde::Serialize;
use serde_json::Value;

use super::{
    client::{Client, Lost},
    words,
};
use crate::cli::{
    output::{plain, print, print_json_text, say},
    values,
};

/// Longer than the service is silent: it sends a sign of life every 15 s.
const SILENT: Duration = Duration::from_secs(45);

/// Before the service is asked again.
const AGAIN: Duration = Duration::from_secs(1);

/// Bytes of one event at most.
const EVENT_BYTES_MAX: usize = 1 << 20;

/// Until Ctrl-C ends the process: there is nothing to finish.
pub(super) fn follow(client: &Client, json: bool) -> anyhow::Result<Outcome> {
    let mut last_id = String::new();
    loop {
        let headers = [("last-event-id", last_id.as_str())];
        let headers = if last_id.is_empty() { &[][..] } else { &headers };
        let mut answer = client.open(&Method::GET, "/v1/events", headers, Bytes::new())?;
        let mut events = Events::default();
        let broken = loop {
            match answer.next(SILENT) {
                Ok(Some(bytes)) => {
                    for event in events.push(&bytes)? {
                        tell(&event, json)?;
                        last_id = event.id.unwrap_or(last_id);
                    }
                }
                Ok(None) => break "the service ended the connection".to_owned(),
                Err(error) if error.is::<Lost>() => break error.to_string(),
                Err(error) => return Err(error),
            }
        };
        say(&format!("{broken}; asking again"));
        std::thread::sleep(AGAIN);
    }
}

fn tell(event: &Event, json: bool) -> anyhow::Result<()> {
    if json {
        // An event is one line: a line end in it can only stand between two values.
        return print_json_text(&event.data.replace('\n', " "));
    }
    if let Ok(happened) = serde_json::from_str::<ServiceEvent>(&event.data) {
        let (kind, message) = (happened.kind, plain(&happened.message));
        return print(&format!("{}  {kind:<13} {message}\n", words::time(happened.unix_ms)));
    }
    let missed = serde_json::from_str::<Value>(&event.data).unwrap_or_default();
    say(&match missed["missed"].as_u64() {
        Some(n) => format!("{n} events were missed"),
        None => "the service was started anew: nobody knows what was missed".to_owned(),
    });
    Ok(())
}

#[derive(Debug, PartialEq, Eq)]
struct Event {
    id: Option<String>,
    data: String,
}

/// Server-sent events, as far as the service uses them: lines that end with a line feed, `id` and `data`.
#[derive(Debug, Default)]
struct Events {
    rest: Vec<u8>,
    id: Option<String>,
    data: Vec<String>,
}

impl Events {
    /// # Errors
    /// An event that is larger than any is.
    fn push(&mut self, bytes: &[u8]) -> anyhow::Result<Vec<Event>> {
        self.rest.extend_from_slice(bytes);
        let mut events = Vec::new();
        while let Some(at) = self.rest.iter().position(|&byte| byte == b'\n') {
            let line: Vec<u8> = self.rest.drain(..=at).collect();
            let line = String::from_utf8_lossy(&line);
            self.line(line.trim_end_matches(['\r', '\n']), &mut events);
        }
        if self.rest.len() + self.data.iter().map(String::len).sum::<usize>() > EVENT_BYTES_MAX {
            bail!("an event of more than {EVENT_BYTES_MAX} bytes: that may be no mocapd");
        }
        Ok(events)
    }

    fn line(&mut self, line: &str, events: &mut Vec<Event>) {
        let (field, value) = line.split_once(':').unwrap_or((line, ""));
        let value = value.strip_prefix(' ').unwrap_or(value);
        match field {
            "" if line.is_empty() && !self.data.is_empty() => {
                let data = std::mem::take(&mut self.data).join("\n");
                events.push(Event { id: self.id.take(), data });
            }
            "id" => self.id = Some(value.to_owned()),
            "data" => self.data.push(value.to_owned()),
            // Comments, which are signs of life, and the kind, which the data has as well.
            _ => {}
        }
    }
}

/// A service whose disk stalls sends nothing for half a minute at most.
const SILENT_DISK: Duration = Duration::from_secs(60);

#[derive(Debug, Serialize)]
pub(super) struct Report {
    take: String,
    output: PathBuf,
    bytes: u64,
}

pub(super) fn download(
    client: &Client,
    name: &str,
    output: Option<&Path>,
) -> anyhow::Result<Report> {
    // What would be another folder's file here is no name there either.
    let here = PathBuf::from(format!("{}.take", name.replace('/', "_")));
    let output = output.map_or(here, Path::to_owned);
    let path = format!("/v1/takes/{}/download", encoded(name));
    let mut answer = client.open(&Method::GET, &path, &[], Bytes::new())?;
    let announced = answer.len();
    let mut file = NewFile::create(&output)?;
    let mut bytes = 0;
    while let Some(piece) = answer.next(SILENT_DISK)? {
        bytes += piece.len() as u64;
        file.write_all(&piece).with_context(|| format!("cannot write {}", output.display()))?;
    }
    if let Some(announced) = announced.filter(|&announced| announced != bytes) {
        bail!("{bytes} of {announced} bytes came: try again");
    }
    file.keep()?;
    say(&format!("{}: {}", output.display(), values::bytes(bytes)));
    Ok(Report { take: name.to_owned(), output, bytes })
}

/// As it stands in a path.
fn encoded(name: &str) -> String {
    let mut out = String::with_capacity(name.len());
    for byte in name.bytes() {
        if byte.is_ascii_alphanumeric() || b"-_.~".contains(&byte) {
            out.push(char::from(byte));
        } else {
            out += &format!("%{byte:02X}");
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_in_pieces_of_any_size() {
        let text = ": alive\n\nid: 1-7\nevent: mark\ndata: {\"a\":1}\n\n:\n\nevent: missed\ndata: x\ndata: y\n\nid: 1-8\nda";
        let id = Some("1-7".to_owned());
        let expected = [
            Event { id, data: "{\"a\":1}".to_owned() },
            Event { id: None, data: "x\ny".to_owned() },
        ];
        for size in 1..text.len() {
            let mut events = Events::default();
            let pieces = text.as_bytes().chunks(size);
            let found: Vec<_> = pieces.flat_map(|piece| events.push(piece).unwrap()).collect();
            assert_eq!(found, expected, "pieces of {size}");
        }
        assert!(Events::default().push(&vec![b'x'; EVENT_BYTES_MAX + 1]).is_err());
    }
}

#[cfg(test)]
mod tests_of_download {
    use super::*;

    #[test]
    fn names_in_paths() {
        assert_eq!(encoded("jump-001"), "jump-001");
        assert_eq!(encoded("a b/../é%"), "a%20b%2F..%2F%C3%A9%25");
    }
}
