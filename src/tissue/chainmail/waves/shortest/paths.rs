//! Waves as shortest paths through a medium: from one bone, from all at once, and the latest times that still count.

use super::super::front::Source;
use super::arrival::{Arrival, LATE, Medium, came};
use super::brick::{Brick, CELLS, value};
use super::dial::Search;
use super::slabs::FirstArrivals;
use rayon::prelude::*;

/// Fewer planes of bricks are not worth a thread.
const LEAST_PLANES: usize = 4;

impl Medium {
    /// Runs one wave and notes nothing but times. `latest`: a time for each cell, after which the wave does not enter it.
    pub(in crate::chainmail) fn times(&self, source: Source, latest: Option<&[Brick<i32>]>) -> Arrival {
        let mut arrival = Arrival::default();
        self.times_into(&mut arrival, source, latest);
        arrival
    }

    /// As [`Medium::times`], in the room of a wave that is needed no more: fresh memory costs a tenth of a wave.
    pub(in crate::chainmail) fn times_into(
        &self,
        arrival: &mut Arrival,
        source: Source,
        latest: Option<&[Brick<i32>]>,
    ) {
        let seeds = match source {
            Source::AnyBone => &self.surface[..],
            Source::Bone(b) => {
                let from = self.surface.partition_point(|s| s.0 < b);
                let to = self.surface.partition_point(|s| s.0 <= b);
                &self.surface[from..to]
            }
        };
        let seeds: Vec<(i32, u32)> = seeds.iter().map(|s| (0, s.1)).collect();
        let room = std::mem::take(&mut arrival.times);
        let mut search = Search::new(self, 0..self.bricks.len(), latest, room);
        search.run(&seeds);
        *arrival = Arrival { times: search.keys, limit: self.limit, pruned: search.pruned };
    }

    /// Runs one wave from all bones and notes which one comes first at each cell; of several at the same time the first in
    /// the skeleton.
    pub(in crate::chainmail) fn first_arrivals(&self) -> FirstArrivals<'_> {
        FirstArrivals::of(self, rayon::current_num_threads().min(self.bricks.planes() / LEAST_PLANES))
    }

    /// The latest time at each cell by [`super::super::super::Variant::prune_ratio`]: the greatest, over all cells that a wave could
    /// go on to, of `ratio` times the first arrival there less the time to go there. What a wave brings within `ratio` times
    /// the first arrival it brings as if it were never pruned.
    ///
    /// These are least sums as well, of a wave that begins in all cells, later where the first one came early.
    pub(in crate::chainmail) fn latest(&self, first: &Arrival, ratio: f64) -> Vec<Brick<i32>> {
        let allowed =
            |t: i32| if came(t, first.limit) { (ratio * f64::from(t)).min(f64::from(self.limit)) as i32 } else { 0 };
        let most =
            first.times.par_iter().map(|times| times.0.map(allowed).into_iter().max().unwrap_or(0)).max().unwrap_or(0);
        let mut search = Search::new(self, 0..self.bricks.len(), None, Vec::new());
        let begin = |(keys, times): (&mut Brick<i32>, &Brick<i32>)| {
            for (key, &time) in keys.0.iter_mut().zip(&times.0).filter(|(key, _)| **key == LATE) {
                *key = most - allowed(time);
            }
        };
        search.keys.par_iter_mut().zip(&first.times).for_each(begin);
        let soft = |cell: &u32| value(&self.rest, *cell as usize) == LATE;
        let cells = (0..(CELLS * self.bricks.len()) as u32).into_par_iter().filter(soft);
        let mut seeds: Vec<(i32, u32)> = cells.map(|cell| (value(&search.keys, cell as usize), cell)).collect();
        seeds.par_sort_unstable();
        search.run(&seeds);
        search.keys.into_par_iter().map(|keys| Brick(keys.0.map(|key| most - key))).collect()
    }
}
