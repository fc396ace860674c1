//! Settings of a simulated device, the rates that follow from them, and their errors.

use std::sync::Arc;

use mocapd_drivers::link::FrameForm;
use mocapd_take::motion::Motion;

use super::SECOND_NS;
use crate::faults::Script;
use crate::generator::RigidBodies;
use crate::sampled::SampledSource;
use crate::source::{Replay, Residuals};

/// Frame rates of a simulated device, in millihertz: 1 Hz to 10 kHz.
pub const RATE_MILLIHERTZ: std::ops::RangeInclusive<u32> = 1_000..=10_000_000;

/// Ticks per second of the device's clock: one every 100 ns, a whole number of nanoseconds.
pub const TICK_HZ: u64 = 10_000_000;

/// How the device plays its motion.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceSettings {
    /// Serial number in Hello.
    pub serial: String,
    /// Resample the motion to this rate, Hz; `None` keeps the recorded rate.
    pub rate_hz: Option<f64>,
    /// Playback speed, 0.001 to 1000, rounded to 0.001. It multiplies the rate in Hello.
    pub speed: f64,
    /// Restart after the last frame, and never end.
    pub looping: bool,
    /// Encoding of positions in frames.
    pub form: FrameForm,
    /// Capacity of the line, bytes per second; 0 for unlimited.
    pub line_bytes_per_s: u64,
    /// Drift of the device's clock against the caller's, parts per million, -100 000 to 100 000. A positive drift makes
    /// the clock slow; recorders report the same number.
    pub drift_ppm: f64,
    /// Size of the queue of frames for a host that does not read; `None` for one second of frames, at most 4 MiB.
    pub queue_bytes: Option<usize>,
    /// Groups of sampled channels.
    pub sampled: Vec<SampledSource>,
    /// Rigid bodies, whose poses follow each frame.
    pub bodies: Option<Arc<RigidBodies>>,
    /// The residuals of the motion's markers; `None` for a device that reports none.
    pub residuals: Option<Arc<Residuals>>,
    /// Faults inside the device. [`FaultyDevice`](crate::faults::FaultyDevice) applies those of wire and connection.
    pub faults: Option<Arc<Script>>,
    /// Keep a [`SentFrame`](super::SentFrame) for every frame; the caller must take them regularly.
    pub log_frames: bool,
}

impl Default for DeviceSettings {
    fn default() -> Self {
        Self {
            serial: "SIM0001".to_owned(),
            rate_hz: None,
            speed: 1.0,
            looping: false,
            form: FrameForm::Float,
            line_bytes_per_s: 0,
            drift_ppm: 0.0,
            queue_bytes: None,
            sampled: Vec::new(),
            bodies: None,
            residuals: None,
            faults: None,
            log_frames: false,
        }
    }
}

/// Why a device cannot be created from a motion and settings.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DeviceError {
    /// The motion has no markers.
    #[error("the motion has no markers: choose a file with at least one")]
    NoMarkers,
    /// The motion has no frames.
    #[error("the motion has no frames: choose another file")]
    NoFrames,
    /// More markers than the link carries.
    #[error("{found} markers, but the link carries at most {max}: choose a file with fewer")]
    TooManyMarkers {
        /// Markers of the motion, with the ghosts of the fault script.
        found: usize,
        /// The link's limit.
        max: usize,
    },
    /// The motion's own rate is out of range.
    #[error("the motion's rate is {found_hz} Hz, expected 1 to 10000: choose another file")]
    MotionRate {
        /// The rate in the file, Hz.
        found_hz: f64,
    },
    /// The requested rate is out of range.
    #[error("rate {found_hz} Hz is out of range: expected 1 to 10000")]
    Rate {
        /// The requested rate, Hz.
        found_hz: f64,
    },
    /// The requested speed is out of range.
    #[error("speed {found} is out of range: expected 0.001 to 1000")]
    Speed {
        /// The requested speed.
        found: f64,
    },
    /// The requested clock drift is out of range.
    #[error("drift {found_ppm} ppm is out of range: expected -100000 to 100000")]
    Drift {
        /// The requested drift, parts per million.
        found_ppm: f64,
    },
    /// Rate times speed is out of range.
    #[error(
        "{rate_hz} Hz at speed {speed} would be {product_hz} Hz, expected 1 to 10000: choose another speed or rate"
    )]
    Product {
        /// The rate before the speed is applied, Hz.
        rate_hz: f64,
        /// The speed.
        speed: f64,
        /// Their product, Hz.
        product_hz: f64,
    },
    /// The link cannot carry a text.
    #[error(transparent)]
    Encode(#[from] mocapd_drivers::link::EncodeError),
}

