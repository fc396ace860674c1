//! Commands of clients, in both directions: as text, and as what a server understands of it.

use std::{fmt, net::IpAddr, str::SplitAsciiWhitespace};

use super::{bodies::BodyComponentKind, frame::MarkerComponentKind, sampled::SampledComponentKind};

/// Versions of the protocol that both ends speak, as the number after `1.`.
pub const VERSIONS: std::ops::RangeInclusive<u32> = 8..=28;

/// The greeting of a server.
pub const WELCOME: &str = "QTM RT Interface connected";

/// Lowest UDP port that a stream may be sent to: "Valid port numbers are 1023 - 65535".
const UDP_PORT_MIN: u16 = 1023;

/// Components that a command names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Components {
    /// Which of [`MarkerComponentKind::ALL`].
    markers: [bool; 4],
    /// Which of [`BodyComponentKind::ALL`].
    bodies: [bool; 4],
    /// Which of [`SampledComponentKind::ALL`].
    samples: [bool; 4],
    /// How many others, which a server without them leaves out.
    pub others: usize,
}

impl Components {
    /// The marker components, in the order of their numbers.
    pub fn markers(&self) -> impl Iterator<Item = MarkerComponentKind> + use<> {
        let named = self.markers;
        MarkerComponentKind::ALL.into_iter().zip(named).filter(|(_, named)| *named).map(|(k, _)| k)
    }

    /// The components of `kinds`.
    #[must_use]
    pub fn of(kinds: &[MarkerComponentKind]) -> Self {
        let markers = MarkerComponentKind::ALL.map(|kind| kinds.contains(&kind));
        Self { markers, ..Self::default() }
    }

    /// The components of bodies, in the order of their numbers.
    pub fn bodies(&self) -> impl Iterator<Item = BodyComponentKind> + use<> {
        let named = self.bodies;
        BodyComponentKind::ALL.into_iter().zip(named).filter(|(_, named)| *named).map(|(k, _)| k)
    }

    /// The same with a component of bodies, if there is any.
    #[must_use]
    pub fn with_bodies(mut self, kind: Option<BodyComponentKind>) -> Self {
        for (named, of) in self.bodies.iter_mut().zip(BodyComponentKind::ALL) {
            *named |= kind == Some(of);
        }
        self
    }

    /// The components of samples, in the order of their numbers.
    pub fn samples(&self) -> impl Iterator<Item = SampledComponentKind> + use<> {
        let named = self.samples;
        let all = SampledComponentKind::ALL.into_iter().zip(named);
        all.filter(|(_, named)| *named).map(|(kind, _)| kind)
    }

    /// Whether there are components of rigid bodies.
    #[must_use]
    pub fn has_bodies(&self) -> bool {
        self.bodies().next().is_some()
    }

    /// Whether there are components of samples.
    #[must_use]
    pub fn has_samples(&self) -> bool {
        self.samples.contains(&true)
    }

    /// The same with components of samples, if there are any.
    #[must_use]
    pub fn with_samples(
        mut self,
        analog: Option<SampledComponentKind>,
        force: Option<SampledComponentKind>,
    ) -> Self {
        for (named, kind) in self.samples.iter_mut().zip(SampledComponentKind::ALL) {
            *named |= analog == Some(kind) || force == Some(kind);
        }
        self
    }

    /// Reads names; `None` for one that the protocol does not have, or when there is none.
    fn parse(names: SplitAsciiWhitespace<'_>) -> Option<Self> {
        // Of these a channel list or a frame of reference may follow after ':'.
        const OTHERS: [&str; 8] =
            ["2d", "2dlin", "image", "gazevector", "eyetracker", "timecode", "skeleton", "all"];
        let mut found = Self::default();
        for name in names {
            let marker =
                MarkerComponentKind::ALL.iter().position(|k| k.name().eq_ignore_ascii_case(name));
            let sampled =
                SampledComponentKind::ALL.iter().position(|k| k.name().eq_ignore_ascii_case(name));
            let body =
                BodyComponentKind::ALL.iter().position(|k| k.name().eq_ignore_ascii_case(name));
            let named = marker.and_then(|at| found.markers.get_mut(at));
            let named = named.or(body.and_then(|at| found.bodies.get_mut(at)));
            let base = name.split(':').next().unwrap_or(name);
            let has_list =
                ["analog", "analogsingle"].map(|analog| base.eq_ignore_ascii_case(analog));
            match named.or(sampled.and_then(|at| found.samples.get_mut(at))) {
                Some(named) => *named = true,
                None if has_list.contains(&true) => found.others += 1,
                None if OTHERS.iter().any(|other| other.eq_ignore_ascii_case(base)) => {
                    found.others += 1;
                }
                None => return None,
            }
        }
        (found != Self::default()).then_some(found)
    }
}

