//! `verify --against` a file with nothing in common says so.
