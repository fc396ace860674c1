//! Names in the margins, with lines to what they name: nothing is written over the body or over another name.

use super::sheet::{INK, Sheet, Stand};

/// A name, and the point that it names.
pub(super) struct Label {
    pub(super) at: [f64; 2],
    pub(super) text: String,
}

/// Lines from one name to the next.
const STEP: f64 = 17.0;
/// Names stay within these rows.
const ROWS: [f64; 2] = [96.0, 736.0];

/// Half of the names go to either margin, each at the height of its point or as near as there is room. None is longer than
/// `column`: what lies beside them is left free.
pub(super) fn draw(
    sheet: &mut Sheet,
    mut labels: Vec<Label>,
    [left, right]: [f64; 2],
    column: f64,
) {
    labels.retain(|label| label.at.iter().all(|c| c.is_finite()));
    labels.sort_by(|a, b| a.at[0].total_cmp(&b.at[0]));
    let rest = labels.split_off(labels.len() / 2);
    for (mut names, edge, stand, inward) in
        [(labels, left + column, Stand::Right, 1.0), (rest, right - column, Stand::Left, -1.0)]
    {
        names.sort_by(|a, b| a.at[1].total_cmp(&b.at[1]));
        let heights = spread(&names.iter().map(|label| label.at[1]).collect::<Vec<f64>>());
        for (label, y) in names.iter().zip(heights) {
            sheet.text(edge, y, &label.text, 11.5, INK, stand);
            let from = [edge + inward * 5.0, y];
            let knee = [edge + inward * 14.0, y];
            let style =
                "fill=\"none\" stroke=\"#282828\" stroke-width=\"0.6\" stroke-opacity=\"0.55\"";
            sheet.path(&[vec![from, knee, label.at]], false, style);
        }
    }
}

/// Heights in the same order, a step apart at least, within the rows.
fn spread(wanted: &[f64]) -> Vec<f64> {
    let n = wanted.len();
    let mut heights = Vec::with_capacity(n);
    let mut free = ROWS[0];
    for &y in wanted {
        let y = y.max(free);
        heights.push(y);
        free = y + STEP;
    }
    let mut limit = ROWS[1];
    for y in heights.iter_mut().rev() {
        *y = y.min(limit);
        limit = *y - STEP;
    }
    heights
}
