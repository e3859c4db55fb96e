//! Where tissue slides the field jumps: each voxel takes the motion of the elements on its own side of the surface
//! (docs/decisions/contact.md).

use super::lattice::{Slip, Tissue};
use crate::field::PushField;
use crate::volume::{Volume, axis_pairs};
use nalgebra::Vector3;
use rayon::prelude::*;

/// Less than this share of a voxel's elements on its own side say nothing of it.
const LEAST: f64 = 1e-3;

/// Gives soft voxels between elements on both sides of a sliding surface the motion of their own side; `coarse` are the elements'
/// displacements, whose grid shares its axes with the field's.
pub(super) fn take_sides(tissue: &Tissue<'_>, slip: &Slip, coarse: &Volume<[f32; 3]>, push: &mut PushField) {
    let Some(sliding) = tissue.sliding else { return };
    let grid = push.displacement.grid().clone();
    let [nx, ny, _] = grid.size();
    let axes = axis_pairs(coarse.grid(), &grid);
    let elements = coarse.grid().size()[0];
    push.displacement.data_mut().par_chunks_mut(nx).enumerate().for_each(|(line, out)| {
        let ((j0, j1, tj), (k0, k1, tk)) = (axes[1][line % ny], axes[2][line / ny]);
        let rows = [
            (j0, k0, (1.0 - tj) * (1.0 - tk)),
            (j1, k0, tj * (1.0 - tk)),
            (j0, k1, (1.0 - tj) * tk),
            (j1, k1, tj * tk),
        ];
        let rows = rows.map(|(j, k, weight)| (coarse.grid().linear([0, j, k]), weight));
        let inside = |e: usize| rows.iter().filter(|(row, _)| slip.inside[row + e]).count();
        // How many of the four elements beside each along the row lie inside.
        let count: Vec<usize> = (0..elements).map(inside).collect();
        for (i, out) in out.iter_mut().enumerate() {
            let (low, high, t) = axes[0][i];
            let voxel = line * nx + i;
            if matches!(count[low] + count[high], 0 | 8) || tissue.bone(voxel).is_some() || !tissue.active(voxel) {
                continue;
            }
            let (mut sum, mut weights) = (Vector3::zeros(), 0.0);
            for (e, along) in [(low, 1.0 - t), (high, t)] {
                for (row, across) in rows {
                    if slip.inside[row + e] == sliding.region.data()[voxel] {
                        sum += Vector3::from(coarse.data()[row + e].map(f64::from)) * (along * across);
                        weights += along * across;
                    }
                }
            }
            if weights > LEAST {
                let u = sum / weights;
                *out = [u.x as f32, u.y as f32, u.z as f32];
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::super::lattice::{Lattice, Material, Organs, SlidingRegion};
    use super::*;
    use crate::geometry::Grid;
    use crate::volume::{LabelMap, Mask};
    use std::collections::BTreeMap;

    #[test]
    fn each_voxel_takes_the_motion_of_its_own_side() {
        let grid = Grid::axis_aligned([24, 20, 26], [1.5, 2.0, 1.5], [0.0; 3]).unwrap();
        let ct = Volume::filled(grid.clone(), 20.0f32);
        let body = Mask::filled(grid.clone(), true);
        let labels = LabelMap { volume: Volume::filled(grid.clone(), 0), names: BTreeMap::new() };
        // A slanted surface: what lies above it moves by 9 mm along x.
        let inside = |l: usize| grid.centre(grid.voxel(l)).coords.dot(&Vector3::new(0.3, 0.2, 1.0)) > 30.0;
        let region = Volume::from_fn(grid.clone(), inside);
        let tissue = Tissue {
            ct: &ct,
            body: &body,
            labels: &labels,
            bone_of_label: &[None; 1],
            lung: None,
            sliding: Some(SlidingRegion { region: &region, along: 0.003, jumps: true }),
            least_hu: -500.0,
        };
        let lattice = Lattice::new(&tissue, &Material::default(), &Organs::default(), 4.5);
        let slip = lattice.slip.as_ref().unwrap();
        let of_side = |inside: bool| [if inside { 9.0f32 } else { 0.0 }, 1.0, 0.0];
        let coarse = Volume::from_fn(lattice.grid.clone(), |n| of_side(slip.inside[n]));
        let mut push =
            PushField { displacement: Volume::filled(grid.clone(), [4.0, 1.0, 0.0]), computed: body.clone() };
        take_sides(&tissue, slip, &coarse, &mut push);
        // Voxels among elements of one side alone are left to who was there before.
        let beside = |l: &usize| (push.displacement.data()[*l][0] - 4.0).abs() > 1e-3;
        let taken: Vec<usize> = (0..grid.len()).filter(beside).collect();
        assert!(taken.len() > 2000, "{}", taken.len());
        let wrong = taken.iter().filter(|l| {
            let (u, own) = (push.displacement.data()[**l], of_side(region.data()[**l]));
            (0..3).any(|a| (u[a] - own[a]).abs() > 1e-5)
        });
        assert_eq!(wrong.count(), 0);
        assert!([true, false].iter().all(|side| taken.iter().any(|l| region.data()[*l] == *side)));
    }
}