impl fmt::Display for Components {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let markers = self.markers().map(MarkerComponentKind::name);
        let bodies = self.bodies().map(BodyComponentKind::name);
        let samples = self.samples().map(SampledComponentKind::name);
        let names: Vec<_> = markers.chain(bodies).chain(samples).collect();
        f.write_str(&names.join(" "))
    }
}

/// Which frames a stream has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StreamRate {
    /// Every frame.
    All,
    /// About so many a second.
    Frequency(u32),
    /// Every n-th.
    Divisor(u32),
}

/// Where a stream goes in datagrams.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DatagramTarget {
    /// The address; `None` for the client's own.
    pub address: Option<IpAddr>,
    /// The port.
    pub port: u16,
}

/// A request for frames until further notice.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamRequest {
    /// Which frames.
    pub rate: StreamRate,
    /// Datagrams in place of the TCP connection.
    pub datagrams: Option<DatagramTarget>,
    /// What is in the frames.
    pub components: Components,
}

impl fmt::Display for StreamRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("StreamFrames ")?;
        match self.rate {
            StreamRate::All => f.write_str("AllFrames")?,
            StreamRate::Frequency(hz) => write!(f, "Frequency:{hz}")?,
            StreamRate::Divisor(n) => write!(f, "FrequencyDivisor:{n}")?,
        }
        match self.datagrams {
            None => {}
            Some(DatagramTarget { address: None, port }) => write!(f, " UDP:{port}")?,
            Some(DatagramTarget { address: Some(ip), port }) => write!(f, " UDP:{ip}:{port}")?,
        }
        write!(f, " {}", self.components)
    }
}

/// Settings that a command names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SettingsRequest {
    /// Of the system.
    pub general: bool,
    /// Of 3D markers.
    pub markers: bool,
    /// Of rigid bodies.
    pub bodies: bool,
    /// Of analog devices.
    pub analog: bool,
    /// Of force plates.
    pub force: bool,
}

/// A command, as a server understands it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ClientCommand {
    /// Which version is used, or use the one given as the number after `1.`.
    Version(Option<u32>),
    /// A version that is not `1.n`.
    VersionOther,
    /// The program's version.
    QtmVersion,
    /// The byte order of the connection.
    ByteOrder,
    /// The last change of state.
    GetState,
    /// Settings.
    GetParameters(SettingsRequest),
    /// One frame.
    GetCurrentFrame(Components),
    /// All frames from now on.
    StreamFrames(StreamRequest),
    /// No more frames.
    StreamFramesStop,
    /// The right to control.
    TakeControl(String),
    /// Give that right back.
    ReleaseControl,
    /// Connect to the cameras.
    New,
    /// Disconnect from the cameras, or close the file.
    Close,
    /// Start a capture, or play the open file.
    Start {
        /// Whether the file is played.
        from_file: bool,
    },
    /// Stop either.
    Stop,
    /// Start a capture that waits for a trigger.
    Trig,
    /// Put an event with this label into the capture.
    SetEvent(String),
    /// Open a measurement.
    Load(String),
    /// Save the measurement.
    Save(String),
    /// Open a project.
    LoadProject(String),
    /// Send the capture as a file.
    GetCapture,
    /// Process the open file again.
    Reprocess,
    /// A light of a camera.
    Led,
    /// Not a command of the protocol, or with wrong arguments.
    Unknown,
}

