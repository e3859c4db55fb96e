//! Jacobian map of a push field: how much each cell of the planning grid grows or shrinks.
//!
//! The cell of a voxel has that voxel as its lowest-index corner and the next voxel along each axis as its others.
//! Its deformed volume is the sum of 5 tetrahedra (thesis 4.2.5 and 4.3.2). A cube falls apart into 5 tetrahedra in
//! two ways, mirror images of each other; alternate cells use alternate ways, so that neighbours cut their common face
//! along the same diagonal and the tetrahedra fill space without gap or overlap.
//!
//! Rows of cells are computed tetrahedron by tetrahedron in flat arrays of one component each. Both ways to cut are computed for
//! every cell: that costs less than sorting cells by their way.

use super::PushField;
use crate::geometry::{LANES, Wide, vectorised};
use crate::volume::{Mask, Volume};
use nalgebra::Matrix3;
use rayon::prelude::*;
use std::ops::Range;

/// Jacobian of a cell in which a tetrahedron is turned inside out.
pub const FOLDED: f32 = -1.0;

/// V_deformed / V_initial of each cell of the planning grid.
///
/// [`FOLDED`] where any of the 5 tetrahedra is not positive; 1 at the last voxel along each axis, which has no cell,
/// and where none of the 8 corners was computed: the smooth extension outside tissue is not anatomy.
pub fn jacobian(push: &PushField) -> Volume<f32> {
    let volume = 6.0 * push.displacement.grid().step().determinant();
    each_cell(
        push,
        1.0,
        #[inline(always)]
        |total, least, _| if least > 0.0 { (f64::from(total) / volume) as f32 } else { FOLDED },
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
        |_, _, least_of_ten| least_of_ten <= 0.0 || least_of_ten.is_nan(),
    )
}

/// `value(total, least, least_of_ten)` of every cell with a computed corner, `unmeasured` elsewhere: six times the volume of
/// the cell, mm^3, that of its least tetrahedron, and that of the least by either way to cut it. The least is not positive
/// where a tetrahedron is turned inside out.
fn each_cell<T: Copy + Default + PartialEq + Send + Sync>(
    push: &PushField,
    unmeasured: T,
    value: impl Fn(f32, f32, f32) -> T + Sync,
) -> Volume<T> {
    let grid = push.displacement.grid();
    let [ni, nj, nk] = grid.size();
    let mut out = vec![T::default(); grid.len()];
    out.par_chunks_mut(ni * nj).enumerate().for_each_init(
        || Rows::new([ni, nj], grid.step()),
        |rows, (k, plane)| {
            if unmeasured != T::default() {
                plane.fill(unmeasured);
            }
            if k + 1 == nk {
                return;
            }
            vectorised(
                #[inline(always)]
                || {
                    rows.begin(push, k);
                    for (j, cells) in plane.chunks_mut(ni).take(nj - 1).enumerate() {
                        if rows.in_row[j] || rows.in_row[j + 1] {
                            rows.advance(push, j, k);
                            rows.cut(j + k);
                            rows.each(cells, &value);
                        }
                    }
                },
            );
        },
    );
    Volume::new(grid.clone(), out).expect("one value per voxel")
}

/// A vector at each place of a row, component by component.
type Line = [Vec<f32>; 3];

/// A row of cells, between four rows of voxels: low or high along `j` (bit 0) and `k` (bit 1).
///
/// Lines hold what lies in the span; there is room for whole blocks at their end.
struct Rows {
    /// The voxels from the first to the last that is a corner of a cell with a computed corner, in any row of these planes.
    span: Range<usize>,
    /// Whether any voxel of a row was computed, in either plane.
    in_row: Vec<bool>,
    /// Whether any of the four voxels at a place was computed.
    computed: Vec<bool>,
    /// Displacements, mm.
    u: [Line; 4],
    /// Deformed edges, mm, all in the sense of growing index: along `i`, in the four rows.
    ex: [Line; 4],
    /// Along `j`, low and high in `k`.
    ey: [Line; 2],
    /// Along `k`, low and high in `j`.
    ez: [Line; 2],
    /// Six times the volume of the cells, of their least tetrahedra, and of the least by either way to cut them.
    total: Vec<f32>,
    least: Vec<f32>,
    least_of_ten: Vec<f32>,
    /// The `j` that the rows stand at.
    at: Option<usize>,
    step: [[f32; 3]; 3],
    /// Sign of an undeformed cell's volume: takes handedness of storage out.
    sense: f32,
}

impl Rows {
    fn new([ni, nj]: [usize; 2], step: &Matrix3<f64>) -> Self {
        let padded = ni + LANES;
        let line = |_| std::array::from_fn(|_| vec![0.0; padded]);
        Self {
            span: 0..0,
            in_row: vec![false; nj],
            computed: vec![false; ni],
            u: std::array::from_fn(line),
            ex: std::array::from_fn(line),
            ey: std::array::from_fn(line),
            ez: std::array::from_fn(line),
            total: vec![0.0; padded],
            least: vec![0.0; padded],
            least_of_ten: vec![0.0; padded],
            at: None,
            step: std::array::from_fn(|a| std::array::from_fn(|c| step[(c, a)] as f32)),
            sense: step.determinant().signum() as f32,
        }
    }

