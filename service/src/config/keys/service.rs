//! Keys of the service: what it keeps, whom it answers, what it says.

use std::{net::SocketAddr, time::Duration};

use serde_json::{Value as Json, json};

use super::{Key, Preset, Takes, When};
use crate::{
    config::render::{duration, path, size},
    http::CONNECTIONS_MAX,
    trigger::DELAY_MAX,
};

const TEN_MINUTES: Duration = Duration::from_secs(600);

/// Of names and networks: more is a mistake, and each is compared with every caller.
const ITEMS_MAX: usize = 32;

/// Of machines that are told of starts and stops, one datagram each.
const SEND_TO_MAX: usize = 16;

fn address(address: Option<SocketAddr>) -> Option<Json> {
    Some(json!(address.map_or_else(String::new, |address| address.to_string())))
}

fn texts<T: ToString>(items: &[T]) -> Option<Json> {
    Some(json!(items.iter().map(ToString::to_string).collect::<Vec<_>>()))
}

/// `arm.at_start`.
pub static ARM_AT_START: Key = Key {
    path: "arm.at_start",
    takes: Takes::Flag,
    preset: Preset::Flag(true),
    what: "Whether the service opens the device and arms itself when it starts.",
    why: "A rig that is switched on is ready to be started; with `false` the device stays free for others.",
    when: When::Restart,
    written: |config| Some(json!(config.arm.at_start)),
};

/// `arm.pre_roll`.
pub static ARM_PRE_ROLL: Key = Key {
    path: "arm.pre_roll",
    takes: Takes::Time { min: Duration::ZERO, max: TEN_MINUTES },
    preset: Preset::Text("10s"),
    what: "How much of the past is kept while it is armed.",
    why: "What happened before anybody pressed start can still be saved.",
    when: When::NextArm,
    written: |config| duration(config.arm.pre_roll),
};

/// `arm.include_pre_roll`.
pub static ARM_INCLUDE_PRE_ROLL: Key = Key {
    path: "arm.include_pre_roll",
    takes: Takes::Time { min: Duration::ZERO, max: TEN_MINUTES },
    preset: Preset::Text("0s"),
    what: "How much of the past a plain start puts into its take; no more than `pre_roll`.",
    why: "A take begins when it was started, unless somebody wants it otherwise.",
    when: When::NextTake,
    written: |config| duration(config.arm.include_pre_roll),
};

/// `arm.memory_max`.
pub static ARM_MEMORY_MAX: Key = Key {
    path: "arm.memory_max",
    takes: Takes::Size { min: 1 << 20, max: 64 << 30 },
    preset: Preset::Text("256MiB"),
    what: "The memory that the pre-roll may need: when it is used up, the oldest is given up first.",
    why: "Ten minutes of two hundred markers at 1000 Hz, every bit of them, would need more than a gigabyte.",
    when: When::NextArm,
    written: |config| size(config.arm.memory_max_bytes),
};

/// `http.socket`.
pub static HTTP_SOCKET: Key = Key {
    path: "http.socket",
    takes: Takes::Text("the path of a Unix socket of at most 107 bytes, or \"\" for none"),
    preset: Preset::Told {
        words: "`$RUNTIME_DIRECTORY/mocapd.sock` where that is set, as systemd does; else `\"/run/mocapd/mocapd.sock\"`",
        example: "\"/run/mocapd/mocapd.sock\"",
    },
    what: "The Unix socket of the HTTP interface; `\"\"` for none.",
    why: "Who may use it is said by the permissions of its folder, so that it needs no token.",
    when: When::Restart,
    written: |config| config.http.socket.as_deref().map_or_else(|| Some(json!("")), path),
};

/// `http.listen`.
pub static HTTP_LISTEN: Key = Key {
    path: "http.listen",
    takes: Takes::Text("an address and a port, or \"\" for none"),
    preset: Preset::Text("127.0.0.1:7060"),
    what: "The TCP address of the HTTP interface; `\"\"` for none.",
    why: "This machine alone reaches 127.0.0.1; an address that others reach needs a `token_file`.",
    when: When::Restart,
    written: |config| address(config.http.listen),
};

