//! Values in one span of each row of a grid and one value everywhere else: maps of the patient keep no memory for the air around.

use super::Volume;
use super::extent::extent;
use crate::geometry::Grid;
use rayon::prelude::*;
use std::ops::Range;

/// Values on a [`Grid`] that are one and the same but for a span of each row along `i`.
#[derive(Debug, Clone, PartialEq)]
pub struct Spans<T> {
    grid: Grid,
    /// The value beyond the spans.
    beyond: T,
    /// The spans of all rows, in storage order, and the end.
    rows: Vec<Span>,
    /// The values of the spans, one after the other.
    data: Vec<T>,
}

/// Where the span of a row begins.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Span {
    /// Along the row.
    first: u32,
    /// Among the values.
    begin: usize,
}

impl<T: Copy + Default + Send + Sync> Spans<T> {
    /// `beyond` everywhere but in `spans`, voxels along each row, one for each row of the grid in storage order. `work(room, k, values)`
    /// fills the spans of plane `k`, which lie there one after the other; what it returns comes back plane by plane.
    pub fn by_planes<S, R: Send>(
        grid: Grid,
        beyond: T,
        spans: &[Range<usize>],
        room: impl Fn() -> S + Sync + Send,
        work: impl Fn(&mut S, usize, &mut [T]) -> R + Sync + Send,
    ) -> (Self, Vec<R>) {
        let rows_per_plane = grid.size()[1];
        debug_assert_eq!(spans.len(), rows_per_plane * grid.size()[2], "one span per row");
        let mut rows = Vec::with_capacity(spans.len() + 1);
        let mut begin = 0;
        for span in spans {
            rows.push(Span { first: span.start as u32, begin });
            begin += span.len();
        }
        rows.push(Span { first: 0, begin });
        let mut data = vec![T::default(); begin];
        let mut planes = Vec::with_capacity(grid.size()[2]);
        let mut rest = &mut data[..];
        for ends in rows.chunks(rows_per_plane).zip(rows[rows_per_plane..].chunks(rows_per_plane)) {
            let (plane, others) = rest.split_at_mut(ends.1[0].begin - ends.0[0].begin);
            planes.push(plane);
            rest = others;
        }
        let found =
            planes.into_par_iter().enumerate().map_init(room, |room, (k, plane)| work(room, k, plane)).collect();
        (Self { grid, beyond, rows, data }, found)
    }

    /// The grid.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The value of a voxel.
    pub fn at(&self, [i, j, k]: [usize; 3]) -> T {
        let (span, values) = self.row(j + k * self.grid.size()[1]);
        if span.contains(&i) { values[i - span.start] } else { self.beyond }
    }

    /// The span of a row, in storage order, and its values.
    pub fn row(&self, row: usize) -> (Range<usize>, &[T]) {
        let values = &self.data[self.rows[row].begin..self.rows[row + 1].begin];
        let first = self.rows[row].first as usize;
        (first..first + values.len(), values)
    }

    /// The values of all spans, in storage order.
    pub fn held(&self) -> &[T] {
        &self.data
    }

    /// Writes the values of the voxels from `start` in storage on.
    pub fn copy_to(&self, start: usize, out: &mut [T]) {
        let ni = self.grid.size()[0];
        let end = start + out.len();
        out.fill(self.beyond);
        for row in start / ni..end.div_ceil(ni) {
            let (span, values) = self.row(row);
            let (first, last) = ((row * ni + span.start).max(start), (row * ni + span.end).min(end));
            if first < last {
                let from = first - row * ni - span.start;
                out[first - start..last - start].copy_from_slice(&values[from..from + (last - first)]);
            }
        }
    }

    /// Every voxel's value.
    pub fn to_volume(&self) -> Volume<T> {
        let mut data = vec![self.beyond; self.grid.len()];
        let ni = self.grid.size()[0];
        data.par_chunks_mut(ni).enumerate().for_each(|(row, out)| {
            let (span, values) = self.row(row);
            out[span].copy_from_slice(values);
        });
        Volume::of(self.grid.clone(), data)
    }
}

impl<T: Copy + Default + Send + Sync> Spans<T> {
    /// A volume that holds `beyond` in most of its voxels: each row from its first to its last other value.
    pub fn within(volume: &Volume<T>, beyond: T) -> Self
    where
        T: PartialEq,
    {
        let [ni, nj, _] = volume.grid().size();
        let span = |row: &[T]| extent(row, |part| part.iter().any(|v| *v != beyond));
        let spans: Vec<_> = volume.data().par_chunks(ni).map(span).collect();
        let fill = |(): &mut (), k: usize, mut plane: &mut [T]| {
            for (row, span) in spans.iter().enumerate().skip(nj * k).take(nj) {
                let (to, rest) = plane.split_at_mut(span.len());
                to.copy_from_slice(&volume.data()[ni * row..][span.clone()]);
                plane = rest;
            }
        };
        Self::by_planes(volume.grid().clone(), beyond, &spans, || (), fill).0
    }

    /// A volume as it is: rows that are whole.
    pub fn of_volume(volume: &Volume<T>) -> Self {
        let [ni, nj, nk] = volume.grid().size();
        let rows = vec![0..ni; nj * nk];
        let fill =
            |(): &mut (), k: usize, plane: &mut [T]| plane.copy_from_slice(&volume.data()[k * ni * nj..][..ni * nj]);
        Self::by_planes(volume.grid().clone(), T::default(), &rows, || (), fill).0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_volume_of_spans_is_the_volume(
            size in prop::array::uniform3(1usize..7), ends in prop::collection::vec((0usize..7, 0usize..7), 36), from in 0usize..200, len in 0usize..60,
        ) {
            let grid = Grid::axis_aligned(size, [1.0; 3], [0.0; 3]).unwrap();
            let [ni, nj, nk] = size;
            let spans: Vec<_> = ends[..nj * nk].iter().map(|(a, b)| (*a.min(b)).min(ni)..(*a.max(b)).min(ni)).collect();
            let value = |row: usize, i: usize| (row * ni + i) as i32;
            let (found, planes) = Spans::by_planes(grid.clone(), -7, &spans, || (), |(), k, plane| {
                let values = (k * nj..(k + 1) * nj).flat_map(|row| spans[row].clone().map(move |i| value(row, i)));
                plane.iter_mut().zip(values).for_each(|(to, v)| *to = v);
                (k, plane.len())
            });
            let of_plane = |k: usize| spans[k * nj..(k + 1) * nj].iter().map(ExactSizeIterator::len).sum();
            prop_assert_eq!(planes, (0..nk).map(|k| (k, of_plane(k))).collect::<Vec<_>>());
            let whole = Volume::from_fn(grid.clone(), |l| if spans[l / ni].contains(&(l % ni)) { l as i32 } else { -7 });
            prop_assert_eq!(found.to_volume(), whole.clone());
            prop_assert_eq!(Spans::within(&whole, -7).to_volume(), whole.clone());
            prop_assert!(Spans::within(&whole, -7).held().len() <= found.held().len());
            prop_assert!((0..grid.len()).all(|l| found.at(grid.voxel(l)) == whole.data()[l]));
            let from = from.min(grid.len());
            let range = from..(from + len).min(grid.len());
            let mut part = vec![0; range.len()];
            found.copy_to(from, &mut part);
            prop_assert_eq!(&part[..], &whole.data()[range]);
            for (row, span) in spans.iter().enumerate().filter(|(_, span)| !span.is_empty()) {
                let run = row * ni + span.start..row * ni + span.end;
                prop_assert_eq!(found.row(row), (span.clone(), &whole.data()[run]));
            }
        }
    }
}