impl ClientCommand {
    /// Reads a command; case does not matter.
    #[must_use]
    pub fn parse(text: &str) -> Self {
        let mut parts = text.split_ascii_whitespace();
        let name = parts.next().unwrap_or_default().to_ascii_lowercase();
        let rest = text.trim().get(name.len()..).unwrap_or_default().trim();
        let is_bare = rest.is_empty();
        match name.as_str() {
            "version" => match rest.split_once('.') {
                _ if is_bare => Self::Version(None),
                Some(("1", minor)) => {
                    minor.parse().map_or(Self::Unknown, |minor| Self::Version(Some(minor)))
                }
                Some(_) => Self::VersionOther,
                None => Self::Unknown,
            },
            "qtmversion" if is_bare => Self::QtmVersion,
            "byteorder" if is_bare => Self::ByteOrder,
            // Until version 1.9 it was called GetLastEvent.
            "getstate" | "getlastevent" if is_bare => Self::GetState,
            "getparameters" => settings(parts).map_or(Self::Unknown, Self::GetParameters),
            "getcurrentframe" => {
                Components::parse(parts).map_or(Self::Unknown, Self::GetCurrentFrame)
            }
            "streamframes" if rest.eq_ignore_ascii_case("stop") => Self::StreamFramesStop,
            "streamframes" => stream(parts).map_or(Self::Unknown, Self::StreamFrames),
            "takecontrol" => Self::TakeControl(rest.to_owned()),
            "releasecontrol" if is_bare => Self::ReleaseControl,
            "new" if is_bare => Self::New,
            "close" if is_bare => Self::Close,
            "start" if is_bare => Self::Start { from_file: false },
            "start" if rest.eq_ignore_ascii_case("rtfromfile") => Self::Start { from_file: true },
            "stop" if is_bare => Self::Stop,
            "trig" if is_bare => Self::Trig,
            "setqtmevent" | "event" => Self::SetEvent(rest.to_owned()),
            "load" => Self::Load(rest.to_owned()),
            "save" => Self::Save(rest.to_owned()),
            "loadproject" => Self::LoadProject(rest.to_owned()),
            "getcapture" | "getcapturec3d" | "getcaptureqtm" if is_bare => Self::GetCapture,
            "reprocess" if is_bare => Self::Reprocess,
            "led" => Self::Led,
            _ => Self::Unknown,
        }
    }
}

fn settings(names: SplitAsciiWhitespace<'_>) -> Option<SettingsRequest> {
    const OTHERS: [&str; 5] = ["image", "gazevector", "eyetracker", "skeleton", "calibration"];
    let mut found = SettingsRequest::default();
    let mut n = 0;
    for name in names {
        n += 1;
        let base = name.split(':').next().unwrap_or(name).to_ascii_lowercase();
        match base.as_str() {
            "all" => {
                found = SettingsRequest {
                    general: true,
                    markers: true,
                    bodies: true,
                    analog: true,
                    force: true,
                };
            }
            "general" => found.general = true,
            "3d" => found.markers = true,
            "6d" => found.bodies = true,
            "analog" => found.analog = true,
            "force" => found.force = true,
            other if OTHERS.contains(&other) => {}
            _ => return None,
        }
    }
    (n > 0).then_some(found)
}

