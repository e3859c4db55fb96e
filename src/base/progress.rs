//! Progress records: the library emits them, the terminal decides how they look.

/// Receives what a run is doing. Implementations must be cheap: `step` is called often.
///
/// An implementation that wants to end a run may unwind out of any of its methods with [`std::panic::resume_unwind`]: nothing
/// of the run remains.
pub trait Progress: Send + Sync {
    /// A stage begins, for example "fit skeleton".
    fn stage(&self, name: &str);
    /// `done` of `total` units of the current stage are finished, `label` names the unit.
    fn step(&self, done: usize, total: usize, label: &str);
    /// Another program does the work, for minutes perhaps: asked several times a second, so that a run can be ended meanwhile.
    fn waiting(&self) {}
    /// Something worth knowing between two stages.
    fn note(&self, _text: &str) {}
    /// The current stage ended after `seconds`.
    fn finish(&self, seconds: f64);
}

/// Progress that nobody sees.
#[derive(Debug, Default, Clone, Copy)]
pub struct Silent;

impl Progress for Silent {
    fn stage(&self, _: &str) {}
    fn step(&self, _: usize, _: usize, _: &str) {}
    fn finish(&self, _: f64) {}
}
