//! The published results of (Shi et al. 2012).

use super::Piece;
use crate::phases::Phase;

/// Tolerances (`ErrLim`) of table 1, mm.
pub const TOLERANCES_MM: [f64; 5] = [1.0, 5.0, 10.0, 15.0, 20.0];

/// Columns of table 1.
pub const COLUMNS: [Piece; 7] = [
    Piece::Phase(Phase::Swings),
    Piece::Phase(Phase::LastSwing),
    Piece::Phase(Phase::TakeOff),
    Piece::Phase(Phase::Flight),
    Piece::Phase(Phase::Settling),
    Piece::Phase(Phase::Walking),
    Piece::Whole,
];

/// Table 1: SR2 by `ErrLim` and phase.
const TABLE_1: [[f64; 7]; 5] = [
    [3.94, 4.34, 2.01, 2.85, 4.71, 5.12, 4.70],
    [5.08, 5.94, 2.64, 3.97, 7.21, 7.85, 6.94],
    [5.47, 6.83, 3.04, 4.73, 8.86, 9.53, 8.07],
    [5.79, 7.39, 3.16, 5.15, 10.4, 11.56, 8.76],
    [6.15, 7.88, 3.16, 5.31, 11.1, 13.24, 9.45],
];

/// Tolerances (`ErrLim`) of table 2, mm.
pub const PREFIX_TOLERANCES_MM: [f64; 2] = [10.0, 20.0];

/// Lengths of table 2, frames from the beginning.
pub const PREFIXES: [usize; 12] = [50, 100, 150, 200, 250, 300, 350, 400, 450, 500, 550, 600];

/// Table 2: SR2 by `ErrLim` and length.
const TABLE_2: [[f64; 12]; 2] = [
    [12.8, 16.0, 10.4, 10.5, 12.7, 11.3, 4.6, 6.3, 5.7, 8.5, 11.0, 8.0],
    [12.8, 18.6, 17.3, 13.1, 16.0, 14.0, 5.0, 7.1, 6.3, 10.1, 13.2, 9.4],
];

/// The SR2 that the paper prints for a piece at a tolerance; `None` if it has none.
#[must_use]
pub fn sr2(piece: Piece, tolerance_mm: f64) -> Option<f64> {
    let row = |tolerances: &[f64]| tolerances.iter().position(|&mm| mm == tolerance_mm);
    match piece {
        Piece::First(frames) => {
            let column = PREFIXES.iter().position(|&length| length == frames)?;
            Some(TABLE_2[row(&PREFIX_TOLERANCES_MM)?][column])
        }
        piece => {
            let column = COLUMNS.iter().position(|&column| column == piece)?;
            Some(TABLE_1[row(&TOLERANCES_MM)?][column])
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_of_both_tables() {
        assert_eq!(sr2(Piece::Phase(Phase::TakeOff), 1.0), Some(2.01));
        assert_eq!(sr2(Piece::Whole, 20.0), Some(9.45));
        assert_eq!(sr2(Piece::First(350), 10.0), Some(4.6));
        assert_eq!(sr2(Piece::First(350), 1.0), None);
        assert_eq!(sr2(Piece::Phase(Phase::Standing), 1.0), None);
        assert_eq!(sr2(Piece::Whole, 2.0), None);
    }
}
