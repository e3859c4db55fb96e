//! Rank 11: how long the hot paths take on this machine, on a scene of the size of the thesis's, beside what its memory allows.

mod exact;
mod floor;
mod run;
mod scene;
mod task;

pub use exact::{AgainstExact, Distances};
pub use floor::{Bandwidth, bandwidth};
pub use scene::{Scene, SceneSize};
pub use task::Task;

use crate::error::Result;
use crate::runtime::{Runtime, peak_memory, processor_seconds, processor_seconds_since, reset_peak_memory};
use crate::stats::Summary;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// What to time.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct BenchmarkOptions {
    /// Size of the scene.
    pub size: SceneSize,
    /// Times that each task runs; the median counts.
    pub repeat: usize,
    /// Tasks, in this order.
    pub tasks: Vec<Task>,
}

impl Default for BenchmarkOptions {
    fn default() -> Self {
        Self { size: SceneSize::Full, repeat: 3, tasks: Task::ALL.to_vec() }
    }
}

/// How one task went.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measurement {
    /// The task.
    pub task: Task,
    /// Median of the runs, s.
    pub seconds: f64,
    /// Fastest run, s.
    pub least_seconds: f64,
    /// Mean processor time of a run, all threads together, s, where the system tells.
    pub processor_seconds: Option<f64>,
    /// Voxels that the task works on: active ones for the chain mail, all of the grid otherwise.
    pub voxels: usize,
    /// Bytes that the task must at least read and write.
    pub bytes: u64,
    /// Voxels per second.
    pub voxels_per_second: f64,
    /// Bytes per second, of those that it must move.
    pub bytes_per_second: f64,
    /// Share of the time that moving these bytes alone would take: 1 is as fast as this machine's memory.
    pub floor_share: f64,
    /// Time that the task should take at most on two cores at full size, s, where one is set.
    pub target_seconds: Option<f64>,
    /// Peak resident memory of the process during the task, scene included, where the system tells.
    pub peak_memory: Option<u64>,
}

/// A whole run of the benchmark.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BenchmarkReport {
    /// Version of aventail.
    pub version: String,
    /// What was asked for.
    pub options: BenchmarkOptions,
    /// Threads.
    pub threads: usize,
    /// Memory bandwidth, measured just before.
    pub bandwidth: Bandwidth,
    /// Voxels of the planning grid.
    pub size: [usize; 3],
    /// Spacing of the planning grid, mm.
    pub spacing_mm: [f64; 3],
    /// Voxels that take part in the chain mail: body above the least HU, and bone.
    pub active: usize,
    /// Bones of the skeleton.
    pub bones: usize,
    /// The tasks.
    pub tasks: Vec<Measurement>,
    /// How far the default propagation is from the exact one, when both [`Task::Superposition`] and [`Task::Propagation`] are
    /// among them.
    pub against_exact: Option<AgainstExact>,
}

impl BenchmarkReport {
    /// As JSON for machines; its code is made here, once.
    ///
    /// # Errors
    /// [`crate::error::Error::Internal`] when a value has no JSON.
    pub fn json(&self) -> Result<String> {
        crate::io::json(self)
    }
}

/// Makes the scene and times the tasks on it.
///
/// # Errors
/// When the scene cannot be made, or a file cannot be written to the folder for temporary files.
pub fn run(options: &BenchmarkOptions, runtime: &Runtime) -> Result<BenchmarkReport> {
    let bandwidth = runtime.stage("memory bandwidth", bandwidth);
    let scene = runtime.stage("make the scene", || Scene::new(options.size, &options.tasks))?;
    let mut tasks = Vec::new();
    for &task in &options.tasks {
        reset_peak_memory();
        let mut seconds = Vec::new();
        let before = processor_seconds();
        runtime.stage(task.name(), || {
            for n in 0..options.repeat.max(1) {
                runtime.progress().step(n, options.repeat, task.name());
                let start = Instant::now();
                task.run(&scene)?;
                seconds.push(start.elapsed().as_secs_f64());
            }
            Ok::<_, crate::error::Error>(())
        })?;
        let peak = peak_memory();
        let spent = processor_seconds_since(before).map(|s| s / options.repeat.max(1) as f64);
        let times = Summary::of(&seconds);
        let (voxels, bytes) = task.work(&scene);
        tasks.push(Measurement {
            task,
            seconds: times.median,
            least_seconds: times.min,
            processor_seconds: spent,
            voxels,
            bytes,
            voxels_per_second: voxels as f64 / times.median,
            bytes_per_second: bytes as f64 / times.median,
            floor_share: bytes as f64 / bandwidth.triad / times.median,
            target_seconds: (options.size == SceneSize::Full).then(|| task.target()).flatten(),
            peak_memory: peak,
        });
    }
    let both = [Task::Superposition, Task::Propagation].iter().all(|t| options.tasks.contains(t));
    let against_exact =
        both.then(|| runtime.stage("default against exact", || exact::against_exact(&scene))).transpose()?;
    let grid = scene.phantom.planning.grid();
    Ok(BenchmarkReport {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        options: options.clone(),
        threads: runtime.threads(),
        bandwidth,
        size: grid.size(),
        spacing_mm: grid.spacing(),
        active: scene.active,
        bones: scene.phantom.skeleton.bones.len(),
        tasks,
        against_exact,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_task_runs_and_its_rates_agree() {
        let runtime = Runtime::silent().unwrap();
        let options = BenchmarkOptions { size: SceneSize::Tiny, repeat: 1, ..BenchmarkOptions::default() };
        let report = run(&options, &runtime).unwrap();
        assert_eq!(report.tasks.iter().map(|t| t.task).collect::<Vec<_>>(), Task::ALL);
        assert!(report.bones == 42 && report.active > 10_000 && report.active < report.size.iter().product());
        for t in &report.tasks {
            assert!(t.seconds > 0.0 && t.voxels > 0 && t.bytes > 0, "{t:?}");
            // The share is of the time that the bytes take at the measured bandwidth.
            assert!((t.floor_share * report.bandwidth.triad / t.bytes_per_second - 1.0).abs() < 1e-9, "{t:?}");
            assert!(t.target_seconds.is_none(), "targets are for the full size");
        }
        // Where elements are as coarse as voxels there is little to lose, and where nothing differs nothing was compared.
        let AgainstExact { field, superposition, pruning } = report.against_exact.unwrap();
        assert!(0.0 < field.mean && field.mean < 0.1 && field.mean < superposition.mean, "{field:?} {superposition:?}");
        assert!(pruning.is_some_and(|waves| waves.of == 42 && waves.most_mm < 1.0), "{pruning:?}");
    }
}
