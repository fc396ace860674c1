//! A C3D whose residuals are all -1 keeps its samples.
