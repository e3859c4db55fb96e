//! Principal modes of postures that were fitted to several fractions of one patient.

use super::{Mode, Six};
use nalgebra::DMatrix;

/// Modes that explain less than this share of the variance are left out.
const LEAST_SHARE: f64 = 0.01;

/// Mean and principal modes of some postures.
#[derive(Debug, Clone, PartialEq)]
pub struct Principal {
    /// The mean posture.
    pub mean: Vec<Six>,
    /// The modes, the strongest first: motion of every joint at one standard deviation.
    pub modes: Vec<Mode>,
    /// Share of the variance that each mode explains.
    pub explained: Vec<f64>,
    /// Variance of all postures, degrees squared and mm squared added up.
    pub variance: f64,
    /// Weight of each mode in each posture, standard deviations: one list per posture.
    pub weights: Vec<Vec<f64>>,
}

/// Principal components of postures of one skeleton, by singular values; `None` for fewer than two.
///
/// Degrees and millimetres count alike: a degree moves by 1 mm what lies 57 mm from the joint. `n` postures have at most
/// `n - 1` modes; those below one percent of the variance are left out. Of each mode the largest value is positive.
pub fn principal(postures: &[Vec<Six>]) -> Option<Principal> {
    let n = postures.len();
    let bones = postures.first()?.len();
    if n < 2 || postures.iter().any(|p| p.len() != bones) {
        return None;
    }
    let mean: Vec<Six> =
        (0..bones).map(|b| std::array::from_fn(|a| postures.iter().map(|p| p[b][a]).sum::<f64>() / n as f64)).collect();
    let centred = DMatrix::from_fn(n, 6 * bones, |p, c| postures[p][c / 6][c % 6] - mean[c / 6][c % 6]);
    let svd = centred.svd(true, true);
    let (u, v) = (svd.u?, svd.v_t?);
    let variance: f64 = svd.singular_values.iter().map(|s| s * s).sum::<f64>() / (n - 1) as f64;
    let mut order: Vec<usize> = (0..svd.singular_values.len()).collect();
    order.sort_by(|a, b| svd.singular_values[*b].total_cmp(&svd.singular_values[*a]));
    let root = ((n - 1) as f64).sqrt();
    let (mut modes, mut explained, mut weights) = (Vec::new(), Vec::new(), vec![Vec::new(); n]);
    for k in order.into_iter().take(n - 1) {
        let sd = svd.singular_values[k] / root;
        let share = sd * sd / variance;
        if share.is_nan() || share < LEAST_SHARE {
            break;
        }
        let row = v.row(k);
        let largest = row.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or(1.0);
        let sign = largest.signum();
        let value = |b: usize| std::array::from_fn(|a| sign * sd * row[6 * b + a]);
        modes.push(Mode { name: format!("mode {}", modes.len() + 1), values: (0..bones).map(value).collect() });
        explained.push(share);
        weights.iter_mut().enumerate().for_each(|(p, w)| w.push(sign * u[(p, k)] * root));
    }
    Some(Principal { mean, modes, explained, variance, weights })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Postures of two bones along two known modes.
    fn postures(weights: &[[f64; 2]]) -> Vec<Vec<Six>> {
        let first = [[3.0, 0.0, 0.0, 0.0, 0.0, 0.0], [4.0, 0.0, 0.0, 0.0, 0.0, 0.0]];
        let second = [[0.0, 0.0, 1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, -2.0, 0.0]];
        let one = |w: &[f64; 2]| {
            let value = |b: usize, a: usize| w[0] * first[b][a] + w[1] * second[b][a] + if a == 1 { 0.5 } else { 0.0 };
            (0..2).map(|b| std::array::from_fn(|a| value(b, a))).collect()
        };
        weights.iter().map(one).collect()
    }

    #[test]
    fn known_modes_come_back() {
        let all = postures(&[[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [0.0, 0.0]]);
        let found = principal(&all).unwrap();
        assert_eq!(found.modes.len(), 2);
        assert!((found.mean[0][1] - 0.5).abs() < 1e-12 && found.mean[1][0].abs() < 1e-12);
        // Weights of +-1 in four of five postures: a standard deviation of 1 with n - 1.
        let expected = [(0, 0, 3.0), (0, 1, 4.0)];
        for (mode, bone, value) in expected {
            assert!((found.modes[mode].values[bone][0] - value).abs() < 1e-9, "{:?}", found.modes[mode]);
        }
        assert!((found.modes[1].values[1][4] - 2.0).abs() < 1e-9 && (found.modes[1].values[0][2] + 1.0).abs() < 1e-9);
        assert!((found.explained[0] - 25.0 / 30.0).abs() < 1e-9 && (found.variance - 30.0).abs() < 1e-9);
        // The postures again, from mean, modes and weights.
        for (posture, weights) in all.iter().zip(&found.weights) {
            for (b, six) in posture.iter().enumerate() {
                for (a, value) in six.iter().enumerate() {
                    let sum: f64 = found.modes.iter().zip(weights).map(|(m, w)| w * m.values[b][a]).sum();
                    assert!((found.mean[b][a] + sum - value).abs() < 1e-9);
                }
            }
        }
    }

    #[test]
    fn there_are_fewer_modes_than_postures() {
        let two = principal(&postures(&[[1.0, 0.0], [0.0, 1.0]])).unwrap();
        assert!(two.modes.len() == 1 && (two.explained[0] - 1.0).abs() < 1e-12);
        assert!(principal(&postures(&[[1.0, 0.0]])).is_none() && principal(&[]).is_none());
        assert!(principal(&postures(&[[1.0, 0.0]; 3])).unwrap().modes.is_empty(), "nothing varies");
    }
}
