//! From what is written to what is meant: each key alone, then those that depend on each other.

use std::{net::IpAddr, path::PathBuf};

use mocapd_codec::{ResamplerKind, Settings, Tolerance};

use super::{
    ArmConfig, Config, DeviceChoice, DeviceConfig, HttpConfig, NameTemplate, Network, Surroundings,
    TakeConfig, TriggerConfig,
    keys::*,
    reader::{self, Reader},
    written::suggestion,
};
use crate::{
    log::Level,
    subject::{NAME_BYTES_MAX, SubjectFiles},
};

/// Bytes of a Unix socket's path, without the 0 behind it: `sun_path` has 108 on Linux.
const SOCKET_BYTES_MAX: usize = 107;

/// Bytes of a rig's name: it is a part of each take's.
const RIG_NAME_BYTES_MAX: usize = 64;

/// As they are written, for who wrote another word.
const LEVELS: [&str; 5] = ["error", "warn", "info", "debug", "trace"];

/// A configuration; it holds only when `reader` has no problems afterwards: what may be left out is left out then.
pub(super) fn check(reader: &mut Reader, surroundings: &Surroundings) -> Option<Config> {
    let rig_name = rig_name(reader, surroundings);
    let device = device(reader);
    let take = take(reader, surroundings);
    let subject = subject(reader);
    let arm = arm(reader);
    let http = http(reader, surroundings);
    let trigger = trigger(reader);
    let log_level = reader.text(&LOG_LEVEL, |text| {
        text.parse::<Level>().map_err(|_| suggestion(text, LEVELS.into_iter()))
    });
    Some(Config {
        rig_name: rig_name?,
        device: device?,
        take: take?,
        subject,
        arm: arm?,
        http: http?,
        trigger: trigger?,
        log_level: log_level?,
    })
}

/// Whether a name can be a part of each take's name, and of a path.
pub(super) fn is_rig_name(name: &str) -> bool {
    let is_part = |c: char| c.is_alphanumeric() || "-_.".contains(c);
    (1..=RIG_NAME_BYTES_MAX).contains(&name.len())
        && name.starts_with(char::is_alphanumeric)
        && name.chars().all(is_part)
}

fn rig_name(reader: &mut Reader, surroundings: &Surroundings) -> Option<String> {
    if reader.is_given(&RIG_NAME) {
        let read = |text: &str| if is_rig_name(text) { Ok(text.to_owned()) } else { Err(None) };
        return reader.text(&RIG_NAME, read);
    }
    match surroundings.file_stem.as_deref() {
        None | Some("mocapd") => Some("rig".to_owned()),
        Some(stem) if is_rig_name(stem) => Some(stem.to_owned()),
        Some(stem) => {
            let stem = super::value::short(stem);
            let advice = RIG_NAME.advice();
            let message = format!(
                "the file's name, {stem}, can be no rig's: give rig.name in the file; {advice}"
            );
            reader.refuse(&RIG_NAME, message);
            None
        }
    }
}

fn device(reader: &mut Reader) -> Option<DeviceConfig> {
    let uri = reader.text(&DEVICE_URI, |text| match text {
        "auto" => Ok(DeviceChoice::Auto),
        _ if text.contains(char::is_control) => Err(None),
        _ => text.parse().map(DeviceChoice::At).map_err(|why| Some(format!("{why}"))),
    });
    let rate_hz = reader.rate_hz(&DEVICE_RATE_HZ);
    let raw_log = reader.flag(&DEVICE_RAW_LOG);
    Some(DeviceConfig { uri: uri?, rate_hz, raw_log: raw_log? })
}

fn take(reader: &mut Reader, surroundings: &Surroundings) -> Option<TakeConfig> {
    let directory = if reader.is_given(&TAKE_DIRECTORY) {
        reader.path(&TAKE_DIRECTORY)
    } else {
        Some(surroundings.state_directory.clone().unwrap_or_else(|| PathBuf::from(".")))
    };
    let name = reader.text(&TAKE_NAME, |text| NameTemplate::parse(text).map_err(Some));
    let codec = codec(reader);
    let stretch = reader.time(&TAKE_STRETCH);
    let sync = reader.time(&TAKE_SYNC);
    let keep_free_bytes = reader.size_bytes(&TAKE_KEEP_FREE);
    let reconnect = reader.time(&TAKE_RECONNECT);
    let max_length = reader.time(&TAKE_MAX_LENGTH);
    Some(TakeConfig {
        directory: directory?,
        name: name?,
        codec: codec?,
        stretch: stretch?,
        sync: sync?,
        keep_free_bytes: keep_free_bytes?,
        reconnect: reconnect?,
        max_length,
    })
}

/// Its files are read when takes may need them.
fn subject(reader: &mut Reader) -> SubjectFiles {
    let name = reader.text(&SUBJECT_NAME, |text| {
        let is_name =
            (1..=NAME_BYTES_MAX).contains(&text.len()) && !text.contains(char::is_control);
        if is_name { Ok(text.to_owned()) } else { Err(None) }
    });
    let skeleton = reader.path(&SUBJECT_SKELETON);
    let face = reader.path(&SUBJECT_FACE);
    SubjectFiles { name, skeleton, face, face_markers: reader.path(&SUBJECT_FACE_MARKERS) }
}

