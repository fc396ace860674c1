//! The table of all keys, and the texts generated from it: the example file and the tables of docs/config.md.

use std::{
    fmt::Write,
    net::{IpAddr, SocketAddr},
    path::{Path, PathBuf},
    time::Duration,
};

use mocapd_acquire::pipeline::{STRETCH_LENGTHS, SYNC_MAX};
use mocapd_codec::{ResamplerKind, Tolerance};
use mocapd_drivers::{
    lsl::INLETS_MAX, natnet::CLIENTS_MAX as NATNET_CLIENTS_MAX, qtm::CLIENTS_MAX as QTM_CLIENTS_MAX,
};
use mocapd_store::{ObjectUrl, is_url};
use mocapd_take::motion::UpAxis;
use serde_json::json;

use super::{
    DeviceChoice, NameTemplate,
    key::{
        ConfigValue, DefaultValue, Field, Key, PATH_BYTES_MAX, Read, ReloadPolicy, ValueType,
        address, field, path,
    },
    problem::suggestion,
    publishers,
};
use crate::{
    http::CONNECTIONS_MAX, log::Level, subject::NAME_BYTES_MAX, trigger::DELAY_MAX, units,
};

/// Sections in the order of the example file, each with its purpose.
pub const SECTIONS: &[(&str, &str)] = &[
    ("rig", "Name of the rig."),
    ("device", "The device to record."),
    ("take", "Where takes are written, and how."),
    ("subject", "Who is captured; stored in every take."),
    (
        "arm",
        "What is kept in memory between takes, so that a take can begin before its start command.",
    ),
    ("archive", "Upload of finished takes to object storage."),
    ("http", "The HTTP interface: its addresses, and who may use it."),
    ("trigger", "Capture triggers over UDP, received and sent."),
    ("publish.qtm", "What is recorded, published live as Qualisys QTM does."),
    ("publish.natnet", "What is recorded, published live as OptiTrack's Motive does."),
    ("publish.lsl", "What is recorded, published live as streams of the Lab Streaming Layer."),
    ("publish.foxglove", "What is recorded, published live for Foxglove and Lichtblick."),
    ("log", "How much is logged."),
];

const TEN_MINUTES: Duration = Duration::from_secs(600);

/// Maximum number of host names and networks: each is compared with every client, and more would be a mistake.
const ITEMS_MAX: usize = 32;

/// Maximum number of receivers of triggers; each is sent one datagram per start and stop.
const SEND_TO_MAX: usize = 16;

/// Maximum number of clients of Foxglove: beyond it, copying for them takes more of a processor than there is.
const FOXGLOVE_CLIENTS_MAX: u64 = 32;

/// One entry per key: purpose, reason, type, default, reload policy and field.
macro_rules! keys {
    ($(
        #[doc = $what:literal]
        #[doc = $why:literal]
        $section:ident$(.$name:ident)+: $values:expr, $default:expr, $when:expr, $field:expr;
    )*) => {
        /// Every key, in the order of the example file.
        pub static KEYS: &[Key] = &[$(Key {
            path: concat!(stringify!($section), $(".", stringify!($name)),+),
            what: $what.trim_ascii(),
            why: $why.trim_ascii(),
            values: $values,
            default: $default,
            when: $when,
            field: $field,
        }),*];
    };
}

