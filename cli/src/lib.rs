//! What the command lines of `mocapd` and `mocapd-sim` share: error messages, usage errors of one line, the signals
//! that end a program, shell completions and manual pages, and numbers for people.

pub mod manual;
pub mod numbers;
pub mod stop;
pub mod usage;

use anyhow::Error;

/// The ends of the system's messages for a full disk (ENOSPC) and an exhausted quota (EDQUOT), with Linux's numbers.
const NO_SPACE: [&str; 2] = ["(os error 28)", "(os error 122)"];

/// An error and its causes in one line. For a full disk it ends with what to do, for any file that was being written.
#[must_use]
pub fn failure_message(error: &Error) -> String {
    let message = format!("{error:#}");
    // Errors of many libraries carry the system's; each of them prints it last.
    if NO_SPACE.iter().any(|ending| message.trim_end().ends_with(ending)) {
        return format!("{message}: free some space or choose another folder");
    }
    message
}

#[cfg(test)]
mod tests {
    use std::io;

    use anyhow::{Context, anyhow};

    use super::*;

    #[test]
    fn a_full_disk_has_a_remedy_and_other_errors_stay() {
        for (code, remedy) in [(28, ": free some space or choose another folder"), (13, "")] {
            let error = io::Error::from_raw_os_error(code);
            let expected = format!("cannot write a.c3d: {error}{remedy}");
            let error = Err::<(), _>(error).context("cannot write a.c3d").unwrap_err();
            assert_eq!(failure_message(&error), expected);
        }
        let with_remedy = anyhow!("no space for a file (os error 28): set TMPDIR");
        assert_eq!(failure_message(&with_remedy), with_remedy.to_string());
    }
}
