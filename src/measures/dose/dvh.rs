//! Dose-volume histograms and the figures read from them.

use super::sample::{self, Sampled};
use crate::findings;
use crate::geometry::Grid;
use crate::volume::contour::Contours;
use crate::volume::{LabelMap, Volume};
use crate::warning::Warning;
use serde::Serialize;

/// Dose to one structure, Gy. Figures are NaN (`null` in JSON) where no part of the structure has a known dose.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Dvh {
    /// Name of the structure.
    pub name: String,
    /// Volume as it was sampled, ml.
    pub volume_ml: f64,
    /// The structure's own volume, ml: of its contours, or of its voxels.
    pub own_ml: f64,
    /// Volume outside the dose grid, ml; it counts with 0 Gy unless it is all.
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
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Share {
    /// Dose, Gy.
    pub gy: f64,
    /// Volume with at least this dose, percent.
    pub percent: f64,
}

/// Volume of the near maximum dose, ml.
const HOT_ML: f64 = 0.03;
/// Share of a structure outside the dose that is worth a word.
const OUTSIDE: f64 = 1e-3;
/// Relative difference of sampled and own volume that is worth a word.
const UNLIKE: f64 = 0.1;

/// Dose-volume histogram of each label that occurs, sorted by label. A voxel of the label map counts with the dose
/// at its centre, or at the middles of its parts where it is larger than the dose's voxels, so that
/// grids may differ. `at` lists the doses of V_x, Gy; `bin` is in Gy.
pub fn dvh(dose: &Volume<f32>, structures: &LabelMap, at: &[f64], bin: f64) -> Vec<Dvh> {
    sample::labels(dose.grid(), structures, |places| of(places.read(dose), at, bin))
}

/// Dose-volume histogram of each structure, in their order, none left out. Each is sampled inside the dose's voxels, the finer
/// the smaller it is; structures may overlap.
pub fn dvh_of_contours(dose: &Volume<f32>, contours: &Contours, at: &[f64], bin: f64) -> Vec<Dvh> {
    contours.structures.iter().map(|s| of(sample::contours(dose.grid(), contours, s).read(dose), at, bin)).collect()
}

/// Structures on a dose's grid, for the histograms of many doses there: as [`dvh`] and [`dvh_of_contours`] make them one by one.
pub struct DvhPlaces(Vec<sample::Places>);

impl DvhPlaces {
    /// Of a label map.
    pub fn of_labels(grid: &Grid, structures: &LabelMap) -> Self {
        Self(sample::labels(grid, structures, |places| places))
    }

    /// Of contours.
    pub fn of_contours(grid: &Grid, contours: &Contours) -> Self {
        Self(contours.structures.iter().map(|s| sample::contours(grid, contours, s)).collect())
    }

    /// The histograms of a dose on the grid.
    pub fn histograms(&self, dose: &Volume<f32>, at: &[f64], bin: f64) -> Vec<Dvh> {
        self.0.iter().map(|places| of(places.read(dose), at, bin)).collect()
    }
}

/// What of the histograms deserves a word: structures outside the dose, without volume, or unlike their contours.
pub fn doubts(list: &[Dvh]) -> Vec<Warning> {
    let mut all = Vec::new();
    for d in list {
        let (name, ml, outside) = (&d.name, d.volume_ml, d.outside_ml);
        if ml <= 0.0 {
            let message = format!("structure {name:?} encloses no volume: its doses are not known");
            all.push(Warning::new(findings::STRUCTURE_EMPTY, message));
        } else if d.mean.is_nan() {
            let message =
                format!("structure {name:?} ({ml:.3} ml) lies wholly outside the dose grid: its doses are not known");
            all.push(Warning::new(findings::STRUCTURE_OUTSIDE_DOSE, message));
        } else if outside > OUTSIDE * ml {
            let share = 100.0 * outside / ml;
            let message = format!(
                "{outside:.3} of {ml:.3} ml ({share:.1} %) of structure {name:?} lie outside the dose grid and count with 0 Gy"
            );
            all.push(Warning::new(findings::STRUCTURE_OUTSIDE_DOSE, message));
        }
        if ml > 0.0 && (ml - d.own_ml).abs() > UNLIKE * d.own_ml {
            let message = format!("structure {name:?}: sampled {ml:.3} ml, its contours enclose {:.3} ml", d.own_ml);
            all.push(Warning::new(findings::STRUCTURE_VOLUME, message));
        }
    }
    all
}