keys! {
    /// Name of the rig, used in names of takes, in the status and in triggers.
    /// One service records one rig; with the file /etc/mocapd/left.toml it is called left.
    rig.name: ValueType::Text(
            "1 to 64 letters, digits, '-', '_' or '.', beginning with a letter or digit"
        ),
        DefaultValue::Dynamic {
            description: "the file name without .toml; `rig` for mocapd.toml",
            example: "\"left\"",
        }, ReloadPolicy::Now, field!(rig_name, rig_name);
    /// The device to record; `auto` takes the only attached device that a driver recognises, as listed by `mocapd devices`.
    /// A path under /dev/serial/by-id or a USB serial number stays the same when other devices are plugged in.
    device.uri: ValueType::Text(
            "auto, serial:PATH[@BAUD], usb:VID:PID[:SERIAL], qtm:HOST[:PORT], natnet:HOST[:PORT] or lsl:NAME, with ?driver=NAME if needed"
        ),
        DefaultValue::Text("auto"), ReloadPolicy::NextArm, field!(device.uri, device_choice);
    /// Frame rate to set on the device; if absent, the device keeps its own.
    /// Every take then has this rate, even if the device was set to another one.
    device.rate_hz: ValueType::Rate,
        DefaultValue::Absent("240"), ReloadPolicy::NextArm, field!(device.rate_hz);
    /// Log every byte received while the device is armed, in a file beside the takes that `mocapd-sim serve` can replay.
    /// For finding faults in a rig: a log is many times as large as its take.
    device.raw_log: ValueType::Flag,
        DefaultValue::Flag(false), ReloadPolicy::NextArm, field!(device.raw_log);
    /// Folder for new takes; created at startup if it does not exist.
    /// Under systemd it is the only folder that the service may write to.
    take.directory: ValueType::Text("a folder"),
        DefaultValue::Dynamic {
            description: "`$STATE_DIRECTORY` if set (systemd sets it), otherwise `\".\"`",
            example: "\"/var/lib/mocapd\"",
        }, ReloadPolicy::NextTake,
        Field {
            read: |config, raw| raw.text(takes_folder).map(|folder| config.take.directory = folder),
            to_json: |config| config.take.directory.to_json(),
        };
    /// Name of a take that is started without one.
    /// Names that begin with the date sort by time; if a name exists, a number is appended, because takes are never overwritten.
    take.name: ValueType::Text(
            "a file name without .take, in which {date}, {time}, {rig} and {count} are replaced"
        ),
        DefaultValue::Text("{date}_{time}_{rig}"), ReloadPolicy::NextTake,
        field!(take.name, |text| NameTemplate::parse(text).map_err(Some));
    /// Largest distance between a sample and its reconstruction; not allowed together with `lossless = true`.
    /// Half a millimetre is five to fifteen times the noise of a good rig, and the default of `mocapd record`.
    take.tolerance: ValueType::Distance,
        DefaultValue::Text("0.5mm"), ReloadPolicy::NextArm,
        Field {
            read: |config, raw| raw.quantity(tolerance).map(|mm| config.take.codec.tolerance = mm),
            to_json: |config| {
                let codec = &config.take.codec;
                (!codec.kind.is_lossless()).then(|| json!(format!("{}mm", codec.tolerance.mm())))
            },
        };
    /// Largest error of the rotations of rigid bodies; if absent, the angle by which a point 200 mm away moves by `tolerance`.
    /// What is far from its body, such as the tip of a long pointer, needs a smaller one; not allowed together with `lossless = true`.
    take.angle_tolerance: ValueType::Text("an angle with its unit, in quotes (deg), 0.0001deg to 10deg"),
        DefaultValue::Absent("\"0.05deg\""), ReloadPolicy::NextArm,
        Field {
            read: |config, raw| {
                raw.text(angle_degrees).map(|degrees| config.take.angle_degrees = Some(degrees))
            },
            to_json: |config| config.take.angle_degrees.map(|degrees| json!(format!("{degrees}deg"))),
        };
    /// Record the residuals that the device reports with its markers, as sampled channels.
    /// They show how well each marker was seen, but are noise that hardly compresses: most takes become several times as large.
    take.residuals: ValueType::Flag,
        DefaultValue::Flag(false), ReloadPolicy::NextArm, field!(take.residuals);
    /// The axis that points up, for devices that do not state one, such as Motive, LSL streams and NDI systems; nothing is rotated.
    /// Without it, players and viewers assume z.
    take.up_axis: ValueType::Text("x, y or z"),
        DefaultValue::Absent("\"y\""), ReloadPolicy::NextArm,
        Field {
            read: |config, raw| raw.text(up_axis).map(|axis| config.take.up_axis = axis),
            to_json: |config| config.take.up_axis.name().map(|name| json!(name)),
        };
    /// Store every sample bit for bit; the same as `resampler = "lossless"`.
    /// For archives that must not change; takes are several times as large.
    take.lossless: ValueType::Flag,
        DefaultValue::Flag(false), ReloadPolicy::NextArm,
        Field {
            // Its effect depends on `take.resampler`: see `ConfigReader::codec`.
            read: |_, raw| bool::read(raw).map(drop),
            to_json: |config| Some(json!(config.take.codec.kind.is_lossless())),
        };
    /// How samples are compressed.
    /// `dense` makes the smallest takes, `fast` suits slow hosts; spline and sync need whole takes and cannot record.
    take.resampler: ValueType::Text("dense, fast or lossless"),
        DefaultValue::Text("dense"), ReloadPolicy::NextArm, field!(take.codec.kind, resampler);
    /// Length of a stretch, which is written as a whole: a killed process loses at most one.
    /// Shorter stretches lose less and make larger takes.
    take.stretch: ValueType::Time(STRETCH_LENGTHS),
        DefaultValue::Text("500ms"), ReloadPolicy::NextArm, field!(take.stretch);
    /// How often written data is synced to the disk: a power cut loses at most this time and one stretch.
    /// With the default stretch that is one second; `0s` syncs after every stretch.
    take.sync: ValueType::Time(Duration::ZERO..=SYNC_MAX),
        DefaultValue::Text("500ms"), ReloadPolicy::NextArm, field!(take.sync);
    /// Disk space to keep free: a take that reaches it is closed, and no new take starts.
    /// A system whose disk is full cannot even log the reason; `0B` uses all of it.
    take.keep_free: ValueType::Size(0..=1 << 50),
        DefaultValue::Text("256MiB"), ReloadPolicy::NextTake, field!(take.keep_free_bytes);
    /// How long a take waits for a device that has disconnected; `0s` closes the take at once.
    /// A minute is enough to plug a cable back in, and for a device to restart.
    take.reconnect: ValueType::Time(Duration::ZERO..=Duration::from_secs(86_400)),
        DefaultValue::Text("60s"), ReloadPolicy::NextArm, field!(take.reconnect);
    /// Longest take: it is closed at this length, with the ending `length`; if absent, there is no limit.
    /// It ends takes that nobody stopped.
    // A month: in longer takes the frame counter of a 1000 Hz device would wrap around.
    take.max_length: ValueType::Time(Duration::from_secs(1)..=Duration::from_secs(744 * 3600)),
        DefaultValue::Absent("\"1h\""), ReloadPolicy::Now, field!(take.max_length);
    /// How long takes stay in the trash, the folder `.trash` in the takes' folder, before they are removed.
    /// A month is long enough to notice that a take is missing; until then the disk has less free space.
    take.trash_keep: ValueType::Time(Duration::from_secs(3600)..=Duration::from_secs(8760 * 3600)),
        DefaultValue::Text("720h"), ReloadPolicy::Now, field!(take.trash_keep);
    /// Name of the subject, stored in every take.
    /// Where labels name several subjects, as in `S01:LKNE`, it selects the one that the skeleton belongs to.
    subject.name: ValueType::Text("a name of at most 128 bytes"),
        DefaultValue::Absent("\"S01\""), ReloadPolicy::NextTake,
        Field {
            read: |config, raw| raw.text(subject_name).map(|name| config.subject.name = Some(name)),
            to_json: |config| config.subject.name.as_deref().map(|name| json!(name)),
        };
    /// The skeleton.json that `mocapd subject body` made from a scan; stored in every take and drawn by the dashboard.
    /// Known limb lengths reveal markers that were swapped, even years later.
    subject.skeleton: ValueType::Text("the path of a file"),
        DefaultValue::Absent("\"/srv/subjects/s01-skeleton.json\""), ReloadPolicy::NextTake,
        field!(subject.skeleton);
    /// The face.json that `mocapd subject face` made from a photograph; stored in every take.
    /// Markers on a face are identified by their positions on it.
    subject.face: ValueType::Text("the path of a file"),
        DefaultValue::Absent("\"/srv/subjects/s01-face.json\""), ReloadPolicy::NextTake, field!(subject.face);
    /// File that maps marker labels to points of the `face`; stored in every take, and used by the dashboard to draw the face under its markers.
    /// Facial marker sets have no standard names.
    subject.face_markers: ValueType::Text("the path of a file"),
        DefaultValue::Absent("\"/srv/subjects/face-markers.json\""), ReloadPolicy::NextTake,
        field!(subject.face_markers);
    /// Whether the service opens the device and arms itself at startup.
    /// The rig is then ready to record once it is switched on; with `false`, other programs can use the device until it is armed.
    arm.at_start: ValueType::Flag,
        DefaultValue::Flag(true), ReloadPolicy::Restart, field!(arm.at_start);
    /// How much of the past is kept in memory while armed.
    /// Motion from before the start command can still be saved.
    arm.pre_roll: ValueType::Time(Duration::ZERO..=TEN_MINUTES),
        DefaultValue::Text("10s"), ReloadPolicy::NextArm, field!(arm.pre_roll);
    /// How much of the pre-roll a start puts into its take unless it asks for another length; at most `pre_roll`.
    /// By default a take begins at its start command.
    arm.include_pre_roll: ValueType::Time(Duration::ZERO..=TEN_MINUTES),
        DefaultValue::Text("0s"), ReloadPolicy::NextTake, field!(arm.include_pre_roll);
    /// Memory limit of the pre-roll; when it is reached, the oldest data is dropped first.
    /// Ten minutes of two hundred markers at 1000 Hz, stored bit for bit, would need more than a gigabyte.
    arm.memory_max: ValueType::Size(1 << 20..=64 << 30),
        DefaultValue::Text("256MiB"), ReloadPolicy::NextArm, field!(arm.memory_max_bytes);
    /// Folder in object storage that finished takes are uploaded to, as `NAME.take`; if absent, none are.
    /// A take in a bucket survives this machine; credentials are those of the environment (docs/archive.md).
    archive.url: ValueType::Text("the URL of a folder: s3://BUCKET/FOLDER/, gs://BUCKET/FOLDER/, az://CONTAINER/FOLDER/ or file:///FOLDER/"),
        DefaultValue::Absent("\"s3://lab-takes/left/\""), ReloadPolicy::Now,
        Field {
            read: |config, raw| raw.text(archive_url).map(|url| config.archive.url = Some(url)),
            to_json: |config| config.archive.url.as_ref().map(|url| json!(url.to_string())),
        };
    /// Limit on the rate of uploads, per second, also while nothing is recorded.
    /// A recording must not notice them, nor the other users of the line: a minute of forty markers takes less than a second at this rate.
    archive.rate_max: ValueType::Size(1 << 10..=10 << 30),
        DefaultValue::Text("8MiB"), ReloadPolicy::Now, field!(archive.rate_max_bytes_per_s);
    /// How long after its upload the local copy of a take is removed; if absent, local copies are kept.
    /// The object is read back first, and compared with the take.
    archive.remove_local_after: ValueType::Time(Duration::ZERO..=Duration::from_secs(8760 * 3600)),
        DefaultValue::Absent("\"168h\""), ReloadPolicy::Now, field!(archive.remove_local_after);
    /// Unix socket of the HTTP interface; `""` for none.
    /// The permissions of its folder decide who may use it, so it needs no token.
    http.socket: ValueType::Text("the path of a Unix socket of at most 107 bytes, or \"\" for none"),
        DefaultValue::Dynamic {
            description: "`$RUNTIME_DIRECTORY/mocapd.sock` if that is set (systemd sets it), otherwise `\"/run/mocapd/mocapd.sock\"`",
            example: "\"/run/mocapd/mocapd.sock\"",
        }, ReloadPolicy::Restart,
        Field {
            read: |config, raw| raw.text(socket).map(|socket| config.http.socket = socket),
            to_json: |config| config.http.socket.to_json().or_else(|| Some(json!(""))),
        };
    /// TCP address of the HTTP interface; `""` for none.
    /// Only this machine can reach 127.0.0.1; an address that other machines can reach needs a `token_file`.
    http.listen: ValueType::Text("an address and a port, or \"\" for none"),
        DefaultValue::Text("127.0.0.1:7060"), ReloadPolicy::Restart, field!(http.listen);
    /// File with the token that clients must send over TCP; mode 0600 or stricter, owned by the service's user.
    /// Without a token, anybody who can reach the address could stop a take.
    http.token_file: ValueType::Text("the path of a file"),
        DefaultValue::Absent("\"/etc/mocapd/token\""), ReloadPolicy::Restart, field!(http.token_file);
    /// Host names under which clients may reach the service over TCP, besides its address and localhost.
    /// Requests under any other name are refused, so that pages of other sites cannot reach the service through a browser.
    http.allowed_hosts: ValueType::List {
            of: "a host name or address without a port",
            max: ITEMS_MAX,
        },
        DefaultValue::EmptyList("rig.lab.example"), ReloadPolicy::Now, field!(http.allowed_hosts, each host);
    /// Limit on simultaneous connections, for the Unix socket and for TCP separately; beyond it, a new connection replaces an idle one or is refused.
    /// A dashboard needs a few. With 256, connections and their downloads use 889 of the 1024 file descriptors that a process has by default, and leave the others to takes.
    http.connections_max: ValueType::Integer(1..=CONNECTIONS_MAX as u64),
        DefaultValue::Integer(64), ReloadPolicy::Restart, field!(http.connections_max);
    /// UDP address for capture triggers from other programs; `""` for none.
    /// No trigger can start a take unless this is set.
    trigger.listen: ValueType::Text(
            "an address and a port, such as \"0.0.0.0:8989\", or \"\" for none"
        ),
        DefaultValue::Text(""), ReloadPolicy::Now, field!(trigger.listen);
    /// Addresses to send triggers to when a take starts or stops here.
    /// Other systems of the laboratory then record the same take under the same name.
    trigger.send_to: ValueType::List {
            of: "an address and a port; broadcast addresses are allowed",
            max: SEND_TO_MAX,
        },
        DefaultValue::EmptyList("192.168.10.255:8989"), ReloadPolicy::Now, field!(trigger.send_to, each receiver);
    /// Senders whose triggers are accepted; if empty, all are accepted, and `mocapd config check` warns of it.
    /// Triggers carry no authentication: the sender's address is all that can be checked.
    trigger.allow_from: ValueType::List { of: "an address or a network in CIDR form", max: ITEMS_MAX },
        DefaultValue::EmptyList("192.168.10.0/24"), ReloadPolicy::Now, field!(trigger.allow_from, each str::parse);
    /// Longest delay that a trigger may ask for; a trigger with a longer one is refused and logged.
    /// Programs delay a start by fractions of a second so that several systems start together; only an attacker needs more.
    trigger.delay_max: ValueType::Time(Duration::ZERO..=DELAY_MAX),
        DefaultValue::Text("5s"), ReloadPolicy::Now, field!(trigger.delay_max);
    /// Whether the service publishes the frames that it receives, as a server of the QTM RT protocol (docs/qtm.md).
    /// Programs that read QTM live can then read any rig; it never costs the recording a frame.
    publish.qtm.enabled: ValueType::Flag,
        DefaultValue::Flag(false), ReloadPolicy::Restart, field!(publish_qtm.enabled);
    /// TCP address of that server.
    /// Only this machine can reach 127.0.0.1; 22223 is the port that clients of QTM connect to by default.
    publish.qtm.listen: ValueType::Text("an address and a port"),
        DefaultValue::Text("127.0.0.1:22223"), ReloadPolicy::Restart,
        field!(publish_qtm.listen, |text| address(text).map_err(Some));
    /// Other machines that may connect; this machine always may, by 127.0.0.1 or ::1.
    /// The protocol has no authentication, so that the address is all that can be checked.
    publish.qtm.allow_from: ValueType::List { of: "an address or a network in CIDR form", max: ITEMS_MAX },
        DefaultValue::EmptyList("192.168.10.0/24"), ReloadPolicy::Restart,
        field!(publish_qtm.allow_from, each str::parse);
    /// Limit on simultaneous clients; further ones are refused.
    /// Each may let up to 4 MiB of frames wait; QTM itself has ten at most.
    publish.qtm.clients_max: ValueType::Integer(1..=QTM_CLIENTS_MAX as u64),
        DefaultValue::Integer(QTM_CLIENTS_MAX as u64), ReloadPolicy::Restart, field!(publish_qtm.clients_max);
    /// Whether a client that gives the password (TakeControl) may start and stop takes, and mark them; needs `password_file`.
    /// By default clients only read.
    publish.qtm.control: ValueType::Flag,
        DefaultValue::Flag(false), ReloadPolicy::Restart, field!(publish_qtm.control);
    /// File with the password for `control`; mode 0600 or stricter, owned by the service's user, at least 16 characters.
    /// It is sent unencrypted: use it in networks that you trust.
    publish.qtm.password_file: ValueType::Text("the path of a file"),
        DefaultValue::Absent("\"/etc/mocapd/qtm-password\""), ReloadPolicy::Restart,
        field!(publish_qtm.password_file);
    /// Whether the service publishes what it receives as a NatNet server (docs/natnet.md).
    /// Programs that read Motive live can then read any rig; it never costs the recording a frame.
    publish.natnet.enabled: ValueType::Flag,
        DefaultValue::Flag(false), ReloadPolicy::Restart, field!(publish_natnet.enabled);
    /// UDP address of that server's commands.
    /// Only this machine can reach 127.0.0.1; 1510 is the port that clients of Motive use by default.
    publish.natnet.listen: ValueType::Text("an address and a port"),
        DefaultValue::Text("127.0.0.1:1510"), ReloadPolicy::Restart,
        field!(publish_natnet.listen, |text| address(text).map_err(Some));
    /// Group and port that frames are sent to, once for all clients, by the interface of `listen`; by default they are sent to each client.
    /// Every machine of that network can read them.
    publish.natnet.multicast: ValueType::Text("an IPv4 group and a port"),
        DefaultValue::Absent("\"239.255.42.99:1511\""), ReloadPolicy::Restart,
        field!(publish_natnet.multicast);
    /// UDP port of a client's machine that its frames are sent to, besides the socket of its commands.
    /// Clients differ in where they expect frames.
    publish.natnet.data_port: ValueType::Integer(1..=65_535),
        DefaultValue::Integer(1511), ReloadPolicy::Restart, field!(publish_natnet.data_port);
    /// Version of frames, unless a client asks for another one, which it can from 4.0 on and without multicast.
    /// Older clients know older versions only.
    publish.natnet.bitstream: ValueType::Text("2.10 to 4.2"),
        DefaultValue::Text("4.1"), ReloadPolicy::Restart,
        field!(publish_natnet.bitstream, |text| publishers::bitstream(text).map_err(Some));
    /// Other machines that may connect; this machine always may.
    /// The protocol has no authentication, so that the address is all that can be checked.
    publish.natnet.allow_from: ValueType::List { of: "an address or a network in CIDR form", max: ITEMS_MAX },
        DefaultValue::EmptyList("192.168.10.0/24"), ReloadPolicy::Restart,
        field!(publish_natnet.allow_from, each str::parse);
    /// Limit on simultaneous clients that are sent frames of their own; further ones get no answer.
    /// Each is sent every frame up to twice.
    publish.natnet.clients_max: ValueType::Integer(1..=NATNET_CLIENTS_MAX as u64),
        DefaultValue::Integer(10), ReloadPolicy::Restart, field!(publish_natnet.clients_max);
    /// Whether the service publishes what it receives as streams of the Lab Streaming Layer (docs/lsl.md).
    /// LabRecorder and other programs can then read any rig; it never costs the recording a frame.
    publish.lsl.enabled: ValueType::Flag,
        DefaultValue::Flag(false), ReloadPolicy::Restart, field!(publish_lsl.enabled);
    /// IPv4 address of this machine at which the streams are found and read; ports are those of LSL's configuration.
    /// Only this machine can reach 127.0.0.1; 0.0.0.0 means all networks.
    publish.lsl.listen: ValueType::Text("an IPv4 address"),
        DefaultValue::Text("127.0.0.1"), ReloadPolicy::Restart,
        field!(publish_lsl.listen, |text| text.parse().map_err(|_| None));
    /// Other machines that may find and read the streams; this machine always may.
    /// The protocol has no authentication, so that the address is all that can be checked.
    publish.lsl.allow_from: ValueType::List { of: "an address or a network in CIDR form", max: ITEMS_MAX },
        DefaultValue::EmptyList("192.168.10.0/24"), ReloadPolicy::Restart,
        field!(publish_lsl.allow_from, each str::parse);
    /// Limit on simultaneous readers, counted for each stream that they read; further ones are refused.
    /// Each may let up to 4 MiB of samples wait, whatever it asks for.
    publish.lsl.clients_max: ValueType::Integer(1..=INLETS_MAX as u64),
        DefaultValue::Integer(32), ReloadPolicy::Restart, field!(publish_lsl.clients_max);
    /// Whether the service publishes what it receives, as a server of the Foxglove WebSocket protocol (docs/foxglove.md).
    /// Foxglove and Lichtblick then show markers, bodies, forces and samples live; it never costs the recording a frame. Needs a build with the feature `full`, as the Debian package is.
    publish.foxglove.enabled: ValueType::Flag,
        DefaultValue::Flag(false), ReloadPolicy::Restart, field!(publish_foxglove.enabled);
    /// TCP address of that server.
    /// Only this machine can reach 127.0.0.1; 8765 is the port that Foxglove suggests.
    publish.foxglove.listen: ValueType::Text("an address and a port"),
        DefaultValue::Text("127.0.0.1:8765"), ReloadPolicy::Restart,
        field!(publish_foxglove.listen, |text| address(text).map_err(Some));
    /// Other machines that may connect; this machine always may, by 127.0.0.1 or ::1.
    /// The protocol has no authentication, so that the address is all that can be checked.
    publish.foxglove.allow_from: ValueType::List { of: "an address or a network in CIDR form", max: ITEMS_MAX },
        DefaultValue::EmptyList("192.168.10.0/24"), ReloadPolicy::Restart,
        field!(publish_foxglove.allow_from, each str::parse);
    /// Web pages whose scripts may connect, by their origin, such as Foxglove in a browser; programs that are installed need no entry.
    /// Any page that is open on an allowed machine could read the stream otherwise.
    publish.foxglove.origins: ValueType::List { of: "an origin: a scheme, a host and maybe a port", max: ITEMS_MAX },
        DefaultValue::EmptyList("https://app.foxglove.dev"), ReloadPolicy::Restart,
        field!(publish_foxglove.origins, each origin);
    /// Limit on simultaneous clients; further ones are refused.
    /// Each may let up to 4 MiB of frames wait.
    publish.foxglove.clients_max: ValueType::Integer(1..=FOXGLOVE_CLIENTS_MAX),
        DefaultValue::Integer(10), ReloadPolicy::Restart, field!(publish_foxglove.clients_max);
    /// How much is logged to standard error, and so to the journal.
    /// `info` logs every arming, start, stop and outage, and nothing per frame.
    log.level: ValueType::Text("error, warn, info, debug or trace"),
        DefaultValue::Text("info"), ReloadPolicy::Now, field!(log_level, level);
}

