//! Units of length: their spellings in files, plausibility checks, and conversion of coordinates to millimetres.

use std::{cell::Cell, fmt, str::FromStr};

use super::counted;
use crate::{
    motion::{Ambiguity, GAP, Notes, Position, Source, is_gap},
    up_axis::Rotation,
};

/// A unit of length.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LengthUnit {
    /// µm
    Micrometre,
    /// mm
    Millimetre,
    /// cm
    Centimetre,
    /// dm
    Decimetre,
    /// m
    Metre,
    /// in
    Inch,
    /// ft
    Foot,
}

/// Units with their full names, without accents. A name cut off after two letters or more is recognised by its
/// beginning if all names with that beginning are of one unit.
const NAMES: [(LengthUnit, &str); 7] = [
    (LengthUnit::Micrometre, "micrometers micrometres microns"),
    (LengthUnit::Millimetre, "millimeters millimetres milimeters milimetres milimetros millimetri"),
    (LengthUnit::Centimetre, "centimeters centimetres centimetros"),
    (LengthUnit::Decimetre, "decimeters decimetres"),
    (LengthUnit::Metre, "meters metres metros"),
    (LengthUnit::Inch, "inches"),
    (LengthUnit::Foot, "feet foot"),
];

impl LengthUnit {
    /// The symbol, and the unit's length in millimetres.
    const fn symbol_and_mm(self) -> (&'static str, f64) {
        match self {
            Self::Micrometre => ("um", 1e-3),
            Self::Millimetre => ("mm", 1.0),
            Self::Centimetre => ("cm", 10.0),
            Self::Decimetre => ("dm", 100.0),
            Self::Metre => ("m", 1000.0),
            Self::Inch => ("in", 25.4),
            Self::Foot => ("ft", 304.8),
        }
    }

    /// The length of one unit in millimetres.
    #[must_use]
    pub fn mm(self) -> f64 {
        self.symbol_and_mm().1
    }

    /// Parses a unit as files spell it: symbol or name, in any case, singular or plural, in brackets, or truncated.
    pub(super) fn from_file(text: &str) -> Option<Self> {
        // Bytes after a zero are uninitialised memory of the program that wrote the file.
        let text = text.split('\0').next().unwrap_or_default();
        let plain = |c: char| match c {
            'à'..='å' => 'a',
            'è'..='ë' => 'e',
            'ì'..='ï' => 'i',
            'µ' | 'μ' => 'u',
            other => other,
        };
        let text: String = text.to_lowercase().chars().map(plain).collect();
        let text = text.trim_matches(|c: char| {
            c.is_whitespace() || c.is_control() || "[](){}<>.,;:'".contains(c)
        });
        Some(match text {
            "um" => Self::Micrometre,
            "mm" | "mms" => Self::Millimetre,
            "cm" | "cms" => Self::Centimetre,
            "dm" => Self::Decimetre,
            "m" | "ms" | "mtr" | "mtrs" => Self::Metre,
            "in" | "ins" | "\"" => Self::Inch,
            "ft" => Self::Foot,
            // Ambiguous: millimetre, or a thousandth of an inch.
            "mil" | "mils" => return None,
            _ if text.chars().count() < 2 => return None,
            _ => {
                let begins = |names: &str| names.split(' ').any(|name| name.starts_with(text));
                let mut found = NAMES.iter().filter(|(_, names)| begins(names));
                let &(unit, _) = found.next()?;
                return found.next().is_none().then_some(unit);
            }
        })
    }
}

impl fmt::Display for LengthUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.symbol_and_mm().0)
    }
}

impl FromStr for LengthUnit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::from_file(text).ok_or_else(|| {
            format!("'{text}' is not a unit of length: use mm, cm, dm, m, um, in or ft")
        })
    }
}

/// The unit of a file's coordinates: given by the user, or else stated by the file.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FileUnit {
    /// The unit as the file states it.
    pub(super) stated: String,
    /// Factor to millimetres.
    pub(super) factor: f64,
    is_known: bool,
    /// Whether the user gave the unit.
    is_given: bool,
    /// Whether the file states no unit, and its format means millimetres then.
    defaults_to_mm: bool,
}

impl FileUnit {
    /// Resolves the unit of a file. A given unit takes precedence over the stated one, with a warning if they differ.
    pub(super) fn resolve(stated: &str, given: Option<LengthUnit>, notes: &mut Notes) -> Self {
        let of_file = LengthUnit::from_file(stated);
        if let Some((given, _)) = given.zip(of_file).filter(|(given, of_file)| given != of_file) {
            notes.warnings.push(format!(
                "The file states `{stated}` as its unit of length; {given} was used, as requested."
            ));
        }
        let unit = given.or(of_file);
        Self {
            stated: stated.to_owned(),
            factor: unit.map_or(1.0, LengthUnit::mm),
            is_known: unit.is_some(),
            is_given: given.is_some(),
            defaults_to_mm: false,
        }
    }

