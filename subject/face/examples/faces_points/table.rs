//! Errors of one face, and the table of them.

use std::collections::BTreeMap;
use std::fmt;

use mocapd_face::fitted::FittedFace;
use mocapd_face::model::{FitOptions, Model};
use mocapd_face::points::FacePoints;

use super::data::{Face, distance};
use super::ibug;

/// Errors in per cent of the outer interocular distance, except for the yaw.
pub(crate) struct Row {
    pub(crate) all: f64,
    pub(crate) eyes: f64,
    pub(crate) brows: f64,
    pub(crate) nose: f64,
    pub(crate) mouth: f64,
    outline: f64,
    /// Whether the confidence is at least 0.5; true for a method without a confidence.
    sure: bool,
    /// Found minus true yaw, in degrees.
    yaw_deg: Option<f64>,
    /// Yaw error of the generic face fitted to the points, in degrees.
    fitted_yaw_deg: Option<f64>,
}

impl Row {
    pub(crate) fn of(face: &Face, found: &FacePoints) -> Row {
        let interocular = face.truth.interocular_px();
        let mean = |points: &mut dyn Iterator<Item = usize>| {
            let errors: Vec<f64> = points
                .filter(|i| face.truth.visible[*i])
                .filter_map(|i| Some(distance(ibug(found, i)?, face.truth.landmarks[i])))
                .collect();
            100.0 * errors.iter().sum::<f64>() / errors.len() as f64 / interocular
        };
        let mouth = || (48..60).chain([62, 66]);
        Row {
            all: mean(&mut (17..27).chain(31..48).chain(mouth())),
            eyes: mean(&mut (36..48)),
            brows: mean(&mut (17..27)),
            nose: mean(&mut (31..36)),
            mouth: mean(&mut mouth()),
            outline: 100.0
                * (0..17).map(|i| to_polygon(face.truth.landmarks[i], &found.outline)).sum::<f64>()
                / 17.0
                / interocular,
            fitted_yaw_deg: face.truth.yaw_deg.zip(fitted_yaw(found)).map(|(t, f)| f - t),
            sure: found.confidence().is_none_or(|confidence| confidence >= FittedFace::SURE),
            yaw_deg: face.truth.yaw_deg.zip(found.yaw_deg).map(|(t, f)| f - t),
        }
    }
}

fn fitted_yaw(found: &FacePoints) -> Option<f64> {
    let fit = Model::generic().ok()?.fit_shape(&found.found(), &FitOptions::default()).ok()?;
    Some(fit.camera.yaw_deg)
}

/// Distance of a point to a closed polygon.
fn to_polygon(p: [f64; 2], polygon: &[[f64; 2]]) -> f64 {
    let sides = polygon.iter().zip(polygon.iter().cycle().skip(1));
    sides
        .map(|(a, b)| {
            let (x, y) = (b[0] - a[0], b[1] - a[1]);
            let t = ((p[0] - a[0]) * x + (p[1] - a[1]) * y) / (x * x + y * y).max(1e-12);
            let t = t.clamp(0.0, 1.0);
            distance(p, [a[0] + t * x, a[1] + t * y])
        })
        .fold(f64::INFINITY, f64::min)
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Row { all, eyes, brows, nose, mouth, outline, sure, yaw_deg, fitted_yaw_deg } = self;
        write!(
            f,
            "all {all:5.1}  eyes {eyes:5.1} brows {brows:5.1} nose {nose:5.1} mouth {mouth:5.1} outline {outline:5.1}"
        )?;
        if !sure {
            write!(f, "  unsure")?;
        }
        for yaw in [yaw_deg, fitted_yaw_deg].into_iter().flatten() {
            write!(f, "  yaw {yaw:+.1}")?;
        }
        Ok(())
    }
}

/// Rows by kind of face and method.
#[derive(Default)]
pub(crate) struct Table {
    rows: BTreeMap<(&'static str, &'static str), Vec<Row>>,
    /// Yaw errors of each search by the default method.
    pub(crate) spent_ms: Vec<f64>,
}

impl Table {
    pub(crate) fn add(&mut self, face: &Face, method: &'static str, row: Row) {
        let turned = face.truth.yaw_deg.map_or(0.0, f64::abs);
        let kind = match (face.synthetic, turned) {
            (false, ..20.0) => "photographs, yaw < 20",
            (false, ..=35.0) => "photographs, yaw 20 to 35",
            (false, _) => "photographs, yaw > 35",
            (true, ..=35.0) => "synthetic, yaw to 35",
            (true, _) => "synthetic, yaw > 35",
        };
        self.rows.entry((kind, method)).or_default().push(row);
    }
}

impl fmt::Display for Table {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "| faces | method | n | median | under 10 % | sure | of those | eyes | brows | nose | mouth | outline | yaw error | of the fit |"
        )?;
        writeln!(f, "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|")?;
        for ((kind, method), rows) in &self.rows {
            let median = |of: fn(&Row) -> f64| median(rows.iter().map(of).collect());
            let good = |r: &&Row| r.all < 10.0;
            let share = |part: usize, of: usize| 100.0 * part as f64 / of as f64;
            let under = share(rows.iter().filter(good).count(), rows.len());
            let (sure, of_those) = if *method == "paper" {
                Default::default()
            } else {
                let sure = rows.iter().filter(|r| r.sure);
                let count = sure.clone().count();
                let of_those = match count {
                    0 => String::new(),
                    count => format!("{:.0} %", share(sure.filter(good).count(), count)),
                };
                (format!("{:.0} %", share(count, rows.len())), of_those)
            };
            let mean = |of: fn(&Row) -> Option<f64>| {
                let yaws: Vec<f64> = rows.iter().filter_map(of).collect();
                let n = yaws.len();
                if n == 0 {
                    String::new()
                } else {
                    format!("{:.1} ({n})", yaws.iter().map(|y| y.abs()).sum::<f64>() / n as f64)
                }
            };
            let (yaw, fitted) = (mean(|r| r.yaw_deg), mean(|r| r.fitted_yaw_deg));
            writeln!(
                f,
                "| {kind} | {method} | {} | {:.1} | {:.0} % | {sure} | {of_those} | {:.1} | {:.1} | {:.1} | {:.1} | {:.1} | {yaw} | {fitted} |",
                rows.len(),
                median(|r| r.all),
                under,
                median(|r| r.eyes),
                median(|r| r.brows),
                median(|r| r.nose),
                median(|r| r.mouth),
                median(|r| r.outline),
            )?;
        }
        writeln!(f, "\nMedian time of the default: {:.0} ms.", median(self.spent_ms.clone()))
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    if n == 0 { f64::NAN } else { (values[(n - 1) / 2] + values[n / 2]) / 2.0 }
}