/// Longest rig name in bytes: it is part of every take name.
const RIG_NAME_BYTES_MAX: usize = 64;

/// Longest path of a Unix socket in bytes, without the final 0: `sun_path` has 108 on Linux.
pub(super) const SOCKET_BYTES_MAX: usize = 107;

/// Checks a name that becomes part of take names and of a path.
pub(super) fn rig_name(text: &str) -> Read<String> {
    let is_part = |c: char| c.is_alphanumeric() || "-_.".contains(c);
    let is_name = (1..=RIG_NAME_BYTES_MAX).contains(&text.len())
        && text.starts_with(char::is_alphanumeric)
        && text.chars().all(is_part);
    if is_name { Ok(text.to_owned()) } else { Err(None) }
}

/// Checks the folder for takes, which a network may not stall.
fn takes_folder(text: &str) -> Read<PathBuf> {
    if is_url(Path::new(text)) {
        return Err(Some(
            "takes are recorded to a local disk, because a network may stall: set archive.url, and finished takes are uploaded"
                .to_owned(),
        ));
    }
    if text.is_empty() { Err(None) } else { path(text, PATH_BYTES_MAX).map_err(Some) }
}

fn archive_url(text: &str) -> Read<ObjectUrl> {
    let mut text = text.to_owned();
    if !text.ends_with('/') {
        text.push('/');
    }
    let url = ObjectUrl::parse(&text).map_err(|error| Some(error.to_string()))?;
    if !url.is_writable() {
        return Err(Some("a web server is read only".to_owned()));
    }
    Ok(url)
}

