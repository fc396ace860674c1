//! Attached devices, and one of them: open it, identify it, start it, read it, stop it.

mod reader;
mod reconnect;

use std::time::Duration;

use anyhow::{Context, anyhow, bail, ensure};
use mocapd_codec::{Settings, poses::PoseBounds};
use mocapd_drivers::{
    device::{
        BodyInfo, Command, DeviceEvent, ForcePlateInfo, Hello, LinkBudget, MarkerInfo, Protocol,
        SampledGroupInfo,
    },
    registry::{self, AttachedDevice, Candidate, Claim, OpenedDevice},
    transport::{
        Access, Transport, TransportError,
        lsl::{self, FoundStream},
    },
    uri::{DeviceUri, Location},
};
use mocapd_take::{
    motion::UpAxis,
    record::{Channel, Device, Header, StatedPlate},
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    header,
    host_clock::monotonic_ns,
    pipeline::PipelineConfig,
    raw_log::RawLogTap,
    setting::{Setting, SettingRefused},
};
pub use reader::{ReadOptions, ReaderOutcome};

/// Bytes requested per read: more than a pty or a USB serial driver delivers.
const READ_BYTES: usize = 64 << 10;

/// Time that a device has to answer a command.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(1);

/// Attempts at a command before the device counts as not answering.
const ATTEMPTS_MAX: usize = 5;

/// What a device announces.
#[derive(Debug, Clone, Default)]
struct DeviceChannels {
    markers: Vec<MarkerInfo>,
    sampled: Vec<SampledGroupInfo>,
    plates: Vec<ForcePlateInfo>,
    bodies: Vec<BodyInfo>,
}

/// A device that has been opened and identified.
#[derive(Debug)]
pub struct Rig {
    uri: DeviceUri,
    family: &'static str,
    transport: Box<dyn Transport>,
    protocol: Box<dyn Protocol>,
    buffer: Vec<u8>,
    outbox: Vec<u8>,
    hello: Hello,
    channels: DeviceChannels,
    not_finite_before: u64,
    /// Identifies the device after it was plugged in again.
    identity: Candidate,
    /// How long to wait for a device that was disconnected.
    replug_timeout: Duration,
    /// Length of a stretch and time between syncs, if the user chose them.
    loss_limits: Option<(Duration, Duration)>,
    /// The largest error of rotations in degrees, if the user chose it.
    angle_degrees: Option<f64>,
    /// Whether the residuals of markers are recorded.
    residuals: bool,
    /// The axis that points up, where the device states none.
    up_axis: UpAxis,
    /// Also receives every byte, when a raw log is written.
    raw_log: Option<RawLogTap>,
}

impl Rig {
    /// Opens a device and identifies it.
    ///
    /// # Errors
    /// When the device cannot be opened or does not answer. The message is one line and says what to do.
    pub fn open(uri: &DeviceUri) -> anyhow::Result<Self> {
        Self::open_logged(uri, None)
    }

    /// Opens a device that was open before, at whichever port it is plugged in now.
    ///
    /// # Errors
    /// When the device cannot be opened or does not answer.
    pub fn reopen(
        uri: &DeviceUri,
        identity: &Candidate,
        raw_log: Option<RawLogTap>,
    ) -> anyhow::Result<Self> {
        let mut rig = Self::open_logged(&registry::current_uri(uri, identity), raw_log)?;
        rig.uri = uri.clone();
        Ok(rig)
    }

    /// Identifies the device after it was plugged in again.
    #[must_use]
    pub fn identity(&self) -> &Candidate {
        &self.identity
    }

