//! Errors that another value of a setting avoids. The caller names the setting as its users know it: an option of a
//! command or a key of a configuration.

use std::fmt;

/// A setting to change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Setting {
    /// The frame rate: a rate in Hz that would work; `None`: only the device's own.
    Rate(Option<f64>),
    /// The disk space to leave free: less of it.
    KeepFree,
}

/// Why something is refused, and which setting avoids it.
#[derive(Debug)]
pub struct SettingRefused {
    pub(crate) why: String,
    pub(crate) setting: Setting,
    /// Another remedy, appended to the advice on the setting; may be empty.
    pub(crate) alternative: &'static str,
}

impl SettingRefused {
    fn message_with(&self, how_to_set: impl Fn(Setting) -> String) -> String {
        format!("{}; {}{}", self.why, how_to_set(self.setting), self.alternative)
    }
}

/// An error in one line, in which `how_to_set` words the advice on the setting.
#[must_use]
pub fn message(error: &anyhow::Error, how_to_set: impl Fn(Setting) -> String) -> String {
    let causes = error.chain().map(|cause| match cause.downcast_ref::<SettingRefused>() {
        Some(refused) => refused.message_with(&how_to_set),
        None => cause.to_string(),
    });
    causes.collect::<Vec<_>>().join(": ")
}

impl fmt::Display for SettingRefused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message_with(|setting| match setting {
            Setting::Rate(Some(rate_hz)) => format!("run it at {rate_hz} Hz"),
            Setting::Rate(None) => "keep the rate of the device".to_owned(),
            Setting::KeepFree => "leave less space free".to_owned(),
        }))
    }
}

impl std::error::Error for SettingRefused {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_context_of_a_refusal_stays() {
        let why = "no".to_owned();
        let refused = SettingRefused { why, setting: Setting::KeepFree, alternative: "!" };
        let error = anyhow::Error::from(refused).context("inner").context("outer");
        assert_eq!(message(&error, |_| "--keep-free".to_owned()), "outer: inner: no; --keep-free!");
    }
}
