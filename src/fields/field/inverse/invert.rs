//! Push to pull: for every fraction voxel y the v with v + u(y + v) = 0.
//!
//! Where tissue comes to lie, the deformed mesh of the planning voxels gives the pre-image of its piecewise linear map,
//! however large the motion, and a mesh as coarse as the chain mail comes close enough to it; elsewhere a scattered guess
//! does. From there Newton's method converges in two steps (`newton`). Where it does not, near folds and bones that slide, the
//! fixed point v <- -u(y + v) (Chen et al. 2008) takes over, with shortened Newton steps where it stalls.

use super::super::PullField;
use super::super::PushField;
use super::super::mesh::tetrahedra::{Drop, FieldMesh};
use super::bones::MovedBones;
use super::newton::thinned;
use super::pre_image::{Continued, InvertOptions, Solved, solve};
use super::reach::Reach;
use super::search::{FoundPlace, Painted, Search, SearchTally};
use crate::error::Result;
use crate::geometry::Grid;
use crate::stats::Summary;
use crate::volume::Volume;
use crate::volume::interpolation::lanes::Sampler;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How well the pull field inverts the push field.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct InverseReport {
    /// |v + u(y + v)| over converged fraction voxels whose pre-image the model computed (patient tissue), mm.
    pub residual_mm: Summary,
    /// Voxels in all whose iteration did not reach the tolerance.
    pub unconverged: usize,
    /// Of those, voxels whose last pre-image is patient tissue.
    pub unconverged_tissue: usize,
    /// Of those, voxels that the nearest answer misses by more than a voxel: the pull field leads out of the planning scan there.
    pub strayed: usize,
    /// Largest residual of an unconverged voxel, mm.
    pub unconverged_max_mm: f64,
    /// Voxels with more than one pre-image (where the push field folds).
    pub multiple: usize,
    /// Voxels whose pre-image lies outside the planning scan.
    pub outside: usize,
    /// Fraction voxels in all.
    pub voxels: usize,
}

impl InverseReport {
    /// Fraction voxels that show patient tissue, whether their pre-image is exact or not.
    pub fn tissue(&self) -> usize {
        self.residual_mm.n + self.unconverged_tissue
    }
}

/// Spacing of the scattered guess, mm.
const GUESS_MM: f64 = 6.0;
/// Voxels of a guess over everything that a field reaches.
const MOST_GUESSES: f64 = 1e7;

/// Nearest-voxel scatter of -u on a coarse fraction grid, holes filled from their neighbours.
fn guess(field: &Volume<[f32; 3]>, fraction: &Grid) -> Result<Volume<[f32; 3]>> {
    let grid = fraction.coarsened(GUESS_MM);
    let size = grid.size();
    let from = field.grid();
    let stride: [usize; 3] = from.spacing().map(|s| ((GUESS_MM / s) as usize).max(1));
    let mut sums = vec![[0f64; 4]; grid.len()];
    for k in (0..from.size()[2]).step_by(stride[2]) {
        for j in (0..from.size()[1]).step_by(stride[1]) {
            for i in (0..from.size()[0]).step_by(stride[0]) {
                let u = Vector3::from(field.at([i, j, k]).map(f64::from));
                if let Some(at) = grid.voxel_at(&(from.centre([i, j, k]) + u)) {
                    let s = &mut sums[grid.linear(at)];
                    s[0] += 1.0;
                    for a in 0..3 {
                        s[1 + a] -= u[a];
                    }
                }
            }
        }
    }
    let mut known: Vec<Option<[f32; 3]>> =
        sums.iter().map(|s| (s[0] > 0.0).then(|| [1, 2, 3].map(|a| (s[a] / s[0]) as f32))).collect();
    let mut layer: Vec<usize> = (0..known.len()).filter(|&n| known[n].is_some()).collect();
    let mut found = vec![([0f32; 3], 0f32); grid.len()];
    while !layer.is_empty() {
        let mut next = Vec::new();
        for &n in &layer {
            let Some(u) = known[n] else { continue };
            let at = grid.voxel(n);
            for a in 0..3 {
                for o in [-1isize, 1] {
                    let mut m = at;
                    let Some(c) = at[a].checked_add_signed(o).filter(|&c| c < size[a]) else { continue };
                    m[a] = c;
                    let m = grid.linear(m);
                    if known[m].is_none() {
                        let e = &mut found[m];
                        if e.1 <= 0.0 {
                            next.push(m);
                        }
                        e.0 = std::array::from_fn(|a| e.0[a] + u[a]);
                        e.1 += 1.0;
                    }
                }
            }
        }
        next.sort_unstable();
        for &n in &next {
            let (sum, count) = found[n];
            known[n] = Some(sum.map(|v| v / count));
        }
        layer = next;
    }
    Volume::new(grid, known.into_iter().map(Option::unwrap_or_default).collect())
}