fn device_choice(text: &str) -> Read<DeviceChoice> {
    match text {
        "auto" => Ok(DeviceChoice::Auto),
        _ if text.contains(char::is_control) => Err(None),
        _ => text.parse().map(DeviceChoice::At).map_err(|why| Some(format!("{why}"))),
    }
}

fn angle_degrees(text: &str) -> Read<f64> {
    units::angle_degrees(text).map_err(Some)
}

fn up_axis(text: &str) -> Read<UpAxis> {
    UpAxis::from_name(text).ok_or(None)
}

fn tolerance(text: &str) -> Read<Tolerance> {
    units::tolerance(text, "lossless = true").map_err(Some)
}

fn resampler(text: &str) -> Read<ResamplerKind> {
    match text.parse::<ResamplerKind>() {
        Ok(kind) if kind.is_live() => Ok(kind),
        Ok(_) => Err(Some(
            "it needs the whole take: record with dense, fast or lossless, then export the take and import it with this resampler"
                .to_owned(),
        )),
        Err(_) => Err(suggestion(text, ["dense", "fast", "lossless"].into_iter())),
    }
}

fn subject_name(text: &str) -> Read<String> {
    let is_name = (1..=NAME_BYTES_MAX).contains(&text.len()) && !text.contains(char::is_control);
    if is_name { Ok(text.to_owned()) } else { Err(None) }
}