fn codec(reader: &mut Reader) -> Option<Settings> {
    let tolerance = reader.tolerance(&TAKE_TOLERANCE);
    let is_lossless = reader.flag(&TAKE_LOSSLESS);
    let kind = reader.text(&TAKE_RESAMPLER, |text| {
        let live = ["dense", "fast", "lossless"].into_iter();
        match text.parse::<ResamplerKind>() {
            Ok(kind) if kind.is_live() => Ok(kind),
            Ok(_) => Err(Some(
                "it works on whole takes: record with dense, fast or lossless, then export and import with it"
                    .to_owned(),
            )),
            Err(_) => Err(suggestion(text, live)),
        }
    });
    let (tolerance, is_lossless, kind) = (tolerance?, is_lossless?, kind?);
    let (lossless_given, kind_given) =
        (reader.is_given(&TAKE_LOSSLESS), reader.is_given(&TAKE_RESAMPLER));
    if lossless_given && kind_given && is_lossless != kind.is_lossless() {
        let message = format!(
            "lossless = {is_lossless} and resampler = \"{kind}\" say different things: take one out"
        );
        reader.refuse(&TAKE_LOSSLESS, message);
        return None;
    }
    if !(is_lossless || kind.is_lossless()) {
        return Some(Settings { kind, tolerance });
    }
    if reader.is_given(&TAKE_TOLERANCE) {
        let message =
            "a take that is lossless keeps every bit and has no tolerance: take one of them out";
        reader.refuse(&TAKE_TOLERANCE, message.to_owned());
        return None;
    }
    // It is ignored; the smallest there is, so that a mistake would cost bytes and no precision.
    let tolerance = Tolerance::from_mm(Tolerance::MIN_MM).unwrap_or(tolerance);
    Some(Settings { kind: ResamplerKind::Lossless, tolerance })
}

fn arm(reader: &mut Reader) -> Option<ArmConfig> {
    let at_start = reader.flag(&ARM_AT_START);
    let pre_roll = reader.time(&ARM_PRE_ROLL);
    let include_pre_roll = reader.time(&ARM_INCLUDE_PRE_ROLL);
    let memory_max_bytes = reader.size_bytes(&ARM_MEMORY_MAX);
    if let (Some(kept), Some(included)) = (pre_roll, include_pre_roll)
        && included > kept
    {
        let text = super::render::duration_text;
        let message = format!(
            "include_pre_roll is {} and only {} are kept: raise pre_roll or lower it",
            text(included),
            text(kept)
        );
        // Where only one of them stands in the file, it is that one.
        let one = if reader.is_given(&ARM_INCLUDE_PRE_ROLL) {
            &ARM_INCLUDE_PRE_ROLL
        } else {
            &ARM_PRE_ROLL
        };
        reader.refuse(one, message);
        return None;
    }
    Some(ArmConfig {
        at_start: at_start?,
        pre_roll: pre_roll?,
        include_pre_roll: include_pre_roll?,
        memory_max_bytes: memory_max_bytes?,
    })
}

fn http(reader: &mut Reader, surroundings: &Surroundings) -> Option<HttpConfig> {
    let socket = if reader.is_given(&HTTP_SOCKET) {
        reader.path_or_none(&HTTP_SOCKET, SOCKET_BYTES_MAX)
    } else {
        socket_of(reader, surroundings)
    };
    let listen = reader.address(&HTTP_LISTEN);
    let token_file = reader.path(&HTTP_TOKEN_FILE);
    let allowed_hosts = reader.list(&HTTP_ALLOWED_HOSTS, host);
    let connections_max = reader.whole(&HTTP_CONNECTIONS_MAX).and_then(|n| usize::try_from(n).ok());
    if let Some(Some(listen)) = listen
        && !listen.ip().to_canonical().is_loopback()
        && !reader.is_given(&HTTP_TOKEN_FILE)
    {
        let message = format!(
            "http.listen is {listen}, which other machines reach: give http.token_file too, \
             or listen on 127.0.0.1:{}",
            listen.port()
        );
        reader.refuse(&HTTP_LISTEN, message);
        return None;
    }
    Some(HttpConfig {
        socket: socket?,
        listen: listen?,
        token_file,
        allowed_hosts: allowed_hosts?,
        connections_max: connections_max?,
    })
}

fn socket_of(reader: &mut Reader, surroundings: &Surroundings) -> Option<Option<PathBuf>> {
    let Some(folder) = &surroundings.runtime_directory else {
        return Some(Some(PathBuf::from("/run/mocapd/mocapd.sock")));
    };
    let socket = folder.join("mocapd.sock");
    if socket.as_os_str().len() <= SOCKET_BYTES_MAX {
        return Some(Some(socket));
    }
    let message = format!(
        "RUNTIME_DIRECTORY is {}, too long for a socket in it: {}",
        super::value::short(&folder.to_string_lossy()),
        HTTP_SOCKET.advice()
    );
    reader.refuse(&HTTP_SOCKET, message);
    None
}

/// A name as browsers send it in `Host`, in small letters, without its port.
fn host(text: &str) -> Result<String, String> {
    if let Ok(address) = text.parse::<IpAddr>() {
        return Ok(address.to_string());
    }
    let is_label = |label: &str| {
        (1..=63).contains(&label.len())
            && label
                .bytes()
                .all(|byte| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_')
    };
    if text.len() <= 253 && text.split('.').all(is_label) {
        return Ok(text.to_ascii_lowercase());
    }
    Err("it is no host's name".to_owned())
}

fn trigger(reader: &mut Reader) -> Option<TriggerConfig> {
    let listen = reader.address(&TRIGGER_LISTEN);
    let send_to = reader.list(&TRIGGER_SEND_TO, |text| match reader::address(text)? {
        address if address.port() == 0 => Err("its port is 0".to_owned()),
        address if address.ip().is_unspecified() => Err("it is nobody's address".to_owned()),
        address => Ok(address),
    });
    let allow_from = reader.list(&TRIGGER_ALLOW_FROM, str::parse::<Network>);
    let delay_max = reader.time(&TRIGGER_DELAY_MAX);
    Some(TriggerConfig {
        listen: listen?,
        send_to: send_to?,
        allow_from: allow_from?,
        delay_max: delay_max?,
    })
}
