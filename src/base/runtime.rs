//! How to run, apart from what to compute: threads, progress, stage times. Nothing here may change a result.

use crate::error::{Error, Result};
use crate::progress::{Progress, Silent};
use serde::{Deserialize, Serialize};
use std::sync::Mutex;
use std::time::Instant;

/// The most threads that can be asked for.
pub const MOST_THREADS: usize = 1024;

/// Time of one stage of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StageTime {
    /// Name of the stage.
    pub stage: String,
    /// Wall time in seconds.
    pub seconds: f64,
    /// Processor time, all threads together, s, where the system tells.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub processor_seconds: Option<f64>,
}

/// Thread pool, progress receiver and stage clock of one run.
pub struct Runtime {
    pool: rayon::ThreadPool,
    progress: Box<dyn Progress>,
    times: Mutex<Vec<StageTime>>,
}

impl Runtime {
    /// A runtime with `threads` threads (0: one per core).
    ///
    /// # Errors
    /// When there are more than [`MOST_THREADS`], or the thread pool cannot be started.
    pub fn new(threads: usize, progress: Box<dyn Progress>) -> Result<Self> {
        if threads > MOST_THREADS {
            return Err(Error::usage(
                format!("{threads} threads are asked for"),
                format!("give at most {MOST_THREADS}"),
            ));
        }
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .map_err(|e| Error::usage(format!("cannot start {threads} threads: {e}"), "use a smaller --threads"))?;
        Ok(Self { pool, progress, times: Mutex::new(Vec::new()) })
    }

    /// A runtime that shows nothing, with one thread per core.
    ///
    /// # Errors
    /// When the thread pool cannot be started.
    pub fn silent() -> Result<Self> {
        Self::new(0, Box::new(Silent))
    }

    /// Number of threads.
    pub fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    /// The progress receiver.
    pub fn progress(&self) -> &dyn Progress {
        self.progress.as_ref()
    }

    /// Runs `work` as a named stage inside the thread pool and records its time.
    pub fn stage<T: Send>(&self, name: &str, work: impl FnOnce() -> T + Send) -> T {
        self.progress.stage(name);
        let (start, before) = (Instant::now(), processor_seconds());
        let out = self.pool.install(work);
        let seconds = start.elapsed().as_secs_f64();
        let processor_seconds = processor_seconds_since(before);
        self.progress.finish(seconds);
        if let Ok(mut times) = self.times.lock() {
            times.push(StageTime { stage: name.to_owned(), seconds, processor_seconds });
        }
        out
    }

    /// Runs both inside the thread pool, at the same time where there is a thread to spare.
    pub fn beside<A: Send, B: Send>(
        &self,
        first: impl FnOnce() -> A + Send,
        second: impl FnOnce() -> B + Send,
    ) -> (A, B) {
        self.pool.install(|| rayon::join(first, second))
    }

    /// Forgets the stage times so far: the next run begins.
    pub fn restart(&self) {
        if let Ok(mut times) = self.times.lock() {
            times.clear();
        }
    }

    /// Stage times so far, in order.
    pub fn times(&self) -> Vec<StageTime> {
        self.times.lock().map(|t| t.clone()).unwrap_or_default()
    }
}

/// Peak resident memory of this process in bytes, where the system tells (Linux).
pub fn peak_memory() -> Option<u64> {
    let status = of_this_process("status")?;
    let line = status.lines().find(|l| l.starts_with("VmHWM:"))?;
    let kib: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib * 1024)
}

/// Processor time of this process so far, all threads together, s, where the system tells (Linux): unlike wall time it
/// hardly depends on what else the machine does.
pub fn processor_seconds() -> Option<f64> {
    let stat = of_this_process("stat")?;
    // Behind the name, which may hold anything: state, then utime and stime as fields 12 and 13, in hundredths of a second.
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
    let ticks: u64 = fields.next()?.parse::<u64>().ok()? + fields.next()?.parse::<u64>().ok()?;
    Some(ticks as f64 / 100.0)
}

/// A file of `/proc/self`; under other systems a folder of that name, such as Wine's, tells of something else.
fn of_this_process(name: &str) -> Option<String> {
    cfg!(target_os = "linux").then(|| std::fs::read_to_string(format!("/proc/self/{name}")).ok()).flatten()
}

/// What has been added since [`processor_seconds`] told `before`.
pub fn processor_seconds_since(before: Option<f64>) -> Option<f64> {
    before.zip(processor_seconds()).map(|(from, to)| to - from)
}

/// Starts [`peak_memory`] anew from what is resident now, where the system allows it (Linux).
pub fn reset_peak_memory() {
    // Only a measurement depends on it; where it is not allowed the peak is the whole process's.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}
