//! The compiled half of the Python package `aventail`: inputs and results of the library, the long work without the
//! interpreter's lock, and the program's command line. `aventail/*.py` is what users see.

use pyo3::prelude::*;

#[pymodule]
mod _aventail {
    use super::*;

    /// Runs a command line.
    #[pyfunction]
    fn main(py: Python<'_>, arguments: Vec<std::ffi::OsString>) -> u8 {
        py.detach(|| aventail::cli::main(arguments))
    }
}
