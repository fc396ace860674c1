//! Groups of meshes that share a row.

use crate::case::Case;

/// The meshes of one row.
pub(crate) struct Group<'a> {
    pub(crate) name: String,
    pub(crate) cases: Vec<&'a Case>,
}

impl<'a> Group<'a> {
    pub(crate) fn by(cases: &[&'a Case], name: impl Fn(&Case) -> String) -> Vec<Self> {
        let mut groups: Vec<Self> = Vec::new();
        for &case in cases {
            let name = name(case);
            match groups.iter_mut().find(|group| group.name == name) {
                Some(group) => group.cases.push(case),
                None => groups.push(Self { name, cases: vec![case] }),
            }
        }
        groups.push(Self { name: "all".to_owned(), cases: cases.to_vec() });
        groups
    }
}

/// The shapes that the constants were learned from.
pub(crate) fn is_development(name: &str) -> bool {
    ["mh_mavg_", "mh_favg_", "contact_mavg_", "contact_favg_"]
        .iter()
        .any(|start| name.starts_with(start))
}

/// The classes of poses by which other programs were measured.
pub(crate) fn pose_class(name: &str) -> String {
    let pose = name.split('_').nth(2).unwrap_or_default();
    match (name, pose) {
        (name, _) if name.starts_with("contact_") => "contact",
        (name, _) if name.starts_with("mhr_") => "jump (MHR)",
        (name, _) if !name.starts_with("mh_") => "scans (FAUST, SMPL)",
        (_, "A" | "T" | "down" | "walk") => "A / T / down / walk",
        (_, "bend" | "akimbo") => "bend / akimbo",
        (_, "squat" | "kneel") => "squat / kneel",
        (_, "lunge" | "run" | "kick") => "lunge / run / kick",
        (_, pose) => pose,
    }
    .to_owned()
}

/// The shape of a body.
pub(crate) fn shape(name: &str) -> String {
    let mut parts = name.split('_');
    match (parts.next(), parts.next()) {
        (Some("mh"), Some(shape)) => shape.to_owned(),
        (Some("contact"), Some(shape)) => format!("{shape}, limbs touching"),
        (Some("faust"), _) => "FAUST".to_owned(),
        (first, _) => first.unwrap_or_default().to_owned(),
    }
}
