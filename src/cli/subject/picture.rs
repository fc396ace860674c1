//! What a picture of a scan shows, out of what was found.

use mocapd_body::{
    Repaired, Survey,
    picture::{Drawing, svg},
    skeleton::{Method, Skeleton},
};

/// The picture, as SVG. `survey` has the levels where the surface has those of a body.
pub(super) fn of(name: &str, repaired: &Repaired, survey: &Survey, skeleton: &Skeleton) -> String {
    let method = match skeleton.method {
        Method::Default => "default method",
        Method::Paper => "as Yu et al. 2008",
    };
    let title = format!("{name}, {method}");
    let mut drawing = Drawing {
        title: &title,
        mesh: Some(&repaired.mesh),
        unit: Some(repaired.unit),
        joints: survey.joints.clone(),
        skeleton: Some(skeleton),
        ..Drawing::default()
    };
    if let Some(levels) = &survey.levels {
        drawing.trace(&levels.rings, &levels.reeb, &levels.segments);
    }
    svg(&drawing)
}
