//! Force plates among the sampled channels of a recording, by the names and units of these.

use mocapd_take::record::SampledChannel;

/// The channels of a plate.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PlateColumns {
    /// What distinguishes its channels' names from those of other plates, such as `1`.
    pub(super) name: String,
    /// By quantity, the index of the channel, and its unit in N or N m: three forces, and three moments if there are any.
    pub(super) columns: Vec<(usize, f64)>,
}

/// The quantities of a plate in the order of its columns.
const QUANTITIES: [&str; 6] = ["fx", "fy", "fz", "mx", "my", "mz"];

/// By quantity, the index of the channel and its unit in N or N m, if there is one.
type Quantities = [Option<(usize, f64)>; 6];

/// The plates of a group: three forces whose names differ only in their axis, with or without the three moments. `Fx1`,
/// `plate 1 Fx` and `Force.Fx1` are such names. A channel in another unit than that of a force or a moment is none.
pub(super) fn named_plates(channels: &[SampledChannel]) -> Vec<PlateColumns> {
    let mut found: Vec<(String, Quantities)> = Vec::new();
    for (index, channel) in channels.iter().enumerate() {
        let Some((name, quantity)) = split_name(&channel.name) else { continue };
        let Some(factor) = factor(&channel.unit, quantity >= 3) else { continue };
        let place = found.iter().position(|(known, _)| *known == name).unwrap_or_else(|| {
            found.push((name, [None; 6]));
            found.len() - 1
        });
        let slot = found.get_mut(place).and_then(|(_, columns)| columns.get_mut(quantity));
        if let Some(slot) = slot.filter(|slot| slot.is_none()) {
            *slot = Some((index, factor));
        }
    }
    let plates = found.into_iter().filter_map(|(name, columns)| {
        let all: Vec<_> = columns.iter().copied().flatten().collect();
        let forces = columns.iter().take(3).flatten().count();
        let columns =
            if all.len() == 6 { all } else { columns.into_iter().take(3).flatten().collect() };
        (forces == 3).then_some(PlateColumns { name, columns })
    });
    plates.collect()
}

/// A name without its quantity, and the index of that. The quantity is a word, or one before a number.
fn split_name(name: &str) -> Option<(String, usize)> {
    let lower = name.to_ascii_lowercase();
    QUANTITIES.iter().enumerate().find_map(|(quantity, word)| {
        let (at, _) = lower.rmatch_indices(word).find(|(at, _)| {
            let is_letter = |c: Option<char>| c.is_some_and(char::is_alphabetic);
            !is_letter(lower[..*at].chars().next_back())
                && !is_letter(lower[at + word.len()..].chars().next())
        })?;
        // The quantity is ASCII, and `to_ascii_lowercase` keeps every length.
        let rest = format!("{}{}", name.get(..at)?, name.get(at + word.len()..)?);
        let rest = rest.trim_matches(|c: char| c.is_whitespace() || ".:_-/".contains(c));
        Some((rest.to_owned(), quantity))
    })
}

/// The unit in N or N m; `None` for a unit of another quantity.
fn factor(unit: &str, is_moment: bool) -> Option<f64> {
    let unit: String =
        unit.chars().filter(|c| !c.is_whitespace() && !".*·-".contains(*c)).collect();
    match (unit.as_str(), is_moment) {
        ("N", false) | ("Nm", true) => Some(1.0),
        ("kN", false) => Some(1000.0),
        ("Nmm", true) => Some(0.001),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn channels(names: &[(&str, &str)]) -> Vec<SampledChannel> {
        let channel = |(name, unit): &(&str, &str)| SampledChannel {
            name: (*name).to_owned(),
            unit: (*unit).to_owned(),
            ..SampledChannel::default()
        };
        names.iter().map(channel).collect()
    }

    #[test]
    fn plates_are_found_by_the_names_and_units_of_their_channels() {
        let found = named_plates(&channels(&[
            ("Fx1", "N"),
            ("Fy1", "N"),
            ("Fz1", "N"),
            ("Mx1", "Nm"),
            ("My1", "Nm"),
            ("Mz1", "N m"),
            ("EMG1", "V"),
            ("left fz", "kN"),
            ("left fx", "kN"),
            ("left fy", "kN"),
            ("Fx3", "V"),
            ("Fy3", "N"),
            ("Fz3", "N"),
        ]));
        let names: Vec<&str> = found.iter().map(|plate| plate.name.as_str()).collect();
        assert_eq!(names, ["1", "left"]);
        assert_eq!(found[0].columns, [0, 1, 2, 3, 4, 5].map(|index| (index, 1.0)));
        assert_eq!(found[1].columns, [8, 9, 7].map(|index| (index, 1000.0)));
        let others = [("suffix", "N"), ("Profx", "N"), ("fxa", "N"), ("", "N"), ("Fé", "N")];
        assert_eq!(named_plates(&channels(&others)), []);
    }
}
