//! Jacobian map of a push field: how much each cell of the planning grid grows or shrinks.
//!
//! The cell of a voxel has that voxel as its lowest-index corner and the next voxel along each axis as its others.
//! Its deformed volume is the sum of 5 tetrahedra (thesis 4.2.5 and 4.3.2). A cube falls apart into 5 tetrahedra in
//! two ways, mirror images of each other; alternate cells use alternate ways, so that neighbours cut their common face
//! along the same diagonal and the tetrahedra fill space without gap or overlap.
//!
//! `cells` computes them.

use super::super::PushField;
pub use super::cells::RowOfCells;
use super::cells::{each_cell, each_row};
use crate::volume::{Mask, Spans, Volume};
use std::ops::Range;

/// Jacobian of a cell in which a tetrahedron is turned inside out.
pub const FOLDED: f32 = -1.0;

/// V_deformed / V_initial of each cell of the planning grid.
///
/// [`FOLDED`] where any of the 5 tetrahedra is not positive; 1 at the last voxel along each axis, which has no cell,
/// and where none of the 8 corners was computed: the smooth extension outside tissue is not anatomy.
pub fn jacobian(push: &PushField) -> Spans<f32> {
    let relative = relative_volume(push);
    each_cell(
        push,
        1.0,
        #[inline(always)]
        |total, least, _| relative(total, least),
    )
}

/// Cells that fail the digital criterion of Liu et al.; false where [`jacobian`] is 1 for want of a cell or a computed
/// corner.
///
/// "On finite difference Jacobian computation in deformable image registration", Int. J. Comput. Vis. 2024, asks for
/// 10 positive determinants at each voxel: the 8 combinations of one-sided differences and two more, `J*1` and `J*2`.
/// Each is the volume of a tetrahedron: the 8 lie at the corners of the cells that meet in the voxel, the other two
/// are the central tetrahedra of both ways to cut a cell. Here they are gathered by cell instead of by voxel: a cell
/// fails when any of its own 10 tetrahedra is not positive. Over an image that is the same set of determinants.
pub fn digital_folds(push: &PushField) -> Mask {
    each_cell(
        push,
        false,
        #[inline(always)]
        |_, _, least_of_ten| fails(least_of_ten),
    )
    .to_volume()
}

/// The cells that [`digital_folds`] sets, by their first voxel in storage, ascending.
pub fn folded_cells(push: &PushField) -> Vec<usize> {
    positions(
        &push.displacement,
        &push.computed,
        #[inline(always)]
        |_, least_of_ten| fails(least_of_ten),
    )
}

/// The cells in which a tetrahedron is turned inside out, wherever the field says anything, by their first voxel in storage,
/// ascending: also where it only goes on outside tissue, which [`jacobian`] leaves out. Where all corners move alike nothing folds.
pub fn folded_anywhere(displacement: &Volume<[f32; 3]>) -> Vec<usize> {
    let still = displacement.data()[0].map(f32::to_bits);
    let moves = displacement.map(|u| u.map(f32::to_bits) != still);
    positions(
        displacement,
        &moves,
        #[inline(always)]
        |least, _| fails(least),
    )
}

/// The cells with a corner that counts for which `which(least, least of ten)` holds, by their first voxel in storage, ascending.
fn positions(displacement: &Volume<[f32; 3]>, counts: &Mask, which: impl Fn(f32, f32) -> bool + Sync) -> Vec<usize> {
    let ni = displacement.grid().size()[0];
    let (_, found) = each_row(
        displacement,
        counts,
        |_| 0..0,
        ((), false),
        #[inline(always)]
        |_, least, least_of_ten| ((), which(least, least_of_ten)),
        |found: &mut Vec<usize>, row| {
            let folded = row.cells.zip(row.other).filter(|(_, folds)| **folds);
            found.extend(folded.map(|(i, _)| row.row * ni + i));
        },
    );
    found.concat()
}

