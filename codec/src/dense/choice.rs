//! The choice of lattice points: greedily, row by row, by rate-distortion optimisation over the points around a
//! sample; trials, which price the rows of a span with points that are decided in advance; and rehearsals, which code them.

use std::ops::RangeInclusive;

use super::{
    SPAN,
    contexts::KINDS,
    cross_channel::SpanResiduals,
    distance_correction::{BATCH_ROWS, KindShares},
    lattice::{AXES, CELL_POINTS, Grid, Lattice, LatticeCell, Point, Points, Reach, lanes},
    level::{Channels, ResidualInputs, RowCodec},
    level_prediction::{AnchorErrors, Batch, LevelLayout, PADDED_ROWS, PADDED_SPAN, PAST_ROWS},
    model::CostCounter,
    segment_lengths::PartnerDistances,
    track::Steps,
};
use crate::{
    Position, Rows,
    block::{squared_distance, widen},
};

/// Price of the squared distance from the sample, in bits at the radius of the ball, by kind of row: higher where more
/// rows are predicted from the point. Chosen by measurement: a price on all levels gains 0.3 %, these prices 0.6 %;
/// choosing the cheapest point regardless of its distance loses 3 %.
const DISTANCE_PRICES: [f64; KINDS] = [20.0, 20.0, 20.0, 20.0, 0.1, 5.0, 10.0, 20.0, 20.0, 20.0];
/// The price where no row is predicted from the point.
const LAST_LEVEL_PRICE: f64 = 0.1;

/// The lattice points inside a tolerance ball, as steps from the prediction.
#[derive(Debug, Clone, Copy)]
pub(super) struct BallPoints {
    points: [Point; 2 * CELL_POINTS],
    n: usize,
}

impl BallPoints {
    pub(super) const NONE: Self = Self { points: [[0; 3]; 2 * CELL_POINTS], n: 0 };

    pub(super) fn points(&self) -> &[Point] {
        &self.points[..self.n]
    }
}

/// The samples of the rows of one level of a run.
#[derive(Debug)]
pub(super) struct LevelSamples {
    grid: Grid,
    /// The largest square in mm^2 whose root is within the tolerance.
    pub(super) max_square: f64,
    /// The samples in mm, by axis; and the squared errors of the predictions of a batch.
    samples: [[f32; PADDED_ROWS]; 3],
    pub(super) predicted_squares: [f64; BATCH_ROWS],
    /// Offsets of the samples from their predictions, in units.
    off: [[f64; PADDED_ROWS]; 3],
}

impl LevelSamples {
    pub(super) fn new(grid: Grid) -> Self {
        Self::within(grid, largest_square(grid.tolerance_mm()))
    }

    /// Samples that must be met exactly.
    pub(super) fn exact(grid: Grid) -> Self {
        Self::within(grid, 0.0)
    }

    fn within(grid: Grid, max_square: f64) -> Self {
        Self {
            grid,
            max_square,
            samples: [[0.0; PADDED_ROWS]; 3],
            predicted_squares: [0.0; BATCH_ROWS],
            off: [[0.0; PADDED_ROWS]; 3],
        }
    }

    /// Begins a level of a channel with these positions.
    #[inline(always)]
    pub(super) fn begin(&mut self, positions: &[Position], layout: &LevelLayout) {
        for i in 0..layout.n.min(PADDED_ROWS) {
            let sample = positions[layout.at(i) - PAST_ROWS];
            for (axis, coordinate) in self.samples.iter_mut().zip(sample) {
                axis[i] = coordinate;
            }
        }
    }

    /// The squared distances in mm^2 between the samples of a batch and the points `units`.
    #[inline(always)]
    pub(super) fn squares<const N: usize>(&self, batch: Batch, units: &Points<N>) -> [f64; N] {
        let positions = self.grid.positions(units);
        let [x, y, z] = &self.samples;
        let samples: [[f32; N]; 3] =
            [lanes(x, batch.from), lanes(y, batch.from), lanes(z, batch.from)];
        let mut squares = [0.0; N];
        for i in 0..N {
            let x = f64::from(positions[0][i]) - f64::from(samples[0][i]);
            let y = f64::from(positions[1][i]) - f64::from(samples[1][i]);
            let z = f64::from(positions[2][i]) - f64::from(samples[2][i]);
            squares[i] = x * x + y * y + z * z;
        }
        squares
    }