    /// The driver family.
    #[must_use]
    pub fn family(&self) -> &'static str {
        self.family
    }

    /// Opens and identifies a device, with every byte on its line copied to a raw log.
    ///
    /// # Errors
    /// When the device cannot be opened or does not answer.
    pub fn open_logged(uri: &DeviceUri, raw_log: Option<RawLogTap>) -> anyhow::Result<Self> {
        if raw_log.is_some() && matches!(&uri.location, Location::Network(at) if at.datagrams) {
            bail!(
                "a raw log holds one stream of bytes, and no datagrams: record {uri} without --raw, or a QTM without \
                 transport=udp"
            );
        }
        let opened = registry::open_with_wrapper(uri, &mut |family, line| match &raw_log {
            Some(tap) => tap.wrap(family, line),
            None => line,
        })?;
        Self::identify(uri.clone(), opened, raw_log)
    }

    /// Bounds the loss: a killed process loses at most the open stretch, a power cut also what came since the last
    /// sync.
    pub fn limit_loss(&mut self, stretch: Duration, sync_every: Duration) {
        self.loss_limits = Some((stretch, sync_every));
    }

    /// Bounds the errors of rotations, in degrees, where poses are not recorded exactly; `None` for the default.
    pub fn limit_angles(&mut self, degrees: Option<f64>) {
        self.angle_degrees = degrees;
    }

    /// Whether to record the residuals of markers too.
    pub fn record_residuals(&mut self, residuals: bool) {
        self.residuals = residuals;
    }

    /// States which axis points up, for devices that do not: takes then say it. One that does is believed.
    pub fn state_up_axis(&mut self, axis: UpAxis) {
        self.up_axis = axis;
    }

    /// The axis that points up, as the device states it, or else as it was stated for it.
    #[must_use]
    pub fn up_axis(&self) -> UpAxis {
        match UpAxis::from_code(self.hello.up_axis) {
            UpAxis::Unknown => self.up_axis,
            axis => axis,
        }
    }

    /// How the device identified itself.
    #[must_use]
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// The device's marker table.
    #[must_use]
    pub fn markers(&self) -> &[MarkerInfo] {
        &self.channels.markers
    }

    /// The device's groups of sampled channels.
    #[must_use]
    pub fn sampled(&self) -> &[SampledGroupInfo] {
        &self.channels.sampled
    }

    /// The device's force plates.
    #[must_use]
    pub fn plates(&self) -> &[ForcePlateInfo] {
        &self.channels.plates
    }

    /// The device's rigid bodies.
    #[must_use]
    pub fn bodies(&self) -> &[BodyInfo] {
        &self.channels.bodies
    }

    /// The frame rate in Hz.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        f64::from(self.hello.rate_millihertz) / 1000.0
    }

    /// The pipeline configuration for this device.
    #[must_use]
    pub fn pipeline_config(&self, codec: Settings) -> PipelineConfig {
        let channels = self.channels.markers.iter().enumerate().map(|(slot, marker)| Channel {
            marker_id: marker.id,
            label: if marker.label.is_empty() {
                Channel::unlabelled_name(slot)
            } else {
                marker.label.clone()
            },
            labelled: marker.labelled,
        });
        let new = PipelineConfig::new;
        let config = PipelineConfig {
            sampled: self.channels.sampled.clone(),
            bodies: self.channels.bodies.clone(),
            ..new(codec, self.rate_hz(), self.hello.tick_hz, channels.collect())
        };
        let angle = self.angle_degrees.filter(|_| config.pose_bounds.is_some());
        let chosen = angle.and_then(|angle| PoseBounds::new(codec.tolerance, angle).ok());
        let pose_bounds = chosen.or(config.pose_bounds);
        let config = PipelineConfig { pose_bounds, residuals: self.residuals, ..config };
        let config = match self.loss_limits {
            Some((stretch, sync_every)) => PipelineConfig { stretch, sync_every, ..config },
            None => config,
        };
        config.with_room_for(self.hello.markers_max.into())
    }

    /// The header of a take that starts now.
    ///
    /// # Errors
    /// When the system provides no random bytes.
    pub fn take_header(&self, config: &PipelineConfig) -> anyhow::Result<Header> {
        let device = Device {
            driver: self.family.to_owned(),
            uri: self.uri.to_string(),
            model: self.hello.model.clone(),
            serial: self.hello.serial.clone(),
            firmware: self.hello.firmware.clone(),
            tick_hz: self.hello.tick_hz,
            low_latency: self.transport.is_low_latency(),
        };
        let plates = self.channels.plates.iter().map(plate_setting);
        Ok(Header {
            up_axis: self.up_axis(),
            device: Some(device),
            channels: config.channels.clone(),
            stretch_rows: config.stretch_rows(),
            settings: [config.custom_times(), plates.collect()].concat(),
            ..header::new(&config.codec, config.rate_hz)?
        })
    }

    /// Sets the frame rate, before a start.
    ///
    /// # Errors
    /// When the device refuses the rate. The message states the rates it supports.
    pub fn set_rate(&mut self, rate_hz: f64) -> anyhow::Result<()> {
        self.try_set_rate(rate_hz, &|| false)
    }

    fn try_set_rate(&mut self, rate_hz: f64, cancel: &dyn Fn() -> bool) -> anyhow::Result<()> {
        let rate_millihertz = (rate_hz * 1000.0).round();
        if !(1.0..=4e9).contains(&rate_millihertz) {
            return Err(rate_error(&format!("cannot run a device at {rate_hz} Hz"), &self.hello));
        }
        let answer =
            self.request(Command::SetRate(rate_millihertz as u32), cancel, |event| match event {
                DeviceEvent::RateSet(set) => Some(Ok(set)),
                DeviceEvent::Refused(budget) => Some(Err(budget)),
                _ => None,
            })?;
        match answer {
            Ok(set) => self.hello.rate_millihertz = set,
            Err(budget) if !budget.fits() => return Err(too_slow(budget, rate_hz, &self.hello)),
            Err(_) => {
                return Err(rate_error(&format!("the device refuses {rate_hz} Hz"), &self.hello));
            }
        }
        Ok(())
    }

    /// Sends a command, and repeats it until `answer` recognises the answer or `cancel` returns true.
    fn request<T>(
        &mut self,
        command: Command,
        cancel: &dyn Fn() -> bool,
        mut answer: impl FnMut(DeviceEvent<'_>) -> Option<T>,
    ) -> anyhow::Result<T> {
        for _ in 0..ATTEMPTS_MAX {
            self.send(command)?;
            let sent_ns = monotonic_ns();
            while monotonic_ns() - sent_ns < ANSWER_TIMEOUT.as_nanos() as u64 {
                ensure!(!cancel(), "gave up waiting for {}", self.uri);
                let n = self.transport.read(&mut self.buffer).context("reading from the device")?;
                let mut found = None;
                self.protocol.push(&self.buffer[..n], &mut |event| {
                    found = found.take().or_else(|| answer(event));
                });
                if let Some(found) = found {
                    return Ok(found);
                }
            }
        }
        let counters = self.protocol.counters();
        if counters.messages == 0 && counters.bytes > 0 {
            bail!(
                "{} sends bytes that the driver {} does not understand: check the baud rate, \
                 or name the driver with ?driver=NAME",
                self.uri,
                self.family
            );
        }
        bail!(
            "{} does not answer: check that it is switched on, that the cable carries data, the baud rate, \
             and the driver (?driver=NAME)",
            self.uri
        )
    }

    fn send(&mut self, command: Command) -> Result<(), TransportError> {
        self.outbox.clear();
        self.protocol.command(command, &mut self.outbox);
        self.transport.write_all(&self.outbox)
    }
}

