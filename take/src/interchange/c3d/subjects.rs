//! The SUBJECTS group: whose markers these are, where their labels say so (`Anna:LASI`).

use super::parameters::Parameters;
use crate::motion::Marker;

/// Most subjects: dimensions count to 255.
const SUBJECTS_MAX: usize = 255;

/// Says who the subjects are, unless a group says so already, or labels do not.
pub(super) fn fill(parameters: &mut Parameters, markers: &[Marker]) {
    if parameters.group_id("SUBJECTS").is_some() {
        return;
    }
    let Some(names) = prefixes(markers) else { return };
    let prefixes: Vec<String> = names.iter().map(|name| format!("{name}:")).collect();
    let none = vec![0; names.len()];
    parameters.set_word("SUBJECTS", "USED", names.len() as u16);
    parameters.set_words("SUBJECTS", "IS_STATIC", &none);
    parameters.set_words("SUBJECTS", "USES_PREFIXES", &vec![1; names.len()]);
    // Prefixes of labels that were written are not too long.
    parameters.set_texts("SUBJECTS", "NAMES", &names).unwrap_or_default();
    parameters.set_texts("SUBJECTS", "LABEL_PREFIXES", &prefixes).unwrap_or_default();
}

/// The prefixes before the first `:` in order, when every labelled marker has one.
fn prefixes(markers: &[Marker]) -> Option<Vec<String>> {
    let mut names: Vec<String> = Vec::new();
    for marker in markers.iter().filter(|marker| marker.labelled) {
        let (name, rest) = marker.label.split_once(':')?;
        if name.trim().is_empty() || rest.trim().is_empty() {
            return None;
        }
        if !names.iter().any(|known| known == name) {
            names.push(name.to_owned());
        }
    }
    (1..=SUBJECTS_MAX).contains(&names.len()).then_some(names)
}
