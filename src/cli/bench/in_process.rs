//! The pipeline alone: frames from memory, stretches to nowhere.

use std::{io, time::Instant};

use mocapd_acquire::{
    header,
    pipeline::{Pipeline, PipelineConfig},
};
use mocapd_codec::Settings;
use mocapd_drivers::{
    device::{DeviceEvent, Frame, MarkerSample, Protocol},
    link::{DeviceLink, FrameForm, HostLink},
};
use mocapd_simulator::device::TICK_HZ;
use mocapd_take::motion::{Motion, is_gap};

use super::reference::copy_gb_per_s;

/// What one run gave.
#[derive(Debug, Clone)]
pub(super) struct Run {
    pub(super) times_real_time: f64,
    pub(super) copy_gb_per_s: f64,
    pub(super) wire_bytes: u64,
    pub(super) frames_lost: u64,
}

/// The frames of `motion` as they would come over the wire.
pub(super) fn wire(motion: &Motion) -> anyhow::Result<Vec<u8>> {
    let mut link = DeviceLink::new();
    let mut out = Vec::new();
    for index in 0..motion.n_frames() {
        let markers: Vec<_> = motion.frame(index).iter().enumerate().map(sample).collect();
        let ticks = (index as f64 * TICK_HZ as f64 / motion.info.rate_hz).round() as u64;
        let frame =
            Frame { seq: index as u32, device_ticks: ticks, timecode: None, markers: &markers };
        link.frame(FrameForm::Float, &frame, &mut out)?;
    }
    Ok(out)
}

fn sample((column, &position_mm): (usize, &[f32; 3])) -> MarkerSample {
    let occluded = is_gap(position_mm);
    MarkerSample { id: column as u16, occluded, position_mm, ..MarkerSample::default() }
}

/// Feeds `wire` as fast as the rings take it: a full ring is waited for here, not a loss.
pub(super) fn run(motion: &Motion, wire: &[u8], codec: Settings) -> anyhow::Result<Run> {
    let copy_gb_per_s = copy_gb_per_s(wire);
    let rate_hz = motion.info.rate_hz;
    let config =
        PipelineConfig::new(codec, rate_hz, TICK_HZ, header::channels(&motion.info.markers));
    let mut header = header::new(&codec, rate_hz)?;
    header.channels.clone_from(&config.channels);
    let (mut intake, pipeline) = Pipeline::start(&config, &header, io::sink())?;
    let mut link = HostLink::new();
    let started = Instant::now();
    // As a pty gives them.
    for bytes in wire.chunks(4095) {
        link.push(bytes, &mut |event| {
            if let DeviceEvent::Frame(frame) = event {
                while intake.is_full() {
                    std::thread::yield_now();
                }
                intake.frame(&frame, started.elapsed().as_nanos() as u64);
            }
        });
    }
    intake.link(link.counters());
    intake.finish();
    let (written, _) = pipeline.finish()?;
    let seconds = started.elapsed().as_secs_f64();
    Ok(Run {
        times_real_time: motion.n_frames() as f64 / rate_hz / seconds,
        copy_gb_per_s,
        wire_bytes: wire.len() as u64,
        frames_lost: motion.n_frames() as u64 - written.ledger.recorded,
    })
}