/// The error for an unsupported rate, which states the supported ones.
fn rate_error(why: &str, hello: &Hello) -> anyhow::Error {
    let [min_hz, max_hz] = [hello.rate_min_millihertz, hello.rate_max_millihertz]
        .map(|millihertz| f64::from(millihertz) / 1000.0);
    if min_hz < max_hz {
        return anyhow!("{why}: it supports {min_hz} to {max_hz} Hz");
    }
    let why = format!("{why}: it supports only {max_hz} Hz");
    SettingRefused { why, setting: Setting::Rate(None), alternative: "" }.into()
}

/// The error for a start that the device refused because its line is too slow.
fn too_slow(budget: LinkBudget, rate_hz: f64, hello: &Hello) -> anyhow::Error {
    let why = format!(
        "the line is too slow for {} Hz: the frames need {} bytes per second, the line carries {}",
        rate_hz, budget.needed_bytes_per_s, budget.available_bytes_per_s
    );
    if budget.rate_fits_millihertz < hello.rate_min_millihertz {
        return anyhow!("{why}; raise the baud rate on both ends, or use USB");
    }
    let setting = Setting::Rate(Some(f64::from(budget.rate_fits_millihertz) / 1000.0));
    SettingRefused { why, setting, alternative: ", or raise the baud rate on both ends" }.into()
}

