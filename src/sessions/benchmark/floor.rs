//! What the memory allows: copy and triad over arrays that no cache holds, as in McCalpin's STREAM.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::hint::black_box;
use std::time::Instant;

/// Memory bandwidth, bytes per second; what is read and what is written both count.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Bandwidth {
    /// `a = b`.
    pub copy: f64,
    /// `a = b + s c`: the floor that tasks are compared with.
    pub triad: f64,
}

/// Values of one array, 64 MB in single precision.
const VALUES: usize = 16 << 20;
/// Values of one part of an array.
const PART: usize = 1 << 16;
/// Runs, of which the fastest counts.
const RUNS: usize = 5;

/// Measures it with all threads of the current pool.
pub fn bandwidth() -> Bandwidth {
    let (b, c) = (vec![1.5f32; VALUES], vec![0.25f32; VALUES]);
    let mut a = vec![1f32; VALUES];
    let fastest = |work: &mut dyn FnMut()| {
        let time = |_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64()
        };
        (0..RUNS).map(time).fold(f64::MAX, f64::min)
    };
    let bytes = (VALUES * size_of::<f32>()) as f64;
    let copy = fastest(&mut || {
        a.par_chunks_mut(PART).zip(b.par_chunks(PART)).for_each(|(a, b)| a.copy_from_slice(b));
        black_box(&mut a);
    });
    let s = black_box(3.0f32);
    let triad = fastest(&mut || {
        a.par_chunks_mut(PART).zip(b.par_chunks(PART)).zip(c.par_chunks(PART)).for_each(|((a, b), c)| {
            a.iter_mut().zip(b).zip(c).for_each(|((a, b), c)| *a = b + s * c);
        });
        black_box(&mut a);
    });
    Bandwidth { copy: 2.0 * bytes / copy, triad: 3.0 * bytes / triad }
}
