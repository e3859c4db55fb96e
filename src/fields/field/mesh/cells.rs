//! The deformed cells of a push field, each cut into 5 tetrahedra in both ways.
//!
//! CellRows of cells are computed tetrahedron by tetrahedron in flat arrays of one component each. Both ways to cut are computed for
//! every cell: that costs less than sorting cells by their way.

use super::super::PushField;
use crate::geometry::wide_vector::{WideVector, cross, dot, minus, plus};
use crate::geometry::{LANES, Wide, vectorised};
use crate::volume::extent::{extent, union};
use crate::volume::{Mask, Spans, Volume};
use nalgebra::Matrix3;
use rayon::prelude::*;
use std::ops::Range;

/// `value(total, least, least_of_ten)` of every cell with a computed corner, `beyond` elsewhere: six times the volume of
/// the cell, mm^3, that of its least tetrahedron, and that of the least by either way to cut it. The least is not positive
/// where a tetrahedron is turned inside out.
pub(in crate::field) fn each_cell<A: CellValue>(
    push: &PushField,
    beyond: A,
    value: impl Fn(f32, f32, f32) -> A + Sync,
) -> Spans<A> {
    each_row(
        &push.displacement,
        &push.computed,
        |_| 0..0,
        (beyond, ()),
        #[inline(always)]
        |total, least, least_of_ten| (value(total, least, least_of_ten), ()),
        |(), _| (),
    )
    .0
}

/// A row of cells while it is at hand: two values of each of some of them.
pub struct RowOfCells<'a, A, B> {
    /// `j + k * nj` of the lowest corners.
    pub row: usize,
    /// The cells, along the row; no cell of the others has a computed corner.
    pub cells: Range<usize>,
    /// One value of each, which is kept.
    pub kept: &'a [A],
    /// The other, which is not.
    pub other: &'a [B],
}

