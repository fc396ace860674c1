//! The encoder's choice of a representation and of events for a channel.

use super::{
    prediction::REFERENCES,
    representation::{
        CellForm, Cells, Head, LATTICE_MAX, PALETTE_MAX, Past, from_ordered, ordered,
    },
    walk::SampledChannelState,
};

/// Number of gaps between values in which a quantum is sought.
const GAPS: usize = 32;
/// Largest number of quanta that a gap in which a quantum is sought may have.
const DIVISOR_MAX: usize = 12;

/// Quanta of text with up to six decimals.
const DECIMAL_QUANTA: [f64; 7] = [1.0, 0.1, 0.01, 1e-3, 1e-4, 1e-5, 1e-6];

/// Samples from which the bits of a lattice are estimated.
const ESTIMATE: usize = 2048;

/// Samples that need more bits than this are stored instead.
const STORED_BITS: f64 = 32.0;

/// The channels before a channel; its references are chosen from them.
#[derive(Debug, Clone, Copy)]
pub(super) struct EarlierChannels<'a> {
    /// Channel after channel, one sample per row of the block.
    pub(super) samples: &'a [f32],
    pub(super) n_rows: usize,
    /// The rows that have a sample of the channel, ascending; `None` for all.
    pub(super) rows: Option<&'a [u32]>,
}

impl EarlierChannels<'_> {
    /// The rows of a sample of the channel and of the two before it; `None` if there is a gap between them.
    fn rows(&self, sample: usize) -> Option<[usize; 3]> {
        let Some(rows) = self.rows else { return Some([sample, sample - 1, sample - 2]) };
        let row = *rows.get(sample)? as usize;
        (*rows.get(sample - 2)? as usize + 2 == row).then(|| [row, row - 1, row - 2])
    }
}

/// Chooses the representation and the events of a channel. Its memory is reused.
#[derive(Debug, Default)]
pub(super) struct Fit {
    cells: Cells,
    /// All finite samples, sorted, as `ordered`.
    sorted: Vec<i32>,
    /// The distinct finite samples, sorted.
    values: Vec<i32>,
    /// The distinct values, by magnitude.
    near: Vec<f64>,
    /// Gaps between neighbouring values, and their possible errors.
    gaps: Vec<(f64, f64)>,
    /// Whether the channels of a group are likely to have one quantum.
    shares_quantum: bool,
    /// If so, the last quantum chosen since the key.
    quantum: Option<f64>,
}

impl Fit {
    pub(super) fn prepare(&mut self, n_rows: usize) {
        self.sorted.reserve(n_rows);
        self.values.reserve(n_rows);
        self.near.reserve(n_rows);
        self.gaps.reserve(n_rows);
        self.cells.palette.reserve(n_rows.min(PALETTE_MAX));
    }

    /// For channels that are likely to share a quantum. It saves 4 % of the bytes of 16-bit integers on recorded
    /// positions; analog channels need up to 1 % more.
    pub(super) fn with_shared_quantum() -> Self {
        Self { shares_quantum: true, ..Self::default() }
    }

    /// Resets all choices.
    pub(super) fn forget(&mut self) {
        self.quantum = None;
    }

    /// Chooses for the samples of a block, given the state after the block before.
    pub(super) fn choose(
        &mut self,
        track: &SampledChannelState,
        samples: &[f32],
        earlier: EarlierChannels<'_>,
    ) -> (Head, &Cells) {
        let mode = self.sort(samples);
        let mode = mode.map(|mode| from_ordered(mode).to_bits());
        let change = mean_change(samples);
        let is_kept = track.is_started
            && track.cells.form != CellForm::Stored
            && holds_all(&track.cells, samples, mode);
        if is_kept && !track.head.corrects {
            self.cells.form = track.cells.form;
            self.cells.decimals = track.cells.decimals;
            self.cells.palette.clear();
            self.cells.palette.extend_from_slice(&track.cells.palette);
        } else {
            self.choose_cells(samples.len(), change);
        }
        if self.shares_quantum
            && let CellForm::Lattice { quantum, .. } = self.cells.form
        {
            self.quantum = Some(quantum);
        }
        let is_stored = self.cells.form == CellForm::Stored;
        let corrects = !is_stored && !holds_all(&self.cells, samples, mode);
        let exponent = if track.is_started { track.head.exponent } else { exponent_of(change) };
        let mut head = Head { exponent, corrects, mode, ..Head::default() };
        if track.is_started {
            (head.n_references, head.references) = (track.head.n_references, track.head.references);
        } else {
            choose_references(samples, earlier, &mut head);
        }
        if !is_stored {
            self.choose_events(samples, track.parity as usize, &mut head);
        }
        (head, &self.cells)
    }

