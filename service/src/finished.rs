//! Finished takes as people see them: rating and notes, names, and the trash.

use std::path::PathBuf;

use mocapd_acquire::files::path_as_text;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Longest notes of a finished take in bytes: a page of text. A list of a thousand takes with them has at most 9 MB in
/// JSON, where line ends, tabs and quotes take two bytes, which `mocapd ctl` reads.
pub const NOTES_BYTES_MAX: usize = 4096;

/// Whether a take can be used. Laboratories keep or exclude a trial, and film sets circle a take or not: a scale of
/// stars would leave open from which star on a take counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum TakeRating {
    /// Not rated.
    #[default]
    None,
    /// To be used.
    Good,
    /// Not to be used.
    Bad,
    /// A rating of a later version.
    #[serde(other)]
    Unknown,
}

impl TakeRating {
    /// The word in the API and in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Good => "good",
            Self::Bad => "bad",
            Self::Unknown => "unknown",
        }
    }
}

/// The rating and the notes of a finished take, from the file beside it.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
pub struct TakeNotes {
    /// `good`, `bad`, or `none` if the take is not rated.
    pub rating: TakeRating,
    /// The notes, at most 4096 bytes; may have several lines.
    pub text: String,
    /// When they were changed last, in milliseconds since 1970.
    pub changed_unix_ms: i64,
    /// Why the file of the notes cannot be used, and what to do; it is left as it is, and rating and notes are empty.
    pub problem: Option<String>,
}

/// A request to change the rating or the notes of a take.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct EditNotes {
    /// Chosen by the client, at most 64 characters: the same request again gets the same reply.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 64, pattern = r"^[ -~]+$")]
    pub request_id: Option<String>,
    /// Id of the take, from the list; if given, another take that has got the name meanwhile is left alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub take_id: Option<String>,
    /// `good`, `bad` or `none`; unchanged if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rating: Option<TakeRating>,
    /// The notes, at most 4096 bytes; unchanged if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
}

/// A request to rename a take.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Rename {
    /// Chosen by the client, at most 64 characters: the same request again gets the same reply.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 64, pattern = r"^[ -~]+$")]
    pub request_id: Option<String>,
    /// Id of the take, from the list; if given, another take that has got the name meanwhile is left alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub take_id: Option<String>,
    /// The new name, without `.take`.
    pub to: String,
}

/// A request to move a take to the trash.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Trash {
    /// Chosen by the client, at most 64 characters: the same request again gets the same reply.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 64, pattern = r"^[ -~]+$")]
    pub request_id: Option<String>,
    /// Id of the take, from the list; if given, another take that has got the name meanwhile is left alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub take_id: Option<String>,
}

/// A request to restore a take from the trash.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Restore {
    /// Chosen by the client, at most 64 characters: the same request again gets the same reply.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 64, pattern = r"^[ -~]+$")]
    pub request_id: Option<String>,
    /// Another name for it, without `.take`; by default its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub to: Option<String>,
}

/// Reply to a rename or a restore: the take has this name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct MovedTake {
    /// Name of the take, without `.take`.
    pub name: String,
    /// Path of its file.
    #[schema(value_type = String)]
    #[serde(serialize_with = "path_as_text")]
    pub path: PathBuf,
    /// Remarks, such as that the archive keeps the old name.
    #[serde(default)]
    pub remarks: Vec<String>,
}

/// A take in the trash.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
pub struct TrashedTake {
    /// Identifies it in the trash.
    pub id: String,
    /// The name that it had, without `.take`.
    pub name: String,
    /// Size of its file in bytes, which the disk has less.
    pub bytes: u64,
    /// When it was moved to the trash, in milliseconds since 1970.
    pub trashed_unix_ms: i64,
    /// When it will be removed (`take.trash_keep`), in milliseconds since 1970.
    pub removed_unix_ms: i64,
}
