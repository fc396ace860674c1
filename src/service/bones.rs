//! Which markers are joined by a line on a screen, by their labels.
//!
//! Only for people's eyes: nothing is measured or stored by it, and labels that nobody knows get no lines.
//! Several subjects are told apart by what stands before the last `:` of their labels.

use std::collections::HashMap;

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
    let mut subjects: Vec<(&str, HashMap<String, u16>)> = Vec::new();
    let mut places: HashMap<&str, usize> = HashMap::new();
    for (slot, label) in (0..=u16::MAX).zip(labels) {
        let (subject, site) = label.rsplit_once(':').unwrap_or(("", label));
        let place = *places.entry(subject).or_insert(subjects.len());
        if place == subjects.len() {
            subjects.push((subject, HashMap::new()));
        }
        subjects[place].1.entry(plain(site)).or_insert(slot);
    }
    subjects.iter().flat_map(|(_, slots)| of_subject(slots)).collect()
}

/// The lines of the family that draws most of them.
fn of_subject(slots: &HashMap<String, u16>) -> Vec<[u16; 2]> {
    let mut best = Vec::new();
    for family in FAMILIES {
        let lines = of_family(family, slots);
        if lines.len() > best.len() {
            best = lines;
        }
    }
    best
}

fn of_family(family: &Lines, slots: &HashMap<String, u16>) -> Vec<[u16; 2]> {
    let mut lines = Vec::new();
    for (from, to) in family {
        let sides: &[&str] =
            if from.contains('*') || to.contains('*') { &["l", "r"] } else { &[""] };
        for side in sides {
            let find = |names: &str| {
                names.split('/').find_map(|name| slots.get(&name.replace('*', side)).copied())
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

/// A label in small letters without what separates its words, and its side as one letter before it: `L.Shoulder`,
/// `l_shoulder`, `LeftShoulder` and `Shoulder_L` are one.
fn plain(label: &str) -> String {
    let small = label.to_lowercase();
    let words: Vec<&str> =
        small.split(|c: char| !c.is_alphanumeric()).filter(|w| !w.is_empty()).collect();
    let (side, words) = match words.as_slice() {
        [rest @ .., last @ ("l" | "left" | "r" | "right")] if !rest.is_empty() => {
            (&last[..1], rest)
        }
        all => ("", all),
    };
    let name = words.concat();
    let name = match (name.strip_prefix("left"), name.strip_prefix("right")) {
        (Some(rest), _) if !rest.is_empty() => format!("l{rest}"),
        (_, Some(rest)) if !rest.is_empty() => format!("r{rest}"),
        _ => name,
    };
    format!("{side}{name}")
}

#[cfg(test)]
mod tests;
