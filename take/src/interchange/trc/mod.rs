//! Track Row Column, the text format of Motion Analysis that `OpenSim` and Cortex read and write.
//!
//! Three header lines (a path line, names, values), a line with `Frame#`, `Time` and a label every three columns,
//! a line `X1 Y1 Z1 X2 ...`, perhaps an empty line, then one line a frame; cells are separated by tabs, in what some
//! scripts write by commas or spaces.
//! In an unlabelled cloud no label stands, `NumMarkers` is 0 and lines differ in length.

mod read;
mod rows;
mod separator;
mod write;

pub(super) use read::read;
pub(super) use write::write;

/// Kind of the header lines that are kept: the first three lines of the file as they are.
const HEADER: &str = "trc/header";
