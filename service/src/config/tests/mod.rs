mod auto_device;
mod documents;
mod messages;
mod sweep;

use super::*;

/// An environment without systemd.
pub(super) fn nowhere() -> Environment {
    Environment { file_stem: Some("left".to_owned()), ..Environment::default() }
}

pub(super) fn parse(text: &str) -> Result<Config, ConfigError> {
    Config::parse("left.toml", text.as_bytes(), &nowhere(), &Overrides::default())
}

/// Every key, none of them at its default.
pub(super) const EVERYTHING: &str = r#"
[rig]
name = "left-2.x"
[device]
uri = "usb:1209:0001:A:1?driver=dvmc"
rate_hz = 59.94
raw_log = true
[take]
directory = "/srv/täkes"
name = "S01 {count}"
tolerance = "100 um"
angle_tolerance = "0.02 deg"
residuals = true
up_axis = "y"
lossless = false
resampler = "fast"
stretch = "0.25s"
sync = "0s"
keep_free = "1.5GB"
reconnect = "5min"
max_length = "90min"
trash_keep = "48h"
[subject]
name = "S 01"
skeleton = "/srv/subjects/s01.json"
face = "faces/s01.json"
face_markers = "faces/markers.json"
[arm]
at_start = false
pre_roll = "1.25s"
include_pre_roll = "1250ms"
memory_max = "1MiB"
[archive]
url = "file:///srv/archive/left/"
rate_max = "1MB"
remove_local_after = "90min"
[http]
socket = ""
listen = "[::]:80"
token_file = "/etc/mocapd/token"
allowed_hosts = ["Rig.Lab", "10.0.0.1"]
connections_max = 1
[trigger]
listen = "0.0.0.0:8989"
send_to = ["192.168.10.255:8989", "[fe80::1]:30"]
allow_from = ["192.168.10.0/24", "::1"]
delay_max = "1s"
[publish.qtm]
enabled = true
listen = "[::]:22300"
allow_from = ["10.1.0.0/16"]
clients_max = 3
control = true
password_file = "/etc/mocapd/qtm-password"
[publish.natnet]
enabled = true
listen = "10.1.0.2:1610"
multicast = "239.255.42.98:1600"
data_port = 1600
bitstream = "3.1"
allow_from = ["10.1.0.0/16"]
clients_max = 4
[publish.lsl]
enabled = true
listen = "0.0.0.0"
allow_from = ["10.1.0.0/16"]
clients_max = 5
[publish.foxglove]
enabled = true
listen = "[::]:8766"
allow_from = ["10.2.0.0/16"]
origins = ["https://app.foxglove.dev", "http://10.2.0.1:8080"]
clients_max = 3
[log]
level = "trace"
"#;

#[test]
fn an_empty_file_is_the_defaults() {
    let config = parse("").unwrap();
    assert_eq!(config.rig_name, "left");
    assert_eq!(config.device.uri, DeviceChoice::Auto);
    assert_eq!(config.device.rate_hz, None);
    assert_eq!(config.take.directory, PathBuf::from("."));
    assert_eq!(config.take.codec.tolerance.mm(), 0.5);
    assert_eq!(config.take.angle_degrees, None);
    assert!(!config.take.residuals);
    assert_eq!(config.take.up_axis, UpAxis::Unknown);
    assert_eq!(config.take.codec.kind, mocapd_codec::ResamplerKind::Dense);
    assert_eq!(config.take.keep_free_bytes, 256 << 20);
    assert_eq!(config.take.max_length, None);
    assert_eq!(config.take.trash_keep, Duration::from_secs(30 * 86_400));
    assert_eq!(config.arm.pre_roll, Duration::from_secs(10));
    assert_eq!(config.arm.include_pre_roll, Duration::ZERO);
    assert!(config.arm.at_start && !config.device.raw_log);
    assert_eq!(config.http.socket, Some("/run/mocapd/mocapd.sock".into()));
    assert_eq!(config.http.listen, Some("127.0.0.1:7060".parse::<SocketAddr>().unwrap()));
    assert_eq!(config.trigger.listen, None);
    assert!(!config.publish_qtm.enabled && config.publish_qtm.listen.ip().is_loopback());
    assert!(!config.publish_natnet.enabled && config.publish_natnet.listen.ip().is_loopback());
    assert!(!config.publish_lsl.enabled && config.publish_lsl.listen.is_loopback());
    assert_eq!(config.log_level, Level::Info);
    assert_eq!(config.notes(), [""; 0]);
}

