//! Arbitrary bytes as a configuration.

use mocapd_service::config::{Config, Environment, Overrides, PROBLEMS_MAX};

/// Parses a configuration: gives a bounded number of errors, one short line each, or a configuration that survives
/// being written and read again without changes.
pub fn config(bytes: &[u8]) {
    let surroundings = Environment { file_stem: Some("left".to_owned()), ..Environment::default() };
    let parse = |bytes: &[u8]| Config::parse("x", bytes, &surroundings, &Overrides::default());
    match parse(bytes) {
        Ok(config) => {
            let written = config.to_toml();
            let again = parse(written.as_bytes()).expect("what we write can be meant");
            assert_eq!(config, again, "{written}");
            assert!(config.changes(&again).is_empty(), "{written}");
            assert!(config.notes().iter().all(|note| !note.contains('\n')));
        }
        Err(error) => {
            let lines = error.lines();
            assert!((1..=PROBLEMS_MAX + 1).contains(&lines.len()), "{lines:?}");
            for line in lines {
                assert!(line.len() < 2000 && !line.contains(char::is_control), "{line:?}");
            }
        }
    }
}
