//! Cells in bricks of 2 x 2 x 2, which lie together in memory: a cell and its 26 neighbours are in eight bricks, each of which
//! is one register wide.

/// Cells of a brick.
pub(super) const CELLS: usize = 8;

/// One value for each cell of a brick; i runs first.
#[repr(align(32))]
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Brick<T>(pub(super) [T; CELLS]);

/// How bricks fill a box, row by row and plane by plane.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bricks {
    /// Bricks along each axis.
    pub(super) size: [usize; 3],
}

impl Bricks {
    /// Bricks that hold so many cells along each axis.
    pub(super) fn holding(cells: [usize; 3]) -> Self {
        Self { size: cells.map(|c| c.div_ceil(2)) }
    }

    /// Number of bricks.
    pub(super) fn len(self) -> usize {
        self.size.iter().product()
    }

    /// Number of bricks in a plane of them.
    pub(super) fn plane(self) -> usize {
        self.size[0] * self.size[1]
    }

    /// The cell at this place in the box: eight times its brick, and its place in that.
    pub(super) fn cell(self, [i, j, k]: [usize; 3]) -> usize {
        let brick = i / 2 + self.size[0] * (j / 2 + self.size[1] * (k / 2));
        CELLS * brick + (i % 2 + 2 * (j % 2) + 4 * (k % 2))
    }

    /// Where the cell beside cell `at` of a brick is, one step on: bricks ahead, and its place in that.
    pub(super) fn beside(self, at: usize, step: [i32; 3]) -> (isize, usize) {
        let to: [isize; 3] = std::array::from_fn(|a| (at >> a & 1) as isize + step[a] as isize);
        let [i, j, k] = to.map(|t| t.div_euclid(2));
        let place = (0..3).map(|a| (to[a].rem_euclid(2) as usize) << a).sum();
        (i + self.size[0] as isize * (j + self.size[1] as isize * k), place)
    }
}

/// The value of a cell.
#[inline(always)]
pub(super) fn value<T: Copy>(bricks: &[Brick<T>], cell: usize) -> T {
    bricks[cell / CELLS].0[cell % CELLS]
}
