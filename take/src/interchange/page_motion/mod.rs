//! Motion coded for a page that plays it without mocapd: integers on a lattice, predicted in time, and range coded.
//!
//! The format is simple, so that a decoder is a page of JavaScript (`web/motion_decoder.js`): it is not that of takes, and
//! larger. `docs/sharing.md` specifies it. Its error comes on top of that of the take that is coded, and is measured for
//! every sample. Rigid bodies are trajectories, too: that of their origin, and that of a vector that is their rotation.

use std::io::{self, Write};

use mocapd_codec::range::{BinaryCoder, Bit, RangeDecoder, RangeEncoder};

use super::recorded_rows::FramePoses;
use crate::{
    motion::{FrameSource, GAP, Position, is_gap},
    poses::{Pose, PoseState},
};

/// Trajectories of a rigid body in a block: its place and its turn.
const OF_BODY: usize = 2;

/// Millimetres that stand for 1 in a turn, the vector part of a unit quaternion over 1 plus its real part. A rotation is at
/// most four times as far from another one, in radians, as their turns: an error of the bound in millimetres is one of the
/// angle by which a point moves that far which is 200 mm away, as in takes.
const TURN_MM: f64 = 800.0;

/// Longest turn in units of [`TURN_MM`]: that of 253 degrees. A rotation has two, one of which is at most 1; a body that keeps
/// turning changes from one to the other where it is much longer than that, so that none that is near half a turn does so
/// often.
const TURN_MAX: f64 = 2.0;

/// What rounding turns to f32 may add to an angle, in degrees: half the distance of floats below 2048 mm, on three axes.
const ROUNDING_DEGREES: f64 = 3e-5;

/// Samples of a block: some 100 000 numbers, which a browser decodes in about ten milliseconds.
const BLOCK_SAMPLES: usize = 1 << 15;

/// Limits on the frames of a block: short takes need few models to learn, and a seek decodes one block.
const BLOCK_FRAMES: [usize; 2] = [16, 2048];

/// Larger numbers of lattice steps are not used: they, and the sums of three of them, are exact in every arithmetic.
const STEPS_MAX: f64 = (1 << 28) as f64;

/// Classes of the magnitude of earlier residuals, by their number of bits.
const CLASSES: usize = 12;
/// Magnitudes up to this have a bit each; the rest is an Exp-Golomb number.
const UNARY_MAX: u32 = 14;

/// Smallest error that a page may add, in millimetres: below it a share of the positions is exact in f32 anyway.
pub const ADDED_MM_MIN: f64 = 0.001;

/// The lattice of a page.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lattice {
    /// The largest distance in millimetres that coding may add to a position.
    pub added_mm: f64,
    /// Distance of its points along an axis, in millimetres.
    pub step_mm: f64,
}

impl Lattice {
    /// The coarsest lattice that keeps every position within `added_mm`, which is at least [`ADDED_MM_MIN`].
    #[must_use]
    pub fn within(added_mm: f64) -> Self {
        let added_mm = added_mm.max(ADDED_MM_MIN);
        // Half the diagonal of a cell, with room for the rounding to f32 of positions up to 100 m.
        Self { added_mm, step_mm: added_mm * 2.0 / 3_f64.sqrt() * 0.99 }
    }

    /// The nearest lattice point of a position, in steps; `None` if the position is too far away or its error too large.
    fn nearest(self, position: Position) -> Option<[i32; 3]> {
        let steps = position.map(|v| (f64::from(v) / self.step_mm).round());
        if steps.iter().any(|v| v.abs() > STEPS_MAX) {
            return None;
        }
        let point = steps.map(|v| v as i32);
        (self.error_mm(point, position) <= self.added_mm).then_some(point)
    }

    /// The lattice point of a position, as close to the expected one as its error allows: axis by axis, the worst first,
    /// the coordinate of the nearest point replaces the expected one.
    fn point(self, position: Position, expected: [i32; 3]) -> Option<[i32; 3]> {
        let nearest = self.nearest(position)?;
        let mut point = expected;
        for _ in 0..3 {
            if self.error_mm(point, position) <= self.added_mm {
                return Some(point);
            }
            let coded = self.position(point);
            let worst = (0..3).filter(|&axis| point[axis] != nearest[axis]).max_by(|&a, &b| {
                (coded[a] - position[a]).abs().total_cmp(&(coded[b] - position[b]).abs())
            });
            let Some(axis) = worst else { break };
            point[axis] = nearest[axis];
        }
        Some(if self.error_mm(point, position) <= self.added_mm { point } else { nearest })
    }

