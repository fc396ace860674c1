//! What is refused, with its place and what to write.

use super::*;

fn lines(text: &str) -> Vec<String> {
    match parse(text) {
        Ok(config) => panic!("{text} is {config:?}"),
        Err(error) => error.lines(),
    }
}

/// The one thing that is wrong with `text`.
#[track_caller]
fn refused(text: &str, place: &str, words: &str) {
    let lines = lines(text);
    assert_eq!(lines.len(), 1, "{lines:#?}");
    let behind = lines[0].strip_prefix(&format!("left.toml {place}"));
    assert!(behind.is_some_and(|rest| rest.starts_with([':', ','])), "{place}: {}", lines[0]);
    assert!(lines[0].contains(words), "'{words}' is not in: {}", lines[0]);
    assert!(lines[0].chars().count() < 600 && !lines[0].contains(char::is_control), "{lines:?}");
}

#[test]
fn unknown_keys_tell_the_nearest_one() {
    refused(
        "[arm]\n pre_rol = '10s'",
        "line 2, column 2",
        "unknown key 'pre_rol' in [arm]: did you mean 'pre_roll'?",
    );
    refused("[arm]\nPreRoll = '10s'", "line 2, column 1", "did you mean 'pre_roll'?");
    refused(
        "[log]\ncolour = 1",
        "line 2, column 1",
        "unknown key 'colour' in [log]: there are level",
    );
    refused(
        "[arm]\ntolerance = '1mm'",
        "line 2, column 1",
        "'tolerance' is no key of [arm]: it stands in [take]",
    );
    refused("tolerance = '1mm'", "line 1, column 1", "put it under [take]");
    refused(
        "[devices]\nuri = 'auto'",
        "line 1, column 2",
        "unknown section [devices]: did you mean 'device'?",
    );
    refused(
        "[studio]",
        "line 1, column 2",
        "there are rig, device, take, subject, arm, http, trigger, log",
    );
    refused(
        "device = 'auto'",
        "line 1, column 1",
        "device is \"auto\": write [device] above its keys",
    );
    refused("[[device]]\nuri = 'auto'", "line 1", "device is a list: write [device]");
    // Another program's key, as long as a file: it is shown, but not all of it.
    refused(&format!("[arm]\n'{}' = 1", "x".repeat(100_000)), "line 2, column 1", "xxx...'");
    refused("[arm]\n\"a\\nb\\u001b\" = 1", "line 2, column 1", "a\\nb\\u{1b}");
}

