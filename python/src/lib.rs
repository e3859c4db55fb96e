//! The compiled half of the Python package `aventail`: arrays to volumes and back, the long work without the interpreter's
//! lock, and the program's command line. `aventail/*.py` is what users see, and `aventail/_aventail.pyi` what is seen here.

mod arrays;
mod case;
mod cohort;
mod dicom;
mod errors;
mod library;
mod measures;
mod phantom;
mod registration;
mod runs;
mod warp;

/// See `aventail/_aventail.pyi`.
#[pyo3::pymodule]
mod _aventail {
    use pyo3::prelude::*;
    use std::ffi::OsString;

    #[pymodule_export]
    use crate::arrays::{read_contours, read_field, read_grid, read_image, read_labels};
    #[pymodule_export]
    use crate::arrays::{write_contours, write_field, write_image, write_labels};
    #[pymodule_export]
    use crate::cohort::summary;
    #[pymodule_export]
    use crate::dicom::{write_dicom_contours, write_dicom_dose, write_dicom_field, write_dicom_image};
    #[pymodule_export]
    use crate::library::{fit_postures, make_library};
    #[pymodule_export]
    use crate::measures::{accumulate, compare_doses, dvh, evaluate, map_dose, skeleton};
    #[pymodule_export]
    use crate::phantom::Phantom;
    #[pymodule_export]
    use crate::registration::{Registration, Samples, pose, register};

    /// Runs a command line, whose first entry is the program's name; returns the exit code.
    #[pyfunction]
    fn main(py: Python<'_>, arguments: Vec<OsString>) -> u8 {
        py.detach(|| aventail::cli::main(arguments))
    }

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