    /// The position of a lattice point, as every decoder computes it.
    #[must_use]
    fn position(self, point: [i32; 3]) -> Position {
        point.map(|steps| (f64::from(steps) * self.step_mm) as f32)
    }

    /// The largest angle in degrees that coding may add to the rotation of a rigid body.
    #[must_use]
    pub fn added_degrees(self) -> f64 {
        degrees(self.added_mm)
    }

    fn error_mm(self, point: [i32; 3], position: Position) -> f64 {
        let coded = self.position(point);
        let squares =
            coded.iter().zip(position).map(|(a, b)| (f64::from(*a) - f64::from(b)).powi(2));
        squares.sum::<f64>().sqrt()
    }
}

/// The angle of a rotation whose turn is wrong by this distance.
fn degrees(mm: f64) -> f64 {
    (4.0 * mm / TURN_MM).to_degrees() + ROUNDING_DEGREES
}

/// A motion that was coded.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CodedMotion {
    /// Number of frames.
    pub frames: u64,
    /// Frames of every block but the last.
    pub block_frames: usize,
    /// The largest distance between a coded position and the one given, in millimetres.
    pub max_added_mm: f64,
    /// The largest angle between a coded rotation of a rigid body and the one given, in degrees, rounded up; 0 without bodies.
    pub max_added_degrees: f64,
    /// Bytes of all blocks.
    pub bytes: u64,
}

/// Frames of a block of so many markers and rigid bodies.
#[must_use]
pub fn block_frames(n_markers: usize, n_bodies: usize) -> usize {
    let [low, high] = BLOCK_FRAMES;
    (BLOCK_SAMPLES / (n_markers + OF_BODY * n_bodies).max(1)).clamp(low, high)
}

/// Codes all frames of a source, with the poses of its rigid bodies, and writes each block as a line of base64. `each` receives
/// the number of every frame, its positions, and whether it was damaged in the file.
///
/// # Errors
/// `Io` if reading or writing fails.
pub fn write(
    frames: &mut dyn FrameSource,
    lattice: Lattice,
    out: &mut dyn Write,
    mut each: impl FnMut(u64, &[Position], bool),
) -> io::Result<CodedMotion> {
    let info = frames.info().clone();
    let n_markers = info.markers.len();
    let mut bodies = BodyTrajectories::open(FramePoses::open(&info), lattice);
    let n_bodies = info.recording.as_ref().map_or(0, |recording| recording.bodies().len());
    let n_columns = n_markers + OF_BODY * n_bodies;
    let block_frames = block_frames(n_markers, n_bodies);
    let mut coded = CodedMotion { block_frames, ..CodedMotion::default() };
    let mut row = vec![GAP; n_markers];
    let mut block = Vec::with_capacity(block_frames * n_columns);
    let mut bytes = Vec::new();
    loop {
        block.clear();
        let mut n_frames = 0;
        while n_frames < block_frames && frames.next_frame(&mut row)? {
            each(coded.frames, &row, frames.is_lost());
            block.extend_from_slice(&row);
            if let Some(bodies) = &mut bodies {
                bodies.put_frame(&mut block)?;
            }
            coded.frames += 1;
            n_frames += 1;
        }
        if n_frames == 0 {
            return Ok(coded);
        }
        bytes.clear();
        let [of_places, of_turns] =
            encode_block(&block, [n_markers, n_bodies], n_frames, lattice, &mut bytes);
        coded.max_added_mm = coded.max_added_mm.max(of_places);
        if n_bodies > 0 {
            coded.max_added_degrees = coded.max_added_degrees.max(degrees(of_turns));
        }
        coded.bytes += bytes.len() as u64;
        let mut line = base64(&bytes);
        line.push('\n');
        out.write_all(line.as_bytes())?;
    }
}

/// The poses of rigid bodies as trajectories, two for each.
struct BodyTrajectories<'a> {
    poses: FramePoses<'a>,
    lattice: Lattice,
    /// The last turn of each body.
    turns: Vec<[f64; 3]>,
}