    /// For formats in which no stated unit means millimetres: [`Self::check`] then notes an ambiguity only if the
    /// motion contradicts millimetres.
    pub(super) fn or_default_millimetres(self) -> Self {
        Self { defaults_to_mm: self.stated.is_empty(), ..self }
    }

    /// Notes an ambiguity if the unit is unknown, or if the file states a unit that the extent of the motion
    /// contradicts.
    pub(super) fn check(&self, extent: &mut MotionExtent, notes: &mut Notes) {
        if self.is_given {
            return;
        }
        let stated = self.stated.clone();
        if self.is_known {
            if extent.n_frames < STATED_CHECKED_FRAMES_MIN {
                return;
            }
            let span_mm = extent.span().max(extent.farthest);
            let unit = Ambiguity::StatedUnit { stated, span_mm };
            if unit.is_in_doubt() {
                notes.ambiguous(unit);
            }
            return;
        }
        let unit = Ambiguity::Unit { stated, span: extent.span() };
        if !self.defaults_to_mm || unit.is_in_doubt() {
            notes.ambiguous(unit);
        }
    }

    /// The source record of trajectories in this unit.
    pub(super) fn into_source(
        self,
        format: &str,
        first_frame: u64,
        frames_missing: u64,
        notes: Notes,
    ) -> Source {
        Source {
            format: format.to_owned(),
            unit: self.stated,
            factor: self.factor,
            first_frame,
            frames_missing,
            warnings: notes.warnings,
            ambiguities: notes.ambiguities,
        }
    }
}

/// A stated unit is not checked in files with fewer frames: those are an example or a pose, not a capture.
const STATED_CHECKED_FRAMES_MIN: usize = 50;

/// Maximum number of frames to measure, evenly spread over the file.
const FRAMES_MEASURED: usize = 500;

/// The extent of a motion, measured in some of its frames.
#[derive(Debug)]
pub(super) struct MotionExtent {
    n_frames: usize,
    /// Frames from one that is measured to the next.
    step: usize,
    n_added: usize,
    /// The extent of each measured frame with two samples or more.
    spans: Vec<f64>,
    path: Bounds,
    /// The largest absolute coordinate.
    farthest: f64,
}

impl MotionExtent {
    /// Prepares to measure a motion of `n_frames` frames.
    pub(super) fn new(n_frames: usize) -> Self {
        Self {
            n_frames,
            step: n_frames.div_ceil(FRAMES_MEASURED).max(1),
            n_added: 0,
            spans: Vec::new(),
            path: Bounds::default(),
            farthest: 0.0,
        }
    }

    /// Adds the positions of the next frame.
    pub(super) fn add_row(&mut self, row: &[Position]) {
        let is_measured = self.n_added.is_multiple_of(self.step);
        self.n_added += 1;
        if !is_measured {
            return;
        }
        let mut frame = Bounds::default();
        row.iter().filter(|&&at| !is_gap(at)).for_each(|&at| frame.add(at));
        if frame.n_positions > 1 {
            self.spans.push(frame.extent());
        }
        self.path.merge(&frame);
        let coordinates = frame.low.into_iter().chain(frame.high).filter(|v| v.is_finite());
        self.farthest = coordinates.map(f64::abs).fold(self.farthest, f64::max);
    }

    /// The span of the markers: the largest extent of one frame's markers along an axis, as the median over frames. For
    /// a single marker, or if no frame has two, the extent of the whole path. 0 without samples.
    fn span(&mut self) -> f64 {
        median(&mut self.spans).unwrap_or_else(|| self.path.extent())
    }
}

/// The bounds of positions along each axis.
#[derive(Debug)]
struct Bounds {
    low: [f64; 3],
    high: [f64; 3],
    n_positions: usize,
}

impl Default for Bounds {
    fn default() -> Self {
        Self { low: [f64::INFINITY; 3], high: [f64::NEG_INFINITY; 3], n_positions: 0 }
    }
}

impl Bounds {
    fn add(&mut self, position: Position) {
        let position = position.map(f64::from);
        self.merge(&Self { low: position, high: position, n_positions: 1 });
    }

    fn merge(&mut self, other: &Self) {
        for axis in 0..3 {
            self.low[axis] = self.low[axis].min(other.low[axis]);
            self.high[axis] = self.high[axis].max(other.high[axis]);
        }
        self.n_positions += other.n_positions;
    }

