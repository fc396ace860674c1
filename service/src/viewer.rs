//! A service without a device, which only shows takes: for `mocapd view`.

use std::{fs, path::PathBuf, sync::Arc, time::SystemTime};

use anyhow::Context;
use crossbeam_channel::never;
use mocapd_acquire::{files::FileId, header::SOFTWARE};

use crate::{
    control::{
        Control, EventFeed, Mark, Marked, Refusal, RefusalKind, Request, SaveLast, Start, Started,
        Stopped,
    },
    engine::summarise,
    finished::{EditNotes, MovedTake, Rename, Restore, TakeNotes, Trash, TrashedTake},
    http::new_secret,
    live::LiveFeed,
    status::{MarkerQuality, PendingStart, Status, TakeStatus, TakeSummary},
};

/// Characters of a name: long ones are cut.
const NAME_CHARS_MAX: usize = 80;

/// A take that is shown.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ShownTake {
    /// Its name in the list.
    pub name: String,
    /// Its file, without symbolic links.
    pub path: PathBuf,
}

/// The takes of a viewer, in the order of its list.
#[derive(Debug, Default)]
pub struct TakeViewer {
    takes: Vec<ShownTake>,
}

impl TakeViewer {
    /// Adds a take. Its name in the list is `name` without what paths and lists cannot have, and unique.
    pub fn add(&mut self, name: &str, path: PathBuf) {
        let plain: String = name
            .chars()
            .map(|c| if c.is_control() || c == '/' || c == '\\' { '_' } else { c })
            .take(NAME_CHARS_MAX)
            .collect();
        let plain = plain.trim_start_matches('.');
        let base = if plain.is_empty() { "take" } else { plain };
        let is_taken = |name: &str| self.takes.iter().any(|take| take.name == name);
        let name = std::iter::once(base.to_owned())
            .chain((2..).map(|n| format!("{base} ({n})")))
            .find(|name| !is_taken(name))
            .unwrap_or_default();
        self.takes.push(ShownTake { name, path });
    }

    /// The takes.
    #[must_use]
    pub fn takes(&self) -> &[ShownTake] {
        &self.takes
    }

    /// The query by which the player compares two takes.
    #[must_use]
    pub fn comparison(take: &str, against: &str) -> String {
        form_urlencoded::Serializer::new(String::new())
            .append_pair("take", take)
            .append_pair("against", against)
            .finish()
    }

    /// A new token for the viewer's address: 256 random bits in hexadecimal digits.
    ///
    /// # Errors
    /// The system has no random bytes.
    pub fn token() -> anyhow::Result<String> {
        new_secret().context("no random bytes for a token")
    }
}

fn refuse<T>() -> Result<T, Refusal> {
    let message = "this viewer has no device: record with `mocapd record` or `mocapd run`";
    Err(Refusal::new(RefusalKind::Conflict, message))
}

fn refuse_change<T>() -> Result<T, Refusal> {
    let message = "this viewer only shows takes: rename or remove their files yourself";
    Err(Refusal::new(RefusalKind::Conflict, message))
}

impl Control for TakeViewer {
    fn status(&self) -> Status {
        Status { software: SOFTWARE.to_owned(), ..Status::default() }
    }

    fn quality(&self) -> Vec<MarkerQuality> {
        Vec::new()
    }

    fn arm(&self, _: &Request) -> Result<Status, Refusal> {
        refuse()
    }

    fn disarm(&self, _: &Request) -> Result<Status, Refusal> {
        refuse()
    }

    fn start(&self, _: &Start) -> Result<Started, Refusal> {
        refuse()
    }

    fn schedule(&self, _: &Start) -> Result<PendingStart, Refusal> {
        refuse()
    }

    fn cancel(&self, _: &Request) -> Result<PendingStart, Refusal> {
        refuse()
    }

    fn stop(&self, _: &Request) -> Result<Stopped, Refusal> {
        refuse()
    }

    fn mark(&self, _: &Mark) -> Result<Marked, Refusal> {
        refuse()
    }

    fn save_last(&self, _: &SaveLast) -> Result<Stopped, Refusal> {
        refuse()
    }

    fn takes(&self, limit: usize) -> Result<Vec<TakeSummary>, Refusal> {
        let summary = |take: &ShownTake| {
            // A file that is gone is reported when it is opened.
            let found = fs::metadata(&take.path).ok();
            let bytes = found.as_ref().map_or(0, fs::Metadata::len);
            let modified = found.and_then(|file| file.modified().ok());
            let modified = modified.unwrap_or(SystemTime::UNIX_EPOCH);
            let (summary, _) = summarise(&take.path, bytes, modified, false);
            TakeSummary { name: take.name.clone(), ..summary }
        };
        Ok(self.takes.iter().take(limit).map(summary).collect())
    }

    fn take_path(&self, name: &str) -> Result<PathBuf, Refusal> {
        let found = self.takes.iter().find(|take| take.name == name);
        found.map(|take| take.path.clone()).ok_or_else(|| {
            Refusal::new(RefusalKind::NotFound, "no take has this name: see /v1/takes")
        })
    }

    fn edit_notes(&self, _: &str, _: &EditNotes) -> Result<TakeNotes, Refusal> {
        refuse_change()
    }

    fn rename(&self, _: &str, _: &Rename) -> Result<MovedTake, Refusal> {
        refuse_change()
    }

    fn trash(&self, _: &str, _: &Trash) -> Result<TrashedTake, Refusal> {
        refuse_change()
    }

    fn trashed(&self, _: usize) -> Vec<TrashedTake> {
        Vec::new()
    }

    fn restore(&self, _: &str, _: &Restore) -> Result<MovedTake, Refusal> {
        refuse_change()
    }

    fn live_take(&self, _: FileId) -> Option<TakeStatus> {
        None
    }

    fn events(&self) -> EventFeed {
        EventFeed::new(never(), Arc::default())
    }

    fn live(&self) -> LiveFeed {
        LiveFeed::new(never(), Arc::default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_lead_nowhere() {
        let mut viewer = TakeViewer::default();
        for name in ["jump", "jump", "../x", ".hidden", "", "a/b\n", &"é".repeat(300)] {
            viewer.add(name, PathBuf::from("x.take"));
        }
        let names: Vec<_> = viewer.takes().iter().map(|take| take.name.as_str()).collect();
        assert_eq!(names[..6], ["jump", "jump (2)", "_x", "hidden", "take", "a_b_"]);
        assert_eq!(names[6].chars().count(), NAME_CHARS_MAX);
        assert!(viewer.take_path("jump (2)").is_ok() && viewer.take_path("x").is_err());
    }

    #[test]
    fn tokens_differ() {
        let [a, b] = [0, 0].map(|_| TakeViewer::token().unwrap());
        assert!(a != b && a.len() == 64);
    }
}
