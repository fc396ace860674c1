//! Every drawing is well-formed XML and shows everything that was given.

use mocapd_body::picture::{BodyPart, Curve, Drawing, Line, Mark, ReebEdge, ReebNode, svg};
use mocapd_body::skeleton::{Method, ScanJoints, Skeleton, Source, joint_name};
use mocapd_body::{Joint, Joints, Mesh, Side, Unit, extremity, geodesic, paper};
use mocapd_testkit::synthetic_body::{BodyOptions, Pose, body};

/// Every number of every attribute is finite, every element closed.
fn sound(text: &str) {
    assert!(text.starts_with("<svg ") && text.ends_with("</svg>\n"));
    assert!(!text.contains("NaN") && !text.contains("inf"), "a number that is none");
    for line in text.lines().filter(|line| !line.starts_with("</svg") && !line.starts_with("<svg"))
    {
        let closed = line.ends_with("/>") || line.ends_with("</text>") || line.ends_with("\">");
        assert!(line.starts_with('<') && closed, "{}", &line[..line.len().min(200)]);
    }
}

/// Traced from the extremities that are found.
fn traced<'a>(mesh: &'a Mesh, joints: &Joints) -> Drawing<'a> {
    let adjacency = geodesic::Adjacency::new(mesh).unwrap();
    let graph = geodesic::Graph::along_edges(mesh, &adjacency);
    let ends = extremity::find(mesh, &graph, &mut geodesic::Workspace::default()).unwrap();
    let paper = paper::joints(mesh, 0, Some(ends.extremities)).unwrap();
    let mut drawing = Drawing { mesh: Some(mesh), joints: joints.clone(), ..Drawing::default() };
    drawing.trace(&paper.levels);
    drawing
}

#[test]
fn a_body_is_drawn_with_all_its_data() {
    let (mesh, mut joints) = body(2, Pose::A, BodyOptions::default());
    joints.estimates.values_mut().for_each(|estimate| estimate.sigma = 0.02);
    let drawing = Drawing { title: "a < b & \"c\"\u{7}", ..traced(&mesh, &joints) };
    let text = svg(&drawing);
    sound(&text);
    assert!(text.contains("a &lt; b &amp; &quot;c&quot; "));
    for joint in joints.estimates.keys() {
        let name = joint_name(*joint).replace("l_", "left ").replace("r_", "right ");
        assert!(text.contains(&format!(">{name}</text>")), "{name}");
    }
    // A dot and a circle per joint in each view.
    assert!(text.matches("<circle").count() >= 4 * joints.estimates.len());
    assert!(text.contains(" / mm</text>") && text.contains(" ± "));
    // Pictures can be embedded in documents.
    assert!(text.len() < 400_000, "{}", text.len());
    assert_eq!(text, svg(&drawing));
}

#[test]
fn stature_notes_and_uncertain_joints_are_drawn() {
    let (mesh, mut joints) = body(2, Pose::A, BodyOptions::default());
    joints.estimates.values_mut().for_each(|estimate| estimate.sigma = 0.02);
    let elbow = Joint::Elbow(Side::Left);
    joints.estimates.get_mut(&elbow).unwrap().sigma = 0.14;
    let scan = ScanJoints {
        source: Source {
            name: "a.obj".to_owned(),
            sha256: "0".repeat(64),
            unit: Some("m".to_owned()),
            unit_inferred: Some(true),
        },
        joints: joints.clone(),
        unit: Unit::Metre,
        notes: vec!["arms < trunk: shoulders are left out".to_owned(), "long ".repeat(50)],
    };
    let mut skeleton = Skeleton::new(Method::Default, &[scan]).unwrap();
    let stature = (skeleton.stature_mm.unwrap(), skeleton.stature_uncertainty_mm.unwrap());
    let with = |skeleton: &Skeleton| {
        let skeleton = Some(skeleton);
        svg(&Drawing { mesh: Some(&mesh), joints: joints.clone(), skeleton, ..Drawing::default() })
    };
    let text = with(&skeleton);
    sound(&text);
    assert!(text.contains(&format!(">{:.0} ± {:.0}</text>", stature.0, stature.1)), "stature");
    assert!(text.contains(">• arms &lt; trunk: shoulders are left out</text>"));
    assert!(text.contains("height=\"1165\""), "two lines of a note, one of the other");
    assert!(text.contains(">left elbow ± 140</text>") && text.contains("80 mm"));
    // No circle is wider than that of 80 mm, at the scale of the bar of 200 or 500 mm.
    let widest = text.split(" r=\"").skip(1).map(|r| r.split('"').next().unwrap());
    let widest = widest.map(|r| r.parse::<f64>().unwrap()).fold(0.0, f64::max);
    assert!(widest < 30.0, "{widest}");
    // The picture keeps a usable size with any number of notes.
    skeleton.notes = vec!["much ".repeat(100); 64];
    let text = with(&skeleton);
    sound(&text);
    let more = format!(">• {} ", 64 - text.matches(">• much").count());
    assert!(text.contains(&more) && text.contains("height=\"1"), "{more}");
    skeleton.notes.clear();
    assert!(with(&skeleton).contains("height=\"1080\""));
}

