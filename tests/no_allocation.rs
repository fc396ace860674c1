//! Nothing between a frame's bytes and its block on the way to disk allocates after the start.
//!
//! Every allocation of the process is counted, on every thread, so this is the only test of its binary.

#![expect(clippy::unwrap_used, reason = "a test stops where it fails")]
#![expect(unsafe_code, reason = "an allocator that counts is one by contract")]

use std::{
    alloc::{GlobalAlloc, Layout, System},
    io::{self, Write},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use mocapd_acquire::{
    header,
    pipeline::{Intake, NewTake, Pipeline, PipelineConfig, TakeOutput},
};
use mocapd_codec::{ResamplerKind, Settings, Tolerance};
use mocapd_drivers::{
    device::{
        BodyInfo, DeviceEvent, Frame, MarkerSample, Pose, PoseFrame, PoseStatus, Protocol,
        SampleBatch, SampledChannelInfo, SampledGroupInfo,
    },
    link::{DeviceLink, FrameForm, HostLink},
};
use mocapd_simulator::generator::{JumpSpec, Occlusion};
use mocapd_take::{
    chunk::types,
    motion::{Motion, is_gap},
};

struct Counting;

static ALLOCATIONS: AtomicU64 = AtomicU64::new(0);

// SAFETY: every call is forwarded unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller's promises are the ones this needs.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promises are the ones this needs.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller's promises are the ones this needs.
        unsafe { System.realloc(pointer, layout, new_size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Counts the stretches and the blocks of samples written, so that the test knows when the pipeline is idle, and the
/// ledgers.
struct CountingSink([Arc<AtomicU64>; 3]);

impl Write for CountingSink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let counted = [types::STRETCH, types::SAMPLES, types::LEDGER];
        for (count, kind) in self.0.iter().zip(counted) {
            count.fetch_add(u64::from(bytes[0] == kind), Ordering::Relaxed);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl TakeOutput for CountingSink {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}

const RATE_HZ: f64 = 240.0;
const TICK_HZ: u64 = 240;

/// Samples of a channel in each frame: 2400 Hz.
const SAMPLES_EACH: u64 = 10;

/// A group of 20 sampled channels.
fn group() -> SampledGroupInfo {
    let channel = SampledChannelInfo { name: "EMG".to_owned(), scale: 1.0, ..Default::default() };
    SampledGroupInfo {
        rate_millihertz: 2_400_000,
        channels: vec![channel; 20],
        ..SampledGroupInfo::default()
    }
}

/// Rigid bodies of two groups.
const N_BODIES: u16 = 9;

/// Groups with samples: that of the sampled channels, two of poses, and two of residuals.
const N_GROUPS: u64 = 5;

/// The bytes of frames `from..to`, and of a batch of samples and of poses for each, as a pty would bring them.
fn wire(motion: &Motion, from: usize, to: usize) -> Vec<u8> {
    let mut link = DeviceLink::new();
    let mut out = Vec::new();
    for seq in from..to {
        let sample = |(id, &position_mm): (usize, &[f32; 3])| MarkerSample {
            id: id as u16,
            occluded: is_gap(position_mm),
            residual_10um: ((seq * 7 + id) % 40) as u8,
            position_mm,
        };
        let markers: Vec<_> = motion.frame(seq).iter().enumerate().map(sample).collect();
        let frame =
            Frame { seq: seq as u32, device_ticks: seq as u64, timecode: None, markers: &markers };
        link.frame(FrameForm::Float, &frame, &mut out).unwrap();
        let first = seq as u64 * SAMPLES_EACH;
        let sample = |i: u64| f32::from((i.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 55) as u16);
        let samples: Vec<f32> = (first * 20..(first + SAMPLES_EACH) * 20).map(sample).collect();
        let batch = SampleBatch {
            group: 0,
            number: seq as u32,
            first,
            device_ticks: seq as u64,
            form: Default::default(),
            n_channels: 20,
            samples: &samples,
        };
        link.samples(&batch, &mut out).unwrap();
        let pose = |body: u16| Pose {
            body,
            status: if (seq as u16 + body) % 50 < 3 {
                PoseStatus::Lost
            } else {
                PoseStatus::Tracked
            },
            position_mm: [seq as f32 * 1.3, f32::from(body), 900.0],
            quaternion: [0.6, 0.0, -0.8, 0.0],
            residual_mm: 0.25,
        };
        let poses: Vec<Pose> = (0..N_BODIES).map(pose).collect();
        let (seq, device_ticks) = (seq as u32, seq as u64);
        let frame = PoseFrame { seq, number: seq, device_ticks, poses: &poses };
        link.poses(&frame, &mut out).unwrap();
    }
    out
}

fn feed(link: &mut HostLink, intake: &mut Intake, bytes: &[u8]) {
    for piece in bytes.chunks(4095) {
        link.push(piece, &mut |event| {
            while intake.is_full() {
                std::thread::yield_now();
            }
            match event {
                DeviceEvent::Frame(frame) => {
                    intake.frame(&frame, frame.device_ticks * 1_000_000_000 / TICK_HZ);
                }
                DeviceEvent::Samples(batch) => intake.samples(&batch),
                DeviceEvent::Poses(frame) => intake.poses(&frame),
                _ => {}
            }
        });
    }
}

fn wait_for(chunks: &AtomicU64, wanted: u64) {
    let since = Instant::now();
    while chunks.load(Ordering::Relaxed) < wanted {
        assert!(since.elapsed() < Duration::from_secs(60), "the pipeline stands still");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Waits for stretches, and as many blocks of each group.
fn wait_for_stretches([stretches, samples, _]: &[Arc<AtomicU64>; 3], wanted: u64) {
    wait_for(stretches, wanted);
    wait_for(samples, wanted * N_GROUPS);
}

/// The allocations of all threads while the measured frames are recorded, and the ledgers written meanwhile.
fn allocations(
    kind: ResamplerKind,
    motion: &Motion,
    warm_up: &[u8],
    measured: &[u8],
) -> (u64, u64) {
    let codec = Settings { kind, tolerance: Tolerance::from_mm(0.5).unwrap() };
    let channels = header::channels(&motion.info.markers);
    let config = PipelineConfig {
        sampled: vec![group()],
        bodies: (0..N_BODIES).map(|id| BodyInfo { id, name: String::new() }).collect(),
        residuals: true,
        ..PipelineConfig::new(codec, RATE_HZ, TICK_HZ, channels)
    };
    let mut header = header::new(&codec, RATE_HZ).unwrap();
    header.channels.clone_from(&config.channels);
    let written_chunks: [Arc<AtomicU64>; 3] = Default::default();
    let (mut intake, pipeline) =
        Pipeline::start(&config, NewTake::new(CountingSink(written_chunks.clone()), header))
            .unwrap();
    let mut link = HostLink::new();

    feed(&mut link, &mut intake, warm_up);
    wait_for_stretches(&written_chunks, 5);
    // The channels allocate per thread at its first wait: let every thread wait once.
    std::thread::sleep(Duration::from_millis(300));
    let ledgers_before = written_chunks[2].load(Ordering::Relaxed);
    let before = ALLOCATIONS.load(Ordering::Relaxed);
    feed(&mut link, &mut intake, measured);
    wait_for_stretches(&written_chunks, 25);
    let allocations = ALLOCATIONS.load(Ordering::Relaxed) - before;
    let ledgers = written_chunks[2].load(Ordering::Relaxed) - ledgers_before;

    intake.finish();
    let (written, _) = pipeline.finish().unwrap();
    assert_eq!(written.ledger.recorded, 504 + 20 * 120);
    let groups = written.sample_ledger.unwrap().groups;
    let stored: Vec<_> = groups.iter().map(|group| (group.stored, group.lost())).collect();
    let frames = 504 + 20 * 120;
    let of_frames = [(frames, 0); 4];
    assert_eq!(stored, [&[(frames * SAMPLES_EACH, 0)][..], &of_frames].concat());
    (allocations, ledgers)
}

#[test]
fn the_sample_path_does_not_allocate_after_the_start() {
    let occlusion = Some(Occlusion { fraction: 0.1, mean_gap_s: 0.1 });
    let spec =
        JumpSpec { seconds: Some(14.0), n_markers: 70, occlusion, ..JumpSpec::new(1, RATE_HZ) };
    let motion = spec.generate().unwrap().motion;
    // The first stretch has 24 rows, the others 120; the 1st and the 20th are key stretches.
    let (warm_up, measured) = (wire(&motion, 0, 24 + 4 * 120), wire(&motion, 504, 504 + 20 * 120));
    for kind in [
        ResamplerKind::Dense,
        ResamplerKind::Fast,
        ResamplerKind::Lossless,
        ResamplerKind::LosslessPredictive,
    ] {
        // A ledger allocates. The second one is written five seconds after the first: on a busy machine that may be here.
        let results = (0..5).map(|_| allocations(kind, &motion, &warm_up, &measured));
        let without_ledger = results.into_iter().find(|&(_, ledgers)| ledgers == 0);
        let n = without_ledger.map(|(allocations, _)| allocations);
        assert_eq!(
            n,
            Some(0),
            "{kind}: 2400 frames of 70 markers, 20 sampled channels, 9 bodies and residuals"
        );
    }
}