#[test]
fn every_key_is_read() {
    let config = parse(EVERYTHING).unwrap();
    assert_eq!(config.rig_name, "left-2.x");
    let DeviceChoice::At(uri) = &config.device.uri else { panic!("{config:?}") };
    assert_eq!(uri.to_string(), "usb:1209:0001:A:1?driver=dvmc");
    assert_eq!(config.device.rate_hz, Some(59.94));
    assert_eq!(config.take.name.to_string(), "S01 {count}");
    assert!((config.take.codec.tolerance.mm() - 0.1).abs() < 1e-12);
    assert_eq!(config.take.angle_degrees, Some(0.02));
    assert!(config.take.residuals);
    assert_eq!(config.take.up_axis, UpAxis::Y);
    assert_eq!(config.take.stretch, Duration::from_millis(250));
    assert_eq!(config.take.keep_free_bytes, 1_500_000_000);
    assert_eq!(config.take.max_length, Some(Duration::from_secs(5400)));
    assert_eq!(config.take.trash_keep, Duration::from_secs(48 * 3600));
    assert_eq!(config.arm.include_pre_roll, config.arm.pre_roll);
    assert_eq!(config.http.socket, None);
    assert_eq!(config.http.allowed_hosts, ["rig.lab", "10.0.0.1"]);
    assert_eq!(config.trigger.send_to.len(), 2);
    assert!(config.trigger.allow_from[0].contains("192.168.10.3".parse().unwrap()));
    assert!(config.publish_qtm.allow_from[0].contains("10.1.2.3".parse().unwrap()));
    assert_eq!((config.publish_qtm.clients_max, config.publish_qtm.control), (3, true));
    let natnet = &config.publish_natnet;
    assert_eq!(natnet.multicast, "239.255.42.98:1600".parse().ok());
    assert_eq!((natnet.bitstream.to_string().as_str(), natnet.data_port), ("3.1", 1600));
    assert!(config.publish_lsl.listen.is_unspecified() && config.publish_lsl.clients_max == 5);
    assert_eq!(config.publish_foxglove.origins[1], "http://10.2.0.1:8080");
    assert_eq!(config.log_level, Level::Trace);
    // Each differs from its default, so a key that is ignored shows.
    let changes = parse("").unwrap().changes(&config);
    let unchanged: Vec<_> = KEYS
        .iter()
        .map(|key| key.path)
        .filter(|path| changes.iter().all(|change| change.key != *path))
        .collect();
    assert_eq!(unchanged, ["take.lossless"], "it would contradict the tolerance");
    assert!(parse("[take]\nlossless = true").unwrap().take.codec.kind.is_lossless());
    assert!(parse("[take]\nresampler = 'lossless'").unwrap().take.codec.kind.is_lossless());
}

#[test]
fn a_written_configuration_is_parsed_to_the_same() {
    for text in ["", EVERYTHING, "[take]\nlossless = true", "[device]\nrate_hz = 240"] {
        let config = parse(text).unwrap();
        let again = parse(&config.to_toml()).unwrap();
        assert_eq!(config, again, "{}", config.to_toml());
        assert_eq!(config.changes(&again), []);
    }
}

#[test]
fn systemds_folders_are_the_defaults_and_the_file_comes_first() {
    let environment = Environment {
        state_directory: Some("/var/lib/mocapd".into()),
        runtime_directory: Some("/run/other".into()),
        file_stem: Some("mocapd".to_owned()),
    };
    let parse = |text: &str, overrides: &Overrides| {
        Config::parse("x", text.as_bytes(), &environment, overrides)
    };
    let config = parse("", &Overrides::default()).unwrap();
    assert_eq!(config.rig_name, "rig");
    assert_eq!(config.take.directory, PathBuf::from("/var/lib/mocapd"));
    assert_eq!(config.http.socket, Some("/run/other/mocapd.sock".into()));

    let text = "[device]\nuri = 'serial:/dev/a'\n[take]\ndirectory = '/srv'\n[http]\nlisten = ''";
    let config = parse(text, &Overrides::default()).unwrap();
    assert_eq!(config.take.directory, PathBuf::from("/srv"));
    assert_eq!(config.http.listen, None);
    let text_of = |text: &str| Some(text.to_owned());
    let overrides = Overrides {
        device: text_of("serial:/dev/b"),
        directory: text_of("/mnt"),
        listen: text_of("127.0.0.1:0"),
    };
    let config = parse(text, &overrides).unwrap();
    let DeviceChoice::At(uri) = &config.device.uri else { panic!("{config:?}") };
    assert_eq!(uri.to_string(), "serial:/dev/b");
    assert_eq!(config.take.directory, PathBuf::from("/mnt"));
    assert_eq!(config.http.listen, Some("127.0.0.1:0".parse().unwrap()));

    // Problems of the command line are reported with the option's name.
    let overrides = Overrides { listen: text_of("0.0.0.0:80"), ..Overrides::default() };
    let error = parse("", &overrides).unwrap_err();
    let ConfigError::Refused { problems, .. } = &error else { panic!("{error}") };
    let [
        ConfigProblem {
            place: SourceLocation::Option("--listen"),
            key: Some("http.listen"),
            message,
        },
    ] = &problems[..]
    else {
        panic!("{problems:?}");
    };
    assert!(message.contains("0.0.0.0:80"), "{message}");
    assert!(error.to_string().contains("--listen"), "{error}");
    let overrides = Overrides { device: text_of("ttyUSB0"), ..Overrides::default() };
    let error = parse("", &overrides).unwrap_err().to_string();
    assert!(error.contains("--device") && error.contains("serial:PATH"), "{error}");
}

