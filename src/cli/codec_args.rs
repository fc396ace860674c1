//! `--tolerance`, `--lossless`, `--resampler`: the same on every command that codes.

use clap::Args;
use mocapd::{outcome::UsageError, units};
use mocapd_codec::{ResamplerKind, Settings, Tolerance};

/// Half a millimetre: five to fifteen times the noise of an optical rig, and 2.5 times smaller files
/// than a tenth.
const DEFAULT_TOLERANCE: &str = "0.5mm";

#[derive(Debug, Args)]
pub(crate) struct CodecArgs {
    /// Largest distance between a sample and its reconstruction: 0.5mm, 100um, 2cm
    #[arg(long, value_name = "LENGTH", default_value = DEFAULT_TOLERANCE,
          value_parser = units::tolerance, allow_hyphen_values = true)]
    tolerance: Tolerance,
    /// Keep every bit
    #[arg(long, conflicts_with_all = ["tolerance", "resampler"])]
    lossless: bool,
    /// dense, fast, lossless, spline[:worst-sample|:exhaustive], sync[:worst-sample|:exhaustive]
    #[arg(long, value_name = "NAME", default_value = "dense", value_parser = str::parse::<ResamplerKind>)]
    resampler: ResamplerKind,
}

impl CodecArgs {
    pub(crate) fn settings(&self) -> Settings {
        let kind = if self.lossless { ResamplerKind::Lossless } else { self.resampler };
        Settings { kind, tolerance: self.tolerance }
    }

    /// For a device, whose samples are coded as they come.
    pub(crate) fn live_settings(&self) -> anyhow::Result<Settings> {
        let settings = self.settings();
        if settings.kind.is_live() {
            return Ok(settings);
        }
        Err(UsageError(format!(
            "{} works on whole takes: record with dense, fast or lossless, then export and import with it",
            settings.kind
        ))
        .into())
    }
}
