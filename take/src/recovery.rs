//! A take again of what can be read of a damaged one: its good chunks unchanged, with what stands for the others,
//! a ledger that closes, index and footer.
//!
//! First the file is read and decoded once ([`Survey::read`]), then its good chunks are copied ([`Survey::write`]).
//! A stretch is never coded again: what its encoder proved of it stays proven.

mod account;
mod kinds;
mod start;
mod survey;
mod write;

pub use self::{
    kinds::{Kind, KindCount},
    start::{Mended, MendedStart, mend_start},
    survey::{ChannelCount, Survey},
};

use crate::record::Channel;
use crate::stretch::Span;

/// The setting in HEADER that tells of a recovery.
pub const RECOVERED: &str = "recovered";

/// What the new take is made of, in order.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Piece {
    /// A chunk of the old one.
    Chunk {
        offset: u64,
        len: u64,
        kind: u8,
        /// Of a stretch.
        span: Option<Span>,
    },
    /// Entries of the channel table in the place of lost ones.
    Channels(Vec<Channel>),
    /// A stretch of no rows in the place of those that are lost.
    Lost { first_row: u64, rows: u64, number: u8 },
}
