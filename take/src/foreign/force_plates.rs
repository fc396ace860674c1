//! The force plates of a take that was imported from a C3D file: forces, moments, centres of pressure and free moments
//! in laboratory axes.
//!
//! Sources: The C3D File Format: User Guide, Motion Lab Systems, 2021, chapters `FORCE_PLATFORM` and "Calculating SCALE
//! values for force plates", for the parameters of types 1 to 4; Kistler, "Multicomponent force plates: formulae", for
//! the moments of the eight channels of type 3.
//!
//! **Sign.** All values are reactions: the force and the moment by which the plate acts on the subject. A person who
//! stands on a level plate has an upward force. The user guide demands this of a file: scales of plates are negative,
//! because sensors measure the action on the plate. A file that breaks the rule yields actions; the reader has no means
//! to notice, and corrects no signs.
//!
//! **Axes.** A plate's own axes follow from its corners, which are in the four quadrants (+x +y), (-x +y), (-x -y),
//! (+x -y). Its z axis is normal to the surface and usually points down. Loads are calculated in these axes and then
//! rotated into those of the markers.
//!
//! A load is reduced to the centre of the surface, the mean of the corners: `M = M_sensors + F x ORIGIN`, where ORIGIN
//! leads from the origin of the sensors to this centre. The centre of pressure is the point of the surface about which
//! the moment has no component along the surface: `(-My / Fz, Mx / Fz, 0)` from the centre. The moment about it is
//! the free moment, along the normal: `Mz - x Fy + y Fx`.

use std::io;

pub use super::force_plate::{
    ForcePlate, ForcePlates, LOADED_N, PlateGeometry, PlateLoad, PlateType, UnusablePlate,
};
use crate::{
    TakeError,
    foreign::analog::{self, AnalogChannel, AnalogSamples},
    interchange::c3d,
    motion::MotionInfo,
};

impl ForcePlates {
    /// The plates of a take; `None` if it has none.
    ///
    /// # Errors
    /// Those of [`AnalogSamples::open`].
    pub fn of(info: &MotionInfo) -> Result<Option<Self>, TakeError> {
        let Some(parameters) = analog::parameters(info)? else { return Ok(None) };
        let samples = AnalogSamples::open(info)?;
        let channels = samples.as_ref().map_or(&[][..], AnalogSamples::channels);
        let mut found = c3d::force_plates(&parameters, channels, unit_mm(info));
        if let (Some(found), Some(samples)) = (&mut found, &samples) {
            found.warnings.extend_from_slice(samples.warnings());
        }
        Ok(found)
    }
}

impl ForcePlates {
    /// The plates of a take by the parameters of its file, and its analog channels, of which there are `n_channels`. The
    /// samples of these need not have been read. `None` if there are no plates.
    ///
    /// # Errors
    /// `InvalidArgument` if the parameters were not read, or have another layout; `Io` if their scratch file cannot be read.
    pub fn described(
        info: &MotionInfo,
        n_channels: usize,
    ) -> Result<Option<(Self, Vec<AnalogChannel>)>, TakeError> {
        let Some(parameters) = analog::parameters(info)? else { return Ok(None) };
        let mut warnings = Vec::new();
        let channels = c3d::analog_channels(&parameters, n_channels, &mut warnings);
        let found = c3d::force_plates(&parameters, &channels, unit_mm(info));
        Ok(found.map(|plates| (plates, channels)))
    }
}

/// Millimetres in the unit of length of the file.
fn unit_mm(info: &MotionInfo) -> f64 {
    Some(info.source.factor).filter(|factor| factor.is_normal()).unwrap_or(1.0)
}

/// What is subtracted from the channels of force plates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Baseline {
    /// Nothing. Many programs state frames 1 to 10 in `FORCE_PLATFORM:ZERO` whether or not somebody stood on the plates,
    /// and the user guide does not demand the correction.
    #[default]
    AsStored,
    /// The mean over the frames in [`ForcePlates::baseline`].
    Subtracted,
}

