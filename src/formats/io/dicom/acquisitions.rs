//! Acquisitions and reconstructions that alternate in one series: by what the slices say of their origin, in the order of
//! their places. Those that follow each other, as in a scan by steps, are one volume.

use super::frames::Frame;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Two acquisitions lie at least so far apart in time, s, and so many times what lies between their slices.
const APART_S: f64 = 1.0;
const APART_TIMES: f64 = 3.0;

/// What tells images of several acquisitions apart that alternate, in words; `None` where they are of one.
pub(super) fn alternating(files: &[PathBuf], frames: &[Frame]) -> Option<String> {
    let first = frames.first()?;
    let by_trait = (0..first.origin.len()).find_map(|n| {
        let values: Vec<&str> = frames.iter().map(|f| f.origin.get(n).map_or("", |o| o.1.as_str())).collect();
        let name = first.origin.get(n)?.0;
        alternate(&values, 0).then(|| listed(files, frames, name, &values))
    });
    by_trait.or_else(|| {
        let parts = by_time(frames)?;
        alternate(&parts, 1).then(|| listed(files, frames, "time", &parts))
    })
}

/// Whether there are more runs of one value than values, and so many more.
fn alternate(values: &[&str], more: usize) -> bool {
    let mut kinds: Vec<&str> = values.to_vec();
    kinds.sort_unstable();
    kinds.dedup();
    let runs = 1 + values.windows(2).filter(|w| w[0] != w[1]).count();
    kinds.len() > 1 && runs > kinds.len() + more
}

/// Images before and after the longest pause, where that is no pause between two slices.
fn by_time(frames: &[Frame]) -> Option<Vec<&'static str>> {
    let times: Vec<f64> = frames.iter().map(|f| f.time).collect::<Option<_>>()?;
    let mut sorted = times.clone();
    sorted.sort_by(f64::total_cmp);
    let mut gaps: Vec<(f64, f64)> = sorted.windows(2).map(|w| (w[1] - w[0], 0.5 * (w[0] + w[1]))).collect();
    gaps.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (gap, middle) = *gaps.first()?;
    let next = gaps.get(1).map_or(0.0, |g| g.0);
    (gap >= APART_S && gap >= APART_TIMES * next)
        .then(|| times.iter().map(|t| if *t < middle { "earlier" } else { "later" }).collect())
}

/// How many images have each of the values of a name, which belong to `frames` in their order, and the first file of each.
pub(super) fn listed<'a>(
    files: &[PathBuf],
    frames: impl IntoIterator<Item = &'a Frame>,
    name: &str,
    values: &[&str],
) -> String {
    let mut kinds: BTreeMap<&str, (usize, usize)> = BTreeMap::new();
    for (frame, value) in frames.into_iter().zip(values) {
        kinds.entry(value).or_insert((0, frame.object)).0 += 1;
    }
    let one = |(value, (count, object)): (&&str, &(usize, usize))| {
        let file = files.get(*object).map_or(String::new(), |p| p.display().to_string());
        let value = if value.is_empty() { "none" } else { value };
        format!("\n    {name} {value}: {count} images, the first {file}")
    };
    kinds.iter().take(6).map(one).collect()
}
