//! Long work on a thread of its own, while Python's thread waits for it, hands progress on, and looks for Ctrl-C.

use crate::errors::Raised;
use aventail::progress::Progress;
use aventail::{Error, Result, Runtime};
use pyo3::prelude::*;
use std::any::Any;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How often Python's thread looks for signals.
const POLL: Duration = Duration::from_millis(50);

/// What a run tells.
enum Told {
    /// A stage begins.
    Stage(String),
    /// Share of the stage that is done.
    Share(f64),
    /// The stage ended.
    Finished,
    /// The work is done, or was given up.
    Done,
}

/// Who is told of a run, and whether it is to stop.
struct Listener {
    to: Sender<Told>,
    stop: Arc<AtomicBool>,
}

/// Hands progress to whoever asked for the work at hand.
#[derive(Default)]
struct Relay {
    listener: Mutex<Option<Listener>>,
    /// Held by the work at hand: what was stopped ends before the next begins.
    turn: Mutex<()>,
}

/// What a stopped run unwinds with.
struct Stopped;

impl Relay {
    /// Hands a word on, where there is one, or ends a run that is to stop: every stage and every step of one asks here.
    fn tell(&self, told: Option<Told>) {
        let listener = held(&self.listener);
        let Some(Listener { to, stop }) = &*listener else { return };
        if stop.load(Ordering::Relaxed) {
            drop(listener);
            resume_unwind(Box::new(Stopped));
        }
        if let Some(told) = told {
            // Nobody listens any longer where Python's thread has gone.
            let _ = to.send(told);
        }
    }
}

/// What a mutex guards; a panic elsewhere must not hide behind one about it.
fn held<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The relay as the library sees it.
struct Reporter(Arc<Relay>);

impl Progress for Reporter {
    fn stage(&self, name: &str) {
        self.0.tell(Some(Told::Stage(name.to_owned())));
    }
    fn step(&self, done: usize, total: usize, _: &str) {
        self.0.tell(Some(Told::Share(done as f64 / total.max(1) as f64)));
    }
    fn waiting(&self) {
        self.0.tell(None);
    }
    fn note(&self, text: &str) {
        self.0.tell(Some(Told::Stage(text.to_owned())));
    }
    fn finish(&self, _: f64) {
        self.0.tell(Some(Told::Finished));
    }
}

/// How work is run: with how many threads, 0 for one per core, and who is told of its progress.
#[derive(FromPyObject)]
pub(crate) struct Work<'py>(usize, Option<Bound<'py, PyAny>>);

impl<'py> Work<'py> {
    pub(crate) fn threads(&self) -> usize {
        self.0
    }

    /// Whoever is told, `progress(stage, share)`.
    pub(crate) fn progress(&self) -> Option<&Bound<'py, PyAny>> {
        self.1.as_ref()
    }
}

/// A runtime of the library whose progress reaches Python.
#[derive(Clone)]
pub(crate) struct Runs {
    runtime: Arc<Runtime>,
    relay: Arc<Relay>,
}

impl Runs {
    /// With `threads` threads, 0 for one per core.
    pub(crate) fn new(threads: usize) -> Result<Self> {
        let relay = Arc::new(Relay::default());
        let runtime = Arc::new(Runtime::new(threads, Box::new(Reporter(Arc::clone(&relay))))?);
        Ok(Self { runtime, relay })
    }

    /// Does `work` on another thread. Meanwhile this one waits without the interpreter's lock, calls `progress(stage, share)`,
    /// and raises what a signal handler raises, at the latest after [`POLL`]; the work then ends at its next stage or step.
    pub(crate) fn run<T: Send + 'static>(
        &self,
        py: Python<'_>,
        progress: Option<&Bound<'_, PyAny>>,
        work: impl FnOnce(&Runtime) -> Result<T> + Send + 'static,
    ) -> PyResult<T> {
        let (to, told) = channel();
        let (told, stop) = (Mutex::new(told), Arc::new(AtomicBool::new(false)));
        let listener = Listener { to: to.clone(), stop: Arc::clone(&stop) };
        let (runtime, relay) = (Arc::clone(&self.runtime), Arc::clone(&self.relay));
        let work = move || {
            // Sent however the work ends.
            let _done = OnDrop(to);
            let _turn = held(&relay.turn);
            *held(&relay.listener) = Some(listener);
            work(&runtime)
        };
        let started = std::thread::Builder::new().name("aventail".into()).spawn(work);
        let thread = started.map_err(|e| Error::usage(format!("cannot start a thread: {e}"), "free some memory"));
        let thread = thread.raised(py)?;
        if let Err(raised) = wait(py, progress, &told) {
            stop.store(true, Ordering::Relaxed);
            return Err(raised);
        }
        let done = py.detach(|| thread.join());
        done.unwrap_or_else(|panic| Err(Error::Internal(why(panic.as_ref())))).raised(py)
    }
}

/// What a panic said.
fn why(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "the work ended in a panic".into())
}

/// Tells that the work is done.
struct OnDrop(Sender<Told>);

impl Drop for OnDrop {
    fn drop(&mut self) {
        let _ = self.0.send(Told::Done);
    }
}

/// Waits until the work is done.
fn wait(py: Python<'_>, progress: Option<&Bound<'_, PyAny>>, told: &Mutex<Receiver<Told>>) -> PyResult<()> {
    let mut stage = String::new();
    loop {
        let next = py.detach(|| held(told).recv_timeout(POLL));
        py.check_signals()?;
        let share = match next {
            Ok(Told::Done) | Err(RecvTimeoutError::Disconnected) => return Ok(()),
            Err(RecvTimeoutError::Timeout) => continue,
            Ok(Told::Stage(name)) => {
                stage = name;
                None
            }
            Ok(Told::Share(share)) => Some(share),
            Ok(Told::Finished) => Some(1.0),
        };
        if let Some(progress) = progress {
            progress.call1((stage.as_str(), share))?;
        }
    }
}
