//! The rates of a device: as recorded, as played, as asked for.

use mocapd_take::motion::Motion;

use super::{DeviceError, DeviceSettings, RATE_MHZ};

/// Rates in millihertz that fit each other.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rates {
    /// Of the recording.
    pub(crate) recorded_mhz: u32,
    /// Of the recording, times the speed: the rate at which every recorded frame is played as it is. `None` when
    /// the device cannot run at it, and another one was asked for.
    pub(crate) native_mhz: Option<u32>,
    /// The one to begin with.
    pub(crate) rate_mhz: u32,
    /// The speed in thousandths.
    pub(crate) speed_milli: u64,
}

impl Rates {
    pub(crate) fn new(motion: &Motion, settings: &DeviceSettings) -> Result<Self, DeviceError> {
        let found_hz = motion.info.rate_hz;
        let recorded_mhz = to_mhz(found_hz).ok_or(DeviceError::MotionRate { found_hz })?;
        let speed = settings.speed;
        if !(0.001..=1000.0).contains(&speed) {
            return Err(DeviceError::Speed { found: speed });
        }
        let speed_milli = (speed * 1000.0).round() as u64;
        let faster = |rate_mhz: u32| {
            let product_hz = f64::from(rate_mhz) * speed_milli as f64 / 1e6;
            let rate_hz = f64::from(rate_mhz) / 1000.0;
            to_mhz(product_hz).ok_or(DeviceError::Product { rate_hz, speed, product_hz })
        };
        let (native_mhz, rate_mhz) = match settings.rate_hz {
            None => faster(recorded_mhz).map(|native| (Some(native), native))?,
            Some(found_hz) => {
                let asked = to_mhz(found_hz).ok_or(DeviceError::Rate { found_hz })?;
                (faster(recorded_mhz).ok(), faster(asked)?)
            }
        };
        Ok(Self { recorded_mhz, native_mhz, rate_mhz, speed_milli })
    }
}

/// To the nearest millihertz, when a device can run at it.
fn to_mhz(rate_hz: f64) -> Option<u32> {
    let mhz = (rate_hz * 1000.0).round();
    (f64::from(*RATE_MHZ.start())..=f64::from(*RATE_MHZ.end())).contains(&mhz).then_some(mhz as u32)
}
