//! Which parts are near a place: lists per cell of a coarse grid, so that a sample visits few solids.

use super::shape::{Bounds, Shape, V3};

/// Cell edge, mm.
pub(super) const CELL: f64 = 12.0;

/// Box of cells over the anatomy with a list of part numbers for each cell.
#[derive(Debug, Clone)]
pub(super) struct Cells {
    low: V3,
    size: [usize; 3],
    start: Vec<u32>,
    parts: Vec<u32>,
}

/// Least and greatest cell of a box along each axis.
type CellSpan = [[usize; 3]; 2];

impl Cells {
    /// Lists the shapes that come within `margin` mm of each cell of the box. Numbers ascend in each list.
    pub(super) fn new<'a>(within: Bounds, shapes: impl Iterator<Item = &'a Shape> + Clone, margin: f64) -> Self {
        let [low, high] = within;
        let size: [usize; 3] = std::array::from_fn(|a| ((high[a] - low[a]) / CELL).ceil().max(1.0) as usize);
        let mut cells = Self { low, size, start: vec![0; size.iter().product::<usize>() + 1], parts: Vec::new() };
        let lists: Vec<Vec<usize>> = shapes.map(|s| cells.touched(s, margin)).collect();
        for &cell in lists.iter().flatten() {
            cells.start[cell + 1] += 1;
        }
        for n in 1..cells.start.len() {
            cells.start[n] += cells.start[n - 1];
        }
        let mut next = cells.start.clone();
        cells.parts = vec![0; lists.iter().map(Vec::len).sum()];
        for (part, list) in (0u32..).zip(&lists) {
            for &cell in list {
                cells.parts[next[cell] as usize] = part;
                next[cell] += 1;
            }
        }
        cells
    }

    /// Cells that a shape comes within `margin` mm of (perhaps a few more).
    fn touched(&self, shape: &Shape, margin: f64) -> Vec<usize> {
        let [lo, hi] = shape.bounds();
        let index = |v: f64, a: usize| (((v - self.low[a]) / CELL).floor().max(0.0) as usize).min(self.size[a] - 1);
        let [from, to]: CellSpan =
            [std::array::from_fn(|a| index(lo[a] - margin, a)), std::array::from_fn(|a| index(hi[a] + margin, a))];
        let reach = margin + CELL * 0.5 * 3.0f64.sqrt() + 1e-6;
        let mut out = Vec::new();
        for k in from[2]..=to[2] {
            for j in from[1]..=to[1] {
                for i in from[0]..=to[0] {
                    let cell = i + self.size[0] * (j + self.size[1] * k);
                    if shape.at_least(&self.centre(cell)) < reach {
                        out.push(cell);
                    }
                }
            }
        }
        out
    }

    /// Number of cells.
    pub(super) fn len(&self) -> usize {
        self.start.len() - 1
    }

    /// Centre of a cell.
    pub(super) fn centre(&self, cell: usize) -> V3 {
        let [nx, ny, _] = self.size;
        let at = [cell % nx, cell / nx % ny, cell / (nx * ny)];
        self.low + V3::from(at.map(|c| (c as f64 + 0.5) * CELL))
    }

    /// Cell of a point; `None` outside the box.
    pub(super) fn cell(&self, p: &V3) -> Option<usize> {
        let q = (p - self.low) / CELL;
        let inside = (0..3).all(|a| q[a] >= 0.0 && q[a] < self.size[a] as f64);
        inside.then(|| q.x as usize + self.size[0] * (q.y as usize + self.size[1] * q.z as usize))
    }

    /// Parts near a cell, ascending.
    pub(super) fn parts(&self, cell: usize) -> &[u32] {
        &self.parts[self.start[cell] as usize..self.start[cell + 1] as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::super::build::{cap, ell};
    use super::*;

    #[test]
    fn lists_every_near_shape() {
        let shapes = [cap([-40.0, 0.0, -40.0], [45.0, 20.0, 40.0], 4.0, 7.0), ell([10.0, 10.0, 0.0], [20.0, 5.0, 9.0])];
        let cells = Cells::new([V3::repeat(-60.0), V3::repeat(60.0)], shapes.iter(), 8.0);
        let mut listed = [0, 0];
        for n in 0..64_000 {
            let p = V3::from([n % 40, n / 40 % 40, n / 1600].map(|c| f64::from(c) * 3.0 - 59.0));
            let near = cells.parts(cells.cell(&p).unwrap());
            for (part, s) in (0u32..).zip(&shapes) {
                assert!(s.distance(&p) > 8.0 || near.contains(&part));
                listed[part as usize] += usize::from(near.contains(&part));
            }
        }
        assert!(listed.iter().all(|&n| n < 32_000), "pruned: {listed:?}");
        assert!(cells.cell(&V3::repeat(61.0)).is_none());
    }
}