    /// Goes to the cells between planes `k` and `k + 1`.
    #[inline(always)]
    fn begin(&mut self, push: &PushField, k: usize) {
        let ni = self.computed.len();
        let (_, planes) = push.computed.data().split_at(push.computed.grid().linear([0, 0, k]));
        let (low, high) = planes.split_at(ni * self.in_row.len());
        self.computed.fill(false);
        for ((any, low), high) in self.in_row.iter_mut().zip(low.chunks(ni)).zip(high.chunks(ni)) {
            let mut found = false;
            for ((column, low), high) in self.computed.iter_mut().zip(low).zip(high) {
                *column |= low | high;
                found |= low | high;
            }
            *any = found;
        }
        let first = self.computed.iter().position(|c| *c).unwrap_or(ni);
        let last = self.computed.iter().rposition(|c| *c).unwrap_or(0);
        self.span = first.saturating_sub(1)..(last + 2).min(ni);
        self.at = None;
    }

    /// Takes up the corners and edges of the row of cells (j, k).
    #[inline(always)]
    fn advance(&mut self, push: &PushField, j: usize, k: usize) {
        let Self { u, ex, ey, ez, step, span, .. } = self;
        let known = self.at.is_some_and(|at| at + 1 == j);
        if known {
            for lines in [&mut *u, ex] {
                lines.swap(0, 1);
                lines.swap(2, 3);
            }
            ez.swap(0, 1);
        }
        let new = usize::from(known);
        let n = span.len();
        let starts: [usize; 4] =
            std::array::from_fn(|m| push.computed.grid().linear([span.start, j + (m & 1), k + (m >> 1)]));
        for m in (0..4).filter(|m| m & 1 >= new) {
            take_apart(&push.displacement.data()[starts[m]..][..n], &mut u[m]);
            for c in 0..3 {
                edges(&mut ex[m][c][..n], step[0][c], &u[m][c], &u[m][c][1..]);
            }
        }
        for c in 0..3 {
            for m in 0..2 {
                edges(&mut ey[m][c][..n], step[1][c], &u[2 * m][c], &u[2 * m + 1][c]);
            }
            for m in new..2 {
                edges(&mut ez[m][c][..n], step[2][c], &u[m][c], &u[m + 2][c]);
            }
        }
        let [a, b, c, d] = starts.map(|s| &push.computed.data()[s..][..n]);
        for ((((any, a), b), c), d) in self.computed.iter_mut().zip(a).zip(b).zip(c).zip(d) {
            *any = a | b | c | d;
        }
        self.at = Some(j);
    }

    /// Cuts the cells of the span; `sum` of their j and k tells the way of the cell at `i` = 0.
    ///
    /// The edges run towards growing index at every corner, so each corner of a regular cell has determinant +1 volume; the
    /// central tetrahedron, spanned by diagonals of the faces, has +2.
    #[inline(always)]
    fn cut(&mut self, sum: usize) {
        let Self { ex, ey, ez, total, least, least_of_ten, sense, span, .. } = self;
        let blocks = span.len().saturating_sub(1).div_ceil(LANES);
        let [x0, x1, x2, x3] = [0, 1, 2, 3].map(|m| run(&ex[m], 0, blocks));
        // Edges along j and k lie low and high along i.
        let [y0, y1, y2, y3] = [0, 1, 2, 3].map(|m| run(&ey[m >> 1], m & 1, blocks));
        let [z0, z1, z2, z3] = [0, 1, 2, 3].map(|m| run(&ez[m >> 1], m & 1, blocks));
        let sense = Wide::all(*sense);
        let total = total.as_chunks_mut::<LANES>().0;
        let (least, least_of_ten) = (least.as_chunks_mut::<LANES>().0, least_of_ten.as_chunks_mut::<LANES>().0);
        let first = (sum + span.start) % 2;
        for n in 0..blocks {
            // Corners 000, 110, 101 and 011 are cut off.
            let mut even = Tetrahedra::new();
            even.add(sense, at(x0, n), at(y0, n), at(z0, n));
            even.add(sense, at(x1, n), at(y1, n), at(z3, n));
            even.add(sense, at(x2, n), at(y3, n), at(z1, n));
            even.add(sense, at(x3, n), at(y2, n), at(z2, n));
            let diagonals = [minus(at(y0, n), at(x0, n)), minus(at(z0, n), at(x0, n)), plus(at(y1, n), at(z3, n))];
            even.add(sense, diagonals[0], diagonals[1], diagonals[2]);
            // The other four.
            let mut odd = Tetrahedra::new();
            odd.add(sense, at(x0, n), at(y1, n), at(z1, n));
            odd.add(sense, at(x1, n), at(y0, n), at(z2, n));
            odd.add(sense, at(x2, n), at(y2, n), at(z0, n));
            odd.add(sense, at(x3, n), at(y3, n), at(z3, n));
            let diagonals = [plus(at(x0, n), at(y1, n)), plus(at(y0, n), at(z2, n)), plus(at(x0, n), at(z1, n))];
            odd.add(sense, diagonals[0], diagonals[1], diagonals[2]);
            let [one, other] = if first == 0 { [&even, &odd] } else { [&odd, &even] };
            for l in 0..LANES {
                let own = if l % 2 == 0 { one } else { other };
                (total[n][l], least[n][l]) = (own.total.0[l], own.least.0[l]);
            }
            least_of_ten[n] = even.least.min(odd.least).0;
        }
    }