impl Rig {
    fn identify(
        uri: DeviceUri,
        opened: OpenedDevice,
        raw_log: Option<RawLogTap>,
    ) -> anyhow::Result<Self> {
        let OpenedDevice { transport, protocol, family, identity } = opened;
        let mut rig = Self {
            uri,
            family,
            transport,
            protocol,
            buffer: vec![0; READ_BYTES],
            outbox: Vec::with_capacity(256),
            hello: Hello::default(),
            channels: DeviceChannels::default(),
            not_finite_before: 0,
            identity,
            replug_timeout: Duration::ZERO,
            loss_limits: None,
            angle_degrees: None,
            residuals: false,
            up_axis: UpAxis::Unknown,
            raw_log,
        };
        rig.query_identity(&|| false)?;
        Ok(rig)
    }

    /// Asks the device for its identity and marker table, also while it streams to an earlier host.
    pub(super) fn query_identity(&mut self, cancel: &dyn Fn() -> bool) -> anyhow::Result<()> {
        let damaged_before = self.protocol.counters().messages_damaged;
        for _ in 0..ATTEMPTS_MAX {
            // A device still streaming to an earlier host would delay the marker table.
            self.send(Command::Stop)?;
            let damaged = self.protocol.counters().messages_damaged;
            let mut hello = None;
            let mut channels = DeviceChannels::default();
            self.send(Command::Identify)?;
            let host_ns = monotonic_ns();
            self.request(Command::Ping { host_ns }, cancel, |event| {
                match event {
                    DeviceEvent::Hello(new) => {
                        hello = Some(new.clone());
                        channels = DeviceChannels::default();
                    }
                    DeviceEvent::Markers(more) => merge_markers(&mut channels.markers, more),
                    DeviceEvent::SampledGroup(group) => merge_group(&mut channels.sampled, group),
                    DeviceEvent::ForcePlate(plate) => merge_plate(&mut channels.plates, plate),
                    DeviceEvent::Bodies(bodies) => channels.bodies = bodies.to_vec(),
                    // The device answers in order: the pong comes after the answers to earlier commands.
                    DeviceEvent::Pong(pong) if pong.host_ns == host_ns => return Some(()),
                    _ => {}
                }
                None
            })?;
            if let Some(hello) = hello
                && self.protocol.counters().messages_damaged == damaged
            {
                self.hello = hello;
                // Takes and their ledgers have the groups in order of numbers, whatever the order of the answers.
                channels.sampled.sort_by_key(|group| group.id);
                channels.plates.sort_by_key(|plate| plate.number);
                self.channels = channels;
                return Ok(());
            }
        }
        if self.protocol.counters().messages_damaged == damaged_before {
            bail!(
                "{} answers but does not identify itself: it may be starting up, or one of its tools does not answer; \
                 wait, unplug its tools, and try again",
                self.uri
            );
        }
        bail!("{} answers, but its messages arrive damaged: check cable and baud rate", self.uri)
    }
}

/// Adds a group of sampled channels; of two with the same number the last description counts. There are as many numbers
/// as groups that the link allows.
fn merge_group(groups: &mut Vec<SampledGroupInfo>, new: &SampledGroupInfo) {
    match groups.iter_mut().find(|known| known.id == new.id) {
        Some(known) => known.clone_from(new),
        None => groups.push(new.clone()),
    }
}

