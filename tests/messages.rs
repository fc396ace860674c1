//! The catalogue of messages: for each kind of error one example, whose text is one line that states its facts. The tests
//! are about form and facts, never about wording.

use std::io;

use mocapd_drivers::transport::TransportError;
use mocapd_take::{
    NotATake,
    damage::{LedgerTotals, Problem, Refusal},
};

/// One line that states the facts, without debug output and without a final full stop, since other messages precede and
/// follow it.
fn assert_is_message(text: &str, facts: &[&str]) {
    assert!(text.chars().count() >= 10, "'{text}' says too little");
    assert!(!text.contains(['\n', '\r', '\t', '{', '}']), "'{text}' is no line of text");
    assert!(!text.contains("Some(") && !text.contains("None"), "'{text}' is debug output");
    assert!(!text.ends_with(['.', ' ', ':']), "'{text}' has an open or a closed end");
    assert_eq!(text.trim(), text);
    for fact in facts {
        assert!(text.contains(fact), "'{text}' does not state {fact}");
    }
}

#[test]
fn every_problem_of_a_take_states_its_place() {
    let totals = |frames, samples| LedgerTotals { frames, samples };
    let problems: [(Problem, &[&str]); 16] = [
        (Problem::Magic, &[]),
        (Problem::HeaderByte(7101), &["7101"]),
        (
            Problem::Damaged { offset: 7101, len: 33, message: "a reason".to_owned() },
            &["7101", "33", "a reason"],
        ),
        (Problem::Repaired { offset: 7101 }, &["7101"]),
        (Problem::NamesLost { markers: 12 }, &["12"]),
        (Problem::MissingBefore { row: 7101 }, &["7101"]),
        (Problem::MissingFrom { row: 7101 }, &["7101"]),
        (Problem::Unplaced { n_rows: 33, from_row: 7101 }, &["33", "7101"]),
        (
            Problem::Refused { first_row: 100, n_rows: 11, refusal: Refusal::DependsOnLost },
            &["100", "110"],
        ),
        (Problem::IndexRow { stated: 100, found: 7101 }, &["100", "7101"]),
        (Problem::FooterRows { stated: 100, found: 7101 }, &["100", "7101"]),
        (
            Problem::LedgerCounts { stated: totals(100, 200), found: totals(101, 202) },
            &["100", "200", "101", "202"],
        ),
        (Problem::ForeignTooLong { kind: "c3d/analog".to_owned() }, &["c3d/analog"]),
        (Problem::More, &[]),
        (Problem::NoLedger, &["ledger"]),
        (Problem::CutOff, &[]),
    ];
    for (problem, facts) in &problems {
        assert_is_message(&problem.to_string(), facts);
    }
}

#[test]
fn every_reason_to_reject_a_file_has_a_message() {
    let reasons = [
        NotATake::Short,
        NotATake::OtherMagic,
        NotATake::SentAsText,
        NotATake::HeaderCut,
        NotATake::HeaderDamaged,
        NotATake::HeaderLost,
        NotATake::NoHeader,
        NotATake::Changed,
    ];
    for reason in reasons {
        assert_is_message(&reason.to_string(), &[]);
    }
}

#[test]
fn every_error_of_a_device_names_it_and_the_remedy() {
    let device = "/dev/ttyUSB7".to_owned();
    let holder = Some("motive (process 71)".to_owned());
    let remedy = "sudo usermod -aG dialout me".to_owned();
    let host = "lab:22223".to_owned();
    let errors: [(TransportError, &[&str]); 10] = [
        (TransportError::NotFound { device: device.clone() }, &["ttyUSB7", "mocapd devices"]),
        (TransportError::Busy { device: device.clone(), holder }, &["ttyUSB7", "process 71"]),
        (TransportError::Busy { device: device.clone(), holder: None }, &["ttyUSB7"]),
        (TransportError::PermissionDenied { device: device.clone(), remedy }, &["sudo usermod"]),
        (TransportError::Disconnected { device: device.clone() }, &["ttyUSB7"]),
        (TransportError::Refused("the rate is refused".to_owned()), &["refused"]),
        (
            TransportError::Unreachable {
                device: host.clone(),
                remedy: "check its name".to_owned(),
            },
            &["lab:22223", "check its name"],
        ),
        (
            TransportError::ConnectionLost { device: host, cause: "it was reset".to_owned() },
            &["lab:22223", "it was reset"],
        ),
        (TransportError::Stuck { device: device.clone() }, &["ttyUSB7"]),
        (
            TransportError::Io { device, action: "reading", source: io::Error::other("EIO") },
            &["ttyUSB7", "reading"],
        ),
    ];
    for (error, facts) in errors {
        assert_is_message(&error.to_string(), facts);
    }
}