#[test]
fn wrong_types_and_units_say_what_was_found_and_what_to_write() {
    let pre_roll = "write a time with its unit in quotes (ms, s, min, h), 0s to 10min, such as pre_roll = \"10s\"";
    refused(
        "[arm]\npre_roll = 10",
        "line 2, column 12",
        &format!("arm.pre_roll is the number 10: {pre_roll}"),
    );
    refused(
        "[arm]\npre_roll = '10'",
        "line 2, column 12",
        &format!("is \"10\": its unit is missing; {pre_roll}"),
    );
    refused("[arm]\npre_roll = '10 mm'", "line 2, column 12", "'mm' is no unit of time");
    refused("[arm]\npre_roll = '11min'", "line 2, column 12", &format!("is \"11min\": {pre_roll}"));
    refused("[arm]\npre_roll = true", "line 2, column 12", "is true: write a time");
    refused("[arm]\npre_roll = 07:32:00", "line 2, column 12", "a date or time of day");
    refused("[arm]\npre_roll = ['10s']", "line 2, column 12", "is a list");
    refused("[arm]\npre_roll = { s = 10 }", "line 2, column 12", "is a table");
    refused(
        "[arm]\nat_start = 1",
        "line 2, column 12",
        "is the number 1: write true or false, such as at_start = true",
    );
    refused("[arm]\nmemory_max = '0B'", "line 2", "1MiB to 64GiB");
    refused("[arm]\nmemory_max = '1 floppy'", "line 2", "no unit of size");
    refused("[take]\nstretch = '49ms'", "line 2", "50ms to 10s");
    refused("[take]\ntolerance = '0mm'", "line 2", "use lossless = true");
    refused("[take]\ntolerance = '1s'", "line 2", "no unit of length");
    refused("[take]\nmax_length = '0s'", "line 2", "1s to 744h, such as max_length = \"1h\"");
    refused("[take]\nresampler = 'spline'", "line 2", "export and import with it");
    refused("[take]\nresampler = 'dens'", "line 2", "did you mean 'dense'?");
    refused("[take]\nname = '{dat}'", "line 2", "did you mean 'date'?");
    refused("[take]\nname = '../{date}'", "line 2", "begin with a dot");
    refused("[take]\ndirectory = ''", "line 2", "write a folder");
    refused("[take]\ndirectory = '~/takes'", "line 2", "write the whole path");
    refused("[device]\nrate_hz = 0", "line 2", "1 to 10000, such as rate_hz = 240");
    refused("[device]\nrate_hz = nan", "line 2", "1 to 10000");
    refused("[device]\nuri = '/dev/ttyUSB0'", "line 2", "serial:/dev/ttyUSB0");
    refused("[rig]\nname = 'a/b'", "line 2", "letters, digits");
    refused("[log]\nlevel = 'warning'", "line 2", "did you mean 'warn'?");
    refused("[http]\nconnections_max = 0", "line 2", "1 to 256");
    // More could use up the descriptors that takes need.
    refused("[http]\nconnections_max = 257", "line 2", "1 to 256");
    refused("[http]\nconnections_max = 1.0", "line 2", "a whole number");
    refused("[http]\nconnections_max = 99999999999999999999", "line 2", "");
    refused("[http]\nlisten = 'localhost:7060'", "line 2", "write 127.0.0.1:7060 or [::1]:7060");
    refused(
        "[http]\nlisten = 'rig.lab:7060'",
        "line 2",
        "names are not looked up: write the address of rig.lab",
    );
    refused("[http]\nlisten = '127.0.0.1'", "line 2", "its port is missing");
    refused("[http]\nlisten = '::1:7060'", "line 2", "in brackets");
    refused(&format!("[http]\nsocket = '/{}'", "x".repeat(107)), "line 2", "more than 107 bytes");
    refused("[http]\ntoken_file = ''", "line 2", "write the path of a file");
    refused("[http]\nallowed_hosts = 'rig'", "line 2", "is \"rig\": write a list of at most 32");
    refused("[http]\nallowed_hosts = ['http://rig']", "line 2, column 18", "no host's name");
    refused(
        "[http]\nallowed_hosts = ['rig', 1]",
        "line 2, column 25",
        "has the number 1: write a list",
    );
    refused(
        "[trigger]\nsend_to = ['10.0.0.1:1', '10.0.0.1:1']",
        "line 2, column 26",
        "twice: take one out",
    );
    refused("[trigger]\nsend_to = ['10.0.0.1:0']", "line 2", "port is 0");
    refused("[trigger]\nsend_to = ['0.0.0.0:1']", "line 2", "nobody's address");
    refused("[trigger]\nallow_from = ['10.0.0.7/8']", "line 2", "write 10.0.0.0/8");
    let many = format!("[trigger]\nallow_from = [{}]", "'::1',".repeat(33));
    refused(&many, "line 2", "it has 33 items");
}

#[test]
fn what_goes_not_together_is_told_where_it_stands() {
    refused(
        "[take]\nlossless = true\ntolerance = '1mm'",
        "line 3, column 13",
        "take one of them out",
    );
    refused("[take]\nresampler = 'lossless'\ntolerance = '1mm'", "line 3", "take one of them out");
    refused("[take]\nresampler = 'fast'\nlossless = true", "line 3", "say different things");
    refused("[take]\nresampler = 'lossless'\nlossless = false", "line 3", "say different things");
    refused(
        "[arm]\ninclude_pre_roll = '11s'",
        "line 2",
        "include_pre_roll is 11s and only 10s are kept",
    );
    refused(
        "[http]\nlisten = '0.0.0.0:7060'",
        "line 2",
        "give http.token_file too, or listen on 127.0.0.1:7060",
    );
    refused("[http]\nlisten = '[::]:7060'", "line 2", "http.token_file");
    for fine in ["127.8.0.1:1", "[::1]:1", "[::ffff:127.0.0.1]:1"] {
        parse(&format!("[http]\nlisten = '{fine}'")).unwrap();
    }
}