/// The loads of the plates of a take, or of a part of one, read in blocks of frames, in bounded memory.
#[derive(Debug)]
pub struct PlateLoads<'a> {
    samples: AnalogSamples<'a>,
    plates: ForcePlates,
    /// By analog channel, what is subtracted.
    baseline: Vec<f64>,
    values: Vec<f64>,
}

impl<'a> PlateLoads<'a> {
    /// Starts at the first frame of `info`. `None` if the take has no force plates, or no analog samples.
    ///
    /// # Errors
    /// Those of [`AnalogSamples::open`]; `InvalidArgument` if a baseline is to be subtracted, but the file states no
    /// frames without load, or none that it has.
    pub fn open(info: &'a MotionInfo, baseline: Baseline) -> Result<Option<Self>, TakeError> {
        let Some(plates) = ForcePlates::of(info)? else { return Ok(None) };
        let Some(samples) = AnalogSamples::open(info)? else { return Ok(None) };
        let baseline = match baseline {
            Baseline::AsStored => vec![0.0; samples.channels().len()],
            Baseline::Subtracted => means(info, plates.baseline)?,
        };
        Ok(Some(Self { samples, plates, baseline, values: Vec::new() }))
    }

    /// The plates.
    #[must_use]
    pub fn plates(&self) -> &ForcePlates {
        &self.plates
    }

    /// Loads of a plate in a frame.
    #[must_use]
    pub fn samples_per_frame(&self) -> usize {
        self.samples.samples_per_frame()
    }

    /// Loads of a plate in a second.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        self.samples.rate_hz()
    }

    /// Replaces `block` by the loads in the next frames, and returns their number; 0 at the end. One load per usable
    /// plate for the first sample of a frame, then for its next sample, and so on.
    ///
    /// # Errors
    /// Those of the scratch file that the samples may be in.
    pub fn next_block(&mut self, block: &mut Vec<PlateLoad>) -> io::Result<usize> {
        block.clear();
        let mut values = std::mem::take(&mut self.values);
        let n_frames = self.samples.next_block(&mut values)?;
        let mut of_plate = [0.0; 8];
        for row in values.chunks_exact(self.baseline.len().max(1)) {
            for plate in &self.plates.plates {
                for (value, &channel) in of_plate.iter_mut().zip(&plate.channels) {
                    let baseline = self.baseline.get(channel).copied().unwrap_or_default();
                    *value = row.get(channel).map_or(f64::NAN, |value| value - baseline);
                }
                block.push(plate.load(of_plate.get(..plate.channels.len()).unwrap_or(&[])));
            }
        }
        self.values = values;
        Ok(n_frames)
    }
}

/// The mean of every analog channel over these frames.
fn means(info: &MotionInfo, frames: Option<(u64, u64)>) -> Result<Vec<f64>, TakeError> {
    let Some((first, last)) = frames else {
        return Err(TakeError::InvalidArgument(
            "FORCE_PLATFORM:ZERO states no frames without load: export without --subtract-baseline"
                .to_owned(),
        ));
    };
    let parameters = analog::parameters(info)?;
    let samples = AnalogSamples::kept(info, parameters.as_ref(), first, last)?;
    let n_channels = samples.as_ref().map_or(0, |samples| samples.channels().len());
    let mut sums = vec![(0.0, 0_u64); n_channels];
    let mut block = Vec::new();
    if let Some(mut samples) = samples {
        while samples.next_block(&mut block)? > 0 {
            let values = block.iter().enumerate().filter(|(_, value)| value.is_finite());
            for (at, value) in values {
                if let Some((sum, n)) = sums.get_mut(at % n_channels.max(1)) {
                    *sum += value;
                    *n += 1;
                }
            }
        }
    }
    if sums.iter().any(|&(_, n)| n == 0) {
        return Err(TakeError::InvalidArgument(format!(
            "FORCE_PLATFORM:ZERO states frames {first} to {last} as without load, but the take has no samples of them"
        )));
    }
    Ok(sums.iter().map(|&(sum, n)| sum / n as f64).collect())
}
