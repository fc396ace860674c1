//! Which markers are joined by a line on a screen, by their labels.
//!
//! Only for people's eyes: nothing is measured or stored by it, and labels that nobody knows get no lines.
//! Several subjects are told apart by what stands before the last `:` of their labels.

use std::collections::HashMap;

use mocapd_report::{
    labels::{SubjectMarkers, subjects},
    limbs::limbs,
};
use mocapd_take::record::Subject;

use super::live::LiveLimb;
use crate::subject::Skeleton;

/// Lines of a marker set: what stands between `/` are names of one site, of which the first that is there is taken; `*`
/// is both sides, one after the other.
type Lines = [(&'static str, &'static str)];

/// The 15 sites of Shi et al. 2012 (doi 10.3969/j.issn.0372-2112.2012.01.021), as `simulator/src/generator/body.rs` and
/// the joint files made from CMU's motion capture database (mocap.cs.cmu.edu) call them, with toes and hands where they
/// are. A body without a throat or a pelvis is joined across.
const JOINTS: &Lines = &[
    ("throat/neck", "head"),
    ("throat/neck/rshoulder", "lshoulder"),
    ("throat/neck", "rshoulder"),
    ("pelvis/hips/root/sacrum", "throat/neck"),
    ("pelvis/hips/root/sacrum/rhip", "lhip"),
    ("pelvis/hips/root/sacrum", "rhip"),
    ("*shoulder", "*elbow"),
    ("*elbow", "*wrist"),
    ("*wrist", "*hand/*finger"),
    ("*hip", "*knee"),
    ("*knee", "*ankle"),
    ("*ankle", "*toe/*foot"),
    ("*ankle", "*heel"),
    ("*heel", "*toe/*foot"),
];

/// Plug-in Gait, full body: names and places after Vicon's "Plug-in Gait Reference Guide". Wands and the offset marker
/// (`LUPA`, `LFRM`, `LTHI`, `LTIB`, `RBAK`) stay without a line.
const PLUG_IN_GAIT: &Lines = &[
    ("lfhd", "rfhd"),
    ("lbhd", "rbhd"),
    ("*fhd", "*bhd"),
    ("c7", "clav"),
    ("c7", "t10"),
    ("clav", "strn"),
    ("strn", "t10"),
    ("*sho", "clav"),
    ("*sho", "c7"),
    ("*sho", "*elb"),
    ("*elb", "*wra"),
    ("*elb", "*wrb"),
    ("*wra", "*wrb"),
    ("*wra", "*fin"),
    ("*wrb", "*fin"),
    ("lasi", "rasi"),
    ("lpsi", "rpsi"),
    ("*asi", "*psi/sacr"),
    ("t10", "*psi/sacr"),
    ("*asi", "*kne"),
    ("*kne", "*ank"),
    ("*ank", "*hee"),
    ("*ank", "*toe"),
    ("*hee", "*toe"),
];

/// The set of the Helen Hayes hospital (Kadaba, Ramakrishnan and Wootten 1990, doi 10.1002/jor.1100080310), with head and
/// arms as Motion Analysis's programs name them, in full and in four letters.
const HELEN_HAYES: &Lines = &[
    ("fronthead/fhea", "rearhead/rhea"),
    ("fronthead/fhea", "tophead/thea"),
    ("rearhead/rhea", "tophead/thea"),
    ("lshoulder/lsho", "rshoulder/rsho"),
    ("*shoulder/*sho", "*elbow/*elb"),
    ("*elbow/*elb", "*wrist/*wri"),
    ("*shoulder/*sho", "*asis/*asi"),
    ("lasis/lasi", "rasis/rasi"),
    ("*asis/*asi", "*psis/vsacral/vsac/sacral/sacrum/s2"),
    ("*asis/*asi", "*knee/*kne"),
    ("*knee/*kne", "*ankle/*ank"),
    ("*ankle/*ank", "*heel/*hee"),
    ("*ankle/*ank", "*toe/*mt1"),
    ("*heel/*hee", "*toe/*mt1"),
];

