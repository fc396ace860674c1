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

use crate::{
    TakeError,
    foreign::analog::{self, AnalogSamples},
    interchange::c3d,
    motion::MotionInfo,
};

/// Smallest force normal to a plate for which there is a centre of pressure, N. It is the moment divided by this force:
/// with moments good to 0.2 N m, as those of the common plates of 0.5 m are, it is good to 10 mm at 20 N, and is noise
/// below. 20 N is also the customary threshold of foot contact in gait analysis.
pub const LOADED_N: f64 = 20.0;

/// The type of a plate: what its channels hold (`FORCE_PLATFORM:TYPE`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlateType {
    /// Six channels: force, centre of pressure x and y, free moment.
    Type1,
    /// Six channels: force and moment.
    Type2,
    /// Eight channels: fx12, fx34, fy14, fy23, fz1 to fz4, forces at four sensors.
    Type3,
    /// Six channels that a calibration matrix turns into force and moment.
    Type4,
}

impl PlateType {
    /// The type of a code, 1 to 4.
    pub(crate) fn from_code(code: f64) -> Option<Self> {
        let all = [Self::Type1, Self::Type2, Self::Type3, Self::Type4];
        all.into_iter().find(|kind| f64::from(kind.code()) == code)
    }

    /// Its code, 1 to 4.
    #[must_use]
    pub fn code(self) -> u8 {
        match self {
            Self::Type1 => 1,
            Self::Type2 => 2,
            Self::Type3 => 3,
            Self::Type4 => 4,
        }
    }

    /// Number of its channels.
    #[must_use]
    pub fn n_channels(self) -> usize {
        if self == Self::Type3 { 8 } else { 6 }
    }
}

type Vector = [f64; 3];

/// Where a plate is.
#[derive(Debug, Clone, PartialEq)]
pub struct PlateGeometry {
    corners_mm: [Vector; 4],
    origin_mm: Vector,
    /// The plate's x, y and z axis in laboratory axes.
    axes: [Vector; 3],
}

impl PlateGeometry {
    /// A plate with these corners.
    ///
    /// # Errors
    /// If the corners span no surface, or a number is not finite.
    pub(crate) fn new(corners_mm: [Vector; 4], origin_mm: Vector) -> Result<Self, String> {
        if corners_mm.iter().flatten().chain(&origin_mm).any(|v| !v.is_finite()) {
            return Err("CORNERS or ORIGIN has a number that is not finite".to_owned());
        }
        let [a, b, c, d] = corners_mm;
        // The mean of two opposite edges, in case the corners were measured with markers.
        let edge = |from: [Vector; 2], to: [Vector; 2]| -> Vector {
            std::array::from_fn(|i| to[0][i] + to[1][i] - from[0][i] - from[1][i])
        };
        let (x, y) = (edge([b, c], [a, d]), edge([c, d], [a, b]));
        let z = cross(x, y);
        let axes = [unit(x), unit(cross(z, x)), unit(z)];
        let [Some(x), Some(y), Some(z)] = axes else {
            return Err("CORNERS do not span a surface".to_owned());
        };
        Ok(Self { corners_mm, origin_mm, axes: [x, y, z] })
    }

    /// The corners in laboratory axes, mm: those of the quadrants (+x +y), (-x +y), (-x -y), (+x -y) of the plate's own
    /// axes.
    #[must_use]
    pub fn corners_mm(&self) -> [Vector; 4] {
        self.corners_mm
    }

    /// ORIGIN in the plate's own axes, mm: in types 2 and 4 the vector from the origin of the sensors to the centre of
    /// the surface; in type 3 half the distances of the sensors along x and y, and the height of the origin above the
    /// surface along z.
    #[must_use]
    pub fn origin_mm(&self) -> Vector {
        self.origin_mm
    }

    /// The plate's own x, y and z axis in laboratory axes.
    #[must_use]
    pub fn axes(&self) -> [Vector; 3] {
        self.axes
    }

    /// The centre of the surface in laboratory axes, mm.
    #[must_use]
    pub fn centre_mm(&self) -> Vector {
        std::array::from_fn(|i| self.corners_mm.iter().map(|corner| corner[i]).sum::<f64>() / 4.0)
    }

    /// A vector in the plate's own axes, in laboratory axes.
    fn to_laboratory(&self, [x, y, z]: Vector) -> Vector {
        std::array::from_fn(|i| x * self.axes[0][i] + y * self.axes[1][i] + z * self.axes[2][i])
    }
}

/// A force plate.
#[derive(Debug, Clone, PartialEq)]
pub struct ForcePlate {
    /// Its number in the file, from 1.
    pub number: usize,
    /// What its channels hold.
    pub kind: PlateType,
    /// Where it is.
    pub geometry: PlateGeometry,
    /// Indices of its analog channels: six, or eight of type 3.
    pub channels: Vec<usize>,
    /// Of type 4: the calibration matrix, by rows; three of N and three of N m per unit of a channel.
    pub calibration: Option<[[f64; 6]; 6]>,
    /// For each channel the factor from its unit to N, N m or mm.
    pub(crate) factors: Vec<f64>,
}

/// The load of a plate at one instant, in laboratory axes. Reactions: what the plate does to the subject. All values are
/// NaN where a channel has no sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlateLoad {
    /// The force, N.
    pub force_n: Vector,
    /// The moment about the centre of the surface, N m.
    pub moment_nm: Vector,
    /// The centre of pressure on the surface, mm; NaN if the force normal to the plate is below [`LOADED_N`].
    pub cop_mm: Vector,
    /// The moment about the centre of pressure, which is normal to the plate, N m; NaN where there is no such centre.
    pub free_moment_nm: Vector,
}