    /// The largest extent along an axis; 0 without positions.
    fn extent(&self) -> f64 {
        self.low.iter().zip(self.high).map(|(low, high)| high - low).fold(0.0, f64::max)
    }
}

/// The median (the upper one for an even count); `None` without values.
pub(super) fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Converts stored positions to millimetres: multiplies each coordinate by one factor in f64 and rounds once to f32.
#[derive(Debug)]
pub(super) struct ToMillimetres {
    factor: f64,
    /// `None` if positions stay as they are.
    rotation: Option<Rotation>,
    not_finite: Cell<usize>,
}

impl ToMillimetres {
    pub(super) fn new(factor: f64, rotation: Rotation) -> Self {
        let rotation = Some(rotation).filter(|rotation| !rotation.is_identity());
        Self { factor, rotation, not_finite: Cell::new(0) }
    }

    /// The position in millimetres. A coordinate that is not finite before or after conversion makes the sample a gap,
    /// which is counted.
    #[inline]
    pub(super) fn position(&self, stored: [f64; 3]) -> Position {
        let position = self.convert(stored);
        if position.iter().all(|v| v.is_finite()) {
            return position;
        }
        self.not_finite.set(self.not_finite.get() + 1);
        GAP
    }

    /// The coordinates in millimetres, finite or not: for data that is not a sample.
    #[inline]
    pub(super) fn convert(&self, stored: [f64; 3]) -> Position {
        let position = stored.map(|v| (v * self.factor) as f32);
        self.rotation.map_or(position, |rotation| rotation.apply(position))
    }

    /// Warns of the samples that became gaps because they are not finite.
    pub(super) fn report(&self, warnings: &mut Vec<String>) {
        let n = self.not_finite.get();
        if n > 0 {
            warnings.push(format!("Not finite, read as missing: {}.", counted(n as u64, "sample")));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_spelling_of_a_unit_is_recognised() {
        for (unit, factor) in [
            ("mm", 1.0),
            (" MM ", 1.0),
            ("mm\0\0", 1.0),
            ("[mm]", 1.0),
            ("mill", 1.0),
            ("Millimètres", 1.0),
            ("cm", 10.0),
            ("Centi", 10.0),
            ("cm.", 10.0),
            ("mete", 1000.0),
            ("METRES", 1000.0),
            ("metre\0x", 1000.0),
            ("Meters", 1000.0),
            ("in", 25.4),
            ("inch", 25.4),
            ("inche", 25.4),
            ("feet", 304.8),
            ("µm", 1e-3),
            ("microm", 1e-3),
        ] {
            assert_eq!(LengthUnit::from_file(unit).map(LengthUnit::mm), Some(factor), "{unit}");
        }
        for unit in ["furlong", "", " ", "mi", "mil", "e", "xm", "metersx", "m/s"] {
            assert_eq!(LengthUnit::from_file(unit), None, "{unit}");
        }
    }

    #[test]
    fn a_value_that_overflows_f32_is_a_gap() {
        let metres = ToMillimetres::new(1000.0, Rotation::IDENTITY);
        let mut warnings = Vec::new();
        assert_eq!(metres.position([0.1, -0.2, 0.3]), [100.0, -200.0, 300.0]);
        metres.report(&mut warnings);
        assert_eq!(warnings, [""; 0]);
        assert!(is_gap(metres.position([1e38, 0.0, 0.0])));
        metres.report(&mut warnings);
        assert!(warnings.len() == 1 && warnings[0].contains("1 sample"), "{warnings:?}");
    }

    #[test]
    fn a_span_is_that_of_a_frame_or_of_a_path() {
        let span = |positions: &[Position], n_markers: usize| {
            let mut extent = MotionExtent::new(positions.len() / n_markers.max(1));
            positions.chunks(n_markers.max(1)).for_each(|row| extent.add_row(row));
            extent.span()
        };
        let frame = |x: f32| [[x, 0.0, 0.0], [x, 1.8, 0.0], GAP];
        let walk: Vec<Position> = (0..2000).flat_map(|i| frame(i as f32)).collect();
        assert!((span(&walk, 3) - 1.8).abs() < 1e-6);
        let path: Vec<Position> = (0..10).map(|i| [0.0, i as f32, 0.0]).collect();
        assert!((span(&path, 1) - 9.0).abs() < 1e-9);
        assert!(span(&[GAP; 4], 2).abs() < 1e-9 && span(&[], 0).abs() < 1e-9);
    }
}
