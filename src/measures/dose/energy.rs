//! Energy/mass-congruent mapping: energy and mass travel together, dose is their ratio where they arrive.
//!
//! Zhong and Siebers, "Monte Carlo dose mapping on deforming anatomy", Phys. Med. Biol. 54 (2009) 5815; Siebers and Zhong,
//! Med. Phys. 35 (2008) 4364. Each voxel is cut into equal parts; a part carries its energy (dose times mass) and its mass to
//! where the field takes it and lays them down in a box of the size that the field gives it, shared among the voxels that
//! the box overlaps. The box has the part's centre and, along each axis, its variance, so that linear dose is kept under any
//! affine map. Nothing is lost: what falls outside the target grid is counted.

use super::DensityTable;
use super::interpolate::{displacement, snapped};
use crate::error::{Error, Result};
use crate::geometry::Grid;
use crate::volume::{Volume, trilinear};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How finely to map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EnergyMassOptions {
    /// Parts of a voxel along each axis, 1 to 8.
    pub parts: usize,
    /// Mass density by CT number.
    pub density: DensityTable,
}

impl Default for EnergyMassOptions {
    fn default() -> Self {
        Self { parts: 2, density: DensityTable::default() }
    }
}

/// What went in and what came out.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct EnergyBalance {
    /// Energy of the source dose, joule.
    pub source_j: f64,
    /// Energy of the mapped dose: its values, as stored, times the mapped mass, joule.
    pub mapped_j: f64,
    /// Energy that falls outside the target grid, joule.
    pub outside_j: f64,
    /// |source - mapped - outside| / source.
    pub relative_error: f64,
    /// Mass in the source grid, g.
    pub source_g: f64,
    /// Mass mapped into the target grid, g.
    pub mapped_g: f64,
}

/// The source planes are worked on in this many parts, added in order: results do not depend on threads.
const CHUNKS: usize = 4;

/// Maps `dose` by `field`, which leads from the dose's frame to that of `to`.
///
/// `ct` gives HU in the dose's frame, on any grid; beyond it there is air. Voxels that receive no mass have no dose.
///
/// # Errors
/// [`Error::Input`] when the number of parts is out of range.
pub fn energy_mass(
    dose: &Volume<f32>,
    ct: &Volume<f32>,
    field: &Volume<[f32; 3]>,
    to: &Grid,
    options: &EnergyMassOptions,
) -> Result<(Volume<f32>, EnergyBalance)> {
    if !(1..=8).contains(&options.parts) {
        let problem = format!("parts = {}", options.parts);
        return Err(Error::input("energy/mass mapping", problem, "give 1 to 8 parts of a voxel along each axis"));
    }
    let planes = dose.grid().size()[2];
    let chunks: Vec<EnergyTally> = (0..CHUNKS)
        .into_par_iter()
        .map(|c| {
            let mut tally = EnergyTally::new(to);
            for k in planes * c / CHUNKS..planes * (c + 1) / CHUNKS {
                tally.plane(k, dose, ct, field, options);
            }
            tally
        })
        .collect();
    let mut balance = EnergyBalance::default();
    let mut sums = vec![[0f64; 2]; to.len()];
    for tally in &chunks {
        balance.source_j += tally.source[0];
        balance.source_g += tally.source[1];
        balance.outside_j += tally.outside[0];
        sums.par_iter_mut().zip(&tally.cells).for_each(|(s, c)| *s = [s[0] + c[0], s[1] + c[1]]);
    }
    let mapped: Vec<f32> =
        sums.par_iter().map(|[energy, mass]| if *mass > 0.0 { (energy / mass) as f32 } else { 0.0 }).collect();
    // Dose times mass is Gy g: a thousandth of a joule.
    let kilo = 1e-3;
    balance.mapped_j = mapped.iter().zip(&sums).map(|(d, s)| f64::from(*d) * s[1]).sum::<f64>() * kilo;
    balance.mapped_g = sums.iter().map(|s| s[1]).sum();
    balance.source_j *= kilo;
    balance.outside_j *= kilo;
    let off = (balance.source_j - balance.mapped_j - balance.outside_j).abs();
    balance.relative_error = if balance.source_j > 0.0 { off / balance.source_j } else { off };
    Ok((Volume::new(to.clone(), mapped)?, balance))
}

/// Energy (Gy g) and mass (g) of each target voxel from a part of the source.
struct EnergyTally<'a> {
    to: &'a Grid,
    cells: Vec<[f64; 2]>,
    source: [f64; 2],
    outside: [f64; 2],
}

impl<'a> EnergyTally<'a> {
    fn new(to: &'a Grid) -> Self {
        Self { to, cells: vec![[0.0; 2]; to.len()], source: [0.0; 2], outside: [0.0; 2] }
    }