impl ForcePlate {
    /// The load, from the values of its channels in the order of [`channels`](Self::channels). Missing values are NaN.
    #[must_use]
    pub fn load(&self, values: &[f64]) -> PlateLoad {
        let value = |i: usize| {
            let factor = self.factors.get(i).copied().unwrap_or(1.0);
            values.get(i).map_or(f64::NAN, |value| value * factor)
        };
        let (force, moment) = self.about_centre(&std::array::from_fn(value));
        let [fx, fy, fz] = force;
        let [mx, my, mz] = moment;
        let is_loaded = fz.abs() >= LOADED_N;
        let (x_m, y_m) = if is_loaded { (-my / fz, mx / fz) } else { (f64::NAN, f64::NAN) };
        let geometry = &self.geometry;
        let from_centre = geometry.to_laboratory([x_m * 1000.0, y_m * 1000.0, 0.0]);
        let centre_mm = geometry.centre_mm();
        PlateLoad {
            force_n: geometry.to_laboratory(force),
            moment_nm: geometry.to_laboratory(moment),
            cop_mm: std::array::from_fn(|i| centre_mm[i] + from_centre[i]),
            free_moment_nm: geometry.to_laboratory([0.0, 0.0, mz - x_m * fy + y_m * fx]),
        }
    }

    /// Force and moment about the centre of the surface in the plate's own axes, N and N m.
    fn about_centre(&self, values: &[f64; 8]) -> (Vector, Vector) {
        let origin_m = self.geometry.origin_mm.map(|v| v / 1000.0);
        match self.kind {
            PlateType::Type1 => {
                let &[fx, fy, fz, x_mm, y_mm, mz, ..] = values;
                let (x, y) = (x_mm / 1000.0, y_mm / 1000.0);
                ([fx, fy, fz], [y * fz, -x * fz, x * fy - y * fx + mz])
            }
            PlateType::Type2 | PlateType::Type4 => {
                let &[fx, fy, fz, mx, my, mz, ..] = values;
                let [fx, fy, fz, mx, my, mz] = match &self.calibration {
                    None => [fx, fy, fz, mx, my, mz],
                    Some(matrix) => {
                        let measured = [fx, fy, fz, mx, my, mz];
                        matrix.map(|row| row.iter().zip(&measured).map(|(c, v)| c * v).sum())
                    }
                };
                ([fx, fy, fz], add([mx, my, mz], cross([fx, fy, fz], origin_m)))
            }
            PlateType::Type3 => {
                let &[fx12, fx34, fy14, fy23, fz1, fz2, fz3, fz4] = values;
                let [a, b, height] = origin_m;
                let force = [fx12 + fx34, fy14 + fy23, fz1 + fz2 + fz3 + fz4];
                let moment = [
                    b * (fz1 + fz2 - fz3 - fz4),
                    a * (fz2 + fz3 - fz1 - fz4),
                    b * (fx34 - fx12) + a * (fy14 - fy23),
                ];
                (force, add(moment, cross(force, [0.0, 0.0, height])))
            }
        }
    }
}

/// A plate of the file that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnusablePlate {
    /// Its number in the file, from 1.
    pub number: usize,
    /// Why, without the final dot.
    pub reason: String,
}

/// The force plates of a take.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ForcePlates {
    /// Those that can be used, in the order of the file.
    pub plates: Vec<ForcePlate>,
    /// The others.
    pub unusable: Vec<UnusablePlate>,
    /// The numbers of the first and the last frame in which the plates were not loaded (`FORCE_PLATFORM:ZERO`), if the
    /// file states them.
    pub baseline: Option<(u64, u64)>,
    /// What the parameters leave open, and how it was read, one sentence each.
    pub warnings: Vec<String>,
}

impl ForcePlates {
    /// The plates of a take; `None` if it has none.
    ///
    /// # Errors
    /// Those of [`AnalogSamples::open`].
    pub fn of(info: &MotionInfo) -> Result<Option<Self>, TakeError> {
        let Some(parameters) = analog::parameters(info)? else { return Ok(None) };
        let samples = AnalogSamples::open(info)?;
        let channels = samples.as_ref().map_or(&[][..], AnalogSamples::channels);
        let unit_mm = Some(info.source.factor).filter(|factor| factor.is_normal()).unwrap_or(1.0);
        let mut found = c3d::force_plates(&parameters, channels, unit_mm);
        if let (Some(found), Some(samples)) = (&mut found, &samples) {
            found.warnings.extend_from_slice(samples.warnings());
        }
        Ok(found)
    }
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
            "FORCE_PLATFORM:ZERO states no frames without load: no baseline can be subtracted"
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

fn cross([a, b, c]: Vector, [x, y, z]: Vector) -> Vector {
    [b * z - c * y, c * x - a * z, a * y - b * x]
}

fn add(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|i| a[i] + b[i])
}

/// The unit vector of this direction; `None` for the zero vector.
fn unit(vector: Vector) -> Option<Vector> {
    let length = vector.iter().map(|v| v * v).sum::<f64>().sqrt();
    (length > 0.0 && length.is_finite()).then(|| vector.map(|v| v / length))
}
