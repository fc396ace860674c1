//! What the `mocapd` program shares with the tests: its exit codes.

pub mod outcome;