impl<'a> BodyTrajectories<'a> {
    fn open(poses: Option<FramePoses<'a>>, lattice: Lattice) -> Option<Self> {
        poses.map(|poses| Self { poses, lattice, turns: Vec::new() })
    }

    /// Appends the places and turns of the next frame's bodies.
    fn put_frame(&mut self, block: &mut Vec<Position>) -> io::Result<()> {
        let poses = self.poses.next_frame()?;
        self.turns.resize(poses.len(), [0.0; 3]);
        for (pose, turn) in poses.iter().zip(&mut self.turns) {
            block.extend(trajectories_of(pose, turn, self.lattice));
        }
        Ok(())
    }
}

/// The place and the turn of a body. Without a pose, the place is a gap, and the turn is the number of the state, in steps.
/// `before` is the last turn of the body, and is replaced.
fn trajectories_of(pose: &Pose, before: &mut [f64; 3], lattice: Lattice) -> [Position; OF_BODY] {
    if !pose.is_tracked() {
        return [GAP, lattice.position([i32::from(pose.state.code()), 0, 0])];
    }
    let [w, x, y, z] = pose.quaternion.map(f64::from);
    let length = ((w * w + x * x) + (y * y + z * z)).sqrt();
    // A quaternion and its opposite are the same rotation.
    let turns = [1.0, -1.0].map(|sign| [x, y, z].map(|v| sign * v / (length + sign * w)));
    let far = |turn: &[f64; 3]| turn.iter().zip(*before).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
    let is_short =
        |turn: &&[f64; 3]| turn.iter().map(|v| v * v).sum::<f64>() <= TURN_MAX * TURN_MAX;
    let nearest = turns.iter().filter(is_short).min_by(|a, b| far(a).total_cmp(&far(b)));
    *before = nearest.copied().unwrap_or_default();
    [pose.position_mm, before.map(|v| (v * TURN_MM) as f32)]
}

/// The pose of a body from its trajectories in a frame, as every decoder computes it. Pages have no residuals.
#[must_use]
pub fn pose_of([place, turn]: [Position; OF_BODY], lattice: Lattice) -> Pose {
    if is_gap(place) {
        let code = (f64::from(turn[0]) / lattice.step_mm).round();
        let state = PoseState::of_code(code as u8);
        let is_wrong = state == PoseState::Tracked;
        return Pose::without(if is_wrong { PoseState::Other } else { state });
    }
    let [x, y, z] = turn.map(|v| f64::from(v) / TURN_MM);
    let square = (x * x + y * y) + z * z;
    let quaternion = [1.0 - square, 2.0 * x, 2.0 * y, 2.0 * z];
    Pose {
        state: PoseState::Tracked,
        position_mm: place,
        quaternion: quaternion.map(|v| (v / (1.0 + square)) as f32),
        residual_mm: f32::NAN,
    }
}

/// Codes a block of markers and bodies, and returns the largest errors of positions and of turns, in millimetres.
fn encode_block(
    positions: &[Position],
    [n_markers, n_bodies]: [usize; 2],
    n_frames: usize,
    lattice: Lattice,
    out: &mut Vec<u8>,
) -> [f64; 2] {
    let n_columns = n_markers + OF_BODY * n_bodies;
    let mut samples = vec![PageSample::Missing; positions.len()];
    let mut errors_mm = [0.0_f64; 2];
    let columns: Vec<MarkerCoding> = (0..n_columns)
        .map(|column| {
            let given = || positions.iter().skip(column).step_by(n_columns);
            let (of, coded) = MarkerCoding::of(given, lattice);
            let is_turn = column >= n_markers && (column - n_markers) % OF_BODY == 1;
            let largest = &mut errors_mm[usize::from(is_turn)];
            let places = samples.iter_mut().skip(column).step_by(n_columns);
            for ((place, sample), position) in places.zip(coded).zip(given()) {
                if let PageSample::Point(point) = sample {
                    *largest = largest.max(lattice.error_mm(point, *position));
                }
                *place = sample;
            }
            of
        })
        .collect();
    let has_exact = samples.iter().any(|sample| matches!(sample, PageSample::Exact(_)));
    let mut coder = RangeEncoder::new(out, usize::MAX);
    let mut source = samples.into_iter();
    let given = Given { has_exact, columns };
    code_block(&mut coder, n_columns, n_frames, Some(&given), |coded| match coded {
        None => source.next().unwrap_or(PageSample::Missing),
        Some(sample) => sample,
    });
    // There is no limit that it could exceed.
    let _is_whole = coder.finish();
    errors_mm
}