/// `http.token_file`.
pub static HTTP_TOKEN_FILE: Key = Key {
    path: "http.token_file",
    takes: Takes::Text("the path of a file"),
    preset: Preset::Absent("\"/etc/mocapd/token\""),
    what: "A file with the token that callers over TCP must send: mode 0600 or stricter, of the service's own user.",
    why: "Whoever reaches the address could otherwise stop a take.",
    when: When::Restart,
    written: |config| config.http.token_file.as_deref().and_then(path),
};

/// `http.allowed_hosts`.
pub static HTTP_ALLOWED_HOSTS: Key = Key {
    path: "http.allowed_hosts",
    takes: Takes::List { of: "a host's name or address without a port", max: ITEMS_MAX },
    preset: Preset::NoItems("rig.lab.example"),
    what: "Names under which callers may reach the service over TCP, beside its address and localhost.",
    why: "A page in a browser that calls it under any other name is refused.",
    when: When::Now,
    written: |config| texts(&config.http.allowed_hosts),
};

/// `http.connections_max`.
pub static HTTP_CONNECTIONS_MAX: Key = Key {
    path: "http.connections_max",
    takes: Takes::Whole { min: 1, max: CONNECTIONS_MAX as u64 },
    preset: Preset::Whole(64),
    what: "Connections at once, each on the socket and over TCP; beyond it, the next one takes the place of one that asks nothing, or is refused.",
    why: "A dashboard needs a few. With 256, connections and their downloads use 889 of the 1024 descriptors that a process has unless it is given more, and takes keep the others.",
    when: When::Restart,
    written: |config| Some(json!(config.http.connections_max)),
};

/// `trigger.listen`.
pub static TRIGGER_LISTEN: Key = Key {
    path: "trigger.listen",
    takes: Takes::Text("an address and a port, such as \"0.0.0.0:8989\", or \"\" for none"),
    preset: Preset::Text(""),
    what: "The UDP address on which capture triggers of other programs are heard; `\"\"` for none.",
    why: "Nobody starts a take over the network unless it was allowed here.",
    when: When::Restart,
    written: |config| address(config.trigger.listen),
};

/// `trigger.send_to`.
pub static TRIGGER_SEND_TO: Key = Key {
    path: "trigger.send_to",
    takes: Takes::List {
        of: "an address and a port; a broadcast address is one, too",
        max: SEND_TO_MAX,
    },
    preset: Preset::NoItems("192.168.10.255:8989"),
    what: "Who is told of our starts and stops, with the same triggers.",
    why: "Other systems of the laboratory then record the same take under the same name.",
    when: When::Now,
    written: |config| texts(&config.trigger.send_to),
};

/// `trigger.allow_from`.
pub static TRIGGER_ALLOW_FROM: Key = Key {
    path: "trigger.allow_from",
    takes: Takes::List { of: "an address or a network in CIDR form", max: ITEMS_MAX },
    preset: Preset::NoItems("192.168.10.0/24"),
    what: "Who is listened to; empty, everybody is, and `mocapd config check` says so.",
    why: "Triggers carry no proof of who sent them: the address is all there is to go by.",
    when: When::Now,
    written: |config| texts(&config.trigger.allow_from),
};

/// `trigger.delay_max`.
pub static TRIGGER_DELAY_MAX: Key = Key {
    path: "trigger.delay_max",
    takes: Takes::Time { min: Duration::ZERO, max: DELAY_MAX },
    preset: Preset::Text("5s"),
    what: "The longest delay that a trigger may ask for; one with a longer delay is refused and logged.",
    why: "Programs delay a start by fractions of a second, so that several begin together; a minute serves nobody but who wants to disturb.",
    when: When::Now,
    written: |config| duration(config.trigger.delay_max),
};

/// `log.level`.
pub static LOG_LEVEL: Key = Key {
    path: "log.level",
    takes: Takes::Text("error, warn, info, debug or trace"),
    preset: Preset::Text("info"),
    what: "How much is said on standard error, and so in the journal.",
    why: "`info` says each arm, start, stop and outage, and nothing for each frame.",
    when: When::Now,
    written: |config| Some(json!(config.log_level.to_string())),
};
