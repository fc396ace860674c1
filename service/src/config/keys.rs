//! The table of keys: what each takes, its default, and why it is there.

mod rig;
mod service;

use std::time::Duration;

use serde_json::Value as Json;

pub use self::{rig::*, service::*};
use super::{
    Config,
    render::{duration_text, size_text},
};

/// A key of mocapd.toml.
#[derive(Debug)]
pub struct Key {
    /// Its section and its name: `arm.pre_roll`.
    pub path: &'static str,
    /// What may stand behind it.
    pub takes: Takes,
    /// What holds when it is left out.
    pub preset: Preset,
    /// What it does: one sentence.
    pub what: &'static str,
    /// Why it is there, or why the default is what it is: one sentence.
    pub why: &'static str,
    /// When a running service takes a new value over.
    pub when: When,
    /// The value in a checked configuration, as TOML and JSON alike; `None` when it is left out there.
    pub(super) written: fn(&Config) -> Option<Json>,
}

/// What may stand behind a key.
#[derive(Debug)]
pub enum Takes {
    /// `true` or `false`.
    Flag,
    /// A time with its unit.
    Time {
        /// The shortest.
        min: Duration,
        /// The longest.
        max: Duration,
    },
    /// A number of bytes with its unit.
    Size {
        /// The smallest, in bytes.
        min: u64,
        /// The largest, in bytes.
        max: u64,
    },
    /// A frame rate in Hz.
    Rate,
    /// A tolerance with its unit.
    Length,
    /// A whole number.
    Whole {
        /// The smallest.
        min: u64,
        /// The largest.
        max: u64,
    },
    /// A text, in these words.
    Text(&'static str),
    /// A list of texts.
    List {
        /// What each item is, in words.
        of: &'static str,
        /// How many there may be.
        max: usize,
    },
}

/// What holds when a key is left out.
#[derive(Debug, Clone, Copy)]
pub enum Preset {
    /// This text.
    Text(&'static str),
    /// This.
    Flag(bool),
    /// This number.
    Whole(u64),
    /// An empty list; what an item may look like.
    NoItems(&'static str),
    /// Nothing; what it may look like, as TOML.
    Absent(&'static str),
    /// It depends on where mocapd runs.
    Told {
        /// On what, in words.
        words: &'static str,
        /// What it may look like, as TOML.
        example: &'static str,
    },
}

/// When a running service takes a new value over.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum When {
    /// At once, also while a take is recorded.
    Now,
    /// With the next take.
    NextTake,
    /// When it is armed the next time.
    NextArm,
    /// When the service is started again.
    Restart,
}

impl When {
    /// In words.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Now => "at once",
            Self::NextTake => "with the next take",
            Self::NextArm => "when it is armed again",
            Self::Restart => "when the service is started again",
        }
    }
}

impl Key {
    /// The section that it stands in.
    #[must_use]
    pub fn section(&self) -> &'static str {
        self.path.split_once('.').map_or("", |(section, _)| section)
    }

    /// Its name in its section.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.path.split_once('.').map_or(self.path, |(_, name)| name)
    }

    /// What an example of it looks like: the default where that is a value.
    #[must_use]
    pub fn example(&self) -> String {
        match self.preset {
            Preset::Text(text) => format!("\"{text}\""),
            Preset::Flag(flag) => flag.to_string(),
            Preset::Whole(number) => number.to_string(),
            Preset::NoItems(_) => "[]".to_owned(),
            Preset::Absent(example) | Preset::Told { example, .. } => example.to_owned(),
        }
    }

    /// The default, in words.
    #[must_use]
    pub fn default_words(&self) -> String {
        match self.preset {
            Preset::Absent(_) => "none".to_owned(),
            Preset::Told { words, .. } => words.to_owned(),
            _ => format!("`{}`", self.example()),
        }
    }

    /// What to write: for whoever wrote something else.
    pub(super) fn advice(&self) -> String {
        let example = match self.preset {
            Preset::NoItems(item) => format!("[\"{item}\"]"),
            Preset::Text("") => return format!("write {}", self.takes.words()),
            _ => self.example(),
        };
        format!("write {}, such as {} = {example}", self.takes.words(), self.name())
    }
}

impl Takes {
    /// In words.
    #[must_use]
    pub fn words(&self) -> String {
        match self {
            Self::Flag => "true or false".to_owned(),
            Self::Time { min, max } => format!(
                "a time with its unit in quotes (ms, s, min, h), {} to {}",
                duration_text(*min),
                duration_text(*max)
            ),
            Self::Size { min, max } => format!(
                "a size with its unit in quotes (kB, MB, GB, KiB, MiB, GiB), {} to {}",
                size_text(*min),
                size_text(*max)
            ),
            Self::Rate => "a frame rate in Hz, 1 to 10000".to_owned(),
            Self::Length => {
                "a distance with its unit in quotes (um, mm, cm, m), 0.0001mm to 1000m".to_owned()
            }
            Self::Whole { min, max } => format!("a whole number, {min} to {max}"),
            Self::Text(words) => (*words).to_owned(),
            Self::List { of, max } => format!("a list of at most {max}, each {of}"),
        }
    }
}

/// Sections, in the order of the example, and what each is about.
pub const SECTIONS: &[(&str, &str)] = &[
    ("rig", "What the rig is called."),
    ("device", "Which device is recorded."),
    ("take", "Where takes go, and how they are written."),
    ("subject", "Who is captured; takes carry what is known of them."),
    ("arm", "What is kept while no take is recorded, so that a start can reach into the past."),
    ("http", "Who may ask and command the service, and where."),
    ("trigger", "Capture triggers over UDP, in and out."),
    ("log", "How much is said."),
];

/// Every key, in the order of the example.
pub static KEYS: &[&Key] = &[
    &RIG_NAME,
    &DEVICE_URI,
    &DEVICE_RATE_HZ,
    &DEVICE_RAW_LOG,
    &TAKE_DIRECTORY,
    &TAKE_NAME,
    &TAKE_TOLERANCE,
    &TAKE_LOSSLESS,
    &TAKE_RESAMPLER,
    &TAKE_STRETCH,
    &TAKE_SYNC,
    &TAKE_KEEP_FREE,
    &TAKE_RECONNECT,
    &TAKE_MAX_LENGTH,
    &SUBJECT_NAME,
    &SUBJECT_SKELETON,
    &SUBJECT_FACE,
    &SUBJECT_FACE_MARKERS,
    &ARM_AT_START,
    &ARM_PRE_ROLL,
    &ARM_INCLUDE_PRE_ROLL,
    &ARM_MEMORY_MAX,
    &HTTP_SOCKET,
    &HTTP_LISTEN,
    &HTTP_TOKEN_FILE,
    &HTTP_ALLOWED_HOSTS,
    &HTTP_CONNECTIONS_MAX,
    &TRIGGER_LISTEN,
    &TRIGGER_SEND_TO,
    &TRIGGER_ALLOW_FROM,
    &TRIGGER_DELAY_MAX,
    &LOG_LEVEL,
];
