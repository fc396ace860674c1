//! What the command lines of `mocapd` and `mocapd-sim` share: messages of errors, usage errors of one line, the signals that
//! end a program, shell completions and manual pages, and numbers for people.

pub mod failure;
pub mod manual;
pub mod numbers;
pub mod stop;
pub mod usage;
