//! Planning as the fraction's modality shows it: each range of HU gets the grey value that the fraction shows of it nearby.
//!
//! Where the bones' motion alone brings the two scans together, least squares over neighbourhoods wider than soft tissue is off
//! tell these grey values. What is made so is compared with the fraction as a CT would be (docs/decisions/mr.md).

use super::Scan;
use crate::volume::ranges::{FAT_HU, RANGES, memberships};
use crate::volume::{Volume, gaussian, trilinear, trilinear_vector};
use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;

/// Width (sigma) of the neighbourhoods, mm: wider than soft tissue is off before images pull it.
const WIDE_MM: f64 = 25.0;
/// Spacing of the grey values, and of the voxels that they are found from, mm.
const SPACING_MM: f64 = 10.0;
const STEP_MM: f64 = 3.0;
/// What holds a neighbourhood's grey values to those of the whole, as a share of its voxels; and the whole's to none.
const SHARED: f64 = 0.05;
const RIDGE: f64 = 1e-4;
/// Where fewer voxels are near than this part of one, the whole's grey values hold.
const FEWEST: f64 = 1e-3;
/// Tissue of either scan is denser or brighter, HU.
const TISSUE_HU: f32 = -500.0;
/// Air, HU.
const AIR_HU: f32 = -1000.0;

const PAIRS: usize = RANGES * (RANGES + 1) / 2;
/// Products of memberships, of memberships and grey values, and the number of voxels.
const SUMS: usize = PAIRS + RANGES + 1;

type Weights = SVector<f64, RANGES>;
type System = SMatrix<f64, RANGES, RANGES>;

/// Adds a voxel.
fn add(sums: &mut [f32; SUMS], m: &[f32; RANGES], grey: f32) {
    let pairs = (0..RANGES).flat_map(|a| (a..RANGES).map(move |b| (a, b)));
    for (n, (a, b)) in pairs.enumerate() {
        sums[n] += m[a] * m[b];
    }
    for (a, m) in m.iter().enumerate() {
        sums[PAIRS + a] += m * grey;
    }
    sums[PAIRS + RANGES] += 1.0;
}

/// The grey values that sums ask for, held to others by `hold` voxels.
fn solved(sums: &[f64; SUMS], held_to: &Weights, hold: f64) -> Weights {
    let mut own = System::identity() * hold;
    let pairs = (0..RANGES).flat_map(|a| (a..RANGES).map(move |b| (a, b)));
    for (n, (a, b)) in pairs.enumerate() {
        own[(a, b)] += sums[n];
        if a != b {
            own[(b, a)] += sums[n];
        }
    }
    let both = Weights::from_fn(|a, _| sums[PAIRS + a]) + held_to * hold;
    own.cholesky().map_or(*held_to, |own| own.solve(&both))
}