    /// Carries one plane of source voxels.
    fn plane(
        &mut self,
        k: usize,
        dose: &Volume<f32>,
        ct: &Volume<f32>,
        field: &Volume<[f32; 3]>,
        options: &EnergyMassOptions,
    ) {
        let grid = dose.grid();
        let [ni, nj, _] = grid.size();
        let parts = options.parts;
        let part_cm3 = grid.voxel_volume() / 1000.0 / parts.pow(3) as f64;
        let last = Vector3::from(grid.size().map(|n| (n - 1) as f64));
        let offset = |m: usize| (m as f64 + 0.5) / parts as f64 - 0.5;
        for l in 0..ni * nj {
            let voxel = Vector3::new((l % ni) as f64, (l / ni) as f64, k as f64);
            let width = self.width(&voxel, grid, field) / parts as f64;
            for part in 0..parts.pow(3) {
                let index = voxel
                    + Vector3::new(offset(part % parts), offset(part / parts % parts), offset(part / (parts * parts)));
                let x = grid.world(&index);
                let inside = index.zip_map(&last, |i, last| i.clamp(0.0, last));
                let gy = trilinear(dose, &inside).unwrap_or(0.0);
                let hu = trilinear(ct, &snapped(ct.grid(), &x)).unwrap_or(-1000.0);
                let mass = options.density.density(hu) * part_cm3;
                self.source = [self.source[0] + gy * mass, self.source[1] + mass];
                let centre = self.to.index(&(x + displacement(field, &x)));
                self.lay(&centre, &width, [gy * mass, mass]);
            }
        }
    }

    /// Width along each target axis, voxels, of the box that stands for a mapped source voxel.
    fn width(&self, voxel: &Vector3<f64>, grid: &Grid, field: &Volume<[f32; 3]>) -> Vector3<f64> {
        let edge = |a: usize| {
            let mut half = Vector3::zeros();
            half[a] = 0.5;
            let [low, high] = [voxel - half, voxel + half].map(|i| grid.world(&i));
            high - low + displacement(field, &high) - displacement(field, &low)
        };
        let edges = self.to.inverse_step() * Matrix3::from_columns(&[edge(0), edge(1), edge(2)]);
        Vector3::new(edges.row(0).norm(), edges.row(1).norm(), edges.row(2).norm())
    }

    /// EnergyShares energy and mass among the voxels that a box overlaps.
    fn lay(&mut self, centre: &Vector3<f64>, width: &Vector3<f64>, what: [f64; 2]) {
        let size = self.to.size();
        let shares: [EnergyShares; 3] = std::array::from_fn(|a| EnergyShares::new(centre[a], width[a].max(1e-9)));
        for (k, wk) in shares[2].each() {
            for (j, wj) in shares[1].each() {
                for (i, wi) in shares[0].each() {
                    let [energy, mass] = what.map(|v| v * wi * wj * wk);
                    let at = [i, j, k];
                    let inside = (0..3).all(|a| at[a] >= 0 && at[a] < size[a] as i64);
                    let sum = if inside {
                        &mut self.cells[self.to.linear(at.map(|c| c as usize))]
                    } else {
                        &mut self.outside
                    };
                    *sum = [sum[0] + energy, sum[1] + mass];
                }
            }
        }
    }
}

/// Voxels along one axis that an interval overlaps, with their shares of it.
struct EnergyShares {
    low: f64,
    high: f64,
}

impl EnergyShares {
    /// Voxel `i` reaches from `i - 1/2` to `i + 1/2`.
    fn new(centre: f64, width: f64) -> Self {
        Self { low: centre - width / 2.0 + 0.5, high: centre + width / 2.0 + 0.5 }
    }