/// The rates that follow from a motion, a requested rate and a speed, in millihertz.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rates {
    /// The recorded rate.
    recorded_millihertz: u32,
    /// Recorded rate times speed: the rate that plays every recorded frame unchanged. `None` when it is out of range
    /// but another rate was requested.
    native_millihertz: Option<u32>,
    /// The initial rate.
    pub(crate) rate_millihertz: u32,
    /// Speed in thousandths.
    speed_milli: u64,
}

impl Rates {
    pub(crate) fn new(motion: &Motion, hz: Option<f64>, speed: f64) -> Result<Self, DeviceError> {
        let found_hz = motion.info.rate_hz;
        let recorded_millihertz =
            to_millihertz(found_hz).ok_or(DeviceError::MotionRate { found_hz })?;
        if !(0.001..=1000.0).contains(&speed) {
            return Err(DeviceError::Speed { found: speed });
        }
        let speed_milli = (speed * 1000.0).round() as u64;
        let faster = |rate_millihertz: u32| {
            let product_hz = f64::from(rate_millihertz) * speed_milli as f64 / 1e6;
            let rate_hz = f64::from(rate_millihertz) / 1000.0;
            to_millihertz(product_hz).ok_or(DeviceError::Product { rate_hz, speed, product_hz })
        };
        let (native_millihertz, rate_millihertz) = match hz {
            None => faster(recorded_millihertz).map(|native| (Some(native), native))?,
            Some(found_hz) => {
                let requested = to_millihertz(found_hz).ok_or(DeviceError::Rate { found_hz })?;
                (faster(recorded_millihertz).ok(), faster(requested)?)
            }
        };
        Ok(Self { recorded_millihertz, native_millihertz, rate_millihertz, speed_milli })
    }

    /// The motion, resampled to a rate in [`RATE_MILLIHERTZ`].
    pub(crate) fn replay(&self, motion: Arc<Motion>, rate_millihertz: u32) -> Replay {
        let recorded = u64::from(self.recorded_millihertz) * self.speed_milli;
        let resampled = || {
            Replay::resampled(Arc::clone(&motion), recorded, u64::from(rate_millihertz) * 1000)
                .filter(|_| Some(rate_millihertz) != self.native_millihertz)
        };
        resampled().unwrap_or_else(|| Replay::native(motion))
    }
}

/// Rounds to millihertz; `None` outside [`RATE_MILLIHERTZ`].
fn to_millihertz(rate_hz: f64) -> Option<u32> {
    let rate = (rate_hz * 1000.0).round();
    let range = f64::from(*RATE_MILLIHERTZ.start())..=f64::from(*RATE_MILLIHERTZ.end());
    range.contains(&rate).then_some(rate as u32)
}

/// Time from the first frame to frame `number`, nanoseconds of the device's clock.
pub(crate) fn frame_after_ns(number: u64, rate_millihertz: u32) -> u64 {
    let ns = u128::from(number) * 1000 * u128::from(SECOND_NS) / u128::from(rate_millihertz.max(1));
    u64::try_from(ns).unwrap_or(u64::MAX)
}