#[test]
fn curves_follow_the_limbs_and_joints_are_in_order() {
    let (mesh, joints) = body(3, Pose::T, BodyOptions::default());
    let drawing = traced(&mesh, &joints);
    assert_eq!(drawing.curves.len(), 5);
    for curve in &drawing.curves {
        assert!(curve.samples.windows(2).all(|pair| pair[0][0] < pair[1][0]), "{:?}", curve.part);
        assert!(curve.samples.iter().all(|s| s[1] > 0.0 && s[1] <= 1.0), "{:?}", curve.part);
        assert!(
            curve.marks.windows(2).all(|pair| pair[0].distance < pair[1].distance),
            "{:?}",
            curve.marks
        );
        let is_last = |mark: &&Mark| mark.name == "wrist" || mark.name == "ankle";
        let wrist = curve.marks.iter().find(is_last);
        assert_eq!(wrist.is_some(), curve.part != BodyPart::Trunk);
    }
    // The left arm's line ends at the left wrist, whichever hand was found first.
    for (line, side) in drawing.centre_lines.iter().filter_map(|line| match line.part {
        BodyPart::Arm(side) => Some((line, side)),
        _ => None,
    }) {
        let at = |joint| drawing.joints.estimates[&joint].position;
        let end = *line.points.last().unwrap();
        let far = |side| {
            let wrist = at(Joint::Wrist(side));
            (0..3).map(|axis| (end[axis] - wrist[axis]).powi(2)).sum::<f64>()
        };
        let other = if side == Side::Left { Side::Right } else { Side::Left };
        assert!(far(side) < far(other));
    }
}

#[test]
fn empty_and_invalid_data_are_drawn_as_far_as_possible() {
    sound(&svg(&Drawing::default()));
    let mesh = Mesh { positions: vec![[f64::NAN; 3], [1.0; 3]], triangles: vec![[0, 1, 7]] };
    let part = BodyPart::Leg(Side::Right);
    let points = vec![[f64::INFINITY, 0.0, 0.0], [0.0; 3]];
    let drawing = Drawing {
        title: &"x".repeat(10_000),
        mesh: Some(&mesh),
        unit: Some(Unit::Centimetre),
        rings: vec![Line { part, points: points.clone() }, Line { part, points: Vec::new() }],
        centre_lines: vec![Line { part, points }],
        reeb_nodes: vec![ReebNode { position: [f64::NAN; 3], value: 1.0 }],
        reeb_edges: vec![ReebEdge { from: 0, to: 9, part }, ReebEdge { from: 0, to: 0, part }],
        curves: vec![Curve { part, samples: vec![[0.0, f64::NAN], [1.0, 0.5]], marks: Vec::new() }],
        ..Drawing::default()
    };
    let text = svg(&drawing);
    sound(&text);
    assert!(text.len() < 20_000);
}
