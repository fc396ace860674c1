//! Converts a fuzzer's bytes to motion: one byte can make a whole channel, or twelve a single sample.

use mocapd_codec::{BlockReport, Position, Rows, Settings};

use crate::Input;

/// Maximum number of rows of a stretch: enough for every span, stride and table, and quick to code.
const ROWS_MAX: usize = 600;

/// Maximum number of rows for the exhaustive resamplers, whose work grows with the third power.
const EXHAUSTIVE_ROWS_MAX: usize = 24;

/// A channel over one stretch.
#[derive(Debug, Clone, Default)]
pub(crate) struct Channel {
    pub(crate) positions: Vec<Position>,
    pub(crate) present: Vec<bool>,
}

/// All channels over one stretch.
#[derive(Debug, Clone)]
pub(crate) struct Stretch {
    pub(crate) key: bool,
    pub(crate) channels: Vec<Channel>,
}

/// A block and its encoder's report.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Block {
    pub(crate) bytes: Vec<u8>,
    pub(crate) shared: Vec<u8>,
    pub(crate) reports: Vec<BlockReport>,
}

impl Stretch {
    pub(crate) fn rows(&self) -> Vec<Rows<'_>> {
        let rows = |channel| {
            let Channel { positions, present }: &Channel = channel;
            Rows::new(positions, present).expect("of one length")
        };
        self.channels.iter().map(rows).collect()
    }

    pub(crate) fn n_rows(&self) -> usize {
        self.channels[0].present.len()
    }
}

/// The current position of each channel of a group.
#[derive(Debug)]
pub(crate) struct Group {
    at: Vec<Position>,
    rows_max: usize,
}

impl Group {
    /// Takes the number of channels from one byte: a few, or the maximum of a group.
    pub(crate) fn new(settings: Settings, input: &mut Input<'_>) -> Self {
        let n = input.byte();
        let n = if n >= 0xf8 { mocapd_codec::GROUP_CHANNELS } else { usize::from(n % 8) + 1 };
        let exhaustive = settings.kind.to_string().ends_with("exhaustive");
        let rows_max = if exhaustive { EXHAUSTIVE_ROWS_MAX } else { ROWS_MAX };
        let start = |i| [100.0 * i as f32, 1000.0, -20.0 * i as f32];
        Self { at: (0..n).map(start).collect(), rows_max }
    }

    pub(crate) fn stretch(&mut self, key: bool, input: &mut Input<'_>) -> Stretch {
        let n_rows = match input.byte() {
            long @ 0xf0.. => usize::from(long & 1) << 8 | usize::from(input.byte()),
            short => usize::from(short),
        };
        let n_rows = n_rows.min(self.rows_max);
        let channels = self.at.iter_mut().map(|at| channel(at, n_rows, input)).collect();
        Stretch { key, channels }
    }
}

fn channel(at: &mut Position, n_rows: usize, input: &mut Input<'_>) -> Channel {
    let (mode, gaps) = (input.byte(), input.byte());
    let scale = 10_f32.powi(i32::from(mode >> 4) - 6);
    let mut noise = u32::from(gaps) + 1;
    let mut speed = [0.0; 3];
    let (mut positions, mut present) = (Vec::new(), Vec::new());
    for row in 0..n_rows {
        match mode & 7 {
            // At rest.
            0 | 1 => {}
            // A random walk.
            2 => *at = add(*at, [0; 3].map(|_| scale * signed(&mut noise))),
            // Smooth: seeded accelerations.
            3 => {
                speed = add(speed, [0; 3].map(|_| 0.02 * scale * signed(&mut noise)));
                *at = add(*at, speed);
            }
            // Steps from the input.
            4 | 5 => *at = add(*at, [0; 3].map(|_| scale * f32::from(input.byte() as i8))),
            // Jumps in between.
            6 if row % 16 == 7 => *at = [0; 3].map(|_| 1000.0 * scale * signed(&mut noise)),
            6 => {}
            // Any bits.
            _ => *at = [0; 3].map(|_| input.float()),
        }
        positions.push(*at);
        let seen = match gaps {
            0 => true,
            0xff => false,
            _ if mode & 8 != 0 => signed(&mut noise) * 128.0 < f32::from(gaps as i8),
            _ => gaps >> (row % 8) & 1 == 0,
        };
        present.push(seen && at.iter().all(|coordinate| coordinate.is_finite()));
        if !at.iter().all(|coordinate| coordinate.is_finite()) {
            *at = [0.0; 3];
        }
    }
    Channel { positions, present }
}

/// A random number from -1 to 1, the same on every machine.
fn signed(noise: &mut u32) -> f32 {
    *noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    (*noise >> 8) as f32 / (1 << 23) as f32 - 1.0
}

fn add(a: Position, b: Position) -> Position {
    std::array::from_fn(|axis| a[axis] + b[axis])
}