    /// One bit per row of a batch: its sample is outside the tolerance ball of the prediction.
    #[inline(always)]
    pub(super) fn outside<const N: usize>(&mut self, batch: Batch, predictions: &Points<N>) -> u32 {
        let squares = self.squares(batch, predictions);
        self.predicted_squares[..N].copy_from_slice(&squares);
        for (axis, off) in self.off.iter_mut().enumerate() {
            let samples: [f32; N] = lanes(&self.samples[axis], batch.from);
            let off = &mut off[batch.from..batch.from + N];
            for i in 0..N {
                off[i] = f64::from(samples[i]) / self.grid.unit_mm - predictions[axis][i];
            }
        }
        let mut bits = 0;
        for (i, squares) in squares.into_iter().enumerate() {
            bits |= u32::from(squares > self.max_square) << i;
        }
        bits
    }

    /// Whether the point `steps` from the prediction of a row is within the tolerance.
    #[inline(always)]
    pub(super) fn is_inside(&self, inputs: &ResidualInputs, steps: [f64; 3]) -> bool {
        let step = inputs.fineness.step(inputs.lattice) as f64;
        let sample = self.samples.each_ref().map(|axis| axis[inputs.place]);
        let point = std::array::from_fn(|axis| inputs.prediction[axis] + steps[axis] * step);
        squared_distance(widen(self.grid.position(point)), widen(sample)) <= self.max_square
    }

    #[inline(always)]
    fn cell(&self, inputs: &ResidualInputs) -> LatticeCell<'static> {
        let reach = Reach::of(inputs.lattice, inputs.fineness);
        let (mut off, mut activity) = ([0.0; AXES], [0.0; AXES]);
        for axis in 0..3 {
            off[axis] = self.off[axis][inputs.place] * reach.steps_per_unit;
            activity[axis] = f64::from(inputs.activity[axis]) / 256.0;
        }
        let distance_price =
            if inputs.last_level { LAST_LEVEL_PRICE } else { DISTANCE_PRICES[inputs.kind] };
        LatticeCell { off, activity, distance_price, reach }
    }

    /// Chooses, of the lattice points around the sample inside the tolerance ball, the one with the smallest sum of
    /// estimated bits and priced distance.
    #[inline(always)]
    pub(super) fn choose(&self, inputs: &ResidualInputs) -> Point {
        let cell = self.cell(inputs);
        let is_inside = |steps: [f64; 3]| self.is_inside(inputs, steps);
        let steps = match inputs.lattice {
            Lattice::Cubic => cell.cheapest::<1, CELL_POINTS>(is_inside),
            Lattice::Centred => cell.cheapest::<2, { 2 * CELL_POINTS }>(is_inside),
        };
        steps.map(|steps| steps as i64)
    }

    /// All lattice points inside the tolerance ball.
    fn ball_points(&self, inputs: &ResidualInputs) -> BallPoints {
        let cell = self.cell(inputs);
        let mut found = BallPoints::NONE;
        let mut take = |steps: [f64; 3]| {
            if self.is_inside(inputs, steps)
                && let Some(point) = found.points.get_mut(found.n)
            {
                *point = steps.map(|steps| steps as i64);
                found.n += 1;
            }
        };
        match inputs.lattice {
            Lattice::Cubic => cell.corners::<1>(&mut take),
            Lattice::Centred => cell.corners::<2>(&mut take),
        }
        found
    }
}

/// The largest f64 number whose square root does not exceed the tolerance.
fn largest_square(tolerance_mm: f64) -> f64 {
    let mut squares = tolerance_mm * tolerance_mm;
    while squares.sqrt() > tolerance_mm {
        squares = squares.next_down();
    }
    while squares.next_up().sqrt() <= tolerance_mm {
        squares = squares.next_up();
    }
    squares
}

/// The decided rows of one channel in a span, by slot, and their steps from the prediction.
#[derive(Debug, Clone, Copy)]
pub(super) struct SpanPlan {
    decided: u64,
    steps: [Point; SPAN],
}

const _: () = assert!(SPAN == u64::BITS as usize);

