//! Messages about refused configurations: location, key, what was found, and what to write.

use std::collections::HashSet;

use super::*;

fn refusal(text: &str) -> ConfigError {
    match parse(text) {
        Ok(config) => panic!("{text} is {config:?}"),
        Err(error) => error,
    }
}

#[track_caller]
fn assert_mentions(message: &str, facts: &[&str]) {
    for fact in facts {
        assert!(message.contains(fact), "'{fact}' is not in: {message}");
    }
}

/// The message about the only problem of `text`, at this line and column (0 for any), of this key (empty if it is not
/// about a known key).
#[track_caller]
fn refused(text: &str, at: (usize, usize), key: &str, facts: &[&str]) -> String {
    let error = refusal(text);
    let ConfigError::Refused { problems, more: 0, .. } = &error else { panic!("{error}") };
    let [ConfigProblem { place: SourceLocation::At { line, column }, key: found, message }] =
        &problems[..]
    else {
        panic!("{problems:#?}");
    };
    let (column_wanted, message) = (if at.1 == 0 { *column } else { at.1 }, message.clone());
    assert_eq!((*line, *column), (at.0, column_wanted), "{message}");
    assert_eq!(found.unwrap_or_default(), key, "{message}");
    assert_mentions(&message, facts);
    let lines = error.lines();
    let [shown] = &lines[..] else { panic!("{lines:?}") };
    let (line, column) = (line.to_string(), column.to_string());
    for part in ["left.toml", line.as_str(), column.as_str(), message.as_str()] {
        assert!(shown.contains(part), "{part} is not in: {shown}");
    }
    assert!(shown.chars().count() < 600 && !shown.contains(char::is_control), "{shown:?}");
    message
}

/// The message about a value of this key, without the advice that ends every such message; the facts precede it.
#[track_caller]
fn wrong(key: &str, value: &str, at: (usize, usize), facts: &[&str]) -> String {
    let key = KEYS.iter().find(|known| known.path == key).unwrap();
    let text = format!("[{}]\n{} = {value}", key.section(), key.name());
    let message = refused(&text, at, key.path, &[key.path]);
    let Some(before) = message.strip_suffix(&key.advice()) else { panic!("{message}") };
    assert_mentions(before, &[&[key.path], facts].concat());
    before.to_owned()
}

/// The messages differ in more than the values they quote.
#[track_caller]
fn differ(messages: &[(String, &str)]) {
    let reasons: HashSet<_> =
        messages.iter().map(|(message, value)| message.replace(value, "")).collect();
    assert_eq!(reasons.len(), messages.len(), "{messages:#?}");
}

#[test]
fn for_unknown_keys_the_nearest_one_is_suggested() {
    refused("[arm]\n pre_rol = '10s'", (2, 2), "", &["'pre_rol'", "[arm]", "'pre_roll'"]);
    refused("[arm]\nPreRoll = '10s'", (2, 1), "", &["'PreRoll'", "'pre_roll'"]);
    refused("[log]\ncolour = 1", (2, 1), "", &["'colour'", "[log]", "level"]);
    refused("[arm]\ntolerance = '1mm'", (2, 1), "", &["'tolerance'", "[arm]", "[take]"]);
    refused("tolerance = '1mm'", (1, 1), "", &["'tolerance'", "[take]"]);
    refused("[devices]\nuri = 'auto'", (1, 2), "", &["[devices]", "'device'"]);
    let all = "rig, device, take, subject, arm, archive, http, trigger, publish.qtm, publish.natnet, publish.lsl, log";
    let sections = "[publish.qtm], [publish.natnet], [publish.lsl]";
    refused("[publish.studio]", (1, 10), "", &["[publish.studio]", sections]);
    let natnet = |keys: &str| format!("[publish.natnet]\n{keys}");
    let group = natnet("multicast = '239.1.1.1:1511'\nlisten = '0.0.0.0:1510'");
    refused(
        &group,
        (2, 13),
        "publish.natnet.multicast",
        &["publish.natnet.listen", "192.168.10.2"],
    );
    let port = natnet("data_port = 1510");
    refused(&port, (2, 13), "publish.natnet.data_port", &["1510", "publish.natnet.listen"]);
    let bitstream = natnet("bitstream = '5.0'");
    refused(&bitstream, (2, 13), "publish.natnet.bitstream", &["2.10 to 4.2 are known"]);
    let group = natnet("multicast = '10.0.0.1:1511'");
    refused(&group, (2, 13), "publish.natnet.multicast", &["224 to 239"]);
    refused("[publish.qtm]\nclient_max = 1", (2, 1), "", &["[publish.qtm]", "'clients_max'"]);
    refused("publish = 1", (1, 1), "", &["publish", "publish.qtm"]);
    let no_password = "[publish.qtm]\ncontrol = true";
    refused(no_password, (2, 11), "publish.qtm.control", &["publish.qtm.password_file"]);
    refused("[studio]", (1, 2), "", &["[studio]", all]);
    refused("device = 'auto'", (1, 1), "", &["\"auto\"", "[device]"]);
    refused("[[device]]\nuri = 'auto'", (1, 0), "", &["[device]"]);
    // A key as long as a file: only an excerpt is quoted.
    refused(&format!("[arm]\n'{}' = 1", "x".repeat(60_000)), (2, 1), "", &["xxx...'"]);
    refused("[arm]\n\"a\\nb\\u001b\" = 1", (2, 1), "", &["a\\nb\\u{1b}"]);
}

