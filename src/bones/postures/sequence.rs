//! Evenly spread numbers: Owen-scrambled Sobol points (Burley, JCGT 9(4), 2020; direction numbers of Kuo and Joe).

use sobol_burley::{NUM_DIMENSIONS, sample};

/// Points of a sequence; there are no more.
pub const MOST_DRAWS: u32 = 1 << 16;

/// One point of the sequence of a seed; its coordinates are asked for in order.
pub(super) struct Point {
    index: u32,
    seed: u32,
    next: u32,
}

impl Point {
    /// Point `index`, below [`MOST_DRAWS`].
    pub(super) fn new(index: u32, seed: u32) -> Self {
        Self { index: index % MOST_DRAWS, seed, next: 0 }
    }

    /// The next coordinate, between 0 and 1, both left out.
    pub(super) fn coordinate(&mut self) -> f64 {
        // The sequence has 256 dimensions; further ones are those of another seed, as its authors pad it.
        let (set, dimension) = (self.next / NUM_DIMENSIONS, self.next % NUM_DIMENSIONS);
        self.next += 1;
        let seed = self.seed.wrapping_add(set.wrapping_mul(0x9E37_79B9));
        // Steps of 2^-24: their middles.
        f64::from(sample(self.index, dimension, seed)) + f64::from(f32::EPSILON) / 4.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_coordinate_fills_every_sixty_fourth_once() {
        for dimension in [0, 7, 255, 256, 300] {
            let mut seen = [0; 64];
            for index in 0..64 {
                let mut point = Point::new(index, 5);
                let value = (0..=dimension).map(|_| point.coordinate()).last().unwrap();
                assert!(value > 0.0 && value < 1.0);
                seen[(value * 64.0) as usize] += 1;
            }
            assert_eq!(seen, [1; 64], "dimension {dimension}");
        }
    }
}
