//! Many runs side by side.

use crate::case::COMMAND;
use crate::errors::Raised;
use aventail::io;
use aventail::report::Summary;
use pyo3::prelude::*;
use std::path::PathBuf;

/// The runs in folders as JSON, written to `out` where that is given.
#[pyfunction]
#[pyo3(signature = (runs, out, anonymous))]
pub(crate) fn summary(py: Python<'_>, runs: Vec<PathBuf>, out: Option<PathBuf>, anonymous: bool) -> PyResult<String> {
    py.detach(|| io::json(&Summary::of(&runs, &[], anonymous, out.as_deref(), COMMAND)?)).raised(py)
}
