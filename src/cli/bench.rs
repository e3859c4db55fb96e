//! `aventail bench`: how long the hot paths take here, beside what the memory allows.

use super::args::CommonArgs;
use super::terminal::progress;
use crate::benchmark::{AgainstExact, BenchmarkOptions, BenchmarkReport, Distances, SceneSize, Task, run as measure};
use crate::error::Result;
use crate::runtime::Runtime;
use clap::{Args, ValueEnum};
use std::fmt::Write;

/// What `aventail bench --help` adds.
pub(super) const HELP: &str = "\
The scene is the phantom on the thesis's grid: 512 x 512 x 126 voxels of 0.98 x 0.98 x 3 mm, 42
bones, 7 million voxels of tissue. Making it takes a minute and is not timed. Each task's time is
the median of --repeat runs; `floor` is the share of that time needed to move its inputs and
results through memory once, at the bandwidth measured in the same run. Targets are for two
idle cores at full size. Processor time adds up all threads and hardly depends on what else the
machine does. With superposition and propagation both among the tasks, the default propagation is
compared with the exact one as well.

Tasks: elements, prioritised, superposition, waves, propagation, propagation-with-images, invert,
resample, labels, jacobian, cells, characteristics, read, write

Example:
  aventail bench --size quarter --only resample,jacobian --repeat 5";

/// Options of `bench`.
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// Size of the scene
    #[arg(long, value_enum, default_value = "full")]
    pub size: SizeName,
    /// Number of runs of each task
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub repeat: u16,
    /// Only these tasks, separated by commas
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', value_parser = task)]
    pub only: Vec<Task>,
    /// Threads, progress, and how the result is told.
    #[command(flatten)]
    pub common: CommonArgs,
}

/// Sizes of the scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SizeName {
    /// 512 x 512 x 126 voxels
    Full,
    /// 256 x 256 x 126 voxels, twice as wide in x and y
    Half,
    /// 128 x 128 x 126 voxels, four times as wide in x and y
    Quarter,
    /// 103 x 72 x 70 voxels of 5 x 5 x 6 mm: a quick check that everything runs
    Tiny,
}

/// The task of a name.
fn task(name: &str) -> Result<Task, String> {
    let all = || Task::ALL.map(Task::name).join(", ");
    Task::ALL.into_iter().find(|t| t.name() == name).ok_or_else(|| format!("the tasks are {}", all()))
}

/// Measures and returns the table (or JSON) for the terminal.
///
/// # Errors
/// When the folder for temporary files cannot be written to.
pub(super) fn run(args: &BenchArgs) -> Result<String> {
    let size = match args.size {
        SizeName::Full => SceneSize::Full,
        SizeName::Half => SceneSize::Half,
        SizeName::Quarter => SceneSize::Quarter,
        SizeName::Tiny => SceneSize::Tiny,
    };
    let tasks = if args.only.is_empty() { Task::ALL.to_vec() } else { args.only.clone() };
    let options = BenchmarkOptions { size, repeat: usize::from(args.repeat), tasks };
    let runtime = Runtime::new(args.common.work.threads, progress(args.common.shown.quiet))?;
    let report = measure(&options, &runtime)?;
    if args.common.told.json {
        return report.json();
    }
    Ok(table(&report))
}

/// The table for people.
fn table(report: &BenchmarkReport) -> String {
    let [x, y, z] = report.size;
    let [sx, sy, sz] = report.spacing_mm;
    let mut text = format!(
        "aventail {}, {} threads; {x} x {y} x {z} voxels of {sx} x {sy} x {sz} mm, {:.2} million active, {} bones\n\
         memory: copy {:.1} GB/s, triad {:.1} GB/s (the floor)\n\n\
         {:<24}{:>9}{:>9}{:>9}{:>9}{:>12}{:>9}{:>8}{:>9}\n",
        report.version,
        report.threads,
        report.active as f64 / 1e6,
        report.bones,
        report.bandwidth.copy / 1e9,
        report.bandwidth.triad / 1e9,
        "task",
        "median s",
        "least s",
        "proc. s",
        "target",
        "Mvoxel/s",
        "GB/s",
        "floor",
        "peak GB",
    );
    for m in &report.tasks {
        let target = m.target_seconds.map_or(String::new(), |s| format!("{s:.2}"));
        let spent = m.processor_seconds.map_or(String::new(), |s| format!("{s:.2}"));
        let peak = m.peak_memory.map_or(String::new(), |b| format!("{:.2}", b as f64 / 1e9));
        writeln!(
            text,
            "{:<24}{:>9.3}{:>9.3}{:>9}{:>9}{:>12.2}{:>9.2}{:>7.1}%{:>9}",
            m.task.name(),
            m.seconds,
            m.least_seconds,
            spent,
            target,
            m.voxels_per_second / 1e6,
            m.bytes_per_second / 1e9,
            100.0 * m.floor_share,
            peak
        )
        .expect("writing to a string does not fail");
    }
    if let Some(found) = &report.against_exact {
        text.push_str(&against_exact(found));
    }
    text
}

/// What the default's shortcuts cost, for people.
fn against_exact(found: &AgainstExact) -> String {
    let of = |d: &Distances| format!("mean {:.3} mm, 95 % {:.3} mm, worst {:.2} mm", d.mean, d.p95, d.max);
    let mut text = format!(
        "\nthe default against influence of every bone at every voxel, none pruned, at the soft tissue's voxels:\n\
         {:<24}{}\n{:<24}{}\n",
        "propagation",
        of(&found.field),
        "before relaxation",
        of(&found.superposition)
    );
    if let Some(waves) = &found.pruning {
        writeln!(text, "{:<24}{waves}", "pruning").expect("writing to a string does not fail");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_help_names_every_task_and_wrong_names_are_refused() {
        for known in Task::ALL {
            assert!(HELP.contains(known.name()), "{}", known.name());
            assert_eq!(task(known.name()), Ok(known));
        }
        assert!(task("resampling").unwrap_err().contains("resample"));
    }
}
