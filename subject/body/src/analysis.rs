//! Analysis of one scan, from a clean surface to joint centres.
//!
//! The default method finds the extremities ([`extremity`]), refines them and places landmarks and joints ([`locate`]),
//! then checks the result: proportions ([`Plausibility`]), volume, neck, and parts missing from the scan. Doubtful joints
//! get a larger standard deviation or are left out, each with a note.

use super::extremity::{Extremities, NamingMode};
use super::geodesic::{Adjacency, Graph, Workspace};
use super::joint::Plausibility;
use super::locate::{Landmarks, refine_ends};
use super::skeleton::Method;
use super::{Joint, Joints, Levels, Mesh, Note, Refusal, Side, extremity, joint, locate, paper};

/// Minimum ratio of the girths of head and neck. Whole bodies have 1.24 or more, in their own and in other builds;
/// bodies cut off above the throat have less.
const NECK_NARROWING_MIN: f64 = 1.12;

/// Additional standard deviation of a wrist whose arm has no plausible length, in body scales: half a hand (0.108,
/// Drillis and Contini 1966), since distances that cross a contact do not show whether the hand is there.
const ARMLESS_WRIST_SIGMA: f64 = 0.054;

const HEAD_UNCERTAIN: &str = "the point taken for the top of the head is not the one farthest from the neck and may be the \
                              forehead, a temple or an open mouth: its +- mm is larger; scan with the head bare and the \
                              mouth closed";

/// Joints and extremities of one scan, and how far to trust them.
#[derive(Debug, Clone)]
pub struct ScanAnalysis {
    /// The joints, in the mesh's frame and unit.
    pub joints: Joints,
    /// Head, hands and feet.
    pub extremities: Extremities,
    /// Confidence in the identification of the extremities, 0 to 1; always 1 for [`Method::Paper`].
    pub confidence: f64,
    /// Whether limbs touch, so that geodesic paths may cross from one limb to another.
    pub in_contact: bool,
    /// Body scale: about the stature in the mesh's unit, independent of the pose; `None` for [`Method::Paper`].
    pub body_scale: Option<f64>,
    /// Remarks for readers of the joints.
    pub notes: Vec<Note>,
    /// Level sets and Reeb graph of the geodesic distance from the head (Yu et al. 2008): always for [`Method::Paper`],
    /// otherwise after [`ScanAnalysis::with_levels`].
    pub levels: Option<Levels>,
}

impl ScanAnalysis {
    /// Finds the joints of a body on a closed, connected surface.
    ///
    /// # Errors
    /// [`Refusal`] if the result would be ambiguous, with what to do.
    pub fn new(mesh: &Mesh, method: Method) -> Result<Self, Refusal> {
        match method {
            Method::Default => Self::by_default(mesh),
            Method::Paper => Self::by_paper(mesh),
        }
    }

    fn by_default(mesh: &Mesh) -> Result<Self, Refusal> {
        let adjacency = Adjacency::new(mesh)?;
        let graph = Graph::with_short_cuts(mesh, &adjacency);
        let mut workspace = Workspace::default();
        let ends = extremity::find(mesh, &graph, &mut workspace)?;
        let (extremities, confidence) = (ends.extremities, ends.confidence());
        let margin = ends.margin;
        let refined = refine_ends(&graph, &extremities, ends.fields, &ends.spread, &mut workspace);
        // An unreachable extremity, contradictory distances, a limb without a centre line, an implausibly long trunk:
        // the surface is fused where a body is not.
        let handles = adjacency.handles();
        let contact = Refusal::Contact { handles };
        let landmarks = Landmarks::new(mesh, &refined.fields()).ok_or(contact)?;
        if ends.mode != NamingMode::FreeLimbs && !landmarks.ends_may_be_right() {
            return Err(Refusal::Ambiguous { margin });
        }
        if ends.mode == NamingMode::CutLimb && !landmarks.limbs_may_be_cut() {
            return Err(Refusal::Ambiguous { margin });
        }
        let mut joints = locate::joints(&landmarks);
        let mut notes = Vec::new();
        match Plausibility::of(&joints) {
            Plausibility::Whole => {}
            // Contact does not explain implausible arms here; a limb mistaken for another does.
            Plausibility::WithoutArms if ends.mode == NamingMode::CutLimb => {
                return Err(Refusal::Ambiguous { margin });
            }
            Plausibility::WithoutArms => notes.push(remove_arms(&mut joints, landmarks.scale)),
            Plausibility::Nothing => return Err(contact),
        }
        let touching = ends.mode >= NamingMode::InContact || landmarks.touching.any();
        let in_contact = touching || !notes.is_empty();
        if landmarks.missing.as_flattened().iter().any(|part| *part > 0.0) {
            notes.push(limbs_cut_note(landmarks.missing));
        }
        // Unusual arm lengths alone are not a sign of contact.
        let scale = landmarks.scale;
        if let Some(by) = joint::size_shortfall(mesh, scale, touching || handles > 0) {
            notes.push(joint::widen_sigmas(&mut joints, scale, by));
        }
        if landmarks.head_is_in_doubt() {
            notes.push(Note::new("head-unsure", HEAD_UNCERTAIN));
        }
        if landmarks.neck.girth_ratio() < NECK_NARROWING_MIN {
            notes.push(remove_head(&mut joints));
        }
        let body_scale = Some(scale);
        Ok(Self { joints, extremities, confidence, in_contact, body_scale, notes, levels: None })
    }