/// Adds a force plate; of two with the same number the last description counts. There are as many numbers as plates that
/// the link allows.
fn merge_plate(plates: &mut Vec<ForcePlateInfo>, new: &ForcePlateInfo) {
    match plates.iter_mut().find(|known| known.number == new.number) {
        Some(known) => known.clone_from(new),
        None => plates.push(new.clone()),
    }
}

/// The setting of a take's header that states a force plate. One whose corners span no surface is stated, too: readers say
/// that it cannot be used.
fn plate_setting(plate: &ForcePlateInfo) -> (String, String) {
    let stated = StatedPlate {
        number: plate.number,
        code: plate.output.code(),
        group: plate.group.into(),
        channels: plate.channels.iter().map(|&index| index.into()).collect(),
        corners_mm: plate.corners_mm.map(|corner| corner.map(f64::from)),
        origin_mm: plate.origin_mm.map(f64::from),
    };
    stated.setting()
}

/// Merges markers into the table. Repeated commands repeat markers: the last description of an id counts.
fn merge_markers(table: &mut Vec<MarkerInfo>, new: &[MarkerInfo]) {
    for marker in new {
        match table.iter_mut().find(|known| known.id == marker.id) {
            Some(known) => known.clone_from(marker),
            None => table.push(marker.clone()),
        }
    }
}

/// An attached device.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct ListedDevice {
    /// The value for `record --device`.
    pub device: String,
    /// Its manufacturer, as the device states it.
    pub manufacturer: Option<String>,
    /// Its product name, as the device states it.
    pub product: Option<String>,
    /// Its serial number.
    pub serial: Option<String>,
    /// The driver for it; null when there is none.
    pub driver: Option<String>,
    /// Whether the device identified itself; false for a bare serial port, which may have anything behind it.
    pub certain: bool,
    /// Why it cannot be opened, and what to do.
    pub problem: Option<String>,
}

impl From<AttachedDevice> for ListedDevice {
    fn from(listed: AttachedDevice) -> Self {
        Self {
            device: listed.candidate.location.to_string(),
            manufacturer: listed.candidate.manufacturer,
            product: listed.candidate.product,
            serial: listed.candidate.serial,
            driver: listed.family.map(|family| family.0.to_owned()),
            certain: listed.family.is_some_and(|family| family.1 == Claim::Certain),
            problem: match listed.access {
                Access::Accessible => None,
                Access::Refused(error) => Some(error.to_string()),
            },
        }
    }
}

/// How long streams have to answer: LSL's own limit for answers by multicast.
const STREAMS_WAIT: Duration = Duration::from_millis(500);

/// The streams of the Lab Streaming Layer that answer; none where the system gives no network.
fn streams() -> Vec<ListedDevice> {
    let found = lsl::streams(STREAMS_WAIT).unwrap_or_default();
    found.iter().map(|stream| listed_stream(stream, &found)).collect()
}

fn listed_stream(stream: &FoundStream, all: &[FoundStream]) -> ListedDevice {
    let of = &stream.description;
    let uri = stream.uri_among(all);
    let problem = uri.is_none().then(|| {
        "another stream has the same name, type and source id: give them different source ids"
            .to_owned()
    });
    ListedDevice {
        device: uri.unwrap_or_else(|| format!("lsl:{}", of.name)),
        manufacturer: Some(of.hostname.clone()),
        product: Some(of.kind.clone()),
        serial: Some(of.source_id.clone()).filter(|id| !id.is_empty()),
        driver: Some("lsl".to_owned()),
        certain: true,
        problem,
    }
}

/// Lists the attached devices. It opens none of them.
///
/// # Errors
/// When the system cannot list its devices.
pub fn devices() -> Result<Vec<ListedDevice>, TransportError> {
    Ok(registry::devices()?.into_iter().map(ListedDevice::from).collect())
}

/// Searches the networks of this machine for servers of motion-capture systems and for streams. It connects to none of them. Where the
/// network cannot be asked, there are none.
#[must_use]
pub fn servers() -> Vec<ListedDevice> {
    registry::network_devices().into_iter().map(ListedDevice::from).chain(streams()).collect()
}
