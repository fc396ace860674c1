//! Motion coded for a page that plays it without mocapd: integers on a lattice, predicted in time, and range coded.
//!
//! The format is simple, so that a decoder is a page of JavaScript (`web/motion_decoder.js`): it is not that of takes, and
//! larger. `docs/sharing.md` specifies it. Its error comes on top of that of the take that is coded, and is measured for
//! every sample.

use std::io::{self, Write};

use mocapd_codec::range::{BinaryCoder, Bit, RangeDecoder, RangeEncoder};

use crate::motion::{FrameSource, GAP, Position, is_gap};

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

    fn error_mm(self, point: [i32; 3], position: Position) -> f64 {
        let coded = self.position(point);
        let squares =
            coded.iter().zip(position).map(|(a, b)| (f64::from(*a) - f64::from(b)).powi(2));
        squares.sum::<f64>().sqrt()
    }
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
    /// Bytes of all blocks.
    pub bytes: u64,
}

/// Frames of a block of so many markers.
#[must_use]
pub fn block_frames(n_markers: usize) -> usize {
    let [low, high] = BLOCK_FRAMES;
    (BLOCK_SAMPLES / n_markers.max(1)).clamp(low, high)
}

/// Codes all frames of a source and writes each block as a line of base64. `each` receives the number of
/// every frame, its positions, and whether it was damaged in the file.
///
/// # Errors
/// `Io` if reading or writing fails.
pub fn write(
    frames: &mut dyn FrameSource,
    lattice: Lattice,
    out: &mut dyn Write,
    mut each: impl FnMut(u64, &[Position], bool),
) -> io::Result<CodedMotion> {
    let n_markers = frames.info().markers.len();
    let block_frames = block_frames(n_markers);
    let mut coded = CodedMotion { block_frames, ..CodedMotion::default() };
    let mut row = vec![GAP; n_markers];
    let mut block = Vec::with_capacity(block_frames * n_markers);
    let mut bytes = Vec::new();
    loop {
        block.clear();
        let mut n_frames = 0;
        while n_frames < block_frames && frames.next_frame(&mut row)? {
            each(coded.frames, &row, frames.is_lost());
            block.extend_from_slice(&row);
            coded.frames += 1;
            n_frames += 1;
        }
        if n_frames == 0 {
            return Ok(coded);
        }
        bytes.clear();
        let error_mm = encode_block(&block, n_markers, n_frames, lattice, &mut bytes);
        coded.max_added_mm = coded.max_added_mm.max(error_mm);
        coded.bytes += bytes.len() as u64;
        let mut line = base64(&bytes);
        line.push('\n');
        out.write_all(line.as_bytes())?;
    }
}

/// Codes a block, and returns the largest error in millimetres.
fn encode_block(
    positions: &[Position],
    n_markers: usize,
    n_frames: usize,
    lattice: Lattice,
    out: &mut Vec<u8>,
) -> f64 {
    let mut samples = vec![PageSample::Missing; positions.len()];
    let columns: Vec<MarkerCoding> = (0..n_markers)
        .map(|column| {
            let given = || positions.iter().skip(column).step_by(n_markers);
            let (of, coded) = MarkerCoding::of(given, lattice);
            let places = samples.iter_mut().skip(column).step_by(n_markers);
            places.zip(coded).for_each(|(place, sample)| *place = sample);
            of
        })
        .collect();
    let has_exact = samples.iter().any(|sample| matches!(sample, PageSample::Exact(_)));
    let errors_mm = samples.iter().zip(positions).map(|(sample, position)| match sample {
        PageSample::Point(point) => lattice.error_mm(*point, *position),
        PageSample::Missing | PageSample::Exact(_) => 0.0,
    });
    let error_mm = errors_mm.fold(0.0, f64::max);
    let mut coder = RangeEncoder::new(out, usize::MAX);
    let mut source = samples.into_iter();
    let given = Given { has_exact, columns };
    code_block(&mut coder, n_markers, n_frames, Some(&given), |coded| match coded {
        None => source.next().unwrap_or(PageSample::Missing),
        Some(sample) => sample,
    });
    // There is no limit that it could exceed.
    let _is_whole = coder.finish();
    error_mm
}

/// Decodes a block of a page into one position per frame and marker: a reference for decoders in other languages.
#[must_use]
pub fn decode_block(
    bytes: &[u8],
    n_markers: usize,
    n_frames: usize,
    lattice: Lattice,
) -> Vec<Position> {
    let mut coder = RangeDecoder::new(bytes);
    let mut positions = Vec::with_capacity(n_markers * n_frames);
    code_block(&mut coder, n_markers, n_frames, None, |sample| {
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
    n_markers: usize,
    n_frames: usize,
    given: Option<&Given>,
    mut next: impl FnMut(Option<PageSample>) -> PageSample,
) {
    let mut models = Models::new();
    let has_exact = coder.bit(&mut models.has_exact, given.is_some_and(|given| given.has_exact));
    let columns: Vec<MarkerCoding> = (0..n_markers)
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
    let mut histories = vec![History::default(); n_markers];
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
mod tests {
    use mocapd_testkit::random::Random;

    use super::*;

    /// A walk of `n` markers with gaps, and positions far away.
    fn walk(seed: u64, n: usize, frames: usize) -> Vec<Position> {
        let mut random = Random::new(seed);
        let mut unit = || random.below(2001) as f32 / 1000.0 - 1.0;
        let mut at = vec![[0.0_f32; 3]; n];
        let mut positions = Vec::new();
        for frame in 0..frames {
            for (marker, place) in at.iter_mut().enumerate() {
                *place = place.map(|v| v + 9.0 * unit());
                let is_missing = marker == 1 || (marker == 2 && frame % 17 < 5);
                positions.push(if is_missing { GAP } else { *place });
            }
        }
        positions[0] = [1e30, -3.5, 0.0];
        positions
    }

    fn error_mm(a: Position, b: Position) -> f64 {
        a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(b)).powi(2)).sum::<f64>().sqrt()
    }

    #[test]
    fn a_block_is_decoded_within_its_bound_and_keeps_every_gap() {
        for (seed, n, frames) in [(1, 5, 300), (2, 1, 40), (3, 3, 1)] {
            let given = walk(seed, n, frames);
            for added_mm in [0.001, 0.5, 40.0] {
                let lattice = Lattice::within(added_mm);
                let mut bytes = Vec::new();
                let stated = encode_block(&given, n, frames, lattice, &mut bytes);
                let found = decode_block(&bytes, n, frames, lattice);
                assert_eq!(found.len(), given.len());
                assert_eq!(found[0], given[0], "too far away for the lattice");
                let mut worst = 0.0_f64;
                for (a, b) in given.iter().zip(&found) {
                    assert_eq!(is_gap(*a), is_gap(*b));
                    if !is_gap(*a) {
                        worst = worst.max(error_mm(*a, *b));
                    }
                }
                assert!(worst <= added_mm && worst == stated, "{worst} {stated} {added_mm}");
            }
        }
    }

    #[test]
    fn arbitrary_bytes_decode_to_as_many_positions() {
        let mut random = Random::new(7);
        for n in 0..200 {
            let bytes: Vec<u8> = (0..n).map(|_| random.below(256) as u8).collect();
            assert_eq!(decode_block(&bytes, 3, 20, Lattice::within(1.0)).len(), 60);
        }
    }

    #[test]
    fn base64_as_in_the_rfc() {
        for (bytes, text) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
    }
}
