//! `ctl events`: follows the service's event stream and resumes it after a broken connection. `ctl download`: fetches a
//! take.

use std::{
    io::Write,
    path::{Path, PathBuf},
    time::Duration,
};

use anyhow::{Context, bail};
use hyper::{Method, body::Bytes};
use mocapd::outcome::Outcome;
use mocapd_acquire::files::NewFile;
use mocapd_service::{status::ServiceEvent, take_files::notes::notes_path};
use serde::Serialize;
use serde_json::Value;

use super::{
    client::{Client, ConnectionLost},
    text,
};
use crate::cli::{
    output::{notify, plain, print, print_json_text},
    values,
};

/// Longer than the service is ever silent: it sends a keep-alive comment every 15 s.
const IDLE_TIMEOUT: Duration = Duration::from_secs(45);

/// Delay before reconnecting.
const RECONNECT_DELAY: Duration = Duration::from_secs(1);

/// Largest event, bytes.
const EVENT_BYTES_MAX: usize = 1 << 20;

/// Prints events until Ctrl-C ends the process; nothing has to be finished then.
pub(super) fn follow(client: &Client, json: bool) -> anyhow::Result<Outcome> {
    let mut last_id = String::new();
    loop {
        let headers = [("last-event-id", last_id.as_str())];
        let headers = if last_id.is_empty() { &[][..] } else { &headers };
        let mut answer = client.open(&Method::GET, "/v1/events", headers, Bytes::new())?;
        let mut events = EventParser::default();
        let broken = loop {
            match answer.next(IDLE_TIMEOUT) {
                Ok(Some(bytes)) => {
                    for event in events.push(&bytes)? {
                        show(&event, json)?;
                        last_id = event.id.unwrap_or(last_id);
                    }
                }
                Ok(None) => break "the service closed the connection".to_owned(),
                Err(error) if error.is::<ConnectionLost>() => break error.to_string(),
                Err(error) => return Err(error),
            }
        };
        notify(&format!("{broken}; reconnecting"));
        std::thread::sleep(RECONNECT_DELAY);
    }
}

fn show(event: &Event, json: bool) -> anyhow::Result<()> {
    if json {
        // One line per event: line ends occur only between JSON values.
        return print_json_text(&event.data.replace('\n', " "));
    }
    if let Ok(event) = serde_json::from_str::<ServiceEvent>(&event.data) {
        let (kind, message) = (event.kind, plain(&event.message));
        return print(&format!("{}  {kind:<13} {message}\n", text::time(event.unix_ms)));
    }
    let missed = serde_json::from_str::<Value>(&event.data).unwrap_or_default();
    notify(&match missed["missed"].as_u64() {
        Some(n) => format!("{n} events were missed"),
        None => "the service was restarted: events may have been missed".to_owned(),
    });
    Ok(())
}

#[derive(Debug, PartialEq, Eq)]
struct Event {
    id: Option<String>,
    data: String,
}

/// An incremental parser of the server-sent events that the service uses: fields `id` and `data`, lines ended by line
/// feeds.
#[derive(Debug, Default)]
struct EventParser {
    rest: Vec<u8>,
    id: Option<String>,
    data: Vec<String>,
}

impl EventParser {
    /// Adds received bytes and returns the events that they complete.
    ///
    /// # Errors
    /// If an event exceeds [`EVENT_BYTES_MAX`].
    fn push(&mut self, bytes: &[u8]) -> anyhow::Result<Vec<Event>> {
        self.rest.extend_from_slice(bytes);
        let mut events = Vec::new();
        while let Some(at) = self.rest.iter().position(|&byte| byte == b'\n') {
            let line: Vec<u8> = self.rest.drain(..=at).collect();
            let line = String::from_utf8_lossy(&line);
            self.line(line.trim_end_matches(['\r', '\n']), &mut events);
        }
        if self.rest.len() + self.data.iter().map(String::len).sum::<usize>() > EVENT_BYTES_MAX {
            bail!("an event exceeds {EVENT_BYTES_MAX} bytes: this may not be a mocapd service");
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
            // Comments (keep-alives), and the event's kind, which its data repeats.
            _ => {}
        }
    }
}

/// Longer than the half a minute for which a service with a stalled disk may send nothing.
const DOWNLOAD_TIMEOUT: Duration = Duration::from_secs(60);

#[derive(Debug, Serialize)]
pub(super) struct DownloadReport {
    take: String,
    output: PathBuf,
    bytes: u64,
    /// The file of the notes; null if the take has none.
    notes: Option<PathBuf>,
}

pub(super) fn download(
    client: &Client,
    name: &str,
    output: Option<&Path>,
) -> anyhow::Result<DownloadReport> {
    // A slash in the name must not lead to another folder.
    let here = PathBuf::from(format!("{}.take", name.replace('/', "_")));
    let output = output.map_or(here, Path::to_owned);
    // First, so that no take is transferred in vain.
    let notes = notes_file(client, name, &output)?;
    let path = format!("/v1/takes/{}/download", encoded(name));
    let mut answer = client.open(&Method::GET, &path, &[], Bytes::new())?;
    let announced = answer.len();
    let mut file = NewFile::create(&output)?;
    let mut bytes = 0;
    while let Some(piece) = answer.next(DOWNLOAD_TIMEOUT)? {
        bytes += piece.len() as u64;
        file.write_all(&piece).with_context(|| format!("cannot write {}", output.display()))?;
    }
    if let Some(announced) = announced.filter(|&announced| announced != bytes) {
        bail!("received {bytes} of {announced} bytes: try again");
    }
    file.keep()?;
    notify(&format!("{}: {}", output.display(), values::bytes(bytes)));
    let notes = match notes {
        Some(notes) => Some(notes.keep()?),
        None => None,
    };
    Ok(DownloadReport { take: name.to_owned(), output, bytes, notes })
}

/// The notes of a take, in a file beside `output` that is complete but has no name yet.
struct NotesFile {
    file: NewFile,
    path: PathBuf,
}

impl NotesFile {
    fn keep(self) -> anyhow::Result<PathBuf> {
        self.file.keep()?;
        notify(&format!("{}: its notes", self.path.display()));
        Ok(self.path)
    }
}

/// Requests the notes of a take; `None` if it has none.
fn notes_file(client: &Client, name: &str, output: &Path) -> anyhow::Result<Option<NotesFile>> {
    let path = format!("/v1/takes/{}/notes", encoded(name));
    let Some(mut answer) = client.open_if_there(&Method::GET, &path, Bytes::new())? else {
        return Ok(None);
    };
    let to = notes_path(output);
    let mut file = NewFile::create(&to)?;
    while let Some(piece) = answer.next(DOWNLOAD_TIMEOUT)? {
        file.write_all(&piece).with_context(|| format!("cannot write {}", to.display()))?;
    }
    Ok(Some(NotesFile { file, path: to }))
}

/// Percent-encodes a name for a URL path.
pub(super) fn encoded(name: &str) -> String {
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
            let mut events = EventParser::default();
            let pieces = text.as_bytes().chunks(size);
            let found: Vec<_> = pieces.flat_map(|piece| events.push(piece).unwrap()).collect();
            assert_eq!(found, expected, "pieces of {size}");
        }
        assert!(EventParser::default().push(&vec![b'x'; EVENT_BYTES_MAX + 1]).is_err());
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
