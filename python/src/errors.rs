//! The library's errors as the exceptions of `aventail._errors`.

use aventail::Error;
use pyo3::prelude::*;

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