/// Bones of CMU's ASF skeletons (mocap.cs.cmu.edu), each a point at its far end.
const ASF: &Lines = &[
    ("root", "lowerback"),
    ("lowerback", "upperback"),
    ("upperback", "thorax"),
    ("thorax", "lowerneck"),
    ("lowerneck", "upperneck"),
    ("upperneck", "head"),
    ("thorax", "*clavicle"),
    ("*clavicle", "*humerus"),
    ("*humerus", "*radius"),
    ("*radius", "*wrist"),
    ("*wrist", "*hand"),
    ("root", "*hipjoint"),
    ("*hipjoint", "*femur"),
    ("*femur", "*tibia"),
    ("*tibia", "*foot"),
    ("*foot", "*toes"),
];

/// Joints of BVH files as most programs name them.
const BVH: &Lines = &[
    ("hips", "spine"),
    ("spine", "spine1/neck"),
    ("spine1", "neck"),
    ("neck", "head"),
    ("neck", "*shoulder/*arm"),
    ("*shoulder", "*arm"),
    ("*arm", "*forearm"),
    ("*forearm", "*hand"),
    ("hips", "*upleg"),
    ("*upleg", "*leg"),
    ("*leg", "*foot"),
    ("*foot", "*toebase"),
];

/// In the order in which they are preferred where two explain as much.
const FAMILIES: [&Lines; 5] = [JOINTS, PLUG_IN_GAIT, HELEN_HAYES, ASF, BVH];

/// Pairs of slots between which a line is drawn, for the labels of the slots. Of a label that comes twice the first is
/// meant. Each subject gets the marker set that explains most of its labels; no lines where none is known.
#[must_use]
pub fn bones(labels: &[String]) -> Vec<[u16; 2]> {
    // What a line can name is a slot of 16 bits.
    let named = labels.iter().take(usize::from(u16::MAX) + 1).map(String::as_str);
    subjects(named).iter().flat_map(of_subject).collect()
}

/// The limbs of the subject's skeleton between these slots. It was checked when it was read: here nothing is said of it.
#[must_use]
pub fn live_limbs(subject: Option<&Subject>, labels: &[String]) -> Vec<LiveLimb> {
    let Ok(Some(skeleton)) = Skeleton::of_take(subject) else { return Vec::new() };
    let named = &labels[..labels.len().min(usize::from(u16::MAX) + 1)];
    let name = subject.map_or("", |subject| subject.name.as_str());
    let (found, _) = limbs(&skeleton.to_bones(), named, name);
    let slot = |column: usize| u16::try_from(column).unwrap_or_default();
    let limb = |limb: &mocapd_report::limbs::Limb| LiveLimb {
        ends: limb.ends.map(slot),
        length_mm: limb.bone.length_mm,
        off_mm: limb.bone.off_mm(),
    };
    found.iter().map(limb).collect()
}

/// Lines by label, and those of limbs that are not among them.
#[must_use]
pub fn with_limbs(mut bones: Vec<[u16; 2]>, limbs: &[LiveLimb]) -> Vec<[u16; 2]> {
    for LiveLimb { ends: [a, b], .. } in limbs {
        if !bones.contains(&[*a, *b]) && !bones.contains(&[*b, *a]) {
            bones.push([*a, *b]);
        }
    }
    bones
}

/// The lines of the family that draws most of them.
fn of_subject(subject: &SubjectMarkers<'_>) -> Vec<[u16; 2]> {
    let mut best = Vec::new();
    for family in FAMILIES {
        let lines = of_family(family, &subject.sites);
        if lines.len() > best.len() {
            best = lines;
        }
    }
    best
}

fn of_family(family: &Lines, slots: &HashMap<String, usize>) -> Vec<[u16; 2]> {
    let mut lines = Vec::new();
    for (from, to) in family {
        let sides: &[&str] =
            if from.contains('*') || to.contains('*') { &["l", "r"] } else { &[""] };
        for side in sides {
            let find = |names: &str| {
                let slot = names.split('/').find_map(|name| slots.get(&name.replace('*', side)))?;
                u16::try_from(*slot).ok()
            };
            if let (Some(from), Some(to)) = (find(from), find(to))
                && from != to
            {
                lines.push([from, to]);
            }
        }
    }
    lines
}

#[cfg(test)]
mod tests;
