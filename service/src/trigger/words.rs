//! Why a datagram starts and stops nothing.

use std::net::IpAddr;

/// One line each: what was found, and what to do where somebody can do something.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// The sender is not one of those that are listened to.
    #[error("{0} is not in trigger.allow_from")]
    NotAllowed(IpAddr),
    /// Longer than a trigger is.
    #[error("it has {0} bytes, and a trigger has at most {max}", max = super::DATAGRAM_BYTES_MAX)]
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
        found: std::time::Duration,
        /// What is allowed.
        max: std::time::Duration,
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
