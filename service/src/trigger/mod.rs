//! Capture triggers: `<CaptureStart>` and `<CaptureStop>` in UDP datagrams, as motion capture programs send and
//! hear them. docs/triggers.md has the bytes.
//!
//! All but [`socket`] and [`Queue`] is sans-io: a datagram's bytes and the time go in, a [`Trigger`] or a [`Refusal`] comes out.

mod encode;
mod listener;
mod parse;
mod queue;
pub mod socket;

#[cfg(test)]
mod tests;

use std::{net::IpAddr, time::Duration};

pub use self::{
    encode::{Announcer, first_packet_id},
    listener::{Heard, IDS_MAX, Listener, Network, REMEMBERED, SENDERS_MAX},
    parse::{DATAGRAM_BYTES_MAX, DELAY_MAX, TEXT_BYTES_MAX, TakeName, parse},
    queue::{DELAYED_MAX, DELAYED_OTHERS_MAX, DUE_EACH_MAX, DUE_MAX, Received, TriggerQueue, Waiting},
    socket::RateLimit,
};

/// What a datagram asks for, or tells.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Trigger {
    /// `<CaptureStart>`: a take begins.
    Start(Capture),
    /// `<CaptureStop>`: it ends.
    Stop(Capture),
    /// `<CaptureComplete>`: its files are written, says another program: nothing has to be done.
    Complete(Capture),
}

/// What it says of a capture.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Capture {
    /// How the take of a start is to be called; `None` where the sender leaves it to us. Which take a stop means: one of
    /// another name is to go on. `None` means the one that is being recorded when it comes, or else one that its sender
    /// has started.
    pub name: Option<TakeName>,
    /// How a take that ended did at the sender; `None` where it does not say.
    pub result: Option<StopResult>,
    /// How long after the datagram the capture begins or ends; zero where nothing is said.
    pub delay: Duration,
    /// What else it says.
    pub about: About,
}

/// What a datagram says beside its name, for the take's event. Nothing here is ever used as a path.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct About {
    /// The sender's number of the datagram: its repeats have the same.
    pub packet_id: Option<u64>,
    /// `Notes`, `Description`, `DatabasePath` and whatever else stands in it, with what it says, in the order of the
    /// datagram; what says nothing is left out.
    pub fields: Vec<(String, String)>,
    /// What was cut or replaced in it, in words.
    pub changed: Vec<String>,
}

/// How a capture ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum StopResult {
    /// `SUCCESS`.
    Success,
    /// `FAIL`.
    Fail,
    /// `CANCEL`.
    Cancel,
    /// Another word.
    Other(String),
}

impl StopResult {
    /// As it is written.
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
    /// What it says.
    #[must_use]
    pub fn capture(&self) -> &Capture {
        let (Self::Start(capture) | Self::Stop(capture) | Self::Complete(capture)) = self;
        capture
    }

    /// How long after the datagram it is to be carried out. A completion asks for nothing, and so waits for nothing.
    #[must_use]
    pub fn delay(&self) -> Duration {
        match self {
            Self::Start(capture) | Self::Stop(capture) => capture.delay,
            Self::Complete(_) => Duration::ZERO,
        }
    }

    /// The element that it is.
    #[must_use]
    pub fn element(&self) -> &'static str {
        match self {
            Self::Start(_) => "CaptureStart",
            Self::Stop(_) => "CaptureStop",
            Self::Complete(_) => "CaptureComplete",
        }
    }

    /// One line for the take's event: everything that it says, as text.
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

/// Why a datagram starts and stops nothing. One line each: what was found, and what to do where somebody can do something.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// The sender is not one of those that are listened to.
    #[error("{0} is not in trigger.allow_from")]
    NotAllowed(IpAddr),
    /// Longer than a trigger is.
    #[error("it has {0} bytes, and a trigger has at most {max}", max = DATAGRAM_BYTES_MAX)]
    TooLong(usize),
    /// Its letters cannot be known.
    #[error("its letters cannot be read ({0}): triggers are UTF-8")]
    Encoding(String),
    /// It is no XML, or more of it than a trigger has.
    #[error("it is no trigger: {0}")]
    Xml(String),
    /// Its outermost element is another one.
    #[error("<{0}> is no trigger: CaptureStart, CaptureStop and CaptureComplete are")]
    Element(String),
    /// A number that cannot be meant.
    #[error("its {what} is \"{found}\": {wanted}")]
    Number {
        /// Which.
        what: &'static str,
        /// What stands there.
        found: String,
        /// What is expected.
        wanted: &'static str,
    },
    /// A delay above what is configured.
    #[error("its Delay is {} ms: trigger.delay_max is {} ms", found.as_millis(), max.as_millis())]
    DelayTooLong {
        /// What it asks for.
        found: Duration,
        /// What is allowed.
        max: Duration,
    },
    /// Its sender, which is not in `trigger.allow_from`, has too many that wait already.
    #[error("{waiting} of {sender} wait already, and it is not in trigger.allow_from")]
    TooManyOfSender {
        /// How many.
        waiting: usize,
        /// Whose.
        sender: IpAddr,
    },
    /// Too many wait already.
    #[error("{0} triggers wait already")]
    TooMany(usize),
    /// Of the name nothing can be kept.
    #[error("a take cannot be called \"{0}\": send another name")]
    Name(String),
    /// A start with the name of a take that exists.
    #[error("a take called {0} exists, and none is overwritten: send another name")]
    NameTaken(String),
}
