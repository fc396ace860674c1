mod clock;
mod commands;
mod frames;
mod poses;
mod samples;

use mocapd_drivers::device::{
    BodyInfo, DeviceEvent, ForcePlateInfo, LinkBudget, Pong, Protocol, SampledGroupInfo,
};
use mocapd_drivers::link::{FrameForm, HostLink};
use mocapd_take::motion::is_gap;

use super::*;
use crate::generator::{JumpSpec, Occlusion};

const MS: u64 = 1_000_000;

/// A message that the host received.
#[derive(Debug, Clone, PartialEq)]
enum Event {
    Group(SampledGroupInfo),
    Plate(ForcePlateInfo),
    Samples(SentSamples),
    Bodies(Vec<BodyInfo>),
    Poses(SentPoses),
    EndOfPoses(u32, u32),
    Hello(Hello),
    Markers(usize),
    Frame { seq: u32, ticks: u64, samples: Vec<MarkerSample> },
    Status(Status),
    Pong(Pong),
    Started(LinkBudget),
    Refused(LinkBudget),
    RateSet(u32),
    End(Status),
}

/// A batch as received.
#[derive(Debug, Clone, PartialEq)]
struct SentSamples {
    group: u8,
    number: u32,
    first: u64,
    ticks: u64,
    samples: Vec<f32>,
}

/// Poses as received.
#[derive(Debug, Clone, PartialEq)]
struct SentPoses {
    seq: u32,
    number: u32,
    ticks: u64,
    poses: Vec<Pose>,
}

/// A device and a host in virtual time.
struct Bench {
    device: Device,
    host: HostLink,
    now_ns: u64,
    events: Vec<Event>,
}

impl Bench {
    fn new(motion: Motion, settings: DeviceSettings) -> Self {
        let device = Device::new(motion, settings).unwrap();
        Self { device, host: HostLink::new(), now_ns: 5_000_000_123, events: Vec::new() }
    }

    fn send(&mut self, command: Command) {
        let mut bytes = Vec::new();
        self.host.command(command, &mut bytes);
        // In pieces, as lines deliver it.
        for piece in bytes.chunks(3) {
            self.device.on_bytes(piece, self.now_ns);
        }
    }

    /// The host reads all pending bytes.
    fn read(&mut self) {
        let bytes = self.device.pending().to_vec();
        self.device.sent(bytes.len());
        let events = &mut self.events;
        self.host.push(&bytes, &mut |event| {
            events.push(match event {
                DeviceEvent::Hello(hello) => Event::Hello(hello.clone()),
                DeviceEvent::Markers(markers) => Event::Markers(markers.len()),
                DeviceEvent::Frame(frame) => Event::Frame {
                    seq: frame.seq,
                    ticks: frame.device_ticks,
                    samples: frame.markers.to_vec(),
                },
                DeviceEvent::SampledGroup(group) => Event::Group(group.clone()),
                DeviceEvent::ForcePlate(plate) => Event::Plate(plate.clone()),
                DeviceEvent::Samples(batch) => Event::Samples(SentSamples {
                    group: batch.group,
                    number: batch.number,
                    first: batch.first,
                    ticks: batch.device_ticks,
                    samples: batch.samples.to_vec(),
                }),
                DeviceEvent::Bodies(bodies) => Event::Bodies(bodies.to_vec()),
                DeviceEvent::Poses(frame) => Event::Poses(SentPoses {
                    seq: frame.seq,
                    number: frame.number,
                    ticks: frame.device_ticks,
                    poses: frame.poses.to_vec(),
                }),
                DeviceEvent::EndOfPoses(end) => Event::EndOfPoses(end.seq, end.number),
                DeviceEvent::Status(status) => Event::Status(status),
                DeviceEvent::Pong(pong) => Event::Pong(pong),
                DeviceEvent::Started(budget) => Event::Started(budget),
                DeviceEvent::Refused(budget) => Event::Refused(budget),
                DeviceEvent::RateSet(rate) => Event::RateSet(rate),
                DeviceEvent::Note(note) => panic!("the link protocol has no notes: {note}"),
                DeviceEvent::EndOfStream(status) => Event::End(status),
                DeviceEvent::Trigger(_) => panic!("no trigger was sent"),
                DeviceEvent::Mark(_) => panic!("the link protocol has no marks"),
            });
        });
        assert_eq!(self.host.counters().bytes_skipped, 0);
    }

    /// Advances the time; the device is polled whenever it asked to be.
    fn pass(&mut self, ns: u64, reading: bool) {
        let end_ns = self.now_ns + ns;
        loop {
            let next_ns = self.device.poll(self.now_ns);
            if reading {
                self.read();
            }
            if next_ns > end_ns {
                self.now_ns = end_ns;
                return;
            }
            self.now_ns = next_ns;
        }
    }

    fn frames(&self) -> Vec<(u32, u64, Vec<MarkerSample>)> {
        self.events
            .iter()
            .filter_map(|event| match event {
                Event::Frame { seq, ticks, samples } => Some((*seq, *ticks, samples.clone())),
                _ => None,
            })
            .collect()
    }

    fn ends(&self) -> Vec<Status> {
        let end = |event: &Event| if let Event::End(status) = event { Some(*status) } else { None };
        self.events.iter().filter_map(end).collect()
    }

    fn assert_counts_add_up(&self) {
        let log = self.device.log();
        let accounted =
            log.frames_sent + log.frames_waiting + log.frames_discarded + log.total.frames_dropped;
        assert_eq!(log.total.frames_produced, accounted, "{log:?}");
    }
}

fn start() -> Command {
    Command::Start { line_bytes_per_s: 0 }
}

fn jump(seconds: f64) -> Motion {
    let occlusion = Some(Occlusion { fraction: 0.1, mean_gap_s: 0.1 });
    let spec = JumpSpec { seconds: Some(seconds), occlusion, ..JumpSpec::new(8, 100.0) };
    spec.generate().unwrap().motion
}

fn row_of(samples: &[MarkerSample]) -> Vec<Option<Position>> {
    samples.iter().map(|s| (!s.occluded).then_some(s.position_mm)).collect()
}

fn expected(motion: &Motion, frame: usize) -> Vec<Option<Position>> {
    motion.frame(frame).iter().map(|p| (!is_gap(*p)).then_some(*p)).collect()
}