/// The figures of a structure's samples.
fn of(sampled: Sampled, at: &[f64], bin: f64) -> Dvh {
    let Sampled { name, mut samples, unit_ml, own_ml, outside } = sampled;
    let weight: f64 = samples.iter().map(|s| f64::from(s.weight)).sum();
    let none = Dvh {
        volume_ml: weight * unit_ml,
        own_ml,
        outside_ml: outside * unit_ml,
        bin,
        mean: f64::NAN,
        min: f64::NAN,
        max: f64::NAN,
        d98: f64::NAN,
        d95: f64::NAN,
        d50: f64::NAN,
        d2: f64::NAN,
        d003cc: f64::NAN,
        v: at.iter().map(|gy| Share { gy: *gy, percent: f64::NAN }).collect(),
        cumulative: Vec::new(),
        name,
    };
    if weight <= 0.0 || outside >= weight * (1.0 - 1e-9) {
        return none;
    }
    samples.sort_unstable_by(|a, b| b.gy.total_cmp(&a.gy));
    let mut so_far = 0.0;
    let reached: Vec<f64> = samples
        .iter()
        .map(|s| {
            so_far += f64::from(s.weight);
            so_far
        })
        .collect();
    let gy = |n: usize| f64::from(samples[n.min(samples.len() - 1)].gy);
    // Samples are counted from the hottest until the volume is reached.
    let hottest = |part: f64| gy(reached.partition_point(|r| *r < part - 1e-9 * weight));
    let share = |least: f64| {
        let n = samples.partition_point(|s| f64::from(s.gy) >= least);
        n.checked_sub(1).map_or(0.0, |last| reached[last] / weight)
    };
    let bins = (gy(0).max(0.0) / bin) as usize + 2;
    Dvh {
        mean: samples.iter().map(|s| f64::from(s.gy) * f64::from(s.weight)).sum::<f64>() / weight,
        min: gy(samples.len() - 1),
        max: gy(0),
        d98: hottest(0.98 * weight),
        d95: hottest(0.95 * weight),
        d50: hottest(0.5 * weight),
        d2: hottest(0.02 * weight),
        d003cc: hottest(HOT_ML / unit_ml),
        v: at.iter().map(|gy| Share { gy: *gy, percent: 100.0 * share(*gy) }).collect(),
        cumulative: (0..bins).map(|b| share(b as f64 * bin)).collect(),
        ..none
    }
}

#[cfg(test)]
mod tests {
    use super::super::sample::DoseSample;
    use super::*;
    use crate::volume::contour::{Polygon, Structure};
    use nalgebra::Matrix3;

    fn close(a: f64, b: f64, what: &str) {
        assert!((a - b).abs() < 1e-6, "{what}: {a} {b}");
    }

    #[test]
    fn a_wedge_of_dose_by_hand() {
        // 100 planes of 10 x 10 voxels with 0, 1, ... 99 Gy; a voxel has 0.006 ml.
        let grid = Grid::axis_aligned([100, 10, 10], [1.0, 2.0, 3.0], [0.0; 3]).unwrap();
        let dose = Volume::from_fn(grid.clone(), |l| grid.voxel(l)[0] as f32);
        let all = LabelMap { volume: Volume::filled(grid.clone(), 4), names: [(4, "target".to_owned())].into() };
        let d = dvh(&dose, &all, &[50.0, 99.5], 1.0).remove(0);
        close(d.volume_ml, 60.0, "volume");
        close(d.own_ml, 60.0, "own volume");
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
        let found = doubts(&[half, d]);
        assert!(found.len() == 1 && found[0].message.contains("30.000 of 60.000 ml"), "{found:?}");
    }

    /// Boxes of contours: `low` to `high` along both axes on each plane.
    fn boxes(name: &str, [low, high]: [f64; 2], heights: impl IntoIterator<Item = f64>) -> Structure {
        let points = vec![[low, low], [high, low], [high, high], [low, high]];
        let polygons = heights.into_iter().map(|height| Polygon { height, points: points.clone() }).collect();
        Structure { name: name.into(), colour: None, polygons }
    }

    /// A wedge of 1 Gy per mm along x on voxels of 4 mm, 20 mm to either side of the middle; 30 Gy there.
    fn wedge() -> Volume<f32> {
        let grid = Grid::axis_aligned([11; 3], [4.0; 3], [-20.0; 3]).unwrap();
        Volume::from_fn(grid.clone(), |l| 30.0 + grid.centre(grid.voxel(l)).x as f32)
    }

