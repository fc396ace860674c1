//! What the tests of several crates share. Tests, benchmarks, examples and fuzz targets depend on it, and no product does.

pub mod memory;
pub mod photograph;
pub mod random;
pub mod recorded;
pub mod synthetic_body;
