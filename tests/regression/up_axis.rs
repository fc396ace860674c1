//! Exports and plots agree on which axis is up.