    /// Sorts the samples of a block. Returns the most frequent value, if it is much more frequent than every other.
    fn sort(&mut self, samples: &[f32]) -> Option<i32> {
        self.sorted.clear();
        self.sorted.extend(
            samples.iter().filter(|sample| sample.is_finite()).map(|&sample| ordered(sample)),
        );
        self.sorted.sort_unstable();
        let mode = self.mode();
        self.values.clear();
        for &value in &self.sorted {
            if self.values.last() != Some(&value) && Some(value) != mode {
                self.values.push(value);
            }
        }
        mode
    }

    /// Quantum and offset of the lattice that almost all samples of a block are on, if there is one that saves bits.
    pub(super) fn lattice_of(&mut self, samples: &[f32]) -> Option<[f64; 2]> {
        self.sort(samples);
        match self.lattice(mean_change(samples))? {
            (saved, CellForm::Lattice { quantum, offset }) if saved > 0.25 => {
                Some([quantum, offset])
            }
            _ => None,
        }
    }

    /// The most frequent value, if it is much more frequent than every other.
    fn mode(&self) -> Option<i32> {
        let (mut most, mut second) = ((0, 0), 0);
        for run in self.sorted.chunk_by(|a, b| a == b) {
            let Some(&value) = run.first() else { continue };
            if run.len() > most.0 {
                second = most.0;
                most = (run.len(), value);
            } else if run.len() > second {
                second = run.len();
            }
        }
        let is_clear = most.0 > 2 && most.0 * 256 > self.sorted.len() && most.0 > 4 * second;
        (is_clear && second > 0).then_some(most.1)
    }

    fn choose_cells(&mut self, n_rows: usize, change: f64) {
        self.cells.palette.clear();
        self.cells.decimals = None;
        let bits = |all, &value: &i32| all | from_ordered(value).to_bits();
        let zeros = self.values.iter().fold(1 << 30, bits).trailing_zeros();
        self.cells.form = CellForm::Float { zeros };
        if self.values.len() < 2 {
            self.cells.form = CellForm::Palette;
            self.cells.palette.push(self.values.first().copied().unwrap_or_default());
            return;
        }
        let mut saved = f64::from(zeros);
        for decimals in [2, 3, 4, 5, 6] {
            let zeros = (2..20).rev().find(|&zeros| {
                self.is_decimal(&Cells {
                    form: CellForm::Float { zeros },
                    decimals: Some(decimals),
                    palette: Vec::new(),
                })
            });
            if let Some(zeros) = zeros
                && f64::from(zeros) > saved + 0.5
            {
                saved = f64::from(zeros);
                self.cells.form = CellForm::Float { zeros };
                self.cells.decimals = Some(decimals);
            }
        }
        if let Some((bits, lattice)) = self.lattice(change)
            && bits > saved + 0.25
        {
            saved = bits;
            self.cells.form = lattice;
            self.cells.decimals = None;
        }
        if self.values.len() <= PALETTE_MAX.min(n_rows / 3)
            && self.palette_bits(n_rows, change) > saved + 0.25
        {
            self.cells.form = CellForm::Palette;
            self.cells.decimals = None;
            self.cells.palette.extend_from_slice(&self.values);
        } else if self.float_bits(change) - saved > STORED_BITS {
            self.cells.form = CellForm::Stored;
            self.cells.decimals = None;
        }
    }

    /// Bits of a sample among the float32 within a few mean changes.
    fn float_bits(&self, change: f64) -> f64 {
        let bits = |value: f64| log2(8.0 * change / spacing(value.abs())).max(0.0);
        let values = self.values.iter().step_by(self.values.len() / ESTIMATE + 1);
        let (sum, n) = values
            .fold((0.0, 0.0), |(sum, n), &value| (sum + bits(from_ordered(value).into()), n + 1.0));
        sum / n
    }

    /// Whether almost all values are those of cells that were rounded to decimals.
    fn is_decimal(&self, cells: &Cells) -> bool {
        let misses = self.values.iter().filter(|&&value| !cells.has(value));
        let most = self.values.len() / 32;
        misses.take(most + 1).count() <= most
    }