/// The inverse of a field x -> x + u(x), one point at a time.
pub struct Inverse<'a> {
    field: Continued<'a>,
    guess: Volume<[f32; 3]>,
    options: InvertOptions,
}

impl<'a> Inverse<'a> {
    /// The inverse of `field` (LPS mm) wherever its grid is moved to. The field is continued by its edge values.
    ///
    /// # Errors
    /// Only for internal inconsistency of grids.
    pub fn new(field: &'a Volume<[f32; 3]>, options: &InvertOptions) -> Result<Self> {
        let grid = field.grid();
        let start = || [Vector3::repeat(f64::MAX), Vector3::repeat(f64::MIN)];
        let [nx, ny, _] = grid.size();
        let of_row = |(row, u): (usize, &[[f32; 3]])| {
            let first = grid.centre([0, row % ny, row / ny]).coords;
            let along: Vector3<f64> = grid.step().column(0).into_owned();
            u.iter().enumerate().fold(start(), |[low, high], (i, u)| {
                let moved = first + along * i as f64 + Vector3::from(u.map(f64::from));
                [low.inf(&moved), high.sup(&moved)]
            })
        };
        let rows = field.data().par_chunks(nx).enumerate().map(of_row);
        let [low, high] = rows.reduce(start, |a, b| [a[0].inf(&b[0]), a[1].sup(&b[1])]);
        // A field that throws voxels far away gets a coarser guess, not one without bounds.
        let step = GUESS_MM.max(((high - low).product() / MOST_GUESSES).cbrt());
        let size = std::array::from_fn(|a| ((high[a] - low[a]) / step).ceil() as usize + 1);
        let reach = Grid::axis_aligned(size, [step; 3], low.into())?;
        Ok(Self { field: Continued::new(field), guess: guess(field, &reach)?, options: options.clone() })
    }

    /// The pre-image of a point, LPS mm.
    pub fn at(&self, y: &Point3<f64>) -> Solved {
        let start = Continued::new(&self.guess).value(y);
        solve(&y.coords, start, &self.field, &self.options)
    }

    /// The grid of the field that is inverted.
    pub fn grid(&self) -> &Grid {
        self.field.grid()
    }
}

/// Planes of the fraction that are drawn and inverted together.
const SLAB: usize = 2;
/// Spacing of the mesh that gives the start, mm: that of the chain mail's elements, between which the field is smooth.
const START_MM: f64 = 4.5;