fn socket(text: &str) -> Read<Option<PathBuf>> {
    match text {
        "" => Ok(None),
        _ => path(text, SOCKET_BYTES_MAX).map(Some).map_err(Some),
    }
}

fn level(text: &str) -> Read<Level> {
    text.parse().map_err(|_| suggestion(text, Level::NAMES.into_iter()))
}

/// Checks a host name as browsers send it in `Host`, and returns it in lower case, without a port.
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
    Err("it is not a host name".to_owned())
}

/// Checks the origin of a web page, as browsers send it: `https://app.foxglove.dev` or `http://192.168.10.5:8080`.
fn origin(text: &str) -> Result<String, String> {
    let at = text.strip_prefix("https://").or_else(|| text.strip_prefix("http://"));
    let at = at.ok_or("it does not begin with http:// or https://")?;
    let is_name = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || "-._:[]".contains(c);
    if at.is_empty() || at.len() > 260 || !at.chars().all(is_name) {
        return Err(
            "an origin is a scheme, a host in lower case and maybe a port, and has no path"
                .to_owned(),
        );
    }
    let default_port = if text.starts_with("https:") { ":443" } else { ":80" };
    if at.ends_with(default_port) {
        return Err(format!("browsers leave {default_port} out: remove it"));
    }
    Ok(text.to_owned())
}

