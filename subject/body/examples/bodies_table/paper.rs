//! The method of (Yu et al. 2008) on the same mesh: by itself, and with the extremities that the default method finds.

use mocapd_body::extremity::{self, Extremities};
use mocapd_body::geodesic::{Adjacency, Graph, Workspace};
use mocapd_body::skeleton::Method;
use mocapd_body::{Joints, Mesh, ScanAnalysis, paper};

use crate::case::KINDS;
use crate::read::Truth;
use crate::score;
use crate::score::Limit;
use crate::table::{Group, mean, quantile};

/// Number of joints to find.
const JOINT_COUNT: usize = 2 * KINDS.len();

/// Its result for one mesh; `None` if it is refused.
pub(crate) struct ByPaper {
    own: Option<Found>,
    with_ends: Option<Found>,
}

struct Found {
    ends_right: bool,
    /// Errors of the found ones of the twelve joints, in per cent of stature.
    errors: Vec<f64>,
}

impl ByPaper {
    pub(crate) fn measure(mesh: &Mesh, truth: &Truth) -> Self {
        let own = ScanAnalysis::new(mesh, Method::Paper).ok();
        let with_ends = ends(mesh).and_then(|ends| paper::joints(mesh, 0, Some(ends)).ok());
        Self {
            own: own.map(|own| Found::new(mesh, truth, &own.joints, &own.extremities)),
            with_ends: with_ends.map(|it| Found::new(mesh, truth, &it.joints, &it.extremities)),
        }
    }
}

impl Found {
    fn new(mesh: &Mesh, truth: &Truth, joints: &Joints, ends: &Extremities) -> Self {
        let errors = score::joint_errors(joints, truth).into_iter();
        let of_twelve = errors.filter(|(name, _)| KINDS.contains(name));
        Self {
            ends_right: score::right(mesh, truth, ends, Limit::ByJoint) == Some(true),
            errors: of_twelve.map(|(_, error)| 100.0 * error / truth.stature_m).collect(),
        }
    }
}

fn ends(mesh: &Mesh) -> Option<Extremities> {
    let graph = Graph::with_short_cuts(mesh, &Adjacency::new(mesh).ok()?);
    Some(extremity::find(mesh, &graph, &mut Workspace::default()).ok()?.extremities)
}

/// Prints a table that compares the default method with the paper's, one row per group.
pub(crate) fn print_comparison(of: &str, groups: &[Group<'_>]) {
    println!(
        "| {of} | meshes | default: refused | mean / p95 | paper: refused | extremities wrong | \
         joints missing | mean / p95 | paper with the default extremities: refused | \
         joints missing | mean / p95 |"
    );
    println!("|{}", "---|".repeat(11));
    for group in groups {
        let refused = group.cases.iter().filter(|case| case.found.is_err()).count();
        let errors = group.cases.iter().flat_map(|case| case.errors().map(|(_, error)| error));
        let ours = spread(errors.collect());
        let own: Vec<Option<&Found>> =
            group.cases.iter().map(|case| case.paper.own.as_ref()).collect();
        let with_ends: Vec<Option<&Found>> =
            group.cases.iter().map(|case| case.paper.with_ends.as_ref()).collect();
        let wrong = own.iter().flatten().filter(|found| !found.ends_right).count();
        let [refused_own, missing, own] = cells(&own);
        println!(
            "| {} | {} | {refused} | {ours} | {refused_own} | {wrong} | {missing} | {own} | {} |",
            group.name,
            group.cases.len(),
            cells(&with_ends).join(" | ")
        );
    }
    println!();
}

/// The number of refused meshes, the number of missing joints on the others, and the errors of the rest.
fn cells(all: &[Option<&Found>]) -> [String; 3] {
    let found = || all.iter().flatten();
    let errors: Vec<f64> = found().flat_map(|found| found.errors.iter().copied()).collect();
    let joints = JOINT_COUNT * found().count();
    let missing = format!("{} of {joints}", joints - errors.len());
    [(all.len() - found().count()).to_string(), missing, spread(errors)]
}

fn spread(mut errors: Vec<f64>) -> String {
    if errors.is_empty() {
        return "-".to_owned();
    }
    format!("{:.2} / {:.2}", mean(&errors), quantile(&mut errors, 0.95))
}
