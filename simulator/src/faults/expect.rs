//! What a script says of a recording that is made under it.

use serde::Deserialize;

/// What a recording under the script comes to.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub struct Expect {
    /// The recorder's exit code.
    pub exit: u8,
    /// What its ledger agrees with.
    #[serde(default)]
    pub ledger: Agreement,
    /// A piece of each contradiction that its ledger tells; no other may be told.
    #[serde(default)]
    pub contradictions: Vec<String>,
    /// A piece of each event that stands in the take; no other may.
    #[serde(default)]
    pub events: Vec<String>,
    /// Frames that must be missing or double, so that the script is not one that does nothing.
    #[serde(default)]
    pub at_least: u64,
}

/// How far a ledger agrees with the device's log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
pub enum Agreement {
    /// Every count is the log's.
    #[default]
    Exact,
    /// Counter and clock began anew: frames that were due meanwhile are by the host's clock, all else is the log's.
    ByHostClock,
}