/// Checks an address to send triggers to.
fn receiver(text: &str) -> Result<SocketAddr, String> {
    match address(text)? {
        address if address.port() == 0 => Err("the port is 0".to_owned()),
        address if address.ip().is_unspecified() => {
            Err("it is not the address of a receiver".to_owned())
        }
        address => Ok(address),
    }
}

/// Width of the example file in characters.
const LINE_MAX: usize = 100;

/// mocapd.toml with every key at its default, commented out.
#[must_use]
pub fn example() -> String {
    let mut out = String::new();
    // Writing into a String does not fail.
    comment(
        &mut out,
        "mocapd.toml: the configuration of `mocapd run` for one rig. Every key is listed with its default: \
         remove the `#` in front of a key and set your value. `mocapd config check FILE` checks a file. \
         docs/config.md has the same keys as tables.",
    );
    for (section, about) in SECTIONS {
        writeln!(out, "\n# {about}\n[{section}]").ok();
        for key in KEYS.iter().filter(|key| key.section() == *section) {
            out.push('\n');
            comment(&mut out, &format!("{} {}", key.what, key.why));
            comment(&mut out, &format!("Value: {}.", key.values.description()));
            match key.default {
                DefaultValue::Absent(_) => comment(&mut out, "No default."),
                DefaultValue::Dynamic { description, .. } => {
                    comment(&mut out, &format!("Default: {}.", description.replace('`', "")));
                }
                DefaultValue::EmptyList(item) => {
                    comment(&mut out, &format!("Example of an entry: \"{item}\"."));
                }
                DefaultValue::Text(_) | DefaultValue::Flag(_) | DefaultValue::Integer(_) => {}
            }
            writeln!(out, "# {} = {}", key.name(), key.example()).ok();
        }
    }
    out
}

/// Writes a text as comment lines.
fn comment(out: &mut String, text: &str) {
    let mut line = "#".to_owned();
    for word in text.split(' ').filter(|word| !word.is_empty()) {
        if line.chars().count() + 1 + word.chars().count() > LINE_MAX {
            writeln!(out, "{line}").ok();
            line = "#".to_owned();
        }
        line.push(' ');
        line.push_str(word);
    }
    writeln!(out, "{line}").ok();
}

/// The table of one section in docs/config.md.
#[must_use]
pub fn table(section: &str) -> String {
    let mut out =
        "| key | value | default | purpose | a reload applies it |\n|---|---|---|---|---|\n"
            .to_owned();
    for key in KEYS.iter().filter(|key| key.section() == section) {
        // A bar would end the column.
        let [takes, default] =
            [key.values.description(), key.default_text()].map(|text| text.replace('|', "\\|"));
        let (name, what, why, when) = (key.name(), key.what, key.why, key.when.description());
        // Writing into a String does not fail.
        writeln!(out, "| `{name}` | {takes} | {default} | {what} {why} | {when} |").ok();
    }
    out
}
