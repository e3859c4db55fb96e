//! Mass density from CT numbers.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Piecewise-linear mass density by CT number; constant beyond both ends.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<[f64; 2]>", into = "Vec<[f64; 2]>")]
pub struct DensityTable {
    /// Pairs of HU and g/cm^3, HU rising.
    points: Vec<[f64; 2]>,
}

impl DensityTable {
    /// A table of HU and g/cm^3.
    ///
    /// # Errors
    /// [`Error::Input`] with fewer than two points, HU that do not rise, or a density that is not positive and finite.
    pub fn new(points: Vec<[f64; 2]>) -> Result<Self> {
        let bad = |problem: String| {
            Err(Error::input("density table", problem, "give at least two lines of HU and g/cm^3, HU rising"))
        };
        if points.len() < 2 {
            return bad(format!("it has {} points", points.len()));
        }
        if let Some(p) = points.iter().find(|p| !(p[0].is_finite() && p[1].is_finite() && p[1] > 0.0)) {
            return bad(format!("{} HU has the density {}", p[0], p[1]));
        }
        if let Some(w) = points.windows(2).find(|w| w[0][0] >= w[1][0]) {
            return bad(format!("{} HU comes before {} HU", w[0][0], w[1][0]));
        }
        Ok(Self { points })
    }

    /// Density in g/cm^3 of a CT number.
    pub fn density(&self, hu: f64) -> f64 {
        let at = self.points.partition_point(|p| p[0] <= hu);
        match (at.checked_sub(1).map(|n| self.points[n]), self.points.get(at)) {
            (Some([h0, d0]), Some([h1, d1])) => d0 + (d1 - d0) * (hu - h0) / (h1 - h0),
            (Some([_, d]), None) => d,
            (None, first) => first.map_or(1.0, |p| p[1]),
        }
    }
}

impl Default for DensityTable {
    /// The densities of Schneider, Bortfeld and Schlegel, Phys. Med. Biol. 45 (2000) 459: air to dense bone, as GATE tabulates them.
    fn default() -> Self {
        let points = [
            [-1000.0, 0.00121],
            [-98.0, 0.93],
            [-97.0, 0.930_486],
            [14.0, 1.03],
            [23.0, 1.031],
            [100.0, 1.1199],
            [101.0, 1.0762],
            [1600.0, 1.9642],
            [3000.0, 2.8],
        ];
        Self { points: points.to_vec() }
    }
}

impl TryFrom<Vec<[f64; 2]>> for DensityTable {
    type Error = Error;
    fn try_from(points: Vec<[f64; 2]>) -> Result<Self> {
        Self::new(points)
    }
}

impl From<DensityTable> for Vec<[f64; 2]> {
    fn from(table: DensityTable) -> Self {
        table.points
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_between_points_constant_beyond() {
        let t = DensityTable::new(vec![[-1000.0, 0.001], [0.0, 1.0], [1000.0, 1.5]]).unwrap();
        let close = |hu: f64, d: f64| assert!((t.density(hu) - d).abs() < 1e-12, "{hu}: {}", t.density(hu));
        close(-2000.0, 0.001);
        close(0.0, 1.0);
        close(500.0, 1.25);
        close(1000.0, 1.5);
        close(4000.0, 1.5);
        let water = DensityTable::default().density(0.0);
        assert!((water - 1.0).abs() < 0.03, "{water}");
        assert!(DensityTable::new(vec![[0.0, 1.0]]).is_err());
        assert!(DensityTable::new(vec![[0.0, 1.0], [0.0, 2.0]]).is_err());
        assert!(DensityTable::new(vec![[0.0, -1.0], [1.0, 2.0]]).is_err());
    }
}
