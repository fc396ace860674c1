//! Shared test utilities. Tests, benchmarks, examples and fuzz targets of all crates use them; no product code does.

pub mod font;
pub mod memory;
pub mod photograph;
pub mod random;
pub mod recorded;
pub mod synthetic_body;
