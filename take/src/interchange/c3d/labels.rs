//! Which points are markers, and what they are called.

use super::parameters::Parameters;
use crate::interchange::text::unlabelled_name;
use crate::motion::Marker;

/// Parameters of POINT that list model outputs: results that share the layout of a point without being one.
const MODEL_OUTPUTS: [&str; 6] = ["ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS"];

/// Most parameters that are looked at as lists of model outputs: texts of length 0 take time, but no bytes.
const MAX_LISTS: usize = 64;

/// What a point of the file is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Points {
    /// The markers in order, and the index of each among the points.
    pub(super) markers: Vec<(usize, Marker)>,
    /// The indices of the model outputs.
    pub(super) outputs: Vec<usize>,
}

/// Sorts `n_points` points into markers and model outputs.
pub(super) fn sort_points(
    parameters: &Parameters,
    n_points: usize,
    warnings: &mut Vec<String>,
) -> Points {
    let labels = parameters.texts("POINT", "LABELS");
    if labels.len() < n_points {
        warnings.push(format!(
            "POINT:LABELS has {} labels for {n_points} points; the rest was read as unlabelled.",
            labels.len()
        ));
    } else if labels.iter().skip(n_points).any(|label| !label.is_empty()) {
        warnings.push(format!("POINT:LABELS has {} labels for {n_points} points.", labels.len()));
    }
    let listed = listed_outputs(parameters);
    let mut points = Points { markers: Vec::new(), outputs: Vec::new() };
    for index in 0..n_points {
        let label = labels.get(index).map_or("", String::as_str);
        if !label.is_empty() && listed.contains(label) {
            points.outputs.push(index);
        } else {
            points.markers.push((index, point_marker(label, points.markers.len())));
        }
    }
    points
}

/// The marker of a label as found. Vicon's names for unlabelled trajectories begin with `*`.
fn point_marker(label: &str, column: usize) -> Marker {
    if label.is_empty() {
        return Marker { label: unlabelled_name(column), labelled: false };
    }
    Marker { label: label.to_owned(), labelled: !label.starts_with('*') }
}

/// The labels of all model outputs, by the parameters named in `MODEL_OUTPUTS` and in `POINT:TYPE_GROUPS`, whose
/// texts come in pairs: the name of such a parameter, and what one of its points is.
fn listed_outputs(parameters: &Parameters) -> std::collections::HashSet<String> {
    let type_groups = parameters.texts("POINT", "TYPE_GROUPS");
    let named = type_groups.iter().step_by(2).map(String::as_str);
    let mut names: Vec<&str> = MODEL_OUTPUTS.into_iter().chain(named).collect();
    // MODELED_MARKERS are positions. What POINT itself needs is never a list of model outputs.
    names.retain(|name| {
        let name = name.to_ascii_uppercase();
        !name.is_empty() && !name.contains("MARKER") && !name.starts_with("LABELS")
    });
    names.truncate(MAX_LISTS);
    names.sort_unstable();
    names.dedup();
    names
        .into_iter()
        .flat_map(|name| parameters.texts("POINT", name))
        .filter(|label| !label.is_empty())
        .collect()
}