#[test]
fn broken_toml_says_where_and_nothing_that_follows_from_it() {
    refused("[arm]\npre_roll = 10s\nat_strt = 1", "line 2", "stand in quotes, such as \"10s\"");
    refused("[take]\ndirectory = /srv\n", "line 2", "stand in quotes");
    refused("[arm]\npre_roll = '1s'\npre_roll = '2s'", "line 3, column 1", "duplicate key");
    refused("[arm\n", "line 1", "");
    let lines = lines("[arm]\na = \nb = = 2\n");
    assert!(lines.len() >= 2, "{lines:#?}");
}

#[test]
fn what_is_no_text_or_too_long_is_refused() {
    let refused = |bytes: &[u8]| {
        let parsed = Config::parse("x", bytes, &nowhere(), &Overrides::default());
        parsed.unwrap_err().to_string()
    };
    assert_eq!(
        refused(
            "[arm]\n# ä \u{e9}\n"
                .as_bytes()
                .iter()
                .copied()
                .chain([0xff])
                .collect::<Vec<_>>()
                .as_slice()
        ),
        "x line 3, column 1: here is a byte that is no UTF-8: save the file as UTF-8"
    );
    let long = vec![b'#'; CONFIG_BYTES_MAX + 1];
    assert!(refused(&long).contains("at most 1 MiB"));
    assert!(parse(str::from_utf8(&long[1..]).unwrap()).is_ok());
    // Deep nesting is refused, and does not end the process.
    assert!(parse(&format!("[arm]\npre_roll = {}", "[".repeat(100_000))).is_err());
    assert!(parse(&format!("{}x = 1", "a.".repeat(100_000))).is_err());
}

#[test]
fn all_that_is_wrong_is_told_at_once_up_to_a_bound() {
    let three =
        "[arm]\npre_roll = 10\nmemory_max = 'x'\n[log]\nlevel = 'loud'\n[http]\nlisten = ''";
    let lines = lines(three);
    let places: Vec<_> = lines.iter().map(|line| line.split(':').next().unwrap()).collect();
    assert_eq!(
        places,
        [
            "left.toml line 2, column 12",
            "left.toml line 3, column 14",
            "left.toml line 5, column 9"
        ]
    );
    let error = parse(three).unwrap_err().to_string();
    assert!(error.ends_with("; and 2 more: see `mocapd config check`"), "{error}");

    let many: String = (0..50).map(|n| format!("key{n} = 1\n")).collect();
    let error = parse(&format!("[arm]\n{many}")).unwrap_err();
    let ConfigError::Refused { problems, more, .. } = &error else { panic!("{error}") };
    assert_eq!((problems.len(), *more), (PROBLEMS_MAX, 30));
    assert_eq!(error.lines().last().unwrap(), "left.toml: and 30 more");
}

#[test]
fn a_file_name_that_is_no_rigs_asks_for_one() {
    let surroundings = Surroundings { file_stem: Some("my rig".to_owned()), ..nowhere() };
    let parse = |text: &str| {
        Config::parse("my rig.toml", text.as_bytes(), &surroundings, &Overrides::default())
    };
    let error = parse("").unwrap_err().to_string();
    assert!(error.contains("give rig.name") && error.contains("name = \"left\""), "{error}");
    assert_eq!(parse("[rig]\nname = 'mine'").unwrap().rig_name, "mine");
}

#[test]
fn a_file_that_is_not_there_says_how_to_write_one() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("left.toml");
    let error = Config::load(&file, &Overrides::default()).unwrap_err();
    assert!(matches!(error, ConfigError::NotFound(_)));
    let words = format!("`mocapd config example > {}`", file.display());
    assert!(error.to_string().contains(&words), "{error}");
    assert!(matches!(
        Config::load(dir.path(), &Overrides::default()),
        Err(ConfigError::Unreadable { .. })
    ));
    std::fs::write(&file, "[log]\nlevel = 'debug'\n").unwrap();
    let config = Config::load(&file, &Overrides::default()).unwrap();
    assert_eq!((config.log_level, config.rig_name.as_str()), (Level::Debug, "left"));
}
