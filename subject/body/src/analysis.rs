//! One scan, from a clean surface to joints: the methods in the order in which they are tried.

use super::extremity::{self, Extremities, NamingMode};
use super::geodesic::{Adjacency, Graph, Workspace};
use super::locate::{self, Landmarks, refine_ends};
use super::paper;
use super::plausible::{self, Plausibility};
use super::skeleton::Method;
use super::{Joint, Joints, Levels, Mesh, Note, Refusal, Side};

/// A body narrows by this below its head, at least: whole ones do by 1.24 and more, as they are and in other builds, and those
/// that are cut off above the throat do not.
const NECK_NARROWING_MIN: f64 = 1.12;

/// How far a wrist may be off besides where its arm is none by its length, in body scales: half a hand (0.108, Drillis and Contini
/// 1966), for whether the hand is there cannot be told from ways that lead through contact.
const ARMLESS_WRIST_SIGMA: f64 = 0.054;

const HEAD_UNCERTAIN: &str = "what was taken for the top of the head is not what is farthest from the neck, and may be the \
                           forehead, a temple or an open mouth: its +- mm is larger; scan with the head bare and the mouth \
                           closed";

/// What a scan gives.
#[derive(Debug, Clone)]
pub struct Survey {
    /// The joints, in the mesh's frame and unit.
    pub joints: Joints,
    /// Head, hands and feet.
    pub extremities: Extremities,
    /// How sure the ends are told apart, from 0 to 1; 1 where nobody asked.
    pub confidence: f64,
    /// Whether limbs touch, so that ways along the surface may lead from one into another.
    pub in_contact: bool,
    /// About the stature, in the mesh's unit, whatever the pose; nothing of [`Method::Paper`].
    pub body_scale: Option<f64>,
    /// What whoever reads the joints should know.
    pub notes: Vec<Note>,
    /// Level sets and Reeb graph of the distance from the head (Yu et al. 2008): of the method that is built upon them,
    /// and where [`Survey::with_levels`] asked for them.
    pub levels: Option<Levels>,
}

impl Survey {
    /// Finds the joints of a body on a closed surface of one piece.
    ///
    /// # Errors
    /// [`Refusal`], with what to do: what cannot be told with confidence is refused, and never guessed.
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
        // An end that nobody reaches, ways that contradict each other, a limb without a middle, or a trunk longer than any:
        // the surface is joined where a body is not.
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
            // Contact does not explain it, but a limb that was taken for another does.
            Plausibility::WithoutArms if ends.mode == NamingMode::CutLimb => {
                return Err(Refusal::Ambiguous { margin });
            }
            Plausibility::WithoutArms => {
                notes.push(remove_arms(&mut joints, landmarks.scale));
            }
            Plausibility::Nothing => return Err(contact),
        }
        let touching = ends.mode >= NamingMode::InContact || landmarks.touching.any();
        let in_contact = touching || !notes.is_empty();
        if landmarks.missing.as_flattened().iter().any(|part| *part > 0.0) {
            notes.push(limbs_cut_note(landmarks.missing));
        }
        // Arms of another length than most people's are no sign of contact by themselves.
        let scale = landmarks.scale;
        if let Some(by) = plausible::size_shortfall(mesh, scale, touching || handles > 0) {
            notes.push(plausible::widen_sigmas(&mut joints, scale, by));
        }
        if landmarks.head_is_in_doubt() {
            notes.push(Note::new("head-unsure", HEAD_UNCERTAIN));
        }
        if landmarks.neck.narrows() < NECK_NARROWING_MIN {
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
            .map_err(|refusal| Self::explain_refusal(mesh, &adjacency, start, refusal))?;
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

    /// What is at fault where the published method refuses: the scan, as the better method sees it, or the method itself.
    fn explain_refusal(
        mesh: &Mesh,
        adjacency: &Adjacency,
        start: u32,
        refusal: Refusal,
    ) -> Refusal {
        let handles = adjacency.handles();
        match Self::by_default(mesh) {
            Err(of_scan) => of_scan,
            Ok(found) if found.in_contact || handles > 0 => Refusal::Contact { handles },
            Ok(found) => paper::explain(mesh, adjacency, start, refusal, &found.extremities),
        }
    }

    /// Level sets and Reeb graph for a picture, where the method has none of its own; `mesh` is the one that was surveyed.
    #[must_use]
    pub fn with_levels(mut self, mesh: &Mesh) -> Self {
        if self.levels.is_none() {
            self.levels = Levels::new(mesh, &self.extremities);
        }
        self
    }
}

/// Takes out the joints that nothing tells of where arms have grown together with the trunk.
fn remove_arms(joints: &mut Joints, scale: f64) -> Note {
    for side in Side::BOTH {
        joints.estimates.remove(&Joint::Shoulder(side));
        joints.estimates.remove(&Joint::Elbow(side));
        if let Some(wrist) = joints.estimates.get_mut(&Joint::Wrist(side)) {
            wrist.sigma = wrist.sigma.hypot(ARMLESS_WRIST_SIGMA * scale);
        }
    }
    let text = "the arms touch the body, and are no arms by their lengths: shoulders and elbows are left out; scan \
                with arms apart";
    Note::new("arms-left-out", text)
}

/// What is left out of limbs that end early.
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
        "part of a limb is not in the scan ({parts} of stature, about): joints that are missing with it are left out, \
         those beside it are unsure; scan the whole body"
    );
    Note::new("limb-cut-off", text)
}

/// Takes out the joints of a head that is not there.
fn remove_head(joints: &mut Joints) -> Note {
    joints.estimates.remove(&Joint::Head);
    joints.estimates.remove(&Joint::Throat);
    let text = "nothing narrows to a neck below the head: the head is not in the scan, or hidden by hair or a hood; it is \
                left out with the throat, and lengths may be off by some per cent; scan all of the body";
    Note::new("head-left-out", text)
}
