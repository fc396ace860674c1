//! The word that was probably meant.

/// The known word that is meant, when one is near: at most two letters away, or a third of a long word.
pub(super) fn nearest<'a>(word: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    known
        .map(|name| (distance(word, name), name))
        .filter(|(away, name)| *away <= 2.max(name.len() / 3))
        .min_by_key(|(away, _)| *away)
        .map(|(_, name)| name)
}

/// Letters to change, add or leave out (Levenshtein 1965).
fn distance(a: &str, b: &str) -> usize {
    let mut row: Vec<usize> = (0..=b.chars().count()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut before = i;
        row[0] = i + 1;
        for (j, y) in b.chars().enumerate() {
            let changed = before + usize::from(x != y);
            before = row[j + 1];
            row[j + 1] = changed.min(before + 1).min(row[j] + 1);
        }
    }
    row.last().copied().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_word() {
        assert_eq!(distance("kitten", "sitting"), 3);
        assert_eq!(nearest("rat", ["rate", "run"].into_iter()), Some("rate"));
        assert_eq!(nearest("bitflips", ["bit-flips", "stall"].into_iter()), Some("bit-flips"));
        assert_eq!(nearest("seconds", ["rate", "run"].into_iter()), None);
    }
}
