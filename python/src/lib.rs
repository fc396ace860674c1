//! The Rust half of the Python package: takes into arrays and arrays into takes. What Python people see of it
//! is in `mocapd/`; what is here is called from there alone.

mod encode;
mod errors;
mod pieces;
mod read;
mod source;
mod survey;
mod take_file;
mod times;
mod wait;
mod window;

/// `mocapd._native`.
#[pyo3::pymodule]
mod _native {
    #[pymodule_export]
    use crate::encode::encode;
    #[pymodule_export]
    use crate::errors::TakeError;
    #[pymodule_export]
    use crate::take_file::TakeFile;
}