/// Decodes a block of a page into one position per frame and trajectory, of which a marker has one, and a rigid body two behind
/// those of all markers: a reference for decoders in other languages.
#[must_use]
pub fn decode_block(
    bytes: &[u8],
    n_columns: usize,
    n_frames: usize,
    lattice: Lattice,
) -> Vec<Position> {
    let mut coder = RangeDecoder::new(bytes);
    let mut positions = Vec::with_capacity(n_columns * n_frames);
    code_block(&mut coder, n_columns, n_frames, None, |sample| {
        if let Some(sample) = sample {
            positions.push(match sample {
                PageSample::Missing => GAP,
                PageSample::Exact(position) => position,
                PageSample::Point(point) => lattice.position(point),
            });
        }
        PageSample::Missing
    });
    positions
}

/// A sample as it is coded.
#[derive(Debug, Clone, Copy, PartialEq)]
enum PageSample {
    Missing,
    Point([i32; 3]),
    /// Too far away for the lattice.
    Exact(Position),
}

/// What an encoder decides for a marker in a block.
#[derive(Debug, Clone, Copy)]
struct MarkerCoding {
    /// 0: all samples are present, 1: none, 2: some.
    presence: u8,
    /// Number of earlier samples in a prediction: 1, 2 or 3.
    order: u8,
}

impl MarkerCoding {
    /// Decides by all positions of a marker, and returns its samples, too.
    fn of<'p, I: Iterator<Item = &'p Position>>(
        given: impl Fn() -> I,
        lattice: Lattice,
    ) -> (Self, Vec<PageSample>) {
        let missing = given().filter(|position| is_gap(**position)).count();
        let presence = match missing {
            0 => 0,
            n if n == given().count() => 1,
            _ => 2,
        };
        let mut best = (1, Vec::new(), f64::INFINITY);
        for order in 1..=3 {
            let (samples, bits) = quantised(given(), order, lattice);
            if bits < best.2 {
                best = (order, samples, bits);
            }
        }
        (Self { presence, order: best.0 }, best.1)
    }
}

/// The samples of a marker if they are predicted from `order` earlier ones, and about how many bits they take.
fn quantised<'p, I: Iterator<Item = &'p Position>>(
    positions: I,
    order: u8,
    lattice: Lattice,
) -> (Vec<PageSample>, f64) {
    let mut history = History::default();
    let mut bits = 0.0;
    let samples = positions.map(|&position| {
        let expected = [0, 1, 2].map(|axis| history.predict(order, axis));
        let point = match history.n {
            0 => lattice.nearest(position),
            _ => lattice.point(position, expected),
        };
        let (false, Some(point)) = (is_gap(position), point) else {
            history.n = 0;
            return if is_gap(position) {
                PageSample::Missing
            } else {
                PageSample::Exact(position)
            };
        };
        if history.n > 0 {
            let sizes =
                [0, 1, 2].map(|axis| point[axis].wrapping_sub(expected[axis]).unsigned_abs());
            bits += match sizes {
                [0, 0, 0] => STILL_BITS,
                sizes => sizes.iter().map(|n| 1.5 + 1.5 * f64::from(32 - n.leading_zeros())).sum(),
            };
        }
        history.push(point);
        PageSample::Point(point)
    });
    let samples = samples.collect();
    (samples, bits)
}

/// About how many bits a sample takes that is where it was expected.
const STILL_BITS: f64 = 0.4;

/// What is coded besides the samples.
struct Given {
    has_exact: bool,
    columns: Vec<MarkerCoding>,
}

/// The last samples of a marker without a gap between them, newest first.
#[derive(Debug, Clone, Copy, Default)]
struct History {
    points: [[i32; 3]; 3],
    n: usize,
    /// The last two residuals by axis, newest first.
    residuals: [[i32; 3]; 2],
    /// Whether the last two samples were where they were expected, newest in the lowest bit.
    as_expected: usize,
}

