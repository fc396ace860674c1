//! The contract of every resampler: it encodes a group of channels over one stretch into one block, and decodes it, within an
//! error bound. Here are also the tolerance, the distances that are measured, and the six bits in which a block states them.

use crate::Position;

/// An error of the codec.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum CodecError {
    /// No encoder writes these bytes: they are damaged, or of another format. The text names what is wrong.
    #[error("corrupt block: {0}")]
    Corrupt(&'static str),
    /// The block ends before its samples do. The text names what is missing.
    #[error("block cut short: {0}")]
    Truncated(&'static str),
    /// An earlier block failed; encoder and decoder agree again only from a key block on.
    #[error("an earlier block failed; continue with a key block")]
    OutOfStep,
    /// The caller passed an argument that cannot be coded; the message says what can.
    #[error("{0}")]
    InvalidArgument(String),
}

pub(crate) type Result<T> = std::result::Result<T, CodecError>;

/// `Corrupt` with the text `otherwise` unless `holds`, a condition that every encoder's bytes meet.
#[inline(always)]
pub(crate) fn ensure(holds: bool, otherwise: &'static str) -> Result<()> {
    if holds { Ok(()) } else { Err(CodecError::Corrupt(otherwise)) }
}

/// Largest number of channels in a group, which are coded together.
///
/// A whole body then shares the fixed costs of a block: its length, its head, the ends of its entropy
/// coders, and what the model learns again after a key. A hundred markers still make two groups, which two
/// processors can code at the same time.
pub const GROUP_CHANNELS: usize = 64;

/// One channel over one stretch: one row per frame. `default()` has no rows.
#[derive(Debug, Clone, Copy, Default)]
pub struct Rows<'a> {
    positions: &'a [Position],
    present: &'a [bool],
}

impl<'a> Rows<'a> {
    /// `positions[i]`, in millimetres, is a sample where `present[i]`; elsewhere it is ignored.
    ///
    /// # Errors
    /// `InvalidArgument` when the two lengths differ.
    pub fn new(
        positions: &'a [Position],
        present: &'a [bool],
    ) -> std::result::Result<Self, CodecError> {
        if positions.len() == present.len() {
            return Ok(Self { positions, present });
        }
        Err(CodecError::InvalidArgument(format!(
            "{} positions but {} presence flags",
            positions.len(),
            present.len()
        )))
    }

    /// Number of rows, with and without a sample.
    #[must_use]
    pub fn len(&self) -> usize {
        self.present.len()
    }

    /// Whether there are no rows.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.present.is_empty()
    }

    /// The sample of a row in millimetres; `None` where it is absent.
    #[must_use]
    pub fn get(&self, row: usize) -> Option<Position> {
        (*self.present.get(row)?).then(|| self.positions[row])
    }

    /// One position per row in millimetres; meaningless where the row is absent.
    #[must_use]
    pub fn positions(&self) -> &'a [Position] {
        self.positions
    }

    /// One flag per row: whether it has a sample.
    #[must_use]
    pub fn present(&self) -> &'a [bool] {
        self.present
    }

    /// The runs of consecutive present rows, as half-open ranges.
    pub fn runs(&self) -> impl Iterator<Item = std::ops::Range<usize>> + 'a {
        runs(self.present)
    }
}

/// The runs of consecutive present rows in `present`, as half-open ranges.
pub(crate) fn runs(present: &[bool]) -> impl Iterator<Item = std::ops::Range<usize>> {
    let mut at = 0;
    std::iter::from_fn(move || {
        let start = at + run_length(&present[at..], false);
        at = start + run_length(&present[start..], true);
        (start < at).then_some(start..at)
    })
}

/// How many flags at the start equal `state`. Changes are rare, so 32 flags are compared at once.
fn run_length(present: &[bool], state: bool) -> usize {
    let (many, _) = present.as_chunks::<32>();
    let is_other = |many: &[bool; 32]| many.iter().fold(false, |any, &p| any | (p != state));
    let same = 32 * many.iter().position(is_other).unwrap_or(many.len());
    let rest = &present[same..];
    same + rest.iter().position(|&p| p != state).unwrap_or(rest.len())
}

/// Marks the rows of `marked`, in addition to those that it has.
pub(crate) fn mark(marked: &mut [bool], rows: &[bool]) {
    for (marked, row) in marked.iter_mut().zip(rows) {
        *marked |= row;
    }
}

/// What an encoder proved about one channel of the block it just wrote.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct BlockReport {
    /// Number of samples present.
    pub samples: u32,
    /// Number of samples kept (knots): the asynchronous sampling `TS_i` of (Shi et al. 2012).
    pub kept: u32,
    /// Largest Euclidean distance between a sample and its float32 reconstruction, in millimetres: measured,
    /// not estimated.
    pub max_error_mm: f64,
}

