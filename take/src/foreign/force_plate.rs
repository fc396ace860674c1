//! A force plate: from the values of its channels to force, moment, centre of pressure and free moment in laboratory
//! axes. [`force_plates`](super::force_plates) states the sources, signs and axes.

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
    /// the surface; in type 3 half the distances of the sensors along x and y, and z of that vector.
    #[must_use]
    pub fn origin_mm(&self) -> Vector {
        self.origin_mm
    }

    /// The plate's own x, y and z axis in laboratory axes.
    #[must_use]
    pub fn axes(&self) -> [Vector; 3] {
        self.axes
    }

    /// The same plate in laboratory axes after a rotation.
    pub(crate) fn turned(&self, turned: impl Fn(Vector) -> Vector + Copy) -> Self {
        let (corners_mm, axes) = (self.corners_mm.map(turned), self.axes.map(turned));
        Self { corners_mm, axes, ..self.clone() }
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
    /// The calibration matrix of a plate of type 4, by rows: three in N and three in N m, per unit of a channel.
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

impl PlateLoad {
    /// Its numbers in the order of the columns of tables: force, moment, centre of pressure and free moment, each along x, y
    /// and z.
    #[must_use]
    pub fn values(&self) -> [f64; 12] {
        let Self { force_n: [a, b, c], moment_nm: [d, e, f], .. } = *self;
        let ([g, h, i], [j, k, l]) = (self.cop_mm, self.free_moment_nm);
        [a, b, c, d, e, f, g, h, i, j, k, l]
    }
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
                let [a, b, z] = origin_m;
                let force = [fx12 + fx34, fy14 + fy23, fz1 + fz2 + fz3 + fz4];
                let moment = [
                    b * (fz1 + fz2 - fz3 - fz4),
                    a * (fz2 + fz3 - fz1 - fz4),
                    b * (fx34 - fx12) + a * (fy14 - fy23),
                ];
                (force, add(moment, cross(force, [0.0, 0.0, z])))
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
