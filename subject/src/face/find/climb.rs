//! A rough frame is moved until the drawn face fits best.

use super::Plane;
use super::frame::Frame;
use super::schema::{ACROSS, DOWN, Schema, likeness, place, slope, standard};

/// How far a pass moves: shares of the eyes' distance, radians, and shares of lengths alike.
const STEPS: [f32; 4] = [0.12, 0.08, 0.05, 0.03];
/// What the slopes' likeness counts beside the brightness'.
const SLOPE_SHARE: f32 = 0.4;
/// What frames that are stretched (logarithm, squared) and sheared (squared) lose: heads are rarely turned far.
const STRETCH_LOSS: f32 = 0.5;
const SHEAR_LOSS: f32 = 0.4;

/// The patch of a frame: brightness and slopes, standard.
#[derive(Debug)]
pub(super) struct Patch {
    /// Brightness, mean 0 and length 1.
    pub(super) bright: Vec<f32>,
    /// Slopes downwards, mean 0 and length 1.
    pub(super) slope: Vec<f32>,
}

impl Patch {
    /// Of a frame on a level.
    pub(super) fn new(local: &Plane, frame: &Frame) -> Self {
        let raw: Vec<f32> = (0..ACROSS * DOWN)
            .map(|i| {
                let [x, y] = place(i);
                let [x, y] = frame.at(x, y);
                local.sample(x, y)
            })
            .collect();
        Self { bright: standard(&raw), slope: standard(&slope(&raw)) }
    }
}

/// The frame near `frame` that the drawn face fits best, and how well.
pub(super) fn climb(local: &Plane, frame: Frame, schema: &Schema) -> (Frame, f32) {
    let mut best = (frame, fit(local, &frame, schema));
    for step in STEPS {
        for change in 0..7_u8 {
            for sign in [-step, step] {
                let moved = moved(&best.0, change, sign);
                let value = fit(local, &moved, schema);
                if value > best.1 {
                    best = (moved, value);
                    break;
                }
            }
        }
    }
    best
}

fn fit(local: &Plane, frame: &Frame, schema: &Schema) -> f32 {
    let patch = Patch::new(local, frame);
    let [stretch, shear] = frame.stretch_and_shear();
    likeness(&patch.bright, &schema.bright) + SLOPE_SHARE * likeness(&patch.slope, &schema.slope)
        - STRETCH_LOSS * stretch.ln().powi(2)
        - SHEAR_LOSS * (shear * shear + frame.turn * frame.turn)
}

fn moved(frame: &Frame, change: u8, by: f32) -> Frame {
    let Frame { origin, across, down, turn } = *frame;
    let along =
        |from: [f32; 2], way: [f32; 2], by: f32| [from[0] + by * way[0], from[1] + by * way[1]];
    let turned = |way: [f32; 2]| {
        let (sin, cos) = by.sin_cos();
        [way[0] * cos - way[1] * sin, way[0] * sin + way[1] * cos]
    };
    match change {
        0 => Frame { origin: along(origin, across, by), ..*frame },
        1 => Frame { origin: along(origin, down, by), ..*frame },
        2 => Frame { across: turned(across), down: turned(down), ..*frame },
        3 => Frame { across: along(across, across, by), down: along(down, down, by), ..*frame },
        6 => Frame { turn: turn + 2.0 * by, ..*frame },
        4 => Frame { down: along(down, down, by), ..*frame },
        _ => Frame { down: along(down, across, by), ..*frame },
    }
}
