mod frames;
mod talk;

use mocapd_drivers::device::{DeviceEvent, LinkBudget, Pong, Protocol};
use mocapd_drivers::link::{FrameForm, HostLink};
use mocapd_take::motion::is_gap;

use super::*;
use crate::generator::{JumpSpec, Occlusion};

const MS: u64 = 1_000_000;

/// What a host heard, in order.
#[derive(Debug, Clone, PartialEq)]
enum Heard {
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

/// A device and a host with a clock of their own.
struct Bench {
    device: Device,
    host: HostLink,
    now_ns: u64,
    heard: Vec<Heard>,
}

impl Bench {
    fn new(motion: Motion, settings: DeviceSettings) -> Self {
        let device = Device::new(motion, settings).unwrap();
        Self { device, host: HostLink::new(), now_ns: 5_000_000_123, heard: Vec::new() }
    }

    fn say(&mut self, command: Command) {
        let mut bytes = Vec::new();
        self.host.command(command, &mut bytes);
        // In pieces, as lines do.
        for piece in bytes.chunks(3) {
            self.device.on_bytes(piece, self.now_ns);
        }
    }

    /// The host reads all that waits.
    fn read(&mut self) {
        let bytes = self.device.pending().to_vec();
        self.device.sent(bytes.len());
        let heard = &mut self.heard;
        self.host.push(&bytes, &mut |event| {
            heard.push(match event {
                DeviceEvent::Hello(hello) => Heard::Hello(hello.clone()),
                DeviceEvent::Markers(markers) => Heard::Markers(markers.len()),
                DeviceEvent::Frame(frame) => Heard::Frame {
                    seq: frame.seq,
                    ticks: frame.device_ticks,
                    samples: frame.markers.to_vec(),
                },
                DeviceEvent::Status(status) => Heard::Status(status),
                DeviceEvent::Pong(pong) => Heard::Pong(pong),
                DeviceEvent::Started(budget) => Heard::Started(budget),
                DeviceEvent::Refused(budget) => Heard::Refused(budget),
                DeviceEvent::RateSet(rate) => Heard::RateSet(rate),
                DeviceEvent::Note(words) => panic!("the link protocol has no notes: {words}"),
                DeviceEvent::EndOfStream(status) => Heard::End(status),
                DeviceEvent::Trigger(_) => panic!("no trigger was pulled"),
            });
        });
        assert_eq!(self.host.counters().bytes_skipped, 0);
    }

    /// So much time passes; the device wakes when it asked to.
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
        self.heard
            .iter()
            .filter_map(|heard| match heard {
                Heard::Frame { seq, ticks, samples } => Some((*seq, *ticks, samples.clone())),
                _ => None,
            })
            .collect()
    }

    fn ends(&self) -> Vec<Status> {
        let end = |heard: &Heard| if let Heard::End(status) = heard { Some(*status) } else { None };
        self.heard.iter().filter_map(end).collect()
    }

    fn assert_books_close(&self) {
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
