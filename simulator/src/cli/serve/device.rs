//! Builds the device from the options.

use std::sync::Arc;

use mocapd_drivers::link::FrameForm;
use mocapd_simulator::device::{Device, DeviceError, DeviceSettings, LineDevice};
use mocapd_simulator::faults::{FaultyDevice, Script};
use mocapd_simulator::ndi::{NdiDevice, NdiError, NdiSettings};
use mocapd_take::motion::Motion;

use super::{DeviceProtocol, ServeArgs, WireFormat};
use crate::cli::{Failure, notify};

/// The device, and its description.
pub(super) fn device(
    args: &ServeArgs,
    motion: Motion,
    script: Option<Arc<Script>>,
) -> Result<(Box<dyn LineDevice>, String), Failure> {
    let usage = |message: &str| Err(Failure::usage_message(message));
    let n_markers = motion.info.markers.len();
    let (device, rate_millihertz): (Box<dyn LineDevice>, u32) = match args.protocol {
        DeviceProtocol::Dvmc if !args.tool.is_empty() || args.no_bx2 => {
            return usage("--tool and --no-bx2 need an NDI system: add --protocol ndi");
        }
        DeviceProtocol::Ndi if args.wire.is_some() => {
            return usage("--wire applies to the link protocol only: an NDI system sends f32");
        }
        DeviceProtocol::Ndi if script.is_some() => {
            return usage("--faults applies to the link protocol only: remove --protocol ndi");
        }
        DeviceProtocol::Dvmc => {
            let settings = DeviceSettings { faults: script.clone(), ..settings(args) };
            let device = Device::new(motion, settings).map_err(refused)?;
            device.warnings().iter().for_each(|warning| notify(warning));
            let rate_millihertz = device.hello().rate_millihertz;
            match script {
                Some(script) => (Box::new(FaultyDevice::new(device, &script)), rate_millihertz),
                None => (Box::new(device), rate_millihertz),
            }
        }
        DeviceProtocol::Ndi if args.drift_ppm != 0.0 => {
            return usage(
                "--drift-ppm needs the link protocol: the NDI system keeps the host's time",
            );
        }
        DeviceProtocol::Ndi => {
            let device = NdiDevice::new(motion, ndi_settings(args)).map_err(ndi_refused)?;
            device.warnings().iter().for_each(|warning| notify(warning));
            let rate_millihertz = device.rate_millihertz();
            (Box::new(device), rate_millihertz)
        }
    };
    let hz = f64::from(rate_millihertz) / 1000.0;
    Ok((device, format!("{n_markers} markers at {hz} Hz, Ctrl-C to stop")))
}

fn settings(args: &ServeArgs) -> DeviceSettings {
    let form = match (args.wire, args.baud) {
        (Some(WireFormat::F32), _) | (None, None) => FrameForm::Float,
        (Some(WireFormat::Um), _) => FrameForm::Micrometres,
        (Some(WireFormat::Compact), _) | (None, Some(_)) => FrameForm::Compact,
    };
    DeviceSettings {
        serial: args.serial.clone(),
        rate_hz: args.rate,
        speed: args.speed,
        drift_ppm: args.drift_ppm,
        looping: args.looping,
        form,
        line_bytes_per_s: args.baud.map_or(0, |baud| u64::from(baud) / 10),
        ..DeviceSettings::default()
    }
}

fn ndi_settings(args: &ServeArgs) -> NdiSettings {
    let settings = NdiSettings::default();
    NdiSettings {
        serial: args.serial.clone(),
        rate_hz: args.rate,
        speed: args.speed,
        looping: args.looping,
        tools: args.tool.clone(),
        bx2: !args.no_bx2,
        baud_max: args.baud.unwrap_or(settings.baud_max),
    }
}

fn ndi_refused(error: NdiError) -> Failure {
    match error {
        NdiError::Device(error) => refused(error),
        NdiError::NoSuchTool { .. } | NdiError::TooManyTools { .. } => Failure::usage(error),
        _ => Failure::from(error),
    }
}

/// A bad value on the command line is a usage error; bad content of a file is not.
fn refused(error: DeviceError) -> Failure {
    match error {
        DeviceError::Rate { .. }
        | DeviceError::Speed { .. }
        | DeviceError::Product { .. }
        | DeviceError::Drift { .. } => Failure::usage(error),
        _ => Failure::from(error),
    }
}