    /// Values of the cells of the span in a row.
    #[inline(always)]
    fn each<T: Copy>(&self, row: &mut [T], value: &impl Fn(f32, f32, f32) -> T) {
        let Some(last) = self.span.end.checked_sub(1).filter(|last| *last > self.span.start) else { return };
        let cells = &mut row[self.span.start..last];
        let measured = self.computed.iter().zip(&self.computed[1..]).map(|(a, b)| a | b);
        let found = self.total.iter().zip(&self.least).zip(&self.least_of_ten);
        for ((cell, measured), ((total, least), least_of_ten)) in cells.iter_mut().zip(measured).zip(found) {
            let found = value(*total, *least, *least_of_ten);
            *cell = if measured { found } else { *cell };
        }
    }
}

/// The components of the vectors of a row.
#[inline(always)]
fn take_apart(row: &[[f32; 3]], to: &mut Line) {
    let [x, y, z] = to;
    for (((u, x), y), z) in row.iter().zip(x).zip(y).zip(z) {
        (*x, *y, *z) = (u[0], u[1], u[2]);
    }
}

/// One component of deformed edges: undeformed they are `step`.
#[inline(always)]
fn edges(out: &mut [f32], step: f32, from: &[f32], to: &[f32]) {
    for ((e, a), b) in out.iter_mut().zip(from).zip(to) {
        *e = step + (b - a);
    }
}

/// [`LANES`] vectors.
type Vectors = [Wide; 3];

/// Blocks of consecutive places, component by component.
type Run<'a> = [&'a [[f32; LANES]]; 3];

/// `blocks` blocks from `first` on.
#[inline(always)]
fn run(line: &Line, first: usize, blocks: usize) -> Run<'_> {
    line.each_ref().map(|l| l[first..][..blocks * LANES].as_chunks().0)
}

#[inline(always)]
fn at([x, y, z]: Run<'_>, n: usize) -> Vectors {
    [Wide(x[n]), Wide(y[n]), Wide(z[n])]
}

#[inline(always)]
fn plus(a: Vectors, b: Vectors) -> Vectors {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
fn minus(a: Vectors, b: Vectors) -> Vectors {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Six times the volumes of tetrahedra of [`LANES`] cells: their sum, and the least of them in the sense of storage.
struct Tetrahedra {
    total: Wide,
    least: Wide,
}

impl Tetrahedra {
    #[inline(always)]
    fn new() -> Self {
        Self { total: Wide::default(), least: Wide::all(f32::INFINITY) }
    }

    /// Adds the one that three vectors span.
    #[inline(always)]
    fn add(&mut self, sense: Wide, a: Vectors, b: Vectors, c: Vectors) {
        let minors = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
        let volume = minors[0] * c[0] + minors[1] * c[1] + minors[2] * c[2];
        self.total = self.total + volume;
        self.least = self.least.min(volume * sense);
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "values that are exact by construction")]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use nalgebra::{Point3, Rotation3, Vector3};
    use proptest::prelude::*;

    /// A push field that takes each point `x` of `grid` to `map(x)`.
    fn push(grid: Grid, map: impl Fn(Point3<f64>) -> Point3<f64> + Sync) -> PushField {
        let displacement = Volume::from_fn(grid.clone(), |l| {
            let x = grid.centre(grid.voxel(l));
            (map(x) - x).map(|c| c as f32).into()
        });
        PushField { displacement, computed: Volume::filled(grid, true) }
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
            for l in 0..grid.len() {
                let v = grid.voxel(l);
                let cell = (0..3).all(|a| v[a] + 1 < grid.size()[a]);
                let measured = cell && grid.cell_corners().iter().any(|c| part.computed.data()[l + c]);
                let (value, fold) = if measured { (map.data()[l], folds.data()[l]) } else { (1.0, false) };
                prop_assert_eq!((part_map.data()[l], part_folds.data()[l]), (value, fold), "voxel {:?}", v);
            }
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
