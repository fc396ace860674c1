//! The NDI driver against transcripts: requests and answers byte for byte, as the vendor's guide has them.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

mod binary;
mod script;
mod setup;
mod text;
