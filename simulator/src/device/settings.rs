//! What a simulated device is told, the rates that come of it, and why it may refuse to be one.

use std::sync::Arc;

use mocapd_drivers::link::FrameForm;
use mocapd_take::motion::Motion;

use super::SECOND_NS;
use crate::faults::Script;
use crate::replay::Replay;

/// The rates a simulated device runs at, in millihertz: 1 Hz to 10 kHz.
pub const RATE_MHZ: std::ops::RangeInclusive<u32> = 1_000..=10_000_000;

/// Ticks a second of the device's clock: one every 100 ns, an integer of nanoseconds.
pub const TICK_HZ: u64 = 10_000_000;

/// How the device plays its motion.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceSettings {
    /// Serial number it gives.
    pub serial: String,
    /// Resample to this rate, Hz; `None` for the recorded one.
    pub rate_hz: Option<f64>,
    /// Times faster than it was recorded, 0.001 to 1000, to the nearest 0.001. It multiplies the rate that
    /// Hello gives.
    pub speed: f64,
    /// Begin again after the last frame, and never end.
    pub looping: bool,
    /// How positions travel.
    pub form: FrameForm,
    /// What the line carries in bytes a second; 0 when it is not limited.
    pub line_bytes_per_s: u64,
    /// How much slower than the caller's clock the device's runs, in parts per million: the host's drift, as a
    /// recorder tells it. Within 100 000 either way.
    pub drift_ppm: f64,
    /// Bytes of frames kept for a host that does not read; `None` for a second's worth, at most 4 MiB.
    pub queue_bytes: Option<usize>,
    /// What goes wrong inside the device; what goes wrong behind it is a
    /// [`FaultyDevice`](crate::faults::FaultyDevice)'s.
    pub faults: Option<Arc<Script>>,
    /// Keep a [`SentFrame`](super::SentFrame) for every frame. Whoever asks for them takes them away.
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
            faults: None,
            log_frames: false,
        }
    }
}

/// Why a motion cannot be a device.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DeviceError {
    /// Nothing to send.
    #[error("no markers: a device needs at least one, choose another file")]
    NoMarkers,
    /// Nothing to send.
    #[error("no frames: the motion is empty, choose another file")]
    NoFrames,
    /// More than the link carries.
    #[error("{found} markers are more than the link's {max}: choose a file with fewer")]
    TooManyMarkers {
        /// In the motion.
        found: usize,
        /// What the link's frames hold.
        max: usize,
    },
    /// The motion's own rate makes no device.
    #[error("the motion's rate is {found_hz} Hz, expected 1 to 10000: choose another file")]
    MotionRate {
        /// As the file has it.
        found_hz: f64,
    },
    /// The rate that was asked for.
    #[error("rate {found_hz} Hz is out of range: give 1 to 10000")]
    Rate {
        /// As it was given.
        found_hz: f64,
    },
    /// The speed that was asked for.
    #[error("speed {found} is out of range: give 0.001 to 1000")]
    Speed {
        /// As it was given.
        found: f64,
    },
    /// The drift that was asked for.
    #[error("drift {found_ppm} ppm is out of range: give -100000 to 100000")]
    Drift {
        /// As it was given.
        found_ppm: f64,
    },
    /// Rate times speed.
    #[error(
        "{rate_hz} Hz at speed {speed} would be {product_hz} Hz, expected 1 to 10000: change the speed or give a rate"
    )]
    Product {
        /// Before the speed.
        rate_hz: f64,
        /// The factor.
        speed: f64,
        /// The rate that the device would have.
        product_hz: f64,
    },
    /// A text that the link cannot carry.
    #[error(transparent)]
    Encode(#[from] mocapd_drivers::link::EncodeError),
}

/// Rates in millihertz that fit each other.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rates {
    /// Of the recording.
    recorded_mhz: u32,
    /// Of the recording, times the speed: the rate at which every recorded frame is played as it is. `None` when
    /// the device cannot run at it, and another one was asked for.
    native_mhz: Option<u32>,
    /// The one to begin with.
    pub(crate) rate_mhz: u32,
    /// The speed in thousandths.
    speed_milli: u64,
}

impl Rates {
    pub(crate) fn new(
        motion: &Motion,
        wanted_hz: Option<f64>,
        speed: f64,
    ) -> Result<Self, DeviceError> {
        let found_hz = motion.info.rate_hz;
        let recorded_mhz = to_mhz(found_hz).ok_or(DeviceError::MotionRate { found_hz })?;
        if !(0.001..=1000.0).contains(&speed) {
            return Err(DeviceError::Speed { found: speed });
        }
        let speed_milli = (speed * 1000.0).round() as u64;
        let faster = |rate_mhz: u32| {
            let product_hz = f64::from(rate_mhz) * speed_milli as f64 / 1e6;
            let rate_hz = f64::from(rate_mhz) / 1000.0;
            to_mhz(product_hz).ok_or(DeviceError::Product { rate_hz, speed, product_hz })
        };
        let (native_mhz, rate_mhz) = match wanted_hz {
            None => faster(recorded_mhz).map(|native| (Some(native), native))?,
            Some(found_hz) => {
                let asked = to_mhz(found_hz).ok_or(DeviceError::Rate { found_hz })?;
                (faster(recorded_mhz).ok(), faster(asked)?)
            }
        };
        Ok(Self { recorded_mhz, native_mhz, rate_mhz, speed_milli })
    }

    /// The motion at a rate that the device can run at.
    pub(crate) fn replay(&self, motion: Arc<Motion>, rate_mhz: u32) -> Replay {
        let recorded = u64::from(self.recorded_mhz) * self.speed_milli;
        let resampled = || {
            Replay::resampled(Arc::clone(&motion), recorded, u64::from(rate_mhz) * 1000)
                .filter(|_| Some(rate_mhz) != self.native_mhz)
        };
        resampled().unwrap_or_else(|| Replay::native(motion))
    }
}

/// To the nearest millihertz, when a device can run at it.
fn to_mhz(rate_hz: f64) -> Option<u32> {
    let mhz = (rate_hz * 1000.0).round();
    (f64::from(*RATE_MHZ.start())..=f64::from(*RATE_MHZ.end())).contains(&mhz).then_some(mhz as u32)
}

/// When a frame is due after the first, by the device's clock.
pub(crate) fn frame_after_ns(number: u64, rate_mhz: u32) -> u64 {
    let after = u128::from(number) * 1000 * u128::from(SECOND_NS) / u128::from(rate_mhz.max(1));
    u64::try_from(after).unwrap_or(u64::MAX)
}