    fn by_paper(mesh: &Mesh) -> Result<Self, Refusal> {
        let adjacency = Adjacency::new(mesh)?;
        let graph = Graph::along_edges(mesh, &adjacency);
        let start = extremity::start(mesh, &graph).ok_or(Refusal::TooFewEnds { found: 0 })?;
        let paper = paper::joints(mesh, start, None)
            .map_err(|refusal| explain_refusal(mesh, &adjacency, start, refusal))?;
        Ok(Self {
            joints: paper.joints,
            extremities: paper.extremities,
            confidence: 1.0,
            in_contact: false,
            body_scale: None,
            notes: Vec::new(),
            levels: Some(paper.levels),
        })
    }

    /// Adds level sets and Reeb graph for a picture, if there are none. `mesh` is the mesh that was analysed.
    #[must_use]
    pub fn with_levels(mut self, mesh: &Mesh) -> Self {
        if self.levels.is_none() {
            self.levels = Levels::new(mesh, &self.extremities);
        }
        self
    }
}

/// The cause of a refusal by the published method: the scan, if the default method refuses it too, or the method
/// itself.
fn explain_refusal(mesh: &Mesh, adjacency: &Adjacency, start: u32, refusal: Refusal) -> Refusal {
    let handles = adjacency.handles();
    match ScanAnalysis::by_default(mesh) {
        Err(of_scan) => of_scan,
        Ok(found) if found.in_contact || handles > 0 => Refusal::Contact { handles },
        Ok(found) => paper::explain(mesh, adjacency, start, refusal, &found.extremities),
    }
}

/// Removes shoulders and elbows where arms have fused with the trunk.
fn remove_arms(joints: &mut Joints, scale: f64) -> Note {
    for side in Side::BOTH {
        joints.estimates.remove(&Joint::Shoulder(side));
        joints.estimates.remove(&Joint::Elbow(side));
        if let Some(wrist) = joints.estimates.get_mut(&Joint::Wrist(side)) {
            wrist.sigma = wrist.sigma.hypot(ARMLESS_WRIST_SIGMA * scale);
        }
    }
    let text = "the arms touch the body and have no plausible lengths: left out shoulders and elbows; scan with arms apart";
    Note::new("arms-left-out", text)
}

/// The note on limbs that end early.
fn limbs_cut_note(missing: [[f64; 2]; 2]) -> Note {
    let longest = |parts: [f64; 2]| 100.0 * parts[0].max(parts[1]);
    let of = |name: &str, names: &str, parts: [f64; 2]| {
        let name = if parts.iter().all(|part| *part > 0.0) { names } else { name };
        (longest(parts) > 0.0).then(|| format!("{name} by {:.0} %", longest(parts)))
    };
    let [arms, legs] = missing;
    let parts = [of("an arm", "both arms", arms), of("a leg", "both legs", legs)];
    let parts = parts.into_iter().flatten().collect::<Vec<_>>().join(" and ");
    let text = format!(
        "part of a limb is missing from the scan ({parts} of stature, estimated): left out its missing joints, those \
         beside them are uncertain; scan the whole body"
    );
    Note::new("limb-cut-off", text)
}

/// Removes the joints of a missing head.
fn remove_head(joints: &mut Joints) -> Note {
    joints.estimates.remove(&Joint::Head);
    joints.estimates.remove(&Joint::Throat);
    let text = "found no neck below the head: the head is missing from the scan, or hidden by hair or a hood; left out head \
                and throat, lengths may be off by some per cent; scan the whole body with the head bare";
    Note::new("head-left-out", text)
}