#[test]
fn wrong_types_and_units_say_what_was_found_and_what_to_write() {
    let pre_roll = KEYS.iter().find(|key| key.path == "arm.pre_roll").unwrap().advice();
    for fact in ["ms, s, min, h", "0s", "10min", "pre_roll = \"10s\""] {
        assert!(pre_roll.contains(fact), "{pre_roll}");
    }
    let of = |value, facts: &[&str]| wrong("arm.pre_roll", value, (2, 12), facts);
    differ(&[
        (of("10", &["10"]), "10"),
        (of("'10'", &["\"10\""]), "10"),
        (of("'10 mm'", &["\"10 mm\"", "'mm'"]), "10 mm"),
        (of("'11min'", &["\"11min\""]), "11min"),
        (of("true", &["true"]), "true"),
        (of("07:32:00", &[]), "07:32:00"),
        (of("['10s']", &[]), "10s"),
        (of("{ s = 10 }", &[]), "10"),
    ]);
    wrong("arm.at_start", "1", (2, 12), &["1"]);
    let size = wrong("arm.memory_max", "'0B'", (2, 0), &["\"0B\""]);
    let unit = wrong("arm.memory_max", "'1 floppy'", (2, 0), &["\"1 floppy\"", "floppy"]);
    differ(&[(size, "0B"), (unit, "1 floppy")]);
    wrong("take.stretch", "'49ms'", (2, 0), &["\"49ms\""]);
    wrong("take.tolerance", "'0mm'", (2, 0), &["\"0mm\"", "lossless = true"]);
    wrong("take.tolerance", "'1s'", (2, 0), &["\"1s\"", "'s'"]);
    let range = ["0.0001", "10 degrees"];
    wrong("take.angle_tolerance", "'11deg'", (2, 0), &["'11deg'", range[0], range[1]]);
    wrong("take.max_length", "'0s'", (2, 0), &["\"0s\""]);
    wrong("take.trash_keep", "'0s'", (2, 0), &["\"0s\""]);
    let offline = wrong("take.resampler", "'spline'", (2, 0), &["\"spline\""]);
    let unknown = wrong("take.resampler", "'dens'", (2, 0), &["\"dens\"", "'dense'"]);
    differ(&[(offline, "spline"), (unknown, "dens")]);
    wrong("take.name", "'{dat}'", (2, 0), &["{dat}", "'date'"]);
    wrong("take.name", "'../{date}'", (2, 0), &["\"../{date}\""]);
    let empty = wrong("take.directory", "''", (2, 0), &["\"\""]);
    let home = wrong("take.directory", "'~/takes'", (2, 0), &["\"~/takes\""]);
    differ(&[(empty, "\"\""), (home, "\"~/takes\"")]);
    let zero = wrong("device.rate_hz", "0", (2, 0), &["0 Hz"]);
    let nan = wrong("device.rate_hz", "nan", (2, 0), &["NaN"]);
    differ(&[(zero, "0"), (nan, "NaN")]);
    wrong("device.uri", "'/dev/ttyUSB0'", (2, 0), &["serial:/dev/ttyUSB0"]);
    wrong("rig.name", "'a/b'", (2, 0), &["\"a/b\""]);
    let secret =
        wrong("archive.url", "'https://me:secret@host/x'", (2, 0), &["https://***@host/x"]);
    assert!(!secret.contains("secret"), "{secret}");
    wrong("log.level", "'warning'", (2, 0), &["\"warning\"", "'warn'"]);
    // More could use up the file descriptors that takes need.
    let of = |value, facts: &[&str]| wrong("http.connections_max", value, (2, 0), facts);
    of("0", &["0"]);
    differ(&[
        (of("257", &["257"]), "257"),
        (of("1.0", &["1.0"]), "1.0"),
        (of("99999999999999999999", &["digits"]), ""),
    ]);
}