    /// Bits that a palette saves per sample, over float32.
    fn palette_bits(&self, n_rows: usize, change: f64) -> f64 {
        let (mut saved, mut stated, mut n) = (0.0, 40.0, 0.0);
        let mut at = 0;
        for (i, &value) in self.values.iter().enumerate() {
            let before = self.values[i.saturating_sub(1)];
            let after = self.values[(i + 1).min(self.values.len() - 1)];
            stated += log2((i64::from(value) - i64::from(before)).max(1) as f64) + 2.0;
            let start = at;
            while self.sorted.get(at).is_some_and(|&sample| sample <= value) {
                at += 1;
            }
            let count = (at - start) as f64;
            let width = 0.5 * (f64::from(from_ordered(after)) - f64::from(from_ordered(before)));
            let value = f64::from(from_ordered(value));
            saved += count * log2((width.min(2.0 * change) / spacing(value.abs())).max(1.0));
            n += count;
        }
        (saved - stated * n / n_rows as f64) / n
    }

    /// A lattice that has almost all values, and saves bits.
    fn lattice(&mut self, change: f64) -> Option<(f64, CellForm)> {
        self.near.clear();
        self.near.extend(self.values.iter().map(|&value| f64::from(from_ordered(value))));
        self.gaps.clear();
        for pair in self.near.windows(2) {
            let largest = pair[0].abs().max(pair[1].abs());
            let error = spacing(largest);
            let gap = pair[1] - pair[0];
            if gap > 8.0 * error {
                self.gaps.push((gap, error));
            }
        }
        self.near.sort_unstable_by(|a, b| a.abs().total_cmp(&b.abs()));
        self.gaps.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        self.gaps.truncate(GAPS);
        let mut best: Option<(f64, CellForm)> = None;
        // The gaps of few, distant samples do not reveal a quantum.
        let decimal = DECIMAL_QUANTA.map(|quantum| (quantum, true));
        for (quantum, is_exact) in decimal.into_iter().chain(self.quantum.map(|q| (q, false))) {
            let lattice = CellForm::Lattice { quantum, offset: 0.0 };
            let cells = Cells { form: lattice, ..Cells::default() };
            if is_exact && !self.values.iter().all(|&value| cells.has(value)) {
                continue;
            }
            let saved = self.saved_bits(lattice, change);
            if best.is_none_or(|(most, _)| saved > most) {
                best = Some((saved, lattice));
            }
        }
        let mut tried = [0.0_f64; 4];
        for n_tried in 0..tried.len() {
            let Some(quantum) = self.likely_quantum(&tried[..n_tried]) else { break };
            tried[n_tried] = quantum;
            for lattice in self.refined(quantum) {
                let saved = self.saved_bits(lattice, change);
                if best.is_none_or(|(most, _)| saved > most) {
                    best = Some((saved, lattice));
                }
            }
        }
        best
    }

    /// The largest quantum that most gaps are multiples of and that was not tried yet.
    fn likely_quantum(&self, tried: &[f64]) -> Option<f64> {
        let mut best: Option<(f64, f64)> = None;
        for (i, &(gap, _)) in self.gaps.iter().enumerate().step_by(3) {
            for divisor in 1..=DIVISOR_MAX {
                let quantum = gap / divisor as f64;
                let (mut hits, mut chance, mut n) = (0.0, 0.0, 0.0);
                for &(other, error) in &self.gaps {
                    let tolerance = (2.0 * error / quantum + 0.01).min(0.5);
                    let multiple = other / quantum;
                    hits += f64::from(u8::from((multiple - multiple.round()).abs() <= tolerance));
                    chance += 2.0 * tolerance;
                    n += 1.0;
                }
                let score = (hits - chance) / n;
                let is_new = tried.iter().all(|&known| (known / quantum - 1.0).abs() > 0.02);
                if is_new && best.is_none_or(|(most, _)| score > most + 0.02) {
                    best = Some((score, quantum));
                }
            }
            if i > 24 {
                break;
            }
        }
        best.filter(|&(score, _)| score > 0.3).map(|(_, quantum)| quantum)
    }

