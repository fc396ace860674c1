//! The speeds of a line, as `COMM` numbers them.

/// The speed after power-on, a break, and `COMM:00000`.
pub const BAUD_AT_RESET: u32 = 9_600;

/// Speeds and their digits in `COMM`, slowest first.
pub const BAUDS: [(u32, char); 9] = [
    (9_600, '0'),
    (14_400, '1'),
    (19_200, '2'),
    (38_400, '3'),
    (57_600, '4'),
    (115_200, '5'),
    (230_400, 'A'),
    (921_600, '6'),
    (1_228_739, '7'),
];

/// Where a speed stands in [`BAUDS`]: itself, or the highest below it; the slowest below that.
pub(super) fn at_most(baud: u32) -> usize {
    BAUDS.iter().rposition(|(known, _)| *known <= baud).unwrap_or(0)
}