impl SpanPlan {
    pub(super) const NONE: Self = Self { decided: 0, steps: [[0; 3]; SPAN] };

    /// The steps of a row; `None` where they are not decided.
    #[inline(always)]
    pub(super) fn steps(&self, slot: usize) -> Option<Point> {
        let is_decided = self.decided >> (slot % SPAN) & 1 == 1;
        is_decided.then(|| self.steps[slot % SPAN])
    }

    /// One bit per slot from `slot` on: whether it is decided.
    #[inline(always)]
    pub(super) fn decided_from(&self, slot: usize) -> u64 {
        self.decided >> (slot % SPAN)
    }

    pub(super) fn decide(&mut self, slot: usize, steps: Point) {
        self.decided |= 1 << (slot % SPAN);
        self.steps[slot % SPAN] = steps;
    }

    /// The decided steps of the row at `slot` if they lead into the tolerance ball; else its prediction, if that is inside.
    pub(super) fn fitting(
        &self,
        slot: usize,
        inputs: &ResidualInputs,
        samples: &LevelSamples,
    ) -> Option<Point> {
        let fits = |steps: &Point| {
            inputs.lattice.contains(*steps)
                && samples.is_inside(inputs, steps.map(|step| step as f64))
        };
        [self.steps(slot)?, [0; 3]].into_iter().find(fits)
    }
}

/// Prices the rows of a span: the points of a plan, greedy choices elsewhere.
#[derive(Debug)]
pub(super) struct Trial<'a> {
    channels: &'a [Rows<'a>],
    samples: LevelSamples,
    pub(super) coder: CostCounter,
    /// The cost at which a trial is abandoned.
    pub(super) limit: u64,
    pub(super) plan: SpanPlan,
    /// The slot of the row whose points are all collected; [`SPAN`] for none.
    pub(super) wanted: usize,
    /// The points of that row, and the greedy choice.
    pub(super) points: BallPoints,
    pub(super) greedy: Point,
    /// The slot of the first row of the current level.
    slot: usize,
}

impl<'a> Trial<'a> {
    pub(super) fn new(channels: &'a [Rows<'a>], grid: Grid) -> Self {
        Self {
            channels,
            samples: LevelSamples::new(grid),
            coder: CostCounter::default(),
            limit: u64::MAX,
            plan: SpanPlan::NONE,
            wanted: SPAN,
            points: BallPoints::NONE,
            greedy: [0; 3],
            slot: 0,
        }
    }
}

impl RowCodec for Trial<'_> {
    type Coder = CostCounter;

    fn coder(&mut self) -> &mut CostCounter {
        &mut self.coder
    }

    #[inline(always)]
    fn choose(&mut self, inputs: ResidualInputs) -> Point {
        let slot = self.slot + inputs.place;
        if let Some(steps) = self.plan.steps(slot) {
            return steps;
        }
        if slot != self.wanted {
            return self.samples.choose(&inputs);
        }
        self.points = self.samples.ball_points(&inputs);
        let stays = self.samples.is_inside(&inputs, [0.0; 3]);
        self.greedy = if stays { [0; 3] } else { self.samples.choose(&inputs) };
        self.greedy
    }

    fn position(&self, channel: usize, row: usize) -> Option<Position> {
        Some(self.channels[channel].positions()[row])
    }

    #[inline(always)]
    fn begin(&mut self, layout: &LevelLayout) {
        self.slot = layout.slot;
        self.samples.begin(self.channels[layout.run.channel].positions(), layout);
    }

    #[inline(always)]
    fn outside<const N: usize>(&mut self, batch: Batch, predictions: &Points<N>) -> u32 {
        let wanted = if self.wanted < SPAN { 1 << self.wanted >> batch.slot } else { 0_u64 };
        let asked = self.plan.decided_from(batch.slot) | wanted;
        self.samples.outside(batch, predictions) | asked as u32
    }

    #[inline(always)]
    fn gives_up(&self) -> bool {
        self.coder.cost >= self.limit
    }

    #[inline(always)]
    fn finish_rows<const N: usize>(&mut self, _: Batch, _: &Points<N>, _: u32) {}
}