#[test]
fn wrong_addresses_and_paths_say_what_to_write() {
    let listen = |value: &str, facts: &[&str]| {
        let quoted = format!("'{value}'");
        wrong("http.listen", &quoted, (2, 0), &[&[value], facts].concat())
    };
    differ(&[
        (listen("localhost:7060", &["127.0.0.1:7060", "[::1]:7060"]), "localhost:7060"),
        (listen("rig.lab:7060", &["rig.lab"]), "rig.lab:7060"),
        (listen("127.0.0.1", &[]), "127.0.0.1"),
        (listen("::1:7060", &[]), "::1:7060"),
    ]);
    wrong("http.socket", &format!("'/{}'", "x".repeat(107)), (2, 0), &["107"]);
    wrong("http.token_file", "''", (2, 0), &["\"\""]);
    wrong("http.allowed_hosts", "'rig'", (2, 0), &["\"rig\""]);
    wrong("http.allowed_hosts", "['http://rig']", (2, 18), &["\"http://rig\""]);
    wrong("http.allowed_hosts", "['rig', 1]", (2, 25), &["1"]);
    let text = "[trigger]\nsend_to = ['10.0.0.1:1', '10.0.0.1:1']";
    refused(text, (2, 26), "trigger.send_to", &["\"10.0.0.1:1\""]);
    let port = wrong("trigger.send_to", "['10.0.0.1:0']", (2, 0), &["\"10.0.0.1:0\""]);
    let no_receiver = wrong("trigger.send_to", "['0.0.0.0:1']", (2, 0), &["\"0.0.0.0:1\""]);
    differ(&[(port, "10.0.0.1:0"), (no_receiver, "0.0.0.0:1")]);
    wrong("trigger.allow_from", "['10.0.0.7/8']", (2, 0), &["\"10.0.0.7/8\"", "10.0.0.0/8"]);
    wrong("trigger.allow_from", &format!("[{}]", "'::1',".repeat(33)), (2, 0), &["33"]);
}

#[test]
fn contradictions_are_reported_where_they_are() {
    let with_tolerance = refused(
        "[take]\nlossless = true\ntolerance = '1mm'",
        (3, 13),
        "take.tolerance",
        &["lossless", "tolerance"],
    );
    let text = "[take]\nresampler = 'lossless'\ntolerance = '1mm'";
    assert_eq!(refused(text, (3, 0), "take.tolerance", &[]), with_tolerance);
    let text = "[take]\nlossless = true\nangle_tolerance = '1deg'";
    refused(text, (3, 0), "take.angle_tolerance", &["lossless", "angle_tolerance"]);
    for (resampler, lossless) in [("fast", "true"), ("lossless", "false")] {
        let text = format!("[take]\nresampler = '{resampler}'\nlossless = {lossless}");
        let both = [format!("lossless = {lossless}"), format!("resampler = \"{resampler}\"")];
        refused(&text, (3, 0), "take.lossless", &[&both[0], &both[1]]);
    }
    refused(
        "[arm]\ninclude_pre_roll = '11s'",
        (2, 0),
        "arm.include_pre_roll",
        &["11s", "10s", "pre_roll"],
    );
    let facts = ["0.0.0.0:7060", "http.token_file", "127.0.0.1:7060"];
    refused("[http]\nlisten = '0.0.0.0:7060'", (2, 0), "http.listen", &facts);
    refused("[http]\nlisten = '[::]:7060'", (2, 0), "http.listen", &["http.token_file"]);
    for fine in ["127.8.0.1:1", "[::1]:1", "[::ffff:127.0.0.1]:1"] {
        parse(&format!("[http]\nlisten = '{fine}'")).unwrap();
    }
}

#[test]
fn syntax_errors_are_located_and_reported_alone() {
    refused("[arm]\npre_roll = 10s\nat_strt = 1", (2, 0), "", &["\"10s\""]);
    refused("[take]\ndirectory = /srv\n", (2, 0), "", &["\"10s\""]);
    let twice = refused("[arm]\npre_roll = '1s'\npre_roll = '2s'", (3, 1), "", &[]);
    assert!(!twice.contains("\"10s\""), "its quotes are there: {twice}");
    refused("[arm\n", (1, 0), "", &[]);
    let lines = refusal("[arm]\na = \nb = = 2\n").lines();
    assert!(lines.len() >= 2, "{lines:#?}");
}