    #[test]
    fn no_structure_vanishes_and_no_layer_is_lost() {
        let structures = vec![
            boxes("through_centres", [-8.0, 8.0], (-3..3).map(|k| 4.0 * f64::from(k))),
            boxes("cochlea", [1.0, 3.0], [1.0, 2.0, 3.0]),
            boxes("half", [12.0, 32.0], (-3..3).map(|k| 4.0 * f64::from(k))),
            boxes("beyond", [93.0, 107.0], (-3..3).map(|k| 4.0 * f64::from(k))),
            boxes("nothing", [0.0, 0.0], []),
        ];
        let all = Contours { axes: Matrix3::identity(), structures };
        let list = dvh_of_contours(&wedge(), &all, &[20.0], 0.1);
        assert_eq!(list.len(), 5);
        let near = |a: f64, b: f64, what: &str| assert!((a - b).abs() < 0.01 * b, "{what}: {a} {b}");
        near(list[0].own_ml, 6.144, "own volume");
        near(list[0].volume_ml, 6.144, "sampled volume");
        near(list[0].mean, 30.0, "mean through centres");
        near(list[1].volume_ml, 0.012, "volume of a cochlea");
        near(list[1].mean, 32.0, "mean of a cochlea");
        // The dose ends at 22 mm along x and y: a quarter of the square, half of it along each.
        near(list[2].outside_ml, 0.75 * 9.6, "outside");
        near(list[3].outside_ml, list[3].volume_ml, "all outside");
        assert!(list[3].mean.is_nan() && list[3].d95.is_nan() && list[4].mean.is_nan());
        let found: Vec<(String, String)> = doubts(&list).into_iter().map(|w| (w.code, w.message)).collect();
        assert_eq!(found.len(), 3, "{found:?}");
        for ((code, message), (expected, word)) in found.iter().zip([
            ("structure-outside-dose", "\"half\""),
            ("structure-outside-dose", "wholly outside"),
            ("structure-empty", "\"nothing\""),
        ]) {
            assert!(code == expected && message.contains(word), "{found:?}");
        }
    }

    #[test]
    fn coarse_labels_are_sampled_inside_their_voxels() {
        let grid = Grid::axis_aligned([2, 2, 2], [8.0; 3], [-4.0; 3]).unwrap();
        let map = LabelMap { volume: Volume::filled(grid, 1), names: [(1, "box".to_owned())].into() };
        let d = dvh(&wedge(), &map, &[], 0.1).remove(0);
        assert!((d.volume_ml - 4.096).abs() < 1e-9 && (d.mean - 30.0).abs() < 1e-4, "{d:?}");
        assert!((d.max - 36.0).abs() < 1e-4, "the outer parts lie at 6 mm: {}", d.max);
    }

    #[test]
    fn the_hottest_of_a_volume_are_counted_in_millilitres() {
        // One voxel has 0.006 ml: five of them are 0.03 ml.
        let grid = Grid::axis_aligned([100, 1, 1], [1.0, 2.0, 3.0], [0.0; 3]).unwrap();
        let dose = Volume::from_fn(grid.clone(), |l| l as f32);
        let map = LabelMap { volume: Volume::filled(grid, 1), names: [(1, "row".to_owned())].into() };
        close(dvh(&dose, &map, &[], 1.0).remove(0).d003cc, 95.0, "D0.03cc");
    }

    #[test]
    fn weights_that_single_precision_rounds_still_end_at_a_sample() {
        for (weight, count) in (1..200).map(|n| (n as f32 / 1000.0, 20)).chain([(0.1, 100), (0.7, 100)]) {
            let samples = (0..count).map(|n| DoseSample { gy: n as f32, weight }).collect();
            let sampled = Sampled { name: "part".into(), samples, unit_ml: 1.0, own_ml: 1.0, outside: 0.0 };
            let d = of(sampled, &[], 1.0);
            close(d.d95, f64::from(count) * 0.05, "D95");
            close(d.d50, f64::from(count) * 0.5, "D50");
        }
    }

    #[test]
    fn no_sample_has_more_dose_than_the_voxels_around_it() {
        let grid = Grid::axis_aligned([20; 3], [4.0; 3], [0.0; 3]).unwrap();
        let dose = Volume::from_fn(grid.clone(), |l| if grid.voxel(l)[0] < 10 { 20.0 } else { 60.0f32 });
        let fine = Grid::axis_aligned([40, 4, 4], [1.0; 3], [20.0, 30.0, 30.0]).unwrap();
        let map = LabelMap { volume: Volume::filled(fine, 1), names: [(1, "edge".to_owned())].into() };
        let d = dvh(&dose, &map, &[], 1.0).remove(0);
        assert_eq!((d.min, d.max), (20.0, 60.0));
    }
}
