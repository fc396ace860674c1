//! Figures 2 and 3 of the paper on the first trial that has phases, and table 1 as a figure.

use anyhow::anyhow;
use mocapd_codec::{Settings, Tolerance};
use mocapd_report::{
    ReportError,
    coded::Coded,
    phases::Phase,
    plot::{Pose, Trajectory, by_phase, pose, trajectory},
    study::{Coder, Findings, Method, Trial},
};
use mocapd_service::bones;

use super::InMemory;

/// `ErrLim` of the paper's figures, mm.
const TOLERANCE_MM: f64 = 5.0;

/// Moments of figure 3.
const MOMENTS: usize = 8;

/// By file name, the SVG.
///
/// # Errors
/// When the drawing library refuses.
pub(super) fn all(trials: &[Trial], findings: &Findings) -> anyhow::Result<Vec<(String, String)>> {
    let mut figures = Vec::new();
    match by_phase(findings) {
        Ok(svg) => figures.push(("sr2-by-phase.svg".to_owned(), svg)),
        Err(ReportError::Nothing(_)) => {}
        Err(error) => return Err(error.into()),
    }
    let Some(trial) = trials.iter().find(|trial| trial.phases.is_ok()) else { return Ok(figures) };
    let settings =
        Settings { kind: Method::WorstSample.kind(), tolerance: Tolerance::from_mm(TOLERANCE_MM)? };
    let take = InMemory.take(&trial.motion, &settings).map_err(|error| anyhow!(error))?;
    let coded = Coded::read(&take[..])?;
    let original = Some(&trial.motion);
    let labels: Vec<String> =
        trial.motion.info.markers.iter().map(|marker| marker.label.clone()).collect();
    let marker = wrist(&labels);
    let up = mocapd_report::up::Up::of(&coded.motion, None);
    let mut moments = Vec::new();
    for part in trial.phases.iter().flatten() {
        let rows = (part.frames.start, part.frames.end);
        if !matches!(part.phase, Phase::Standing | Phase::Walking) {
            moments.push(part.frames.clone());
        }
        let wanted = Trajectory { name: &trial.name, coded: &coded, original, marker, rows, up };
        match trajectory(&wanted) {
            Ok(svg) => {
                let name = part.phase.name().replace(' ', "-");
                let figure = format!("figure-2-{name}.svg");
                // Of a take with several jumps the first of each.
                if !figures.iter().any(|(there, _)| *there == figure) {
                    figures.push((figure, svg));
                }
            }
            Err(ReportError::Nothing(_)) => {}
            Err(error) => return Err(error.into()),
        }
    }
    if let Some((from, to)) = moments.first().zip(moments.last()) {
        let span = to.end - 1 - from.start;
        let rows: Vec<usize> =
            (0..MOMENTS).map(|i| from.start + i * span / (MOMENTS - 1)).collect();
        let bones = bones::bones(&labels);
        let wanted = Pose {
            name: &trial.name,
            coded: &coded,
            original,
            rows: &rows,
            bones: &bones,
            limbs: &[],
            faces: &[],
            front: None,
            up,
        };
        figures.push(("figure-3.svg".to_owned(), pose(&wanted)?));
    }
    Ok(figures)
}

/// The paper shows a wrist; without one the first marker stands in.
fn wrist(labels: &[String]) -> usize {
    let plain = |label: &String| label.to_lowercase().replace(['_', '-', ' '], "");
    let find = |name: &str| labels.iter().position(|label| plain(label).ends_with(name));
    ["rwrist", "rightwrist", "wrist", "rwra", "rwri"]
        .iter()
        .find_map(|name| find(name))
        .unwrap_or(0)
}