fn stream(mut parts: SplitAsciiWhitespace<'_>) -> Option<StreamRequest> {
    let rate = parts.next()?.to_ascii_lowercase();
    let number = |text: &str| text.parse().ok().filter(|n| *n > 0);
    let rate = match rate.split_once(':') {
        None if rate == "allframes" => StreamRate::All,
        Some(("frequency", hz)) => StreamRate::Frequency(number(hz)?),
        Some(("frequencydivisor", n)) => StreamRate::Divisor(number(n)?),
        _ => return None,
    };
    let mut datagrams = None;
    let next = parts.clone().next().unwrap_or_default();
    if next.to_ascii_lowercase().starts_with("udp") {
        parts.next();
        let (_, target) = next.split_once(':')?;
        let (address, port) = match target.rsplit_once(':') {
            Some((address, port)) => (Some(address.parse().ok()?), port),
            None => (None, target),
        };
        let port = port.parse().ok().filter(|port| *port >= UDP_PORT_MIN)?;
        datagrams = Some(DatagramTarget { address, port });
    }
    Some(StreamRequest { rate, datagrams, components: Components::parse(parts)? })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_residuals() -> Components {
        Components::of(&[
            MarkerComponentKind::LabelledWithResiduals,
            MarkerComponentKind::UnlabelledWithResiduals,
        ])
    }

    #[test]
    fn streams_read_back_as_written() {
        let to = |address: Option<&str>, port| {
            Some(DatagramTarget { address: address.map(|ip| ip.parse().unwrap()), port })
        };
        for (rate, datagrams, text) in [
            (StreamRate::All, None, "StreamFrames AllFrames 3DRes 3DNoLabelsRes"),
            (
                StreamRate::Frequency(30),
                to(None, 2234),
                "StreamFrames Frequency:30 UDP:2234 3DRes 3DNoLabelsRes",
            ),
            (
                StreamRate::Divisor(4),
                to(Some("10.0.0.7"), 65_535),
                "StreamFrames FrequencyDivisor:4 UDP:10.0.0.7:65535 3DRes 3DNoLabelsRes",
            ),
        ] {
            let request = StreamRequest { rate, datagrams, components: with_residuals() };
            assert_eq!(request.to_string(), text);
            assert_eq!(ClientCommand::parse(text), ClientCommand::StreamFrames(request));
        }
    }

    /// The documents' own examples, and those of the vendor's clients.
    #[test]
    fn documented_commands_are_understood() {
        let markers = SettingsRequest { markers: true, force: true, ..SettingsRequest::default() };
        for (text, command) in [
            ("Version", ClientCommand::Version(None)),
            ("version 1.25", ClientCommand::Version(Some(25))),
            ("Version 2.0", ClientCommand::VersionOther),
            ("QTMVersion", ClientCommand::QtmVersion),
            ("byteorder", ClientCommand::ByteOrder),
            ("GetLastEvent", ClientCommand::GetState),
            ("GetParameters 3D Force", ClientCommand::GetParameters(markers)),
            (
                "getparameters skeleton:global",
                ClientCommand::GetParameters(SettingsRequest::default()),
            ),
            ("StreamFrames Stop", ClientCommand::StreamFramesStop),
            ("TakeControl x364k6Gt", ClientCommand::TakeControl("x364k6Gt".to_owned())),
            ("takecontrol ", ClientCommand::TakeControl(String::new())),
            ("start rtfromfile", ClientCommand::Start { from_file: true }),
            ("Event test_event", ClientCommand::SetEvent("test_event".to_owned())),
            ("Load \"a b.qtm\"", ClientCommand::Load("\"a b.qtm\"".to_owned())),
        ] {
            assert_eq!(ClientCommand::parse(text), command, "{text}");
        }
        let ClientCommand::StreamFrames(stream) =
            ClientCommand::parse("StreamFrames Frequency:30 UDP:2234 3D Analog")
        else {
            panic!("the documents' example of a stream");
        };
        assert_eq!(
            (stream.components.to_string(), stream.components.others),
            ("3D Analog".to_owned(), 0)
        );
        let ClientCommand::GetCurrentFrame(one) =
            ClientCommand::parse("getcurrentframe 3dnolabels analog:1,2,3-6,16 6d")
        else {
            panic!("a frame with a list of channels");
        };
        assert_eq!((one.to_string(), one.others), ("3DNoLabels 6D".to_owned(), 1));
    }

    #[test]
    fn wrong_commands_are_not() {
        for text in [
            "",
            "Hello",
            "Version one",
            "Version 1.",
            "GetParameters",
            "GetParameters 4D",
            "StreamFrames",
            "StreamFrames AllFrames",
            "StreamFrames Frequency:0 3D",
            "StreamFrames AllFrames UDP 3D",
            "StreamFrames AllFrames UDP:1022 3D",
            "StreamFrames AllFrames UDP:65536 3D",
            "StreamFrames AllFrames UDP:lab:2000 3D",
            "GetCurrentFrame",
            "GetCurrentFrame 5D",
            "Start now",
        ] {
            assert_eq!(ClientCommand::parse(text), ClientCommand::Unknown, "{text}");
        }
    }
}