/// [`jacobian`], and what `then` makes, plane by plane, of each row of it and of [`digital_folds`] while they are at hand. The spans of
/// the map hold `at_least` the cells given for each row.
pub fn jacobian_by_rows<R: Default + Send>(
    push: &PushField,
    at_least: impl Fn(usize) -> Range<usize>,
    then: impl Fn(&mut R, RowOfCells<'_, f32, bool>) + Sync,
) -> (Spans<f32>, Vec<R>) {
    let relative = relative_volume(push);
    each_row(
        &push.displacement,
        &push.computed,
        at_least,
        (1.0, false),
        #[inline(always)]
        |total, least, least_of_ten| (relative(total, least), fails(least_of_ten)),
        then,
    )
}

/// A cell's Jacobian from six times its volume and that of its least tetrahedron.
fn relative_volume(push: &PushField) -> impl Fn(f32, f32) -> f32 + Sync + use<> {
    let share = (1.0 / (6.0 * push.displacement.grid().step().determinant())) as f32;
    #[inline(always)]
    move |total: f32, least: f32| if least > 0.0 { total * share } else { FOLDED }
}

#[inline(always)]
fn fails(least: f32) -> bool {
    least <= 0.0 || least.is_nan()
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values that are exact by construction")]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use nalgebra::{Matrix3, Point3, Rotation3, Vector3};
    use proptest::prelude::*;

    /// A push field that takes each point `x` of `grid` to `map(x)`.
    fn push(grid: Grid, map: impl Fn(Point3<f64>) -> Point3<f64> + Sync) -> PushField {
        let displacement = Volume::from_fn(grid.clone(), |l| {
            let x = grid.centre(grid.voxel(l));
            (map(x) - x).map(|c| c as f32).into()
        });
        PushField { displacement, computed: Volume::filled(grid, true) }
    }

    fn jacobian(push: &PushField) -> Volume<f32> {
        super::jacobian(push).to_volume()
    }

    /// Grids as scanners write them: any spacing, oblique, either handedness.
    fn grids() -> impl Strategy<Value = Grid> {
        (prop::array::uniform3(0.5f64..4.0), prop::array::uniform3(-2.0f64..2.0), prop::array::uniform3(any::<bool>()))
            .prop_map(|(spacing, rotation, flips)| {
                let mut direction = Rotation3::from_scaled_axis(rotation.into()).into_inner();
                for a in (0..3).filter(|&a| flips[a]) {
                    direction.column_mut(a).neg_mut();
                }
                Grid::new([6, 5, 4], spacing, Point3::new(3.0, -20.0, 7.0), direction).unwrap()
            })
    }

    /// Values of the voxels that have a cell.
    fn cells<T: Copy>(v: &Volume<T>) -> Vec<T> {
        let [ni, nj, nk] = v.grid().size();
        (0..v.grid().len())
            .filter(|&l| matches!(v.grid().voxel(l), [i, j, k] if i + 1 < ni && j + 1 < nj && k + 1 < nk))
            .map(|l| v.data()[l])
            .collect()
    }

    proptest! {
        #[test]
        fn affine_maps_have_their_determinant(grid in grids(), scale in 0.3f64..3.0, axis in prop::array::uniform3(-3.0f64..3.0),
                                              shear in -0.5f64..0.5) {
            let rotation = Rotation3::from_scaled_axis(axis.into());
            let rotated = jacobian(&push(grid.clone(), |x| rotation * x));
            prop_assert!(rotated.data().iter().all(|j| (j - 1.0).abs() < 1e-5));
            let mut m = Matrix3::identity() * scale;
            m[(0, 2)] = shear;
            let field = push(grid.clone(), |x| rotation * (m * x));
            let det = scale.powi(3) as f32;
            prop_assert!(cells(&jacobian(&field)).iter().all(|j| (j / det - 1.0).abs() < 1e-4));
            prop_assert_eq!(digital_folds(&field).count(), 0);
            let mirrored = push(grid, |x| Point3::new(-x.x, x.y, x.z));
            prop_assert!(cells(&jacobian(&mirrored)).iter().all(|&j| j == FOLDED));
            prop_assert!(cells(&digital_folds(&mirrored)).iter().all(|&f| f));
        }
    }

    #[test]
    fn identity_is_one_and_the_far_faces_have_no_cell() {
        let grid = Grid::axis_aligned([4, 3, 3], [1.0, 1.5, 3.0], [0.0; 3]).unwrap();
        assert!(jacobian(&push(grid.clone(), |x| x)).data().iter().all(|&j| j == 1.0));
        let doubled = jacobian(&push(grid, |x| x * 2.0));
        assert_eq!(*doubled.at([2, 1, 1]), 8.0);
        assert_eq!([*doubled.at([3, 1, 1]), *doubled.at([2, 2, 1]), *doubled.at([2, 1, 2])], [1.0; 3]);
        let mut partly = push(doubled.grid().clone(), |x| x * 2.0);
        partly.computed = Volume::from_fn(doubled.grid().clone(), |l| l == 0);
        assert_eq!((*jacobian(&partly).at([0, 0, 0]), *jacobian(&partly).at([1, 0, 0])), (8.0, 1.0));
        let flat = Grid::axis_aligned([4, 3, 1], [1.0; 3], [0.0; 3]).unwrap();
        assert!(jacobian(&push(flat, |x| x * 2.0)).data().iter().all(|&j| j == 1.0));
    }

    proptest! {
        /// Only the spans and rows with computed voxels are looked at: what is found there does not depend on the rest.
        #[test]
        fn part_of_the_cells_has_the_values_of_all(size in prop::array::uniform3(2usize..40), every in 1u32..400, seed in any::<u32>()) {
            let grid = Grid::axis_aligned([size[0], size[1] % 9 + 2, size[2] % 7 + 2], [1.0, 1.5, 2.0], [0.0; 3]).unwrap();
            let random = |l: usize, salt: u32| (l as u32 ^ salt ^ seed).wrapping_mul(2_654_435_761).rotate_left(13).wrapping_mul(40_503) >> 8;
            let displacement = Volume::from_fn(grid.clone(), |l| [1, 2, 3].map(|c| random(l, c << 20) as f32 / 16_777_216.0));
            let all = PushField { displacement: displacement.clone(), computed: Volume::filled(grid.clone(), true) };
            let part = PushField { displacement, computed: Volume::from_fn(grid.clone(), |l| random(l, 77).is_multiple_of(every)) };
            let ((map, folds), (part_map, part_folds)) = ((jacobian(&all), digital_folds(&all)), (jacobian(&part), digital_folds(&part)));
            let set: Vec<usize> = (0..grid.len()).filter(|&l| part_folds.data()[l]).collect();
            prop_assert_eq!(folded_cells(&part), set);
            for l in 0..grid.len() {
                let v = grid.voxel(l);
                let cell = (0..3).all(|a| v[a] + 1 < grid.size()[a]);
                let measured = cell && grid.cell_corners().iter().any(|c| part.computed.data()[l + c]);
                let (value, fold) = if measured { (map.data()[l], folds.data()[l]) } else { (1.0, false) };
                prop_assert_eq!((part_map.data()[l], part_folds.data()[l]), (value, fold), "voxel {:?}", v);
            }
            // More cells may be asked for; row by row each is told once.
            let [ni, nj, nk] = grid.size();
            let asked = |row: usize| if row % nj + 1 < nj && row / nj + 1 < nk { row % ni..ni - 1 } else { 0..0 };
            let (wide, rows) = jacobian_by_rows(&part, asked, |rows: &mut Vec<(usize, Vec<bool>)>, row| {
                rows.push((row.row * ni + row.cells.start, row.other.to_vec()));
            });
            prop_assert!((0..nj * nk).all(|row| asked(row).all(|i| wide.row(row).0.contains(&i))));
            prop_assert_eq!(wide.to_volume(), part_map);
            let mut told = vec![false; grid.len()];
            for (start, folds) in rows.concat() {
                told[start..][..folds.len()].copy_from_slice(&folds);
            }
            prop_assert_eq!(&told[..], part_folds.data());
        }
    }

    /// Greatest error over all cells, and over means of 2 x 2 x 2 cells, for a smooth map at spacing 2 / `n`.
    fn smooth_errors(n: usize) -> [f64; 2] {
        let h = 2.0 / n as f64;
        let grid = Grid::axis_aligned([n + 1; 3], [h; 3], [-1.0; 3]).unwrap();
        let map = |x: Point3<f64>| {
            Point3::new(x.x + 0.3 * x.y.sin() * x.x, x.y + 0.2 * (x.z * 2.0).sin(), x.z + 0.25 * x.x * x.z)
        };
        let exact = |x: Point3<f64>| {
            let dx = [1.0 + 0.3 * x.y.sin(), 0.3 * x.y.cos() * x.x, 0.0];
            let dz = [0.25 * x.z, 0.0, 1.0 + 0.25 * x.x];
            Matrix3::from([dx, [0.0, 1.0, 0.4 * (x.z * 2.0).cos()], dz]).determinant()
        };
        let j = jacobian(&push(grid.clone(), map));
        let at = |v: [usize; 3]| f64::from(*j.at(v));
        let (mut single, mut mean) = (0.0f64, 0.0f64);
        for l in 0..grid.len() {
            let v = grid.voxel(l);
            if v.iter().all(|&c| c < n) {
                single = single.max((at(v) - exact(grid.centre(v) + Vector3::repeat(h / 2.0))).abs());
            }
            if v.iter().all(|&c| c > 0 && c < n) {
                let around: f64 = (0..8).map(|c| at(std::array::from_fn(|a| v[a] - (c >> a & 1)))).sum();
                mean = mean.max((around / 8.0 - exact(grid.centre(v))).abs());
            }
        }
        [single, mean]
    }

    #[test]
    fn smooth_maps_converge_to_the_analytic_determinant() {
        // One cell cut one way leans to a side (first order); cells of both ways together do not (second order).
        let ([cell, mean], [fine_cell, fine_mean]) = (smooth_errors(10), smooth_errors(20));
        assert!(fine_cell < 5e-3 && fine_cell < cell / 1.8, "{cell} {fine_cell}");
        assert!(fine_mean < 1e-3 && fine_mean < mean / 3.0, "{mean} {fine_mean}");
    }

    #[test]
    fn one_displaced_corner_changes_the_cells_around_it_by_hand_values() {
        let grid = Grid::axis_aligned([4, 4, 4], [1.0; 3], [0.0; 3]).unwrap();
        let middle = Point3::new(1.0, 1.0, 1.0);
        // Moved by (a, a, a) towards cell (1,1,1), where it is corner 000 of an odd cell (central tetrahedron).
        let moved = |a: f64| push(grid.clone(), |x| if x == middle { x + Vector3::repeat(a) } else { x });
        let j = jacobian(&moved(0.3));
        // The central tetrahedron 000, 110, 011, 101 of height 2/sqrt(3) loses 3a/2 of its third of the cell; the three
        // corner tetrahedra that hold 000 lose a of their sixth each: a in all.
        assert!((j.at([1, 1, 1]) - 0.7).abs() < 1e-6, "{}", j.at([1, 1, 1]));
        // The opposite cell (0,0,0) is even; the point is corner 111 of its central tetrahedron: grows by as much.
        assert!((j.at([0, 0, 0]) - 1.3).abs() < 1e-6);
        // Tetrahedra fill space: what one cell gains its neighbours lose.
        let sum: f64 = cells(&j).iter().map(|&v| f64::from(v)).sum();
        assert!((sum - 27.0).abs() < 1e-5);
        // Beyond the plane through the other three corners, x + y + z = 2 from the cell's corner, it folds.
        assert!(*jacobian(&moved(0.66)).at([1, 1, 1]) > 0.0);
        assert_eq!(*jacobian(&moved(0.67)).at([1, 1, 1]), FOLDED);
        // The digital criterion also sees the corner tetrahedron of the other cut: plane x + y + z = 1.
        assert!(!digital_folds(&moved(0.32)).at([1, 1, 1]));
        assert!(digital_folds(&moved(0.34)).at([1, 1, 1]));
    }

    proptest! {
        #[test]
        fn mirrored_cuts_fill_space(noise in prop::collection::vec(-0.15f32..0.15, 5 * 5 * 5 * 3)) {
            // Interior points move at random, the surface stays: the volume in all must stay as well.
            let grid = Grid::axis_aligned([5, 5, 5], [1.0; 3], [0.0; 3]).unwrap();
            let displacement = Volume::from_fn(grid.clone(), |l| {
                let inner = grid.voxel(l).iter().all(|&c| c > 0 && c < 4);
                std::array::from_fn(|a| if inner { noise[3 * l + a] } else { 0.0 })
            });
            let field = PushField { displacement, computed: Volume::filled(grid, true) };
            let j = cells(&jacobian(&field));
            prop_assert!(j.iter().all(|&v| v > 0.0));
            prop_assert!((j.iter().map(|&v| f64::from(v)).sum::<f64>() - 64.0).abs() < 1e-4);
        }
    }
}
