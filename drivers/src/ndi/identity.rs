//! What answers say of the device.

use super::{exchange::Outcome, host::Task};
use crate::device::Hello;

/// What a request was to do, for people.
pub(super) fn what(task: Task) -> String {
    match task {
        Task::Free(handle) => format!("free port {handle:02X}"),
        Task::Initialize(handle) => format!("initialize the tool in port {handle:02X}"),
        Task::Enable(handle) => format!("enable the tool in port {handle:02X}"),
        _ => "list its ports".to_owned(),
    }
}

/// The answer to `VER:0`: the first line is the model, others name serial number and firmware.
pub(super) fn hello(text: &str) -> Hello {
    let field = |name: &str| {
        let found = text.lines().find_map(|line| line.trim().strip_prefix(name));
        found.unwrap_or_default().trim().to_owned()
    };
    Hello {
        model: text.lines().next().unwrap_or_default().trim().to_owned(),
        serial: field("NDI S/N:"),
        firmware: field("Freeze Tag:"),
        ..Hello::default()
    }
}

/// `G.003.005`: `BX2` came with the Vega's third revision.
pub(super) fn has_bx2(revision: &str) -> bool {
    let mut parts = revision.split('.');
    let family = parts.next().unwrap_or_default();
    let major: u32 = parts.next().and_then(|major| major.parse().ok()).unwrap_or(0);
    family >= "G" && major >= 3
}

/// The value in `Name=value`.
pub(super) fn value<'a>(outcome: Outcome<'a>) -> Option<&'a str> {
    match outcome {
        Outcome::Text(text) => text.split_once('=').map(|(_, value)| value.trim()),
        Outcome::Refused(_) | Outcome::Silence => None,
    }
}
