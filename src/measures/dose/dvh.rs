//! Dose-volume histograms and the figures read from them.

use crate::volume::{LabelMap, Volume, trilinear};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Dose to one structure, Gy.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Dvh {
    /// Name of the structure.
    pub name: String,
    /// Volume, ml.
    pub volume_ml: f64,
    /// Volume outside the dose grid, ml; it counts with 0 Gy.
    pub outside_ml: f64,
    /// Mean.
    pub mean: f64,
    /// Least.
    pub min: f64,
    /// Greatest.
    pub max: f64,
    /// Dose that 98 % of the volume receives at least.
    pub d98: f64,
    /// Dose that 95 % of the volume receives at least.
    pub d95: f64,
    /// Median.
    pub d50: f64,
    /// Dose that 2 % of the volume receives at least.
    pub d2: f64,
    /// Dose that the hottest 0.03 cm^3 receives at least.
    pub d003cc: f64,
    /// Volume share in percent that receives at least each asked dose: V_x.
    pub v: Vec<Share>,
    /// Cumulative histogram: share of the volume (0 to 1) with at least `n * bin` Gy.
    pub cumulative: Vec<f64>,
    /// Width of a bin, Gy.
    pub bin: f64,
}

/// Volume share at one dose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Share {
    /// Dose, Gy.
    pub gy: f64,
    /// Volume with at least this dose, percent.
    pub percent: f64,
}

/// Volume of the near maximum dose, ml.
const HOT_ML: f64 = 0.03;

/// Dose-volume histogram of each structure, sorted by label. Each voxel of the label map counts once, with the dose
/// interpolated linearly at its centre, so that grids may differ. `at` lists the doses of V_x, Gy; `bin` is in Gy.
pub fn dvh(dose: &Volume<f32>, structures: &LabelMap, at: &[f64], bin: f64) -> Vec<Dvh> {
    let grid = structures.volume.grid();
    let mut voxels: BTreeMap<u16, Vec<usize>> = BTreeMap::new();
    for (l, label) in structures.volume.data().iter().enumerate().filter(|(_, l)| **l > 0) {
        voxels.entry(*label).or_default().push(l);
    }
    let voxel_ml = grid.voxel_volume() / 1000.0;
    let list: Vec<(u16, Vec<usize>)> = voxels.into_iter().collect();
    list.par_iter()
        .map(|(label, voxels)| {
            let name = structures.names.get(label).cloned().unwrap_or_else(|| label.to_string());
            let sampled: Vec<Option<f64>> =
                voxels.iter().map(|l| trilinear(dose, &dose.grid().index(&grid.centre(grid.voxel(*l))))).collect();
            let outside = sampled.iter().filter(|d| d.is_none()).count();
            let doses = sampled.into_iter().map(Option::unwrap_or_default).collect();
            Dvh { outside_ml: outside as f64 * voxel_ml, ..of(name, doses, voxel_ml, at, bin) }
        })
        .collect()
}

/// The figures of at least one voxel's doses.
fn of(name: String, mut doses: Vec<f64>, voxel_ml: f64, at: &[f64], bin: f64) -> Dvh {
    doses.sort_unstable_by(|a, b| b.total_cmp(a));
    let n = doses.len();
    // Voxels are counted from the hottest until the volume is reached.
    let hottest = |voxels: f64| doses[((voxels - 1e-9).ceil().max(1.0) as usize).min(n) - 1];
    let share = |gy: f64| doses.partition_point(|d| *d >= gy) as f64 / n as f64;
    let bins = (doses[0].max(0.0) / bin) as usize + 2;
    Dvh {
        volume_ml: n as f64 * voxel_ml,
        outside_ml: 0.0,
        mean: doses.iter().sum::<f64>() / n as f64,
        min: doses[n - 1],
        max: doses[0],
        d98: hottest(0.98 * n as f64),
        d95: hottest(0.95 * n as f64),
        d50: hottest(0.5 * n as f64),
        d2: hottest(0.02 * n as f64),
        d003cc: hottest(HOT_ML / voxel_ml),
        v: at.iter().map(|gy| Share { gy: *gy, percent: 100.0 * share(*gy) }).collect(),
        cumulative: (0..bins).map(|b| share(b as f64 * bin)).collect(),
        bin,
        name,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn a_wedge_of_dose_by_hand() {
        // 100 planes of 10 x 10 voxels with 0, 1, ... 99 Gy; a voxel has 0.006 ml.
        let grid = Grid::axis_aligned([100, 10, 10], [1.0, 2.0, 3.0], [0.0; 3]).unwrap();
        let dose = Volume::from_fn(grid.clone(), |l| grid.voxel(l)[0] as f32);
        let all = LabelMap { volume: Volume::filled(grid.clone(), 4), names: [(4, "target".to_owned())].into() };
        let d = dvh(&dose, &all, &[50.0, 99.5], 1.0).remove(0);
        let close = |a: f64, b: f64, what: &str| assert!((a - b).abs() < 1e-6, "{what}: {a} {b}");
        close(d.volume_ml, 60.0, "volume");
        close(d.mean, 49.5, "mean");
        close(d.d95, 5.0, "D95");
        close(d.d50, 50.0, "D50");
        close(d.d2, 98.0, "D2");
        close(d.d003cc, 99.0, "D0.03cc");
        close(d.v[0].percent, 50.0, "V50");
        close(d.v[1].percent, 0.0, "V99.5");
        close(d.cumulative[0], 1.0, "start");
        close(d.cumulative[30], 0.7, "V30");
        assert_eq!((d.name.as_str(), d.cumulative.len()), ("target", 101));
        // A dose grid that ends half way: the rest counts with nothing, and it says so.
        let short = Grid::axis_aligned([50, 10, 10], [1.0, 2.0, 3.0], [0.0; 3]).unwrap();
        let half = dvh(&Volume::filled(short, 10.0), &all, &[], 1.0).remove(0);
        close(half.outside_ml, 30.0, "outside");
        close(half.mean, 5.0, "mean of half");
    }
}