/// Two values of each cell with a corner that counts, as [`each_cell`] gives one, in a span of each row that holds `at_least` the
/// cells given for it. The first are kept; `then` takes each row while it is at hand, into one result for each plane.
pub(in crate::field) fn each_row<A: CellValue, B: CellValue, R: Default + Send>(
    displacement: &Volume<[f32; 3]>,
    counts: &Mask,
    at_least: impl Fn(usize) -> Range<usize>,
    beyond: (A, B),
    value: impl Fn(f32, f32, f32) -> (A, B) + Sync,
    then: impl Fn(&mut R, RowOfCells<'_, A, B>) + Sync,
) -> (Spans<A>, Vec<R>) {
    let grid = displacement.grid();
    let [ni, nj, nk] = grid.size();
    let spans = spans(counts, at_least);
    let room = || (CellRows::new(ni, grid.step()), vec![beyond.1; ni]);
    Spans::by_planes(grid.clone(), beyond.0, &spans, room, |(rows, other), k, kept| {
        let mut found = R::default();
        if k + 1 == nk {
            return found;
        }
        let (of_plane, mut rest) = (&spans[k * nj..(k + 1) * nj], kept);
        rows.at = None;
        for (j, cells) in of_plane.iter().enumerate() {
            let (kept, others) = rest.split_at_mut(cells.len());
            rest = others;
            if cells.is_empty() {
                continue;
            }
            let other = &mut other[..cells.len()];
            vectorised(
                #[inline(always)]
                || {
                    rows.advance(displacement, counts, of_plane, j, k);
                    rows.cut(j + k);
                    rows.each(kept, other, beyond, &value);
                },
            );
            then(&mut found, RowOfCells { row: j + k * nj, cells: cells.clone(), kept, other });
        }
        found
    })
}

/// The cells of each row from the first to the last that has a computed corner or is asked for.
fn spans(computed: &Mask, at_least: impl Fn(usize) -> Range<usize>) -> Vec<Range<usize>> {
    let [ni, nj, nk] = computed.grid().size();
    let rows: Vec<Range<usize>> = computed
        .data()
        .par_chunks(ni * nj)
        .flat_map_iter(|plane| {
            plane.chunks(ni).map(|row| {
                vectorised(
                    #[inline(always)]
                    || extent(row, |part| part.iter().fold(false, |any, set| any | set)),
                )
            })
        })
        .collect();
    let voxels = |row: usize| {
        let along = |row: usize| union(&rows[row], &rows[row + 1]);
        union(&along(row), &along(row + nj))
    };
    let of_row = |row: usize| {
        let (j, k) = (row % nj, row / nj);
        if j + 1 == nj || k + 1 == nk || ni == 1 {
            return 0..0;
        }
        let corners = voxels(row);
        let computed = if corners.is_empty() { 0..0 } else { corners.start.saturating_sub(1)..corners.end.min(ni - 1) };
        union(&computed, &at_least(row))
    };
    (0..nj * nk).map(of_row).collect()
}

/// What is found of a cell; `()` for nothing.
pub(in crate::field) trait CellValue: Copy + Default + Send + Sync {}

impl<T: Copy + Default + Send + Sync> CellValue for T {}

/// A vector at each place of a row, component by component.
type CellLine = [Vec<f32>; 3];

/// A row of cells, between four rows of voxels: low or high along `j` (bit 0) and `k` (bit 1).
///
/// There is room for whole blocks at the end of lines.
struct CellRows {
    /// The voxels that are corners of the cells looked at.
    span: Range<usize>,
    /// Whether any of the four voxels at each place of the span counts.
    computed: Vec<bool>,
    /// Displacements, mm.
    u: [CellLine; 4],
    /// Deformed edges, mm, all in the sense of growing index: along `i`, in the four rows.
    ex: [CellLine; 4],
    /// Along `j`, low and high in `k`.
    ey: [CellLine; 2],
    /// Along `k`, low and high in `j`.
    ez: [CellLine; 2],
    /// Along the span: six times the volume of the cells, of their least tetrahedra, and of the least by either way to cut them.
    total: Vec<f32>,
    least: Vec<f32>,
    least_of_ten: Vec<f32>,
    /// The `j` that the rows stand at.
    at: Option<usize>,
    step: [[f32; 3]; 3],
    /// Sign of an undeformed cell's volume: takes handedness of storage out.
    sense: f32,
}

impl CellRows {
    fn new(ni: usize, step: &Matrix3<f64>) -> Self {
        let padded = ni + LANES;
        let line = |_| std::array::from_fn(|_| vec![0.0; padded]);
        Self {
            span: 0..0,
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

    /// Takes up the corners and edges of the row of cells (j, k); `cells` are the spans of the plane's rows, of which this one's is not
    /// empty.
    #[inline(always)]
    fn advance(&mut self, displacement: &Volume<[f32; 3]>, counts: &Mask, cells: &[Range<usize>], j: usize, k: usize) {
        let span = corners(&cells[j]);
        // Voxels of a row are needed for the cells on either side of it.
        let needed = [j.checked_sub(1).map_or(0..0, |before| corners(&cells[before])), corners(&cells[j + 1])];
        let needed = needed.map(|beside| union(&beside, &span));
        let Self { u, ex, ey, ez, step, .. } = self;
        let known = self.at.is_some_and(|at| at + 1 == j);
        if known {
            for lines in [&mut *u, ex] {
                lines.swap(0, 1);
                lines.swap(2, 3);
            }
            ez.swap(0, 1);
        }
        let new = usize::from(known);
        let starts: [usize; 4] = std::array::from_fn(|m| counts.grid().linear([0, j + (m & 1), k + (m >> 1)]));
        for m in (0..4).filter(|m| m & 1 >= new) {
            let Range { start, end } = needed[m & 1];
            take_apart(&displacement.data()[starts[m]..][start..end], u[m].each_mut().map(|u| &mut u[start..end]));
            for c in 0..3 {
                edges(&mut ex[m][c][start..end], step[0][c], &u[m][c][start..], &u[m][c][start + 1..]);
            }
        }
        for c in 0..3 {
            for m in 0..2 {
                edges(
                    &mut ey[m][c][span.clone()],
                    step[1][c],
                    &u[2 * m][c][span.start..],
                    &u[2 * m + 1][c][span.start..],
                );
            }
            for m in new..2 {
                let Range { start, end } = needed[m];
                edges(&mut ez[m][c][start..end], step[2][c], &u[m][c][start..], &u[m + 2][c][start..]);
            }
        }
        let [a, b, c, d] = starts.map(|s| &counts.data()[s..][span.clone()]);
        for ((((any, a), b), c), d) in self.computed.iter_mut().zip(a).zip(b).zip(c).zip(d) {
            *any = a | b | c | d;
        }
        (self.span, self.at) = (span, Some(j));
    }

    /// Cuts the cells of the span; `sum` of their j and k tells the way of the cell at `i` = 0.
    ///
    /// The edges run towards growing index at every corner, so each corner of a regular cell has determinant +1 volume; the
    /// central tetrahedron, spanned by diagonals of the faces, has +2.
    #[inline(always)]
    fn cut(&mut self, sum: usize) {
        let Self { ex, ey, ez, total, least, least_of_ten, sense, span, .. } = self;
        let blocks = span.len().saturating_sub(1).div_ceil(LANES);
        let start = span.start;
        let [x0, x1, x2, x3] = [0, 1, 2, 3].map(|m| run(&ex[m], start, blocks));
        // Edges along j and k lie low and high along i.
        let [y0, y1, y2, y3] = [0, 1, 2, 3].map(|m| run(&ey[m >> 1], start + (m & 1), blocks));
        let [z0, z1, z2, z3] = [0, 1, 2, 3].map(|m| run(&ez[m >> 1], start + (m & 1), blocks));
        let sense = Wide::all(*sense);
        let total = total.as_chunks_mut::<LANES>().0;
        let (least, least_of_ten) = (least.as_chunks_mut::<LANES>().0, least_of_ten.as_chunks_mut::<LANES>().0);
        let first = (sum + start) % 2;
        for n in 0..blocks {
            let [x, y, z] = [at(x0, n), at(y0, n), at(z0, n)];
            // Corners 000, 110, 101 and 011 are cut off, or the other four; the central one is spanned by diagonals.
            let even = Tetrahedra::of(
                sense,
                [
                    [x, y, z],
                    [at(x1, n), at(y1, n), at(z3, n)],
                    [at(x2, n), at(y3, n), at(z1, n)],
                    [at(x3, n), at(y2, n), at(z2, n)],
                    [minus(&y, &x), minus(&z, &x), plus(&at(y1, n), &at(z3, n))],
                ],
            );
            let odd = Tetrahedra::of(
                sense,
                [
                    [x, at(y1, n), at(z1, n)],
                    [at(x1, n), y, at(z2, n)],
                    [at(x2, n), at(y2, n), z],
                    [at(x3, n), at(y3, n), at(z3, n)],
                    [plus(&x, &at(y1, n)), plus(&y, &at(z2, n)), plus(&x, &at(z1, n))],
                ],
            );
            let [one, other] = if first == 0 { [&even, &odd] } else { [&odd, &even] };
            for l in 0..LANES {
                let own = if l % 2 == 0 { one } else { other };
                (total[n][l], least[n][l]) = (own.total.0[l], own.least.0[l]);
            }
            least_of_ten[n] = even.least.min(odd.least).0;
        }
    }

    /// Values of the cells of the span.
    #[inline(always)]
    fn each<A: CellValue, B: CellValue>(
        &self,
        kept: &mut [A],
        other: &mut [B],
        beyond: (A, B),
        value: &impl Fn(f32, f32, f32) -> (A, B),
    ) {
        let measured = self.computed.iter().zip(&self.computed[1..]).map(|(a, b)| a | b);
        let found = self.total.iter().zip(&self.least).zip(&self.least_of_ten);
        for (((kept, other), measured), ((total, least), least_of_ten)) in
            kept.iter_mut().zip(other).zip(measured).zip(found)
        {
            let found = value(*total, *least, *least_of_ten);
            (*kept, *other) = if measured { found } else { beyond };
        }
    }
}

/// The voxels that are corners of some cells of a row.
#[inline(always)]
fn corners(cells: &Range<usize>) -> Range<usize> {
    if cells.is_empty() { 0..0 } else { cells.start..cells.end + 1 }
}

/// The components of the vectors of a row.
#[inline(always)]
fn take_apart(row: &[[f32; 3]], [x, y, z]: [&mut [f32]; 3]) {
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

/// Blocks of consecutive places, component by component.
type CellRun<'a> = [&'a [[f32; LANES]]; 3];

/// `blocks` blocks from `first` on.
#[inline(always)]
fn run(line: &CellLine, first: usize, blocks: usize) -> CellRun<'_> {
    line.each_ref().map(|l| l[first..][..blocks * LANES].as_chunks().0)
}

#[inline(always)]
fn at([x, y, z]: CellRun<'_>, n: usize) -> WideVector {
    [Wide(x[n]), Wide(y[n]), Wide(z[n])]
}

/// Six times the volumes of the 5 tetrahedra of [`LANES`] cells: their sum, and the least of them in the sense of storage.
struct Tetrahedra {
    total: Wide,
    least: Wide,
}

impl Tetrahedra {
    /// Those that the vectors span.
    #[inline(always)]
    fn of(sense: Wide, spanned: [[WideVector; 3]; 5]) -> Self {
        let mut all = Self { total: Wide::default(), least: Wide::all(f32::INFINITY) };
        for [a, b, c] in spanned {
            let volume = dot(&cross(&a, &b), &c);
            all.total = all.total + volume;
            all.least = all.least.min(volume * sense);
        }
        all
    }
}