/// Codes the rows of a span by their plans, as the encoder will, but only counts them. The model learns, so that it is the one after the span.
#[derive(Debug)]
pub(super) struct Rehearsal<'a> {
    channels: &'a [Rows<'a>],
    plans: &'a [SpanPlan],
    samples: LevelSamples,
    coder: CostCounter<true>,
    /// The channel of the current level, and the slot of its first row.
    channel: usize,
    slot: usize,
}

impl<'a> Rehearsal<'a> {
    pub(super) fn new(channels: &'a [Rows<'a>], plans: &'a [SpanPlan], grid: Grid) -> Self {
        let samples = LevelSamples::new(grid);
        Self { channels, plans, samples, coder: CostCounter::default(), channel: 0, slot: 0 }
    }

    /// The cost so far, in 2^-10 bits.
    pub(super) fn cost(&self) -> u64 {
        self.coder.cost
    }
}

impl RowCodec for Rehearsal<'_> {
    type Coder = CostCounter<true>;

    fn coder(&mut self) -> &mut CostCounter<true> {
        &mut self.coder
    }

    #[inline(always)]
    fn choose(&mut self, inputs: ResidualInputs) -> Point {
        let slot = self.slot + inputs.place;
        let planned = self.plans[self.channel].fitting(slot, &inputs, &self.samples);
        planned.unwrap_or_else(|| self.samples.choose(&inputs))
    }

    fn position(&self, channel: usize, row: usize) -> Option<Position> {
        Some(self.channels[channel].positions()[row])
    }

    #[inline(always)]
    fn begin(&mut self, layout: &LevelLayout) {
        (self.channel, self.slot) = (layout.run.channel, layout.slot);
        self.samples.begin(self.channels[self.channel].positions(), layout);
    }

    #[inline(always)]
    fn outside<const N: usize>(&mut self, batch: Batch, predictions: &Points<N>) -> u32 {
        let planned = self.plans[batch.channel].decided_from(batch.slot) as u32;
        self.samples.outside(batch, predictions) | planned
    }

    #[inline(always)]
    fn finish_rows<const N: usize>(&mut self, _: Batch, _: &Points<N>, _: u32) {}
}

/// The state of one channel in a span.
#[derive(Debug, Clone)]
pub(super) struct ChannelState {
    points: [[f64; 3]; SPAN],
    steps: [Steps; SPAN],
    span: [[f64; PADDED_SPAN]; 3],
    packed_steps: [u64; PADDED_SPAN],
    activity: [[i32; 4]; KINDS],
    anchor_errors: AnchorErrors,
    shares: KindShares,
    distances: PartnerDistances,
    residuals: SpanResiduals,
}

impl ChannelState {
    /// The state of a channel with the rows `rows` of its span.
    pub(super) fn of(channels: &Channels, channel: usize, rows: RangeInclusive<usize>) -> Self {
        let track = &channels.tracks[channel];
        let (mut points, mut steps) = ([[f64::NAN; 3]; SPAN], [Steps::default(); SPAN]);
        for (i, row) in rows.take(SPAN).enumerate() {
            (points[i], steps[i]) = (track.points[row], track.steps[row]);
        }
        Self {
            points,
            steps,
            span: track.span,
            packed_steps: track.packed_steps,
            activity: track.activity,
            anchor_errors: track.anchor_errors.clone(),
            shares: *channels.correction.shares(channel),
            distances: *channels.segments.partner_distances(channel),
            residuals: *channels.cross_channel.residuals(channel),
        }
    }

    /// Restores the state.
    pub(super) fn restore(
        &self,
        channels: &mut Channels,
        channel: usize,
        rows: RangeInclusive<usize>,
    ) {
        let track = &mut channels.tracks[channel];
        for (i, row) in rows.take(SPAN).enumerate() {
            (track.points[row], track.steps[row]) = (self.points[i], self.steps[i]);
        }
        track.span = self.span;
        track.packed_steps = self.packed_steps;
        track.activity = self.activity;
        track.anchor_errors.clone_from(&self.anchor_errors);
        *channels.correction.shares_mut(channel) = self.shares;
        *channels.segments.partner_distances_mut(channel) = self.distances;
        *channels.cross_channel.residuals_mut(channel) = self.residuals;
    }
}