impl BlockReport {
    /// Reports that every sample of the channel is stored exactly, and marks the rows that have one.
    pub(crate) fn keep_all(&mut self, rows: Rows<'_>, kept_rows: &mut [bool]) {
        (self.kept, self.max_error_mm) = (self.samples, 0.0);
        mark(kept_rows, rows.present());
    }
}

/// Encodes the blocks of one group of channels, in order. A block may continue the state of the one before.
///
/// Call this trait; do not implement it outside this crate: it may get more methods.
pub trait BlockEncoder: Send + std::fmt::Debug {
    /// Allocates the memory for blocks of up to `n_channels` channels and `n_rows` rows. Without this call
    /// the encoder allocates as blocks need it. A debug build allocates more, to check every block.
    fn prepare(&mut self, n_channels: usize, n_rows: usize);

    /// Appends one block to `out`; appends nothing when no channel has a sample.
    ///
    /// `channels` has 1 to [`GROUP_CHANNELS`] entries with the same number of rows each; `reports` has one
    /// entry per channel. Between two key blocks a channel keeps its index; new channels are appended.
    ///
    /// `key` forgets all state first, so that a decoder may start here. `shared` is the result of
    /// [`Settings::plan`](crate::Settings::plan) for this stretch. The live kinds do not allocate after
    /// [`prepare`](Self::prepare) when `out` has spare capacity for
    /// [`max_block_bytes`](crate::Settings::max_block_bytes).
    ///
    /// # Errors
    /// `InvalidArgument` when a present sample is not finite or the slices differ in length; `out` is then
    /// unchanged. `OutOfStep` when an earlier block failed and this is not a key block.
    fn encode(
        &mut self,
        channels: &[Rows<'_>],
        shared: &[u8],
        key: bool,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
    ) -> std::result::Result<(), CodecError>;

    /// Whether each row of the last block keeps a sample of any channel. Meaningless after an error.
    fn kept_rows(&self) -> &[bool];

    /// Appends one key block that decodes to exactly these floats, at about their size; appends nothing when no channel
    /// has a sample. It is for samples that were decoded from other blocks.
    ///
    /// `stated_error_mm` is the largest error that those blocks state; the new block states it, too. The other arguments
    /// are those of [`encode`](Self::encode).
    ///
    /// # Errors
    /// `InvalidArgument` when a present sample is not finite, the slices differ in length, or the error exceeds the
    /// tolerance; `out` is then unchanged.
    fn encode_exact(
        &mut self,
        channels: &[Rows<'_>],
        stated_error_mm: f64,
        out: &mut Vec<u8>,
        reports: &mut [BlockReport],
    ) -> std::result::Result<(), CodecError>;
}

/// Decodes the blocks of one group of channels, in order, starting at a key block.
///
/// Its memory grows with the rows times the channels of a block; [`stated_channels`](crate::stated_channels)
/// reads the latter before decoding. Call this trait; do not implement it outside this crate: it may get
/// more methods.
pub trait BlockDecoder: Send + std::fmt::Debug {
    /// Replaces `out` by the rows of one block, with one entry per channel: from the group's first channel to
    /// the last one that has had a sample since the key block. An empty block has no channels. The memory in
    /// `out` is reused. The decoder trusts `n_rows`: bound it when it comes from a file.
    ///
    /// # Errors
    /// `Corrupt` or `Truncated`; `out` is then empty, and until the next key block every other block gives
    /// `OutOfStep`.
    fn decode(
        &mut self,
        block: &[u8],
        shared: &[u8],
        n_rows: usize,
        key: bool,
        out: &mut Vec<DecodedRows>,
    ) -> std::result::Result<(), CodecError>;

    /// Accounts for an empty block: any number of rows without a sample.
    fn skip(&mut self, key: bool);
}

/// The rows of one channel of a decoded block. Its memory is reused from block to block.
#[derive(Debug, Clone, Default, PartialEq)]
#[non_exhaustive]
pub struct DecodedRows {
    /// One position per row, in millimetres; `[0.0; 3]` where the row is absent.
    pub positions: Vec<Position>,
    /// One flag per row: whether it has a sample.
    pub present: Vec<bool>,
    /// One flag per row: whether its sample was kept (a knot) rather than interpolated.
    pub kept: Vec<bool>,
    /// The error bound that the block states for all its channels, in millimetres: the largest error that
    /// the encoder measured, rounded up to a multiple of 1/63 of the tolerance, never above the tolerance.
    pub max_error_mm: f64,
}

impl DecodedRows {
    /// Whether any row has a sample.
    #[must_use]
    pub fn has_samples(&self) -> bool {
        self.present.contains(&true)
    }

    /// Sets the number of rows and clears `kept`, reusing memory. `positions` and `present` keep old values: the
    /// caller must write them for every row.
    pub(crate) fn reuse(&mut self, n_rows: usize) {
        self.positions.resize(n_rows, [0.0; 3]);
        self.present.resize(n_rows, false);
        self.kept.clear();
        self.kept.resize(n_rows, false);
        self.max_error_mm = 0.0;
    }

    /// Zeroes the positions of absent rows.
    pub(crate) fn blank_absent(&mut self) {
        for (position, present) in self.positions.iter_mut().zip(&self.present) {
            *position = if *present { *position } else { [0.0; 3] };
        }
    }
}

/// Largest Euclidean distance in 3D, in millimetres, between a sample and its reconstruction.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct Tolerance(f64);

impl Tolerance {
    /// The smallest tolerance: below it, a float32 position at room scale has no redundant digits.
    pub const MIN_MM: f64 = 1e-4;
    /// The largest tolerance: anything beyond a kilometre is a typing error.
    pub const MAX_MM: f64 = 1e6;
    /// The step of a block that states the whole tolerance as its error.
    pub const STEPS: u8 = STATED_STEPS;

    /// The tolerance of `mm` millimetres.
    ///
    /// # Errors
    /// `InvalidArgument` when `mm` is not finite or outside `MIN_MM..=MAX_MM`.
    pub fn from_mm(mm: f64) -> Result<Self> {
        if mm.is_finite() && (Self::MIN_MM..=Self::MAX_MM).contains(&mm) {
            return Ok(Self(mm));
        }
        Err(CodecError::InvalidArgument(format!(
            "a tolerance of {mm} mm is outside {} mm to {} m; for exact samples use --lossless",
            Self::MIN_MM,
            Self::MAX_MM / 1000.0
        )))
    }

    /// The tolerance in millimetres.
    #[must_use]
    pub fn mm(self) -> f64 {
        self.0
    }

    /// The error bound in millimetres that a block states with [`stated_error_step`](crate::stated_error_step): up to
    /// [`STEPS`](Self::STEPS), a step is a fraction of the tolerance.
    #[must_use]
    pub fn stated_mm(self, step: u8) -> f64 {
        stated_mm(step, self.0)
    }
}

/// The stated bound is a multiple of 1/63 of the tolerance: the largest number of six bits.
pub(crate) const STATED_STEPS: u8 = 63;

/// One f64 per axis.
pub(crate) type Vector = [f64; 3];

/// Converts to f64, which is exact.
#[inline(always)]
pub(crate) fn widen(position: Position) -> Vector {
    position.map(f64::from)
}

/// The squared Euclidean distance. The order of operations is fixed, so that every machine gets the same bits.
#[inline(always)]
pub(crate) fn squared_distance(a: Vector, b: Vector) -> f64 {
    let (x, y, z) = (a[0] - b[0], a[1] - b[1], a[2] - b[2]);
    x * x + y * y + z * z
}

/// Euclidean distance in f64, in millimetres.
pub(crate) fn distance_mm(a: Position, b: Position) -> f64 {
    squared_distance(widen(a), widen(b)).sqrt()
}

/// The bound that `step` (0 to 63) states, in millimetres.
pub(crate) fn stated_mm(step: u8, tolerance_mm: f64) -> f64 {
    match step {
        0 => 0.0,
        // The division below could round to more than the tolerance.
        STATED_STEPS.. => tolerance_mm,
        _ => tolerance_mm * f64::from(step) / f64::from(STATED_STEPS),
    }
}

/// The smallest step that states at least `error_mm`; `None` when the error exceeds the tolerance.
pub(crate) fn stated_step(error_mm: f64, tolerance_mm: f64) -> Option<u8> {
    if error_mm.is_nan() || error_mm > tolerance_mm {
        return None;
    }
    let guess = (error_mm / tolerance_mm * f64::from(STATED_STEPS)).ceil() as u8;
    (guess..=STATED_STEPS).find(|&step| stated_mm(step, tolerance_mm) >= error_mm)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stated_bound_covers_the_error_and_keeps_the_tolerance() {
        for tolerance in [1e-4, 0.1, 0.3, 1.0, 7.7, 1e6] {
            for i in 0..=10_000 {
                let error = tolerance * f64::from(i) / 10_000.0;
                let step = stated_step(error, tolerance).unwrap();
                let stated = stated_mm(step, tolerance);
                assert!(stated >= error && stated <= tolerance, "{error} {stated} {tolerance}");
                let finer = stated_mm(step.saturating_sub(1), tolerance);
                assert!(step == 0 || finer < error, "{step} is not the smallest for {error}");
            }
            assert_eq!(stated_step(tolerance.next_up(), tolerance), None);
        }
        assert_eq!(stated_step(f64::NAN, 1.0), None);
    }
}
