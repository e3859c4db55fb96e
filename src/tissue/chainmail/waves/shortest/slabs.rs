//! One wave on several threads: each has some planes of the medium's bricks and one more on either side, runs its own
//! search, and tells its neighbours what came to the planes that are theirs, until no one learns anything new.
//!
//! Times are least sums, and of equal times the first bone counts: whatever the planes, the end is the same.

use super::arrival::{LATE, Medium, arrived};
use super::brick::{Brick, CELLS, value};
use super::dial::Search;
use rayon::prelude::*;
use std::ops::Range;

/// How one wave from all bones went: when it came to each cell, and from which bone.
pub(in crate::chainmail) struct FirstArrivals<'a> {
    /// The slabs' searches, in order.
    parts: Vec<Search<'a>>,
}

impl<'a> FirstArrivals<'a> {
    /// Runs the wave, by at most so many slabs.
    pub(in crate::chainmail) fn of(medium: &'a Medium, slabs: usize) -> Self {
        let mut parts: Vec<Search<'_>> =
            cut(medium, slabs).into_par_iter().map(|planes| slab(medium, planes)).collect();
        let mut seeds: Vec<Vec<(i32, u32)>> = parts.iter_mut().map(|p| p.surface(medium)).collect();
        while seeds.iter().any(|s| !s.is_empty()) {
            parts.par_iter_mut().zip(&seeds).for_each(|(part, seeds)| part.run(seeds));
            let news: Vec<News> = parts.iter_mut().flat_map(Search::news).collect();
            seeds = parts.iter_mut().map(|part| part.learn(&news)).collect();
        }
        Self { parts }
    }

    /// Ticks at a cell of soft tissue and the bone; `None` where the wave does not come, and in bones.
    pub(in crate::chainmail) fn at(&self, cell: usize) -> Option<(u32, u16)> {
        // The parts' own cells follow each other.
        let part = &self.parts[self.parts.partition_point(|p| CELLS * (p.first + p.own.end) <= cell)];
        let (time, bone) = part.told_by(value(&part.keys, cell - CELLS * part.first));
        Some((arrived(time, part.limit)?, bone))
    }
}

/// Slabs of planes of bricks with about as much soft tissue each.
fn cut(medium: &Medium, most: usize) -> Vec<Range<usize>> {
    let late = |brick: &Brick<i32>| brick.0.iter().filter(|t| **t == LATE).count();
    let planes = medium.rest.par_chunks(medium.bricks.plane());
    let soft: Vec<usize> = planes.map(|plane| plane.iter().map(late).sum()).collect();
    let count = soft.len();
    let share = soft.iter().sum::<usize>().div_ceil(most.max(1)).max(1);
    let (mut slabs, mut start, mut held) = (Vec::new(), 0, 0);
    for (k, soft) in soft.into_iter().enumerate() {
        held += soft;
        if held >= share && slabs.len() + 1 < most && k + 1 < count {
            slabs.push(start..k + 1);
            (start, held) = (k + 1, 0);
        }
    }
    slabs.push(start..count);
    slabs
}

/// What a cell was told: the cell in the medium, and its key.
type News = (usize, i32);

/// A search over these planes, and one more on either side that does not hand on.
fn slab(medium: &Medium, planes: Range<usize>) -> Search<'_> {
    let plane = medium.bricks.plane();
    let own = planes.start * plane..planes.end * plane;
    let seen = own.start.saturating_sub(plane)..(own.end + plane).min(medium.bricks.len());
    let own = own.start - seen.start..own.end - seen.start;
    let last = medium.surface.last().map_or(0, |s| s.0);
    Search::new(medium, seen, None, Vec::new()).telling(last).handing_on(own)
}

impl Search<'_> {
    /// Where a cell of the medium is among those that are this search's own.
    fn place(&self, cell: usize) -> Option<usize> {
        cell.checked_sub(CELLS * self.first).filter(|c| self.own.contains(&(c / CELLS)))
    }

    /// Its cells of the bones' surface, with their bones noted.
    fn surface(&mut self, medium: &Medium) -> Vec<(i32, u32)> {
        let mut seeds = Vec::new();
        for &(bone, cell) in &medium.surface {
            let Some(cell) = self.place(cell as usize) else { continue };
            self.keys[cell / CELLS].0[cell % CELLS] = i32::from(bone);
            seeds.push((i32::from(bone), cell as u32));
        }
        seeds
    }

    /// What came to planes that are another's.
    fn news(&mut self) -> Vec<News> {
        let mut told = std::mem::take(&mut self.told);
        told.sort_unstable();
        told.dedup();
        told.into_iter().map(|n| (CELLS * self.first + n as usize, value(&self.keys, n as usize))).collect()
    }

    /// Takes up what is better than it had; the cells from which that goes on, earliest first.
    fn learn(&mut self, news: &[News]) -> Vec<(i32, u32)> {
        let mut seeds = Vec::new();
        for &(cell, key) in news {
            let Some(cell) = self.place(cell) else { continue };
            let held = &mut self.keys[cell / CELLS].0[cell % CELLS];
            if key < *held {
                *held = key;
                seeds.push((key, cell as u32));
            }
        }
        seeds.sort_unstable();
        seeds
    }
}
