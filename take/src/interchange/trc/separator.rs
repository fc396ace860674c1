//! What stands between the cells of a TRC file: tabs, and in what some scripts write commas or spaces.

/// What separates the cells of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Separator {
    /// One byte between two cells: a tab, a comma or a semicolon. Cells may be empty.
    Byte(u8),
    /// Any number of spaces: no cell is empty.
    Spaces,
}

impl Separator {
    /// The separator of a line by what stands in it.
    pub(super) fn of(line: &[u8]) -> Self {
        let found = [b'\t', b',', b';'].into_iter().find(|byte| line.contains(byte));
        found.map_or(Self::Spaces, Self::Byte)
    }

    /// Whether it stands in a line.
    pub(super) fn is_in(self, line: &[u8]) -> bool {
        match self {
            Self::Byte(byte) => line.contains(&byte),
            Self::Spaces => true,
        }
    }

    /// The cells of a line.
    pub(super) fn cells(self, line: &[u8]) -> impl Iterator<Item = &[u8]> {
        let is_between = move |byte: &u8| match self {
            Self::Byte(separator) => *byte == separator,
            Self::Spaces => byte.is_ascii_whitespace(),
        };
        let line = if self == Self::Spaces { line.trim_ascii() } else { line };
        line.split(is_between).filter(move |cell| self != Self::Spaces || !cell.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_told_by_what_separates_them() {
        let cells = |line: &'static str| -> Vec<&str> {
            let line = line.as_bytes();
            let cells = Separator::of(line).cells(line);
            cells.map(|cell| std::str::from_utf8(cell).unwrap_or("?")).collect()
        };
        assert_eq!(cells("1\t0,5\t\tb c"), ["1", "0,5", "", "b c"]);
        assert_eq!(cells("1,,2"), ["1", "", "2"]);
        assert_eq!(cells("  1   0.5 2 "), ["1", "0.5", "2"]);
    }
}