impl History {
    fn predict(&self, order: u8, axis: usize) -> i32 {
        let [a, b, c] = self.points.map(|point| point[axis]);
        match (usize::from(order)).min(self.n.max(1)) {
            1 => a,
            2 => a.wrapping_mul(2).wrapping_sub(b),
            _ => a.wrapping_sub(b).wrapping_mul(3).wrapping_add(c),
        }
    }

    fn push(&mut self, point: [i32; 3]) {
        self.points = [point, self.points[0], self.points[1]];
        self.n = (self.n + 1).min(3);
    }
}

/// The models of a block. All are new at its beginning, so that a player can start with any block.
struct Models {
    has_exact: Bit,
    presence: [Bit; 2],
    order: [Bit; 2],
    present: [Bit; 2],
    exact: Bit,
    /// By whether the last two samples of the marker, and the last one of any, were as expected.
    as_expected: [Bit; 8],
    zero: [[Bit; CLASSES]; 3],
    negative: [[Bit; 3]; 3],
    more: [[Bit; UNARY_MAX as usize]; CLASSES],
    length: [Bit; 32],
}

impl Models {
    fn new() -> Self {
        Self {
            has_exact: Bit::NEW,
            presence: [Bit::NEW; 2],
            order: [Bit::NEW; 2],
            present: [Bit::NEW; 2],
            exact: Bit::NEW,
            as_expected: [Bit::NEW; 8],
            zero: [[Bit::NEW; CLASSES]; 3],
            negative: [[Bit::NEW; 3]; 3],
            more: [[Bit::NEW; UNARY_MAX as usize]; CLASSES],
            length: [Bit::NEW; 32],
        }
    }

    /// Codes a number from 0 to 2 with two models.
    fn of_three<C: BinaryCoder>(coder: &mut C, models: &mut [Bit; 2], value: u8) -> u8 {
        if !coder.bit(&mut models[0], value > 0) {
            0
        } else {
            1 + u8::from(coder.bit(&mut models[1], value > 1))
        }
    }

    /// Codes a residual of an axis; `class` is that of earlier residuals, `signs` are those of the last two, 0 to 2.
    fn residual<C: BinaryCoder>(
        &mut self,
        coder: &mut C,
        (axis, class): (usize, usize),
        signs: [usize; 2],
        value: i32,
    ) -> i32 {
        if !coder.bit(&mut self.zero[axis][class], value != 0) {
            return 0;
        }
        let is_negative = coder.bit(&mut self.negative[signs[0]][signs[1]], value < 0);
        let size = value.unsigned_abs().wrapping_sub(1);
        let mut n = 0;
        while n < UNARY_MAX && coder.bit(&mut self.more[class][n as usize], size > n) {
            n += 1;
        }
        if n == UNARY_MAX {
            n = n.wrapping_add(self.large(coder, size.wrapping_sub(UNARY_MAX)));
        }
        let size = n.wrapping_add(1) as i32;
        if is_negative { size.wrapping_neg() } else { size }
    }

    /// Codes a number of any size: the number of its bits in unary, then these.
    fn large<C: BinaryCoder>(&mut self, coder: &mut C, value: u32) -> u32 {
        let value = u64::from(value) + 1;
        let bits = value.ilog2();
        let mut n = 0;
        while n < 31 && coder.bit(&mut self.length[n as usize], bits > n) {
            n += 1;
        }
        let low = coder.plain(value & ((1 << n) - 1), n);
        ((1_u64 << n | low) - 1) as u32
    }
}