    /// Lattices near a quantum: through zero and through the values, rounded to short decimal numbers.
    fn refined(&self, quantum: f64) -> impl Iterator<Item = CellForm> + use<> {
        let anchor = self.near.first().copied().unwrap_or_default();
        let (mut q, mut kk, mut kd) = (quantum, 0.0, 0.0);
        // With growing distance from the anchor, so that the quantum is always known well enough for the next value.
        for &value in &self.near {
            let d = value - anchor;
            let k = (d / q).round();
            if (d - k * q).abs() < 0.2 * q && k != 0.0 {
                kk += k * k;
                kd += k * d;
                q = kd / kk;
            }
        }
        let offset = anchor - (anchor / q).round() * q;
        let zero = self.through_zero(q);
        let line = self.through_values(q, offset);
        let candidates = [
            Some(CellForm::Lattice { quantum: zero, offset: 0.0 }),
            Some(CellForm::Lattice { quantum: f64::from(zero as f32), offset: 0.0 }),
            Some(CellForm::Lattice { quantum: line.0, offset: line.1 }),
            Some(CellForm::Lattice { quantum: f64::from(line.0 as f32), offset: line.1 }),
            Some(CellForm::Lattice {
                quantum: f64::from(line.0 as f32),
                offset: (line.1 / line.0 * 4.0).round() / 4.0 * f64::from(line.0 as f32),
            }),
        ];
        candidates.into_iter().flatten()
    }

    /// The middle of the quanta that give all values but a few, through zero.
    fn through_zero(&self, quantum: f64) -> f64 {
        let (mut least, mut most) = (0.0_f64, f64::MAX);
        let mut q = quantum;
        for &value in &self.near {
            let k = (value / q).round();
            if k == 0.0 {
                continue;
            }
            let half = 0.5 * spacing(value.abs());
            let (a, b) = ((value.abs() - half) / k.abs(), (value.abs() + half) / k.abs());
            // A value off the lattice does not count.
            let (low, high) = (least.max(a), most.min(b));
            if low <= high {
                (least, most) = (low, high);
                q = 0.5 * (least + most);
            }
        }
        q
    }

    /// Least squares of the values over their numbers.
    fn through_values(&self, quantum: f64, offset: f64) -> (f64, f64) {
        let (mut q, mut o) = (quantum, offset);
        for _ in 0..2 {
            let (mut n, mut sk, mut sv, mut skk, mut skv) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for &value in &self.near {
                let k = ((value - o) / q).round();
                if (value - o - k * q).abs() < 0.2 * q {
                    let v = value - k * q;
                    n += 1.0;
                    sk += k;
                    sv += v;
                    skk += k * k;
                    skv += k * v;
                }
            }
            let det = n * skk - sk * sk;
            if det > 0.0 {
                let slope = (n * skv - sk * sv) / det;
                q += slope;
                o = (sv - slope * sk) / n;
            }
        }
        (q, o)
    }

    /// Bits that a lattice saves per value, over float32.
    fn saved_bits(&self, form: CellForm, change: f64) -> f64 {
        let CellForm::Lattice { quantum, .. } = form else { return 0.0 };
        let cells = Cells { form, ..Cells::default() };
        if cells.check().is_err() {
            return 0.0;
        }
        let (mut n, mut misses, mut far, mut saved) = (0.0, 0.0_f64, 0.0, 0.0);
        let stride = self.sorted.len() / ESTIMATE + 1;
        for &value in self.sorted.iter().step_by(stride) {
            n += 1.0;
            let value = f64::from(from_ordered(value));
            if (value / quantum).abs() > LATTICE_MAX as f64 {
                return 0.0;
            }
            let back = cells.value(cells.nearest(value));
            let off = (i64::from(ordered(back)) - i64::from(ordered(value as f32))).unsigned_abs();
            misses += f64::from(u8::from(off > 0));
            far += log2(off as f64 + 1.0);
            saved += log2(quantum.min(2.0 * change) / spacing(value.abs()));
        }
        let p = misses / n;
        // The entropy of the flags, or above it.
        let flags = p * (log2(1.0 / p.max(1.0 / n)) + 1.5);
        (saved - 2.0 * far) / n - flags - p
    }