/// Planning (HU) as the fraction shows it, by a displacement from planning to fraction (mm, on any grid). `darkest` is the grey
/// value of air inside of the patient in the fraction; outside of him its values are a CT's air.
pub fn translated(planning: Scan<'_>, fraction: &Volume<f32>, darkest: f32, moved: &Volume<[f32; 3]>) -> Volume<f32> {
    let grid = planning.ct.grid();
    let (coarse, nodes) = (grid.coarsened(STEP_MM), grid.coarsened(SPACING_MM));
    let voxel = |n: usize| {
        let l = grid.linear(grid.voxel_at(&coarse.centre(coarse.voxel(n)))?);
        let (hu, x) = (planning.ct.data()[l], grid.centre(grid.voxel(l)));
        if !planning.body.data()[l] || hu < TISSUE_HU {
            return None;
        }
        let place = x + trilinear_vector(moved, &moved.grid().index(&x))?;
        let grey = trilinear(fraction, &fraction.grid().index(&place))? as f32;
        let node = nodes.linear(nodes.voxel_at(&x)?);
        // What is no number is not above either.
        (grey > TISSUE_HU).then(|| (node, memberships(hu), grey - darkest))
    };
    let voxels: Vec<_> = (0..coarse.len()).into_par_iter().filter_map(voxel).collect();
    let mut sums = vec![[0f32; SUMS]; nodes.len()];
    voxels.iter().for_each(|(node, m, grey)| add(&mut sums[*node], m, *grey));
    let all: [f64; SUMS] = std::array::from_fn(|q| sums.iter().map(|s| f64::from(s[q])).sum());
    let whole = solved(&all, &Weights::zeros(), RIDGE * all[PAIRS + RANGES] + f64::MIN_POSITIVE);
    let spread = |q| gaussian(&Volume::from_fn(nodes.clone(), |n| sums[n][q]), WIDE_MM);
    let spread: Vec<Volume<f32>> = (0..SUMS).into_par_iter().map(spread).collect();
    let local = |n: usize| {
        let here: [f64; SUMS] = std::array::from_fn(|q| f64::from(spread[q].data()[n]));
        solved(&here, &whole, SHARED * here[PAIRS + RANGES] + FEWEST)
    };
    let local: Vec<Weights> = (0..nodes.len()).into_par_iter().map(local).collect();
    let greys: Vec<Volume<f32>> = (0..RANGES).map(|k| Volume::from_fn(nodes.clone(), |n| local[n][k] as f32)).collect();
    let value = |l: usize| {
        let hu = planning.ct.data()[l];
        let index = nodes.index_within(&grid.centre(grid.voxel(l)));
        let shares = memberships(hu).into_iter().zip(&greys).filter(|(m, _)| *m > 0.0);
        let grey: f64 = shares.map(|(m, grey)| f64::from(m) * trilinear(grey, &index).unwrap_or(0.0)).sum();
        let solid = ((hu - AIR_HU) / (FAT_HU - AIR_HU)).clamp(0.0, 1.0);
        darkest + solid * grey.max(0.0) as f32
    };
    Volume::from_fn(grid.clone(), value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn tissue_gets_the_grey_value_that_the_fraction_shows_of_it_nearby() {
        // Fat, muscle and bone in turn, and an airway; the fraction lies 6 mm aside and grows brighter along x.
        let grid = Grid::axis_aligned([60, 40, 40], [3.0; 3], [0.0; 3]).unwrap();
        let hu = |[i, j, k]: [usize; 3]| match (i / 3 + j / 3 + k / 3) % 4 {
            _ if (28..31).contains(&i) => -1000.0,
            0 => -110.0,
            1 | 2 => 60.0,
            _ => 1100.0,
        };
        let shown = |hu: f32, x: f64| match hu {
            hu if hu < -500.0 => -150.0,
            hu if hu < 0.0 => -150.0 + 300.0 * (1.0 + x as f32 / 360.0),
            hu if hu < 500.0 => -150.0 + 120.0 * (1.0 + x as f32 / 360.0),
            _ => -140.0,
        };
        let planning = Volume::from_fn(grid.clone(), |l| hu(grid.voxel(l)));
        let shift = [6.0, 0.0, 0.0];
        let there = Grid::axis_aligned([60, 40, 40], [3.0; 3], shift).unwrap();
        let fraction = Volume::from_fn(there, |l| shown(hu(grid.voxel(l)), 3.0 * grid.voxel(l)[0] as f64));
        let moved = Volume::filled(grid.coarsened(9.0), shift.map(|c| c as f32));
        let body = Volume::filled(grid.clone(), true);
        let found = translated(Scan { ct: &planning, body: &body }, &fraction, -150.0, &moved);
        let inner = |l: &usize| grid.voxel(*l).iter().zip(grid.size()).all(|(&c, n)| c > 3 && c + 4 < n);
        for l in (0..grid.len()).filter(inner) {
            let expected = shown(planning.data()[l], 3.0 * grid.voxel(l)[0] as f64);
            assert!((found.data()[l] - expected).abs() < 25.0, "{:?}: {} {expected}", grid.voxel(l), found.data()[l]);
        }
    }
}