/// Inverts a push field on the fraction grid. Where the field does move given bones rigidly, their voxels are theirs, whatever
/// is folded over them. The report's `multiple` is left at 0: it needs the folded cells.
///
/// # Errors
/// Only for internal inconsistency of grids.
pub fn invert(
    push: &PushField,
    fraction: &Grid,
    bones: Option<&MovedBones<'_>>,
    options: &InvertOptions,
) -> Result<(PullField, InverseReport)> {
    let (guess, thin) = rayon::join(|| guess(&push.displacement, fraction), || thinned(push, START_MM));
    let (guess, thin) = (guess?, thin?);
    let search = Search {
        push,
        robust: Continued::new(&push.displacement),
        quick: Sampler::new(&push.displacement),
        reach: Reach::new(push),
        guess: Continued::new(&guess),
        mesh: FieldMesh::new(&thin, |v| thin.displacement.data()[v], true, fraction),
        bones,
        fraction,
        options,
    };
    let plane = fraction.size()[0] * fraction.size()[1];
    let mut v = vec![[0f32; 3]; fraction.len()];
    let mut inside = vec![false; fraction.len()];
    let tallies: Vec<SearchTally> = v
        .par_chunks_mut(SLAB * plane)
        .zip(inside.par_chunks_mut(SLAB * plane))
        .enumerate()
        .map_init(Default::default, |(drawn, owner): &mut (Vec<_>, Vec<_>), (slab, (v, inside))| {
            drawn.clear();
            drawn.resize(v.len(), Drop::default());
            search.mesh.draw_slab(slab * SLAB, drawn);
            owner.clear();
            owner.resize(v.len(), 0);
            if let Some(bones) = bones {
                bones.paint(slab * SLAB, owner);
            }
            search.slab(slab * SLAB, Painted { drawn, owner }, FoundPlace { v, inside })
        })
        .collect();
    let report = InverseReport {
        unconverged: tallies.iter().map(|t| t.unconverged).sum(),
        unconverged_tissue: tallies.iter().map(|t| t.tissue).sum(),
        strayed: tallies.iter().map(|t| t.strayed).sum(),
        unconverged_max_mm: tallies.iter().map(|t| t.worst).fold(0.0, f64::max),
        multiple: 0,
        outside: tallies.iter().map(|t| t.outside).sum(),
        voxels: fraction.len(),
        residual_mm: Summary::of_singles(&tallies.iter().map(|t| &t.residuals[..]).collect::<Vec<_>>()),
    };
    let pull =
        PullField { displacement: Volume::new(fraction.clone(), v)?, inside: Volume::new(fraction.clone(), inside)? };
    Ok((pull, report))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::Volume;
    use crate::volume::trilinear_vector;

    fn push(f: impl Fn(Vector3<f64>) -> Vector3<f64> + Sync) -> PushField {
        let grid = Grid::axis_aligned([40, 30, 20], [2.0, 2.0, 3.0], [-40.0, -30.0, -30.0]).unwrap();
        let displacement = Volume::from_fn(grid.clone(), |l| {
            let u = f(grid.centre(grid.voxel(l)).coords);
            [u.x as f32, u.y as f32, u.z as f32]
        });
        PushField { displacement, computed: Volume::filled(grid, true) }
    }

    #[test]
    fn what_lies_beyond_the_planning_scan_is_counted() {
        // The field moves a part of the scan only: most rows are left where they are without a search.
        let mut push = push(|x| Vector3::new(0.0, 0.0, if x.norm() < 10.0 { 1.0 } else { 0.0 }));
        let planning = push.displacement.grid().clone();
        push.computed = push.displacement.map(|u| u[2] > 0.0);
        let fraction = Grid::axis_aligned([60, 20, 30], [2.0, 2.0, 3.0], [-61.0, -21.0, -46.0]).unwrap();
        let (pull, report) = invert(&push, &fraction, None, &InvertOptions::default()).unwrap();
        let within = |n: usize| planning.contains(&planning.index(&fraction.centre(fraction.voxel(n))));
        let outside = (0..fraction.len()).filter(|n| !within(*n)).count();
        assert!(outside > 10_000 && outside < fraction.len() - 5000, "{outside}");
        assert_eq!(report.outside, outside);
        assert!((0..fraction.len()).all(|n| pull.inside.data()[n] == within(n)));
    }

    #[test]
    fn inverts_a_turn_and_a_shift_exactly() {
        let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), 0.4);
        let shift = Vector3::new(7.0, -3.0, 2.0);
        let push = push(|x| turn * x + shift - x);
        let fraction = Grid::axis_aligned([20, 20, 10], [2.5, 2.5, 3.0], [-18.0, -27.0, -12.0]).unwrap();
        let (pull, report) = invert(&push, &fraction, None, &InvertOptions::default()).unwrap();
        assert_eq!(report.unconverged, 0);
        for (n, v) in pull.displacement.data().iter().enumerate() {
            let y = fraction.centre(fraction.voxel(n)).coords;
            let truth = turn.inverse() * (y - shift) - y;
            if pull.inside.data()[n] {
                assert!((Vector3::from(v.map(f64::from)) - truth).norm() < 2e-3);
            }
        }
    }

    #[test]
    fn tissue_that_turns_by_half_a_circle_is_found() {
        // A rod turns by 170 degrees; around it the field fades to nothing and folds.
        let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), 170f64.to_radians());
        let rod = |x: &Vector3<f64>| x.y.abs() < 5.0 && x.x.abs() < 24.0;
        let mut push = push(|x| {
            let away = (x.y.abs() - 5.0).max(x.x.abs() - 24.0).max(0.0);
            (turn * x - x) * (1.0 - away / 8.0).max(0.0)
        });
        let grid = push.displacement.grid().clone();
        push.computed = Volume::from_fn(grid.clone(), |l| rod(&grid.centre(grid.voxel(l)).coords));
        let (pull, _) = invert(&push, &grid, None, &InvertOptions::default()).unwrap();
        let mut inside = 0;
        for (n, v) in pull.displacement.data().iter().enumerate() {
            let y = grid.centre(grid.voxel(n)).coords;
            let truth = turn.inverse() * y;
            if truth.y.abs() < 4.0 && truth.x.abs() < 22.0 && truth.z.abs() < 27.0 {
                inside += 1;
                assert!((y + Vector3::from(v.map(f64::from)) - truth).norm() < 2e-3, "{y:?}");
            }
        }
        assert!(inside > 500);
        // Nor is the rod seen where it does not come to lie, although the quick search ends in it here and there.
        for (n, v) in pull.displacement.data().iter().enumerate() {
            let y = grid.centre(grid.voxel(n)).coords;
            let truth = turn.inverse() * y;
            let far = (truth.y.abs() - 5.0).max(truth.x.abs() - 24.0) > 6.0;
            let shown = y + Vector3::from(v.map(f64::from));
            let deep = (5.0 - shown.y.abs()).min(24.0 - shown.x.abs()) > 3.0 && shown.z.abs() < 24.0;
            assert!(!(far && deep), "{y:?} shows {shown:?}");
        }
    }

    #[test]
    fn a_wavy_field_converges_below_tolerance() {
        let push = push(|x| Vector3::new(4.0 * (x.y / 9.0).sin(), 3.0 * (x.x / 11.0).cos(), 2.0 * (x.x / 8.0).sin()));
        let fraction = push.displacement.grid().clone();
        let (_, report) = invert(&push, &fraction, None, &InvertOptions::default()).unwrap();
        assert_eq!(report.unconverged, 0);
        assert!(report.residual_mm.max < 1e-3 && report.residual_mm.n > 10_000);
    }

    #[test]
    fn what_is_found_is_the_inverse_on_any_grid() {
        let push = push(|x| Vector3::new(4.0 * (x.y / 9.0).sin(), 3.0 * (x.x / 11.0).cos(), 2.0 * (x.x / 8.0).sin()));
        let turn = nalgebra::Rotation3::from_euler_angles(0.3, -0.2, 0.5).into_inner();
        let mut mirrored = turn;
        mirrored.column_mut(0).neg_mut();
        // Rows that are no whole blocks, shorter than one, along axes that are none of planning's; a single plane.
        for (size, direction, corner) in [
            ([43, 7, 5], turn, [-30.0, -5.0, -4.0]),
            ([5, 9, 11], mirrored, [7.0, -9.0, -9.0]),
            ([13, 6, 1], turn, [0.0; 3]),
        ] {
            let fraction = Grid::new(size, [1.3, 1.9, 2.3], corner.into(), direction).unwrap();
            let (pull, report) = invert(&push, &fraction, None, &InvertOptions::default()).unwrap();
            let mut checked = 0;
            for (n, v) in pull.displacement.data().iter().enumerate() {
                let (y, v) = (fraction.centre(fraction.voxel(n)), Vector3::from(v.map(f64::from)));
                let at = push.displacement.grid().index(&(y + v));
                assert_eq!(pull.inside.data()[n], push.displacement.grid().contains(&at));
                if let Some(u) = trilinear_vector(&push.displacement, &at) {
                    checked += 1;
                    assert!((v + u).norm() < 1.1e-3, "{size:?} {n}: {}", (v + u).norm());
                }
            }
            assert!(checked > fraction.len() / 2 && report.unconverged == 0, "{checked} {report:?}");
        }
    }

    #[test]
    fn a_fold_is_counted_not_hidden() {
        // x + u(x) runs back over itself: slope of u is below -1 in the middle.
        let push = push(|x| Vector3::new(-12.0 * (x.x / 6.0).tanh(), 0.0, 0.0));
        let fraction = push.displacement.grid().clone();
        let (pull, report) = invert(&push, &fraction, None, &InvertOptions::default()).unwrap();
        assert!(pull.displacement.data().iter().flatten().all(|v| v.is_finite()));
        assert_eq!(report.voxels, fraction.len());
        assert!(report.residual_mm.max < 1e-3);
    }
}
