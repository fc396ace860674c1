//! Refusals that another value of a setting helps against. Who shows one names the setting as its users know it: an
//! option of a command, a key of a configuration.

use std::fmt;

/// What can be set otherwise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Setting {
    /// The frame rate: this one can be had, in Hz; `None`: none but the device's own.
    Rate(Option<f64>),
    /// What stays free of the disk: less.
    KeepFree,
}

/// Why something is refused, and what helps.
#[derive(Debug)]
pub struct SettingRefused {
    pub(crate) why: String,
    pub(crate) setting: Setting,
    /// What helps beside the setting, behind its words; may be empty.
    pub(crate) or: &'static str,
}

impl SettingRefused {
    /// In one line; `advice` says what to do with the setting.
    #[must_use]
    pub fn words(&self, advice: impl FnOnce(Setting) -> String) -> String {
        format!("{}; {}{}", self.why, advice(self.setting), self.or)
    }
}

impl fmt::Display for SettingRefused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.words(|setting| match setting {
            Setting::Rate(Some(rate_hz)) => format!("run it at {rate_hz} Hz"),
            Setting::Rate(None) => "leave its rate as it is".to_owned(),
            Setting::KeepFree => "let less stay free".to_owned(),
        }))
    }
}

impl std::error::Error for SettingRefused {}
