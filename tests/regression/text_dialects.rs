//! TRC and CSV files of other programs are read as they mean it.
