//! The NDI driver against transcripts: requests and replies byte for byte, as in the vendor's guide.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod binary;
mod script;
mod setup;
mod text;
