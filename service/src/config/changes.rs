//! What differs between two configurations, and when a running service takes it over.

use serde_json::Value as Json;

use super::{
    Config,
    keys::{KEYS, When},
};

/// A key with another value.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// Which key, such as `arm.pre_roll`.
    pub key: &'static str,
    /// When the new value holds.
    pub when: When,
    /// Its value until then; `None` where it had none.
    pub from: Option<Json>,
    /// Its new one.
    pub to: Option<Json>,
}

impl Config {
    /// What `new` has otherwise, in the order of the table. Values are compared as they are written, which is
    /// exact: what is written is read as the same again.
    #[must_use]
    pub fn changes(&self, new: &Self) -> Vec<Change> {
        let changed = |key: &&'static super::keys::Key| {
            let (from, to) = ((key.written)(self), (key.written)(new));
            (from != to).then_some(Change { key: key.path, when: key.when, from, to })
        };
        KEYS.iter().filter_map(changed).collect()
    }
}
