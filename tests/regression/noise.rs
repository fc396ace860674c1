//! Noise is one estimate, the same everywhere.
