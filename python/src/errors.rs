//! The library's errors as the exceptions of `aventail._errors`.

use aventail::Error;
use aventail::warning::Warning;
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use std::ffi::CString;

/// The exception of an error: message, what is at fault, cause, remedy, code and exit code.
pub(crate) fn raise(py: Python<'_>, error: &Error) -> PyErr {
    let made = py.import("aventail._errors").and_then(|module| {
        let parts = (
            error.to_string(),
            error.what(),
            error.problem().to_owned(),
            error.remedy().to_owned(),
            error.code(),
            error.exit_code(),
        );
        module.getattr("made")?.call1(parts)
    });
    made.map_or_else(|failed| failed, PyErr::from_value)
}

/// Says what is to be known as warnings of Python, each with its code.
pub(crate) fn warn(py: Python<'_>, warnings: &[Warning]) -> PyResult<()> {
    let category = py.get_type::<PyUserWarning>();
    warnings.iter().try_for_each(|warning| {
        let text = CString::new(format!("{} ({})", warning.message, warning.code).replace('\0', " "))?;
        PyErr::warn(py, &category, &text, 1)
    })
}

/// A result of the library for Python.
pub(crate) trait Raised<T> {
    /// The value, or the exception.
    fn raised(self, py: Python<'_>) -> PyResult<T>;
}

impl<T> Raised<T> for aventail::Result<T> {
    fn raised(self, py: Python<'_>) -> PyResult<T> {
        self.map_err(|e| raise(py, &e))
    }
}
