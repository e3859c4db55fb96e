//! Landmark residuals before and after (thesis 4.3.3).

use crate::field::PushField;
use crate::stats::Summary;
use crate::volume::trilinear_vector;
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

/// A point known in both images, LPS mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Landmark {
    /// Its name.
    pub name: String,
    /// Position in the planning CT.
    pub planning: Point3<f64>,
    /// Position in the fraction CT.
    pub fraction: Point3<f64>,
}

/// Residual of one landmark.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandmarkResidual {
    /// The landmark.
    pub landmark: Landmark,
    /// Where the push field takes the planning position; `None` outside the planning grid.
    pub mapped: Option<Point3<f64>>,
    /// Distance before registration, mm (|x_planning - x_fraction|).
    pub before: f64,
    /// Distance after, mm (|x_mapped - x_fraction|); `None` outside the planning grid.
    pub after: Option<f64>,
}

/// Residuals of a set of landmarks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LandmarkReport {
    /// Each landmark's residual.
    pub each: Vec<LandmarkResidual>,
    /// Distances before, mm.
    pub before: Summary,
    /// Distances with one shift of the whole scan alone, mm: what is left for the deformation to explain. Nothing where no
    /// such shift is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shifted: Option<Summary>,
    /// Distances after, mm.
    pub after: Summary,
    /// Mean over landmarks of after / before (thesis eq. 4.2 as eq. 4.3 reads it); landmarks that do not move are left out.
    pub mean_of_ratios: f64,
    /// Standard deviation (n - 1) of after / before (thesis eq. 4.3).
    pub std_of_ratios: f64,
    /// Mean after / mean before, over landmarks inside the planning grid: the steadier figure.
    pub ratio_of_means: f64,
}

/// A landmark that moves less than this, mm, has no ratio of residuals: nobody places one so exactly, and one such ratio
/// would outweigh all others.
const UNMOVED_MM: f64 = 0.1;

/// Residuals of `landmarks` under `push`, whose displacement is interpolated linearly at the planning positions.
///
/// A landmark outside the planning grid keeps its residual before but has none after.
pub fn evaluate(push: &PushField, landmarks: &[Landmark]) -> LandmarkReport {
    let each: Vec<_> = landmarks.iter().map(|l| residual(push, l)).collect();
    let all: Vec<f64> = each.iter().map(|r| r.before).collect();
    let pairs: Vec<(f64, f64)> = each.iter().filter_map(|r| Some((r.before, r.after?))).collect();
    let after: Vec<f64> = pairs.iter().map(|p| p.1).collect();
    let ratios: Vec<f64> = pairs.iter().filter(|p| p.0 > UNMOVED_MM).map(|p| p.1 / p.0).collect();
    let ratios = Summary::of(&ratios);
    let (before_sum, after_sum) = pairs.iter().fold((0.0, 0.0), |(b, a), p| (b + p.0, a + p.1));
    LandmarkReport {
        before: Summary::of(&all),
        shifted: None,
        after: Summary::of(&after),
        mean_of_ratios: ratios.mean,
        std_of_ratios: ratios.std,
        ratio_of_means: if before_sum > 0.0 { after_sum / before_sum } else { 0.0 },
        each,
    }
}

impl LandmarkReport {
    /// With the residuals under a shift of the whole planning scan alone, mm.
    pub fn with_shift(self, shift: &Vector3<f64>) -> Self {
        let off = |r: &LandmarkResidual| (r.landmark.planning + shift - r.landmark.fraction).norm();
        let all: Vec<f64> = self.each.iter().map(off).collect();
        Self { shifted: Some(Summary::of(&all)), ..self }
    }
}

/// Residual of one landmark.
fn residual(push: &PushField, landmark: &Landmark) -> LandmarkResidual {
    let index = push.displacement.grid().index(&landmark.planning);
    let mapped = trilinear_vector(&push.displacement, &index).map(|u| landmark.planning + u);
    LandmarkResidual {
        landmark: landmark.clone(),
        mapped,
        before: (landmark.planning - landmark.fraction).norm(),
        after: mapped.map(|p| (p - landmark.fraction).norm()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;
    use crate::volume::Volume;

    #[test]
    fn residuals_by_hand() {
        // u = (x / 10, 0, 0) on a grid over 0..20 mm.
        let grid = Grid::axis_aligned([11, 3, 3], [2.0, 2.0, 2.0], [0.0; 3]).unwrap();
        let displacement = Volume::from_fn(grid.clone(), |l| [grid.centre(grid.voxel(l)).x as f32 / 10.0, 0.0, 0.0]);
        let push = PushField { displacement, computed: Volume::filled(grid, true) };
        let landmark = |name: &str, p: [f64; 3], f: [f64; 3]| Landmark {
            name: name.into(),
            planning: p.into(),
            fraction: f.into(),
        };
        let r = evaluate(
            &push,
            &[
                landmark("exact", [5.0, 1.0, 1.0], [5.5, 1.0, 1.0]), // before 0.5, after 0
                landmark("half", [10.0, 1.0, 1.0], [12.0, 1.0, 1.0]), // before 2, after 1
                landmark("still", [10.0, 2.0, 2.0], [10.05, 2.0, 2.0]), // before 0.05, after 0.95: no ratio
                landmark("outside", [30.0, 1.0, 1.0], [33.0, 5.0, 1.0]), // before 5
            ],
        );
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-6, "{a} {b}");
        assert_eq!((r.before.n, r.after.n), (4, 3));
        close(r.before.mean, 7.55 / 4.0);
        close(r.after.mean, 1.95 / 3.0);
        close(r.mean_of_ratios, 0.25);
        close(r.std_of_ratios, 0.125f64.sqrt());
        close(r.ratio_of_means, 1.95 / 2.55);
        assert_eq!((r.each[3].mapped, r.each[3].after), (None, None));
        close(r.each[1].mapped.unwrap().x, 11.0);
        // One shift by 2 mm along x: 1.5, 0, 1.95 and |(1, 4)| are left.
        let shifted = r.with_shift(&Vector3::new(2.0, 0.0, 0.0)).shifted.unwrap();
        assert_eq!(shifted.n, 4);
        close(shifted.mean, (1.5 + 0.0 + 1.95 + 17f64.sqrt()) / 4.0);
        assert_eq!(evaluate(&push, &[]).after, Summary::default());
    }
}
