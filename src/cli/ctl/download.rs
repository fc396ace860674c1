//! `download`: a take in a file that is there when it is whole.

use std::{
    io::Write,
    path::{Path, PathBuf},
    time::Duration,
};

use anyhow::{Context, bail};
use hyper::{Method, body::Bytes};
use mocapd_acquire::files::NewFile;
use serde::Serialize;

use super::client::Client;
use crate::cli::{numbers, output::say};

/// A service whose disk stalls sends nothing for half a minute at most.
const SILENT: Duration = Duration::from_secs(60);

#[derive(Debug, Serialize)]
pub(super) struct Report {
    take: String,
    output: PathBuf,
    bytes: u64,
}

pub(super) fn run(client: &Client, name: &str, output: Option<&Path>) -> anyhow::Result<Report> {
    // What would be another folder's file here is no name there either.
    let here = PathBuf::from(format!("{}.take", name.replace('/', "_")));
    let output = output.map_or(here, Path::to_owned);
    let path = format!("/v1/takes/{}/download", encoded(name));
    let mut answer = client.open(&Method::GET, &path, &[], Bytes::new())?;
    let announced = answer.len();
    let mut file = NewFile::create(&output)?;
    let mut bytes = 0;
    while let Some(piece) = answer.next(SILENT)? {
        bytes += piece.len() as u64;
        file.write_all(&piece).with_context(|| format!("cannot write {}", output.display()))?;
    }
    if let Some(announced) = announced.filter(|&announced| announced != bytes) {
        bail!("{bytes} of {announced} bytes came: try again");
    }
    file.keep()?;
    say(&format!("{}: {}", output.display(), numbers::bytes(bytes)));
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
    fn names_in_paths() {
        assert_eq!(encoded("jump-001"), "jump-001");
        assert_eq!(encoded("a b/../é%"), "a%20b%2F..%2F%C3%A9%25");
    }
}