/// Codes a block. An encoder passes what is `given`. `next` returns the next sample when it receives `None`, which a
/// decoder ignores, and then receives the sample as it was coded.
fn code_block<C: BinaryCoder>(
    coder: &mut C,
    n_columns: usize,
    n_frames: usize,
    given: Option<&Given>,
    mut next: impl FnMut(Option<PageSample>) -> PageSample,
) {
    let mut models = Models::new();
    let has_exact = coder.bit(&mut models.has_exact, given.is_some_and(|given| given.has_exact));
    let columns: Vec<MarkerCoding> = (0..n_columns)
        .map(|i| {
            let of = given.map_or(MarkerCoding { presence: 0, order: 1 }, |given| given.columns[i]);
            let presence = Models::of_three(coder, &mut models.presence, of.presence);
            let order = match presence {
                1 => 1,
                _ => 1 + Models::of_three(coder, &mut models.order, of.order - 1),
            };
            MarkerCoding { presence, order }
        })
        .collect();
    let mut histories = vec![History::default(); n_columns];
    let mut before = Before::default();
    for _ in 0..n_frames {
        for (column, history) in columns.iter().zip(&mut histories) {
            let given = next(None);
            let is_present = match column.presence {
                0 => true,
                1 => false,
                _ => coder.bit(
                    &mut models.present[usize::from(history.n > 0)],
                    given != PageSample::Missing,
                ),
            };
            if !is_present {
                history.n = 0;
                next(Some(PageSample::Missing));
                continue;
            }
            let is_exact =
                has_exact && coder.bit(&mut models.exact, matches!(given, PageSample::Exact(_)));
            if is_exact {
                let position = if let PageSample::Exact(position) = given { position } else { GAP };
                let bits = position.map(|v| coder.plain(u64::from(v.to_bits()), 32) as u32);
                history.n = 0;
                next(Some(PageSample::Exact(bits.map(f32::from_bits))));
                continue;
            }
            let point = if let PageSample::Point(point) = given { point } else { [0; 3] };
            let point = code_point(coder, &mut models, column.order, (history, &mut before), point);
            next(Some(PageSample::Point(point)));
        }
    }
}

/// The sample that was coded before, of any marker.
#[derive(Debug, Clone, Copy, Default)]
struct Before {
    /// Where a sample without an earlier one of its marker is expected.
    point: [i32; 3],
    was_expected: bool,
}

/// Codes the point of a present sample.
fn code_point<C: BinaryCoder>(
    coder: &mut C,
    models: &mut Models,
    order: u8,
    (history, before): (&mut History, &mut Before),
    point: [i32; 3],
) -> [i32; 3] {
    let is_new = history.n == 0;
    if is_new {
        // After a gap, the last place of the marker; at the beginning of a block, that of another one.
        let is_first = history.points == [[0; 3]; 3];
        history.points[0] = if is_first { before.point } else { history.points[0] };
        history.residuals = [[0; 3]; 2];
        history.as_expected = 0;
    }
    let expected = [0, 1, 2].map(|axis| history.predict(order, axis));
    let context = history.as_expected << 1 | usize::from(before.was_expected);
    let is_expected = !is_new && coder.bit(&mut models.as_expected[context], point == expected);
    let mut residuals = [0_i32; 3];
    for axis in 0..3 {
        if is_expected {
            break;
        }
        let [newer, older] = history.residuals.map(|residual| residual[axis]);
        let beside = if axis > 0 { residuals[axis - 1].unsigned_abs() } else { 0 };
        let earlier = u64::from(newer.unsigned_abs()) * 2
            + u64::from(older.unsigned_abs())
            + u64::from(beside);
        let class = match history.n {
            0 => CLASSES - 1,
            _ => ((u64::BITS - earlier.leading_zeros()) as usize).min(CLASSES - 2),
        };
        let signs = [newer, older].map(|residual| (residual.signum() + 1) as usize);
        let value = point[axis].wrapping_sub(expected[axis]);
        residuals[axis] = models.residual(coder, (axis, class), signs, value);
    }
    let coded = [0, 1, 2].map(|axis| expected[axis].wrapping_add(residuals[axis]));
    // The first residual is a distance between places, and says nothing about those that follow.
    history.residuals = if is_new { [[0; 3]; 2] } else { [residuals, history.residuals[0]] };
    history.as_expected = (history.as_expected << 1 | usize::from(is_expected)) & 3;
    history.push(coded);
    *before = Before { point: coded, was_expected: is_expected };
    coded
}

const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

/// Bytes as base64 with padding (RFC 4648).
#[must_use]
pub fn base64(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let word = three.iter().fold(0_u32, |word, byte| word << 8 | u32::from(*byte));
        let word = word << (8 * (3 - three.len()));
        for digit in 0..4 {
            let value = (word >> (18 - 6 * digit) & 63) as usize;
            text.push(if digit <= three.len() { char::from(DIGITS[value]) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests;