    /// Chooses the events that a distribution does not express.
    fn choose_events(&self, samples: &[f32], parity: usize, head: &mut Head) {
        let step = |a: f32, b: f32| self.cells.nearest(a.into()) - self.cells.nearest(b.into());
        // By parity of the row: exact events, and misses by one cell.
        let (mut repeats, mut near) = ([0_usize; 2], [0_usize; 2]);
        let (mut lines, mut near_lines) = ([0_usize; 2], [0_usize; 2]);
        for (row, pair) in samples.windows(2).enumerate() {
            let is_repeat = pair[0].to_bits() == pair[1].to_bits();
            let row = (parity + row + 1) & 1;
            repeats[row] += usize::from(is_repeat);
            near[row] += usize::from(step(pair[0], pair[1]).unsigned_abs() == 1);
        }
        for (row, three) in samples.windows(3).enumerate() {
            let line = (2.0 * f64::from(three[1]) - f64::from(three[0])) as f32;
            let is_line = line.is_finite() && line.to_bits() == three[2].to_bits();
            let row = (parity + row) & 1;
            lines[row] += usize::from(is_line);
            near_lines[row] += usize::from(step(line, three[2]).unsigned_abs() == 1);
        }
        let pays = |exact: [usize; 2], near: [usize; 2]| {
            [0, 1].map(|i| exact[i] * 32 > samples.len() && exact[i] > 2 * near[i])
        };
        head.repeats = pays(repeats, near);
        head.lines = pays(lines, near_lines);
        if lines.iter().sum::<usize>() <= repeats.iter().sum() {
            head.lines = [false; 2];
        }
        head.past = if head.lines != [false; 2] {
            Past::Events
        } else if head.repeats != [false; 2] {
            Past::Cells
        } else {
            Past::All
        };
    }
}

/// Rows from which correlations are computed.
const CORRELATED: usize = 1024;
/// Smallest correlation of a channel that predicts another.
const CORRELATION_MIN: f64 = 0.05;

/// Chooses as references the earlier channels whose changes correlate best with this one's.
fn choose_references(samples: &[f32], earlier: EarlierChannels<'_>, head: &mut Head) {
    let n_samples = samples.len();
    let stride = n_samples / CORRELATED + 1;
    let bend = |samples: &[f32], rows: [usize; 3]| {
        let [now, then, before] = rows.map(|row| f64::from(samples[row]));
        let bend = now - 2.0 * then + before;
        if bend.abs() < f64::from(f32::MAX) { bend } else { 0.0 }
    };
    let mut best = [(CORRELATION_MIN, 0_u8); REFERENCES];
    for (channel, other) in earlier.samples.chunks_exact(earlier.n_rows).enumerate() {
        let (mut aa, mut ab, mut bb) = (0.0, 0.0, 0.0);
        for sample in (2..n_samples).step_by(stride) {
            let Some(rows) = earlier.rows(sample) else { continue };
            let (a, b) = (bend(samples, [sample, sample - 1, sample - 2]), bend(other, rows));
            aa += a * a;
            ab += a * b;
            bb += b * b;
        }
        let mut entry = (ab.abs() / (aa * bb).sqrt(), channel as u8);
        for slot in &mut best {
            if entry.0 > slot.0 {
                std::mem::swap(slot, &mut entry);
            }
        }
    }
    for (_, channel) in best.iter().filter(|entry| entry.0 > CORRELATION_MIN) {
        head.references[usize::from(head.n_references)] = *channel;
        head.n_references += 1;
    }
}

/// The binary logarithm of a positive number, linear between powers of two: within 0.09, the same on every machine.
fn log2(number: f64) -> f64 {
    let bits = number.to_bits();
    let mantissa = (bits & ((1 << 52) - 1)) as f64 / (1_u64 << 52) as f64;
    (bits >> 52) as f64 - 1023.0 + mantissa
}

/// An upper bound of the distance of float32s at a magnitude.
pub(super) fn spacing(magnitude: f64) -> f64 {
    let bits = ((magnitude as f32).to_bits() >> 23).max(1);
    // 2^(exponent - 23)
    f64::from_bits(u64::from(bits + 1023 - 127 - 23) << 52)
}

/// Whether every sample is the value of a cell, or the most frequent one.
fn holds_all(cells: &Cells, samples: &[f32], mode: Option<u32>) -> bool {
    samples.iter().all(|&sample| {
        Some(sample.to_bits()) == mode || sample.is_finite() && cells.has(ordered(sample))
    })
}

/// The mean change from sample to sample, of those that change.
fn mean_change(samples: &[f32]) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for pair in samples.windows(2) {
        let change = (f64::from(pair[1]) - f64::from(pair[0])).abs();
        if change > 0.0 && change < f64::from(f32::MAX) {
            sum += change;
            n += 1.0;
        }
    }
    if n == 0.0 { 1.0 } else { sum / n }
}

/// The binary exponent of a change, clamped to the range of [`Head::exponent`].
fn exponent_of(change: f64) -> i8 {
    let exponent = (change.to_bits() >> 52) as i64 - 1023;
    exponent.clamp(-126, 126) as i8
}