#[test]
fn changes_have_their_reload_policy() {
    let old = parse("").unwrap();
    let new = parse(
        "[log]\nlevel='warn'\n[take]\nname='{time}'\n[arm]\npre_roll='20s'\n[http]\nlisten=''",
    )
    .unwrap();
    let changes = old.changes(&new);
    let found: Vec<_> = changes.iter().map(|change| (change.key, change.when)).collect();
    assert_eq!(
        found,
        [
            ("take.name", ReloadPolicy::NextTake),
            ("arm.pre_roll", ReloadPolicy::NextArm),
            ("http.listen", ReloadPolicy::Restart),
            ("log.level", ReloadPolicy::Now)
        ]
    );
    assert_eq!(changes[1].from, Some("10s".into()));
    assert_eq!(changes[1].to, Some("20s".into()));
    let lossless = old.changes(&parse("[take]\nlossless = true").unwrap());
    let keys: Vec<_> = lossless.iter().map(|change| change.key).collect();
    assert_eq!(keys, ["take.tolerance", "take.lossless", "take.resampler"]);
    assert_eq!(lossless[0].to, None);
}

#[test]
fn questionable_settings_are_noted() {
    let notes = |text: &str| parse(text).unwrap().notes();
    let about = |text: &str, keys: &[&str]| {
        let notes = notes(text);
        assert_eq!(notes.len(), 1, "{text}: {notes:?}");
        assert!(keys.iter().all(|key| notes[0].contains(key)), "{text}: {notes:?}");
    };
    about("[trigger]\nlisten = '0.0.0.0:8989'", &["trigger.allow_from", "0.0.0.0:8989"]);
    assert_eq!(notes("[trigger]\nlisten = '127.0.0.1:8989'"), [""; 0]);
    assert_eq!(notes("[trigger]\nlisten = '0.0.0.0:8989'\nallow_from = ['10.0.0.1']"), [""; 0]);
    about("[trigger]\nallow_from = ['10.0.0.1']", &["trigger.allow_from", "trigger.listen"]);
    about("[http]\nlisten = '0.0.0.0:1'\ntoken_file = 'x'", &["http.listen", "0.0.0.0:1"]);
    let publish = |keys: &str| format!("[publish.qtm]\nenabled = true\n{keys}");
    let outside = "listen = '0.0.0.0:22223'";
    about(&publish(outside), &["publish.qtm.allow_from", "0.0.0.0:22223"]);
    assert_eq!(notes(&publish(&format!("{outside}\nallow_from = ['10.0.0.1']"))), [""; 0]);
    about(&publish("allow_from = ['10.0.0.1']"), &["publish.qtm.allow_from", "127.0.0.1:22223"]);
    about(&publish("password_file = 'x'"), &["publish.qtm.password_file", "control"]);
    let natnet = |keys: &str| format!("[publish.natnet]\nenabled = true\n{keys}");
    about(&natnet("listen = '0.0.0.0:1510'"), &["publish.natnet.allow_from", "192.168.10.0/24"]);
    about(&natnet("allow_from = ['10.0.0.1']"), &["publish.natnet.allow_from", "0.0.0.0:1510"]);
    about(&natnet("listen = '[::1]:1510'\nallow_from = ['fd00::1']"), &["listen on [::]:1510 for"]);
    let group = "listen = '10.0.0.2:1510'\nallow_from = ['10.0.0.1']\nmulticast = '239.1.1.1:1511'";
    about(&natnet(group), &["every machine", "239.1.1.1:1511"]);
    let lsl = |keys: &str| format!("[publish.lsl]\nenabled = true\n{keys}");
    about(&lsl("listen = '10.0.0.2'"), &["publish.lsl.allow_from", "10.0.0.2"]);
    about(&lsl("allow_from = ['10.0.0.1']"), &["publish.lsl.allow_from", "0.0.0.0"]);
    assert_eq!(notes(&lsl("")), [""; 0]);
    let nobody = ["http.socket", "http.listen", "trigger.listen"];
    about("[http]\nlisten = ''\nsocket = ''", &nobody);
    about("[device]\nraw_log = true", &["device.raw_log"]);
}
