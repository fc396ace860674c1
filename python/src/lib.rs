//! The native half of the Python package: decodes takes into arrays and encodes arrays as takes. Only the Python half
//! in `mocapd/` calls it; that is the public API.

mod background;
mod cache;
mod decode;
mod encode;
mod errors;
mod foreign;
mod import;
mod read;
mod recording;
mod records;
mod remote;
mod scan;
mod source;
mod take_file;
mod times;
mod whole;

/// `mocapd._native`.
#[pyo3::pymodule]
mod _native {
    #[pymodule_export]
    use crate::encode::encode;
    #[pymodule_export]
    use crate::errors::TakeError;
    #[pymodule_export]
    use crate::import::{Imported, import_motion, importer_version, measure_take, normal_options};
    #[pymodule_export]
    use crate::remote::{ObjectStore, RemoteTake};
    #[pymodule_export]
    use crate::take_file::TakeFile;
    #[pymodule_export]
    use crate::whole::{check_take, repack_take};
}
