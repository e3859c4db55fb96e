//! One wave on several threads: each has some planes of the medium and one more on either side, runs its own search, and tells
//! its neighbours what came to the planes that are theirs, until no one learns anything new.
//!
//! Times are least sums, and of equal times the first bone counts: whatever the planes, the end is the same.

use super::arrival::{LATE, Medium, SPAN};
use super::dial::{Owners, Search};
use rayon::prelude::*;
use std::ops::Range;

/// Time of each cell, and which bone comes first, by at most so many slabs.
pub(super) fn first_arrivals(medium: &Medium, slabs: usize) -> (Vec<i32>, Vec<u16>) {
    let mut parts: Vec<Part<'_>> = cut(medium, slabs).into_iter().map(|planes| Part::new(medium, planes)).collect();
    let mut seeds: Vec<Vec<(i32, u32)>> = parts.iter_mut().map(|p| p.surface(medium)).collect();
    while seeds.iter().any(|s| !s.is_empty()) {
        parts.par_iter_mut().zip(&seeds).for_each(|(part, seeds)| part.search.run(seeds));
        let news: Vec<News> = parts.iter_mut().flat_map(Part::news).collect();
        seeds = parts.iter_mut().map(|part| part.learn(&news)).collect();
    }
    let (mut times, mut owners) = (Vec::with_capacity(medium.len() + SPAN), Vec::with_capacity(medium.len()));
    for part in &parts {
        times.extend_from_slice(&part.search.times[part.own.clone()]);
        owners.extend_from_slice(&part.search.notes.0[part.own.clone()]);
    }
    (times, owners)
}

/// Slabs of planes with about as much soft tissue each.
fn cut(medium: &Medium, most: usize) -> Vec<Range<usize>> {
    let [nx, ny, nz] = medium.size();
    let soft: Vec<usize> = medium.rest[..medium.len()]
        .par_chunks(nx * ny)
        .map(|plane| plane.iter().filter(|t| **t == LATE).count())
        .collect();
    let share = soft.iter().sum::<usize>().div_ceil(most.max(1)).max(1);
    let (mut slabs, mut start, mut held) = (Vec::new(), 0, 0);
    for (k, soft) in soft.into_iter().enumerate() {
        held += soft;
        if held >= share && slabs.len() + 1 < most && k + 1 < nz {
            slabs.push(start..k + 1);
            (start, held) = (k + 1, 0);
        }
    }
    slabs.push(start..nz);
    slabs
}

/// A thread's planes.
struct Part<'a> {
    search: Search<'a, Owners>,
    /// Its first cell in the medium, that of the plane before its own.
    first: usize,
    /// Its own cells, counted from the first.
    own: Range<usize>,
}

/// What a cell was told: the cell in the medium, time and bone.
type News = (usize, i32, u16);

impl<'a> Part<'a> {
    fn new(medium: &'a Medium, planes: Range<usize>) -> Self {
        let plane = medium.size()[0] * medium.size()[1];
        let own = planes.start * plane..planes.end * plane;
        let seen = own.start.saturating_sub(plane)..(own.end + plane).min(medium.len());
        let first = seen.start;
        let own = own.start - first..own.end - first;
        let notes = Owners(vec![0; seen.len()]);
        Self { search: Search::new(medium, seen, None, notes).handing_on(own.clone()), first, own }
    }

    /// Its cells of the bones' surface, with their bones noted.
    fn surface(&mut self, medium: &Medium) -> Vec<(i32, u32)> {
        let mut seeds = Vec::new();
        for &(bone, cell) in &medium.surface {
            let Some(cell) = (cell as usize).checked_sub(self.first).filter(|c| self.own.contains(c)) else { continue };
            self.search.notes.0[cell] = bone;
            seeds.push((0, cell as u32));
        }
        seeds
    }

    /// What came to planes that are another's.
    fn news(&mut self) -> Vec<News> {
        let search = &mut self.search;
        let mut told = std::mem::take(&mut search.told);
        told.sort_unstable();
        told.dedup();
        told.into_iter()
            .map(|n| (self.first + n as usize, search.times[n as usize], search.notes.0[n as usize]))
            .collect()
    }

    /// Takes up what is better than it had; the cells from which that goes on, earliest first.
    fn learn(&mut self, news: &[News]) -> Vec<(i32, u32)> {
        let mut seeds = Vec::new();
        for &(cell, time, bone) in news {
            let Some(cell) = cell.checked_sub(self.first).filter(|c| self.own.contains(c)) else { continue };
            let held = (self.search.times[cell], self.search.notes.0[cell]);
            if (time, bone) < held {
                (self.search.times[cell], self.search.notes.0[cell]) = (time, bone);
                seeds.push((time, cell as u32));
            }
        }
        seeds.sort_unstable();
        seeds
    }
}
