//! Cells in bricks of 2 x 2 x 2, which lie together in memory: a cell and its 26 neighbours are in eight bricks, each of which
//! is one register wide.

/// Cells of a brick.
pub(in crate::chainmail) const CELLS: usize = 8;

/// One value for each cell of a brick; i runs first.
#[repr(align(32))]
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::chainmail) struct Brick<T>(pub(in crate::chainmail) [T; CELLS]);

/// Bricks along either side of a tile.
pub(in crate::chainmail) const TILE: usize = 8;
/// Bricks of a tile.
const TILE_BRICKS: usize = TILE * TILE;

/// How bricks fill a box: plane by plane, each plane in tiles of 8 x 8 bricks, half a page of memory. A front that crosses a tile stays
/// on its page; of rows, each of which is two pages, it would cross thousands.
#[derive(Debug, Clone, Copy)]
pub(in crate::chainmail) struct Bricks {
    /// Tiles along i and j, planes along k.
    size: [usize; 3],
}

impl Bricks {
    /// Bricks that hold so many cells along each axis.
    pub(in crate::chainmail) fn holding([i, j, k]: [usize; 3]) -> Self {
        Self { size: [i.div_ceil(2 * TILE), j.div_ceil(2 * TILE), k.div_ceil(2)] }
    }

    /// Number of bricks.
    pub(in crate::chainmail) fn len(self) -> usize {
        self.plane() * self.planes()
    }

    /// Number of bricks in a plane of them.
    pub(in crate::chainmail) fn plane(self) -> usize {
        self.size[0] * self.size[1] * TILE_BRICKS
    }

    /// Number of planes.
    pub(in crate::chainmail) fn planes(self) -> usize {
        self.size[2]
    }

    /// The cell at this place in the box: eight times its brick, and its place in that.
    pub(in crate::chainmail) fn cell(self, [i, j, k]: [usize; 3]) -> usize {
        let tile = i / (2 * TILE) + self.size[0] * (j / (2 * TILE) + self.size[1] * (k / 2));
        let brick = tile * TILE_BRICKS + i / 2 % TILE + TILE * (j / 2 % TILE);
        CELLS * brick + (i % 2 + 2 * (j % 2) + 4 * (k % 2))
    }

    /// Where the first cell of a brick is in the box.
    pub(in crate::chainmail) fn place(self, brick: usize) -> [usize; 3] {
        let (tile, within) = (brick / TILE_BRICKS, brick % TILE_BRICKS);
        let (row, i) = (tile / self.size[0], tile % self.size[0]);
        [2 * (i * TILE + within % TILE), 2 * (row % self.size[1] * TILE + within / TILE), 2 * (row / self.size[1])]
    }

    /// Where the cell beside cell `at` of a brick is, one step on: bricks ahead along each axis, and its place in that brick.
    pub(in crate::chainmail) fn beside(at: usize, step: [i32; 3]) -> ([i32; 3], usize) {
        let to: [i32; 3] = std::array::from_fn(|a| (at >> a & 1) as i32 + step[a]);
        let place = (0..3).map(|a| (to[a].rem_euclid(2) as usize) << a).sum();
        (to.map(|t| t.div_euclid(2)), place)
    }

    /// How far it is in memory from a brick at each place of a tile to the one `step` ahead.
    pub(in crate::chainmail) fn ahead(self, step: [i32; 3]) -> [i32; TILE_BRICKS] {
        let tile = TILE_BRICKS as i32;
        // Where the step leaves the tile: how far the next is, less a tile's width.
        let along = |at: usize, step: i32, width: i32, next: i32| {
            let to = at as i32 + step;
            (to.rem_euclid(TILE as i32) - at as i32) * width + to.div_euclid(TILE as i32) * next
        };
        std::array::from_fn(|n| {
            let (i, j) = (n % TILE, n / TILE);
            along(i, step[0], 1, tile)
                + along(j, step[1], TILE as i32, tile * self.size[0] as i32)
                + step[2] * self.plane() as i32
        })
    }
}

/// The place of a brick in its tile.
#[inline(always)]
pub(in crate::chainmail) fn in_tile(brick: usize) -> usize {
    brick % TILE_BRICKS
}

/// The value of a cell.
#[inline(always)]
pub(in crate::chainmail) fn value<T: Copy>(bricks: &[Brick<T>], cell: usize) -> T {
    bricks[cell / CELLS].0[cell % CELLS]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn steps_lead_where_they_should(size in prop::array::uniform3(1usize..50), at in prop::array::uniform3(0usize..50), step in prop::array::uniform3(-1i32..2)) {
            let bricks = Bricks::holding(size);
            let at: [usize; 3] = std::array::from_fn(|a| at[a] % size[a]);
            let cell = bricks.cell(at);
            prop_assert!(cell / CELLS < bricks.len() && cell / CELLS / bricks.plane() == at[2] / 2);
            prop_assert_eq!(bricks.place(cell / CELLS), at.map(|c| c / 2 * 2));
            let to: [i32; 3] = std::array::from_fn(|a| at[a] as i32 + step[a]);
            if (0..3).all(|a| (0..size[a] as i32).contains(&to[a])) {
                let (ahead, place) = Bricks::beside(cell % CELLS, step);
                let brick = (cell / CELLS) as i32 + bricks.ahead(ahead)[in_tile(cell / CELLS)];
                prop_assert_eq!(brick as usize * CELLS + place, bricks.cell(to.map(|c| c as usize)));
            }
        }
    }
}