    fn each(&self) -> impl Iterator<Item = (i64, f64)> + use<> {
        let (low, high) = (self.low, self.high);
        let share = move |i: i64| (high.min(i as f64 + 1.0) - low.max(i as f64)).max(0.0) / (high - low);
        (low.floor() as i64..=high.floor() as i64).map(move |i| (i, share(i)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::interpolate;
    use super::*;
    use nalgebra::{Point3, Rotation3};
    use proptest::prelude::*;

    fn water(grid: &Grid) -> Volume<f32> {
        Volume::filled(grid.clone(), 0.0)
    }

    fn field(grid: &Grid, map: impl Fn(Point3<f64>) -> Point3<f64> + Sync) -> Volume<[f32; 3]> {
        Volume::from_fn(grid.clone(), |l| {
            let x = grid.centre(grid.voxel(l));
            (map(x) - x).map(|c| c as f32).into()
        })
    }

    #[test]
    fn linear_dose_under_an_affine_map_is_exact() {
        let grid = Grid::axis_aligned([40, 40, 24], [2.0, 2.0, 3.0], [-40.0, -40.0, -36.0]).unwrap();
        let dose = |x: &Point3<f64>| 40.0 + 0.3 * x.x - 0.2 * x.y + 0.1 * x.z;
        let planned = Volume::from_fn(grid.clone(), |l| dose(&grid.centre(grid.voxel(l))) as f32);
        let turn = Rotation3::from_euler_angles(0.1, -0.2, 0.3);
        let affine = turn.matrix() * Matrix3::from_diagonal(&Vector3::new(0.8, 1.2, 0.9));
        let back = affine.try_inverse().unwrap();
        let push = field(&grid, |x| Point3::from(affine * x.coords));
        let (mapped, balance) =
            energy_mass(&planned, &water(&grid), &push, &grid, &EnergyMassOptions::default()).unwrap();
        assert!(balance.relative_error < 1e-6, "{balance:?}");
        let pull = field(&grid, |y| Point3::from(back * y.coords));
        let plain = interpolate(&planned, &pull, &grid).unwrap();
        let (mut sum, mut sum_plain, mut n) = (0.0, 0.0, 0.0);
        for l in 0..grid.len() {
            let y = grid.centre(grid.voxel(l));
            let x = Point3::from(back * y.coords);
            // Inside, where no box comes from beyond the edge.
            if y.coords.norm() < 22.0 {
                let exact = dose(&x);
                sum += (f64::from(mapped.data()[l]) / exact - 1.0).abs();
                sum_plain += (f64::from(plain.data()[l]) / exact - 1.0).abs();
                n += 1.0;
            }
        }
        println!("mean relative error: energy/mass {:.2e}, interpolation {:.2e}", sum / n, sum_plain / n);
        assert!(n > 1000.0 && sum / n < 1e-3 && sum_plain / n < 1e-3, "{} {}", sum / n, sum_plain / n);
    }

    #[test]
    fn an_even_dose_stays_even_up_to_the_border() {
        let grid = Grid::axis_aligned([6, 5, 4], [2.0, 2.5, 3.0], [0.0; 3]).unwrap();
        let planned = Volume::filled(grid.clone(), 20.0);
        let rest = field(&grid, |x| x);
        let (mapped, balance) = energy_mass(&planned, &water(&grid), &rest, &grid, &Default::default()).unwrap();
        assert!(mapped.data().iter().all(|d| (d - 20.0).abs() < 1e-4), "{:?}", mapped.extremes());
        let grams = DensityTable::default().density(0.0) * grid.len() as f64 * 0.015;
        assert!((balance.source_g - grams).abs() < 1e-9 && balance.outside_j.abs() < 1e-9, "{balance:?} {grams}");
    }

    /// The CT reaches over the lower half of the dose: what lies beyond has the mass of air.
    #[test]
    fn beyond_the_ct_there_is_air() {
        let grid = Grid::axis_aligned([6, 5, 8], [2.0; 3], [0.0; 3]).unwrap();
        let half = Grid::axis_aligned([6, 5, 4], [2.0; 3], [0.0; 3]).unwrap();
        let planned = Volume::filled(grid.clone(), 20.0);
        let (_, balance) =
            energy_mass(&planned, &water(&half), &field(&grid, |x| x), &grid, &Default::default()).unwrap();
        let [air, wet] = [-1000.0, 0.0].map(|hu| DensityTable::default().density(hu) * half.len() as f64 * 0.008);
        assert!((balance.source_g - air - wet).abs() < 1e-9, "{balance:?}: {air} and {wet} g");
        assert!((balance.source_j - 20e-3 * (air + wet)).abs() < 1e-9, "{balance:?}");
    }

    #[test]
    fn the_parts_of_a_voxel_fill_it() {
        // A dose that only combinations of the three axes tell, moved by half a voxel along each: parts that lie on a
        // diagonal of the voxel would give the mean of their own places.
        let grid = Grid::axis_aligned([9, 9, 9], [1.0; 3], [0.0; 3]).unwrap();
        let dose = |x: &Point3<f64>| 100.0 + x.x * x.y + 2.0 * x.y * x.z + 3.0 * x.z * x.x;
        let planned = Volume::from_fn(grid.clone(), |l| dose(&grid.centre(grid.voxel(l))) as f32);
        let half = Vector3::repeat(0.5);
        let push = field(&grid, |x| x + half);
        let (mapped, _) = energy_mass(&planned, &water(&grid), &push, &grid, &Default::default()).unwrap();
        for at in [[4, 4, 4], [3, 5, 2], [6, 2, 5]] {
            let exact = dose(&(grid.centre(at) - half));
            assert!((f64::from(*mapped.at(at)) - exact).abs() < 1e-3, "{at:?}: {} {exact}", mapped.at(at));
        }
    }

    #[test]
    fn where_voxels_merge_energy_is_right_and_interpolation_is_not() {
        // Tissue is compressed to a quarter along x; dose and density change from voxel to voxel: the dose of a target
        // voxel is the mean over 4 source voxels weighted by mass, which a value at its middle misses.
        let grid = Grid::axis_aligned([128, 8, 8], [1.0; 3], [0.0; 3]).unwrap();
        let small = Grid::axis_aligned([32, 8, 8], [1.0; 3], [0.0; 3]).unwrap();
        let at = |l: usize| grid.voxel(l)[0];
        let planned = Volume::from_fn(grid.clone(), |l| 30.0 + 30.0 * ((at(l) as f32) / 3.0).sin());
        let ct = Volume::from_fn(grid.clone(), |l| if at(l) % 4 < 2 { -700.0 } else { 300.0f32 });
        // Voxel edges fall on voxel edges: x = -1/2 stays, 4 voxels become one.
        let to = |x: f64| (x + 0.5) / 4.0 - 0.5;
        let push = field(&grid, |x| Point3::new(to(x.x), x.y, x.z));
        let density = DensityTable::new(vec![[-1000.0, 0.001], [1000.0, 2.0]]).unwrap();
        let options = EnergyMassOptions { parts: 8, density };
        let (mapped, balance) = energy_mass(&planned, &ct, &push, &small, &options).unwrap();
        assert!(balance.relative_error < 1e-6, "{balance:?}");
        assert!((balance.mapped_g / balance.source_g - 1.0).abs() < 0.02);
        let pull = field(&small, |y| Point3::new((y.x + 0.5) * 4.0 - 0.5, y.y, y.z));
        let plain = interpolate(&planned, &pull, &small).unwrap();
        // The exact answer: energy over mass by fine integration of the same trilinear images.
        let line = |v: &Volume<f32>, x: f64| trilinear(v, &Vector3::new(x.clamp(0.0, 127.0), 3.0, 3.0)).unwrap();
        let exact = |i: usize| {
            let (mut energy, mut mass) = (0.0, 0.0);
            for n in 0..4000 {
                let x = 4.0 * i as f64 - 0.5 + 4.0 * (f64::from(n) + 0.5) / 4000.0;
                let m = options.density.density(line(&ct, x));
                mass += m;
                energy += m * line(&planned, x);
            }
            energy / mass
        };
        let (mut off, mut off_plain, mut mean) = (0.0, 0.0, 0.0);
        for i in 1..31 {
            let e = exact(i);
            mean += e;
            off += (f64::from(*mapped.at([i, 3, 3])) - e).abs();
            off_plain += (f64::from(*plain.at([i, 3, 3])) - e).abs();
        }
        println!(
            "mean dose error: energy/mass {:.4} %, interpolation {:.2} %",
            100.0 * off / mean,
            100.0 * off_plain / mean
        );
        assert!(off / mean < 1e-3 && off_plain / mean > 0.02, "{} {}", off / mean, off_plain / mean);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn energy_is_conserved_by_any_field(noise in prop::collection::vec(-4.0f32..4.0, 9 * 8 * 7 * 3), parts in 1usize..4) {
            let grid = Grid::axis_aligned([9, 8, 7], [2.0, 1.5, 3.0], [0.0; 3]).unwrap();
            let push = Volume::from_fn(grid.clone(), |l| [noise[3 * l], noise[3 * l + 1], noise[3 * l + 2]]);
            let dose = Volume::from_fn(grid.clone(), |l| (l % 61) as f32);
            let ct = Volume::from_fn(grid.clone(), |l| (l * 37 % 1800) as f32 - 1000.0);
            let to = Grid::axis_aligned([10, 10, 10], [1.7; 3], [-1.0; 3]).unwrap();
            let options = EnergyMassOptions { parts, ..EnergyMassOptions::default() };
            let (mapped, balance) = energy_mass(&dose, &ct, &push, &to, &options).unwrap();
            prop_assert!(balance.relative_error < 1e-6, "{:?}", balance);
            prop_assert!(balance.outside_j > 0.0);
            prop_assert!(mapped.data().iter().all(|d| (0.0..=60.0 + 1e-4).contains(d)));
        }
    }

    #[test]
    fn the_same_bits_at_any_number_of_threads() {
        let grid = Grid::axis_aligned([16, 14, 12], [2.0; 3], [0.0; 3]).unwrap();
        let push = field(&grid, |x| x + Vector3::new(3.0 * (x.y / 7.0).sin(), 1.0, 0.3 * x.x.cos()));
        let dose = Volume::from_fn(grid.clone(), |l| (l % 61) as f32);
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| energy_mass(&dose, &water(&grid), &push, &grid, &EnergyMassOptions::default()).unwrap())
        };
        assert_eq!(with(1), with(3));
    }
}
