//! `--tolerance`, `--lossless`, `--resampler`: the same on every command that codes.

use clap::Args;
use mocapd::outcome::UsageError;
use mocapd_codec::{ResamplerKind, Settings, Tolerance};
use mocapd_service::units;

/// Five to fifteen times the noise of an optical rig, and 2.5 times smaller files than a tenth of a
/// millimetre.
const DEFAULT_TOLERANCE_MM: f64 = 0.5;

#[derive(Debug, Args)]
pub(crate) struct CodecArgs {
    /// Largest distance between a sample and its reconstruction: 0.5mm, 100um, 2cm [default: 0.5mm]
    #[arg(long, value_name = "LENGTH", value_parser = units::tolerance, allow_hyphen_values = true)]
    tolerance: Option<Tolerance>,
    /// Keep every bit; the same as --resampler lossless
    #[arg(long, conflicts_with_all = ["tolerance", "resampler"])]
    lossless: bool,
    /// dense, fast or lossless; of whole takes (import, bench codec) also spline[:worst-sample|:exhaustive] and
    /// sync[:worst-sample|:exhaustive]
    #[arg(long, value_name = "NAME", default_value = "dense", value_parser = str::parse::<ResamplerKind>)]
    resampler: ResamplerKind,
}

impl CodecArgs {
    /// For samples that are all there.
    ///
    /// # Errors
    /// A usage error when a tolerance is given to a resampler that has none.
    pub(crate) fn settings(&self) -> anyhow::Result<Settings> {
        let kind = if self.lossless { ResamplerKind::Lossless } else { self.resampler };
        if kind.is_lossless() && self.tolerance.is_some() {
            let message = "lossless keeps every bit and has no tolerance: leave --tolerance out";
            return Err(UsageError(message.to_owned()).into());
        }
        let tolerance = self.tolerance.map_or(Tolerance::from_mm(DEFAULT_TOLERANCE_MM), Ok)?;
        Ok(Settings { kind, tolerance })
    }

    /// For a device, whose samples are coded as they come.
    ///
    /// # Errors
    /// A usage error for a resampler that needs the whole take.
    pub(crate) fn live_settings(&self) -> anyhow::Result<Settings> {
        let settings = self.settings()?;
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

/// What a report says of the bound: 0 where every bit is kept.
pub(crate) fn tolerance_mm(codec: &Settings) -> f64 {
    if codec.kind.is_lossless() { 0.0 } else { codec.tolerance.mm() }
}
