//! Capture triggers: `<CaptureStart>` and `<CaptureStop>` in UDP datagrams, as motion capture programs send and receive
//! them. docs/triggers.md specifies the bytes.
//!
//! Everything except [`socket`] and [`TriggerQueue`] is sans-io: a datagram and the time go in, and a [`Trigger`] or a
//! [`TriggerError`] comes out.

mod datagram;
mod queue;
pub mod socket;

#[cfg(test)]
mod tests;

use std::{net::IpAddr, time::Duration};

pub use self::{
    datagram::{
        Announcer, DATAGRAM_BYTES_MAX, DELAY_MAX, TEXT_BYTES_MAX, TakeName, first_packet_id, parse,
    },
    queue::{
        DELAYED_MAX, DELAYED_OTHERS_MAX, DUE_EACH_MAX, DUE_MAX, IDS_MAX, Incoming, Listener,
        Network, PendingTriggers, REMEMBERED, ReceivedTrigger, SENDERS_MAX, TriggerQueue,
    },
    socket::RateLimit,
};

/// A request or notification in a datagram.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Trigger {
    /// `<CaptureStart>`: a take starts.
    Start(Capture),
    /// `<CaptureStop>`: a take stops.
    Stop(Capture),
    /// `<CaptureComplete>`: another program has written its files. Nothing has to be done.
    Complete(Capture),
}

/// The content of a trigger.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Capture {
    /// For a start, the name of the new take; `None` leaves it to us. For a stop, the take to stop: one of another name
    /// continues. `None` means the take that is being recorded when the datagram arrives, or otherwise one started by
    /// the same sender.
    pub name: Option<TakeName>,
    /// The result of a stopped take at the sender; `None` if missing.
    pub result: Option<StopResult>,
    /// The time from the datagram to the start or stop; zero if missing.
    pub delay: Duration,
    /// The other elements.
    pub about: About,
}

/// The other elements of a datagram, for the take's event. Nothing of it is ever used as a path.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct About {
    /// The sender's packet number: repeats have the same one.
    pub packet_id: Option<u64>,
    /// `Notes`, `Description`, `DatabasePath` and all other elements with their values, in the order of the datagram.
    /// Empty ones are omitted.
    pub fields: Vec<(String, String)>,
    /// Messages about what was shortened or replaced.
    pub changed: Vec<String>,
}

/// The result of a capture.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum StopResult {
    /// `SUCCESS`.
    Success,
    /// `FAIL`.
    Fail,
    /// `CANCEL`.
    Cancel,
    /// Any other word.
    Other(String),
}

impl StopResult {
    /// The word in the datagram.
    #[must_use]
    pub fn word(&self) -> &str {
        match self {
            Self::Success => "SUCCESS",
            Self::Fail => "FAIL",
            Self::Cancel => "CANCEL",
            Self::Other(word) => word,
        }
    }
}

impl Trigger {
    /// The content of the trigger.
    #[must_use]
    pub fn capture(&self) -> &Capture {
        let (Self::Start(capture) | Self::Stop(capture) | Self::Complete(capture)) = self;
        capture
    }

    /// The time from the datagram to its execution. A completion requests nothing and is not delayed.
    #[must_use]
    pub fn delay(&self) -> Duration {
        match self {
            Self::Start(capture) | Self::Stop(capture) => capture.delay,
            Self::Complete(_) => Duration::ZERO,
        }
    }

    /// The name of the XML element.
    #[must_use]
    pub fn element(&self) -> &'static str {
        match self {
            Self::Start(_) => "CaptureStart",
            Self::Stop(_) => "CaptureStop",
            Self::Complete(_) => "CaptureComplete",
        }
    }

    /// All content as one line, for the take's event.
    #[must_use]
    pub fn note(&self, from: IpAddr) -> String {
        let mut note = format!("{} from {}", self.element(), from.to_canonical());
        let Capture { result, delay, about, .. } = self.capture();
        if let Some(id) = about.packet_id {
            note += &format!(", packet {id}");
        }
        if *delay > Duration::ZERO {
            note += &format!(", delay {} ms", delay.as_millis());
        }
        if let Some(result) = result {
            note += &format!(", result {}", result.word());
        }
        for (what, text) in &about.fields {
            note += &format!(", {what} \"{text}\"");
        }
        for changed in &about.changed {
            note += &format!("; {changed}");
        }
        note
    }
}

/// Why a datagram has no effect: what was found, and what to do about it, on one line.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TriggerError {
    /// The sender is not in `trigger.allow_from`.
    #[error("{0} is not in trigger.allow_from")]
    NotAllowed(IpAddr),
    /// The datagram is too long.
    #[error("a datagram of {0} bytes: triggers have at most {max}", max = DATAGRAM_BYTES_MAX)]
    TooLong(usize),
    /// Its text cannot be decoded.
    #[error("unsupported encoding ({0}): triggers are UTF-8")]
    Encoding(String),
    /// It is not XML, or has more parts than a trigger.
    #[error("not a trigger: {0}")]
    Xml(String),
    /// The root element is not a trigger.
    #[error("<{0}> is not a trigger: expected CaptureStart, CaptureStop or CaptureComplete")]
    Element(String),
    /// A number is invalid.
    #[error("{what} is \"{found}\": {wanted}")]
    Number {
        /// The element.
        what: &'static str,
        /// The value found.
        found: String,
        /// What is expected.
        wanted: &'static str,
    },
    /// The delay exceeds the configured limit.
    #[error("its Delay of {} ms exceeds trigger.delay_max, {} ms", found.as_millis(), max.as_millis())]
    DelayTooLong {
        /// The requested delay.
        found: Duration,
        /// The longest delay allowed.
        max: Duration,
    },
    /// Too many triggers of the sender, which is not in `trigger.allow_from`, are pending.
    #[error(
        "{waiting} triggers of {sender}, which is not in trigger.allow_from, are pending already"
    )]
    TooManyOfSender {
        /// Number of its pending triggers.
        waiting: usize,
        /// The sender.
        sender: IpAddr,
    },
    /// Too many triggers are pending.
    #[error("{0} triggers are pending already")]
    TooMany(usize),
    /// No part of the name is usable.
    #[error("\"{0}\" is not a usable take name: send another one")]
    Name(String),
    /// The name of a start belongs to an existing take.
    #[error("a take named {0} exists and is never overwritten: send another name")]
    NameTaken(String),
}