#[test]
fn invalid_utf_8_and_files_that_are_too_long_are_refused() {
    let refused = |bytes: &[u8]| {
        let error = Config::parse("x", bytes, &nowhere(), &Overrides::default()).unwrap_err();
        match error {
            ConfigError::Refused { mut problems, more: 0, .. } if problems.len() == 1 => {
                problems.remove(0)
            }
            other => panic!("{other}"),
        }
    };
    let latin = [&b"[arm]\n# \xc3\xa4 \xc3\xa9\n"[..], &[0xff]].concat();
    let ConfigProblem { place, message, .. } = refused(&latin);
    assert_eq!(place, SourceLocation::At { line: 3, column: 1 });
    assert!(message.contains("UTF-8"), "{message}");
    let long = vec![b'#'; CONFIG_BYTES_MAX + 1];
    let ConfigProblem { place, message, .. } = refused(&long);
    assert!(place == SourceLocation::Nowhere && message.contains("64 KiB"), "{message}");
    assert!(parse(str::from_utf8(&long[1..]).unwrap()).is_ok());
    // Deep nesting is refused, and does not end the process.
    assert!(parse(&format!("[arm]\npre_roll = {}", "[".repeat(100_000))).is_err());
    assert!(parse(&format!("{}x = 1", "a.".repeat(100_000))).is_err());
}

#[test]
fn all_problems_are_reported_at_once_up_to_a_limit() {
    let three =
        "[arm]\npre_roll = 10\nmemory_max = 'x'\n[log]\nlevel = 'loud'\n[http]\nlisten = ''";
    let error = refusal(three);
    let ConfigError::Refused { problems, more: 0, .. } = &error else { panic!("{error}") };
    let places: Vec<_> = problems.iter().map(|problem| problem.place).collect();
    let at = |line, column| SourceLocation::At { line, column };
    assert_eq!(places, [at(2, 12), at(3, 14), at(5, 9)]);
    assert_eq!(error.lines().len(), 3);
    // The one-line form has the first problem, the number of the others, and the command that lists them.
    let message = error.to_string();
    let behind = message.strip_prefix(&error.lines()[0]).unwrap();
    assert!(behind.contains('2') && behind.contains("`mocapd config check`"), "{message}");

    let many: String = (0..50).map(|n| format!("key{n} = 1\n")).collect();
    let error = refusal(&format!("[arm]\n{many}"));
    let ConfigError::Refused { problems, more, .. } = &error else { panic!("{error}") };
    assert_eq!((problems.len(), *more), (PROBLEMS_MAX, 30));
    let lines = error.lines();
    assert_eq!(lines.len(), PROBLEMS_MAX + 1);
    assert!(lines[PROBLEMS_MAX].contains("left.toml") && lines[PROBLEMS_MAX].contains("30"));
}

#[test]
fn a_file_name_that_is_not_a_rig_name_is_explained() {
    let environment = Environment { file_stem: Some("my rig".to_owned()), ..nowhere() };
    let parse = |text: &str| {
        Config::parse("my rig.toml", text.as_bytes(), &environment, &Overrides::default())
    };
    let error = parse("").unwrap_err();
    let ConfigError::Refused { problems, .. } = &error else { panic!("{error}") };
    assert_eq!((problems[0].place, problems[0].key), (SourceLocation::Nowhere, Some("rig.name")));
    let message = error.to_string();
    assert!(message.contains("my rig.toml") && message.contains("name = \"left\""), "{message}");
    assert_eq!(parse("[rig]\nname = 'mine'").unwrap().rig_name, "mine");
}

#[test]
fn a_missing_file_explains_how_to_write_one() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("left.toml");
    let error = Config::load(&file, &Overrides::default()).unwrap_err();
    assert!(matches!(error, ConfigError::NotFound(_)));
    let command = format!("`mocapd config example > {}`", file.display());
    assert!(error.to_string().contains(&command), "{error}");
    assert!(matches!(
        Config::load(dir.path(), &Overrides::default()),
        Err(ConfigError::Unreadable { .. })
    ));
    std::fs::write(&file, "[log]\nlevel = 'debug'\n").unwrap();
    let config = Config::load(&file, &Overrides::default()).unwrap();
    assert_eq!((config.log_level, config.rig_name.as_str()), (Level::Debug, "left"));
}
