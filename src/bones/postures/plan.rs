//! What varies, by how much, and one posture of it.

use super::sequence::Point;
use super::truncated::quantile;
use super::{Six, pose_of};
use crate::skeleton::{Bone, Pose, Skeleton};
use serde::{Deserialize, Serialize};

/// How one joint varies by itself, beside the modes. Of the root: the couch.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Standard deviations before anything is cut off; 0 for what does not vary by itself.
    pub sd: Six,
    /// What the joint's whole motion stays within: least, greatest.
    pub range: [[f64; 2]; 6],
}

/// A motion of many joints together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Mode {
    /// Its name, for tables.
    pub name: String,
    /// Motion of every joint at one standard deviation.
    pub values: Vec<Six>,
}

/// A posture that somebody chose.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedPose {
    /// Its name.
    pub name: String,
    /// Motion of every joint.
    pub pose: Pose,
}

/// Volume of an organ over that in planning, evenly spread between two factors.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VolumeRange {
    /// Name of its label.
    pub organ: String,
    /// Least and greatest factor.
    pub range: [f64; 2],
}

/// What makes a posture implausible.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Limits {
    /// Greatest depth of one bone in another, beyond that in planning, mm; the usual one of warnings where none is given.
    pub overlap_mm: Option<f64>,
    /// Greatest number of folded tissue cells outside bone contact and sliding surfaces.
    pub folded_cells: usize,
}

/// How postures of one skeleton are distributed.
#[derive(Debug, Clone, PartialEq)]
pub struct PosturePlan {
    /// Factor on all standard deviations.
    pub scale: f64,
    /// Where every distribution ends, standard deviations from its middle.
    pub truncation_sd: f64,
    /// The middle of the distribution, joint by joint.
    pub mean: Vec<Six>,
    /// What each joint varies by itself, in the order of the bones.
    pub joints: Vec<Spread>,
    /// What joints do together.
    pub modes: Vec<Mode>,
    /// Organs whose volume varies.
    pub volumes: Vec<VolumeRange>,
    /// What makes a posture implausible.
    pub limits: Limits,
    /// Postures to be made before any is drawn.
    pub postures: Vec<NamedPose>,
}

/// A posture that was drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawn {
    /// Motion of every joint.
    pub pose: Pose,
    /// Each organ's factor, in the order of [`PosturePlan::volumes`].
    pub factors: Vec<f64>,
    /// Coordinates of joints that the modes would have taken out of their range and that were held at its end.
    pub held: usize,
}

impl Spread {
    /// Of a bone's joint that does not vary; its ranges are the joint's.
    pub fn of(bone: &Bone) -> Self {
        let [x, y, z] = bone.joint.translation_range_mm.map(|r| [-r, r]);
        let [a, b, c] = bone.joint.rotation_range_deg;
        Self { sd: [0.0; 6], range: [a, b, c, x, y, z] }
    }
}

impl PosturePlan {
    /// A plan in which nothing moves; ranges are those of the skeleton's joints.
    pub fn still(skeleton: &Skeleton) -> Self {
        Self {
            scale: 1.0,
            truncation_sd: 3.0,
            mean: vec![[0.0; 6]; skeleton.bones.len()],
            joints: skeleton.bones.iter().map(Spread::of).collect(),
            modes: Vec::new(),
            volumes: Vec::new(),
            limits: Limits::default(),
            postures: Vec::new(),
        }
    }

    /// Number of independent numbers behind a posture.
    pub fn dimensions(&self) -> usize {
        let joints = self.joints.iter().flat_map(|j| j.sd).filter(|sd| *sd > 0.0).count();
        self.modes.len() + joints + self.volumes.len()
    }

    /// Posture number `index` (below [`super::MOST_DRAWS`]) of the sequence of a seed; it does not depend on how many are drawn.
    ///
    /// A joint's motion is the mean, each mode times a normal number, and a normal number of its own that is cut to what
    /// the joint's range leaves. What the modes alone would take out of range is held at its end.
    pub fn draw(&self, index: u32, seed: u32) -> Drawn {
        let mut point = Point::new(index, seed);
        let cut = self.truncation_sd;
        let weights: Vec<f64> =
            self.modes.iter().map(|_| self.scale * quantile(point.coordinate(), 1.0, [-cut, cut])).collect();
        let mut held = 0;
        let mut values = self.mean.clone();
        for (n, (own, spread)) in values.iter_mut().zip(&self.joints).enumerate() {
            for (a, value) in own.iter_mut().enumerate() {
                let wanted = *value + self.modes.iter().zip(&weights).map(|(m, w)| w * m.values[n][a]).sum::<f64>();
                let [low, high] = spread.range[a];
                let within = wanted.clamp(low, high);
                held += usize::from((wanted - within).abs() > f64::EPSILON);
                *value = within;
                if spread.sd[a] > 0.0 {
                    let sd = self.scale * spread.sd[a];
                    let room = [(low - within).max(-cut * sd), (high - within).min(cut * sd)];
                    *value = (within + quantile(point.coordinate(), sd, room)).clamp(low, high);
                }
            }
        }
        let factors =
            self.volumes.iter().map(|v| v.range[0] + point.coordinate() * (v.range[1] - v.range[0])).collect();
        Drawn { pose: pose_of(&values), factors, held }
    }
}

#[cfg(test)]
mod tests {
    use super::super::sixes;
    use super::*;
    use crate::skeleton::Joint;
    use nalgebra::{Matrix3, Point3};

    /// A root and `n` joints of 10 degrees and 2 mm on it, one on the other.
    pub(in super::super) fn column(n: usize) -> Skeleton {
        let bone = |b: usize| Bone {
            name: format!("bone_{b}"),
            label: b as u16 + 1,
            parent: b.checked_sub(1),
            joint: Joint {
                name: String::new(),
                centre: Point3::new(0.0, 0.0, 20.0 * b as f64),
                axes: Matrix3::identity(),
                rotation_range_deg: if b == 0 { [[-180.0, 180.0]; 3] } else { [[-10.0, 10.0]; 3] },
                translation_range_mm: if b == 0 { [1e4; 3] } else { [2.0; 3] },
                source: String::new(),
            },
            centroid: Point3::new(0.0, 0.0, 20.0 * b as f64),
            volume_mm3: 1e4,
        };
        Skeleton { bones: (0..=n).map(bone).collect() }
    }

    /// One mode over two joints, each of which varies by itself too.
    fn plan() -> PosturePlan {
        let mut plan = PosturePlan::still(&column(2));
        plan.mean[1][0] = 1.0;
        let mut values = vec![[0.0; 6]; 3];
        (values[1][0], values[2][0]) = (1.5, 0.9);
        plan.modes.push(Mode { name: "bend".into(), values });
        (plan.joints[1].sd[0], plan.joints[2].sd[0], plan.joints[0].sd[5]) = (0.4, 0.5, 2.0);
        plan.volumes.push(VolumeRange { organ: "gland".into(), range: [0.7, 0.9] });
        plan
    }

    fn mean_and_sd(values: &[f64]) -> [f64; 2] {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        [mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt()]
    }

    #[test]
    fn means_deviations_and_correlation_are_those_asked_for() {
        let plan = plan();
        assert_eq!(plan.dimensions(), 5);
        let drawn: Vec<Drawn> = (0..1024).map(|n| plan.draw(n, 11)).collect();
        let of = |b: usize, a: usize| drawn.iter().map(|d| sixes(&d.pose)[b][a]).collect::<Vec<f64>>();
        let (one, two, up) = (of(1, 0), of(2, 0), of(0, 5));
        // Cut at 3 standard deviations a normal distribution keeps 0.9866 of its own.
        let cut = 0.986_6;
        let wanted = [(&one, 1.0, 1.5f64.hypot(0.4)), (&two, 0.0, 0.9f64.hypot(0.5)), (&up, 0.0, 2.0)];
        for (values, mean, sd) in wanted {
            let [m, s] = mean_and_sd(values);
            assert!((m - mean).abs() < 0.02 && (s / (cut * sd) - 1.0).abs() < 0.02, "{m} {s}, not {mean} {sd}");
        }
        let [m1, s1] = mean_and_sd(&one);
        let [m2, s2] = mean_and_sd(&two);
        let together = one.iter().zip(&two).map(|(a, b)| (a - m1) * (b - m2)).sum::<f64>() / 1023.0 / (s1 * s2);
        let expected = 1.5 * 0.9 / (1.5f64.hypot(0.4) * 0.9f64.hypot(0.5));
        assert!((together - expected).abs() < 0.02, "{together}, not {expected}");
        let factors: Vec<f64> = drawn.iter().map(|d| d.factors[0]).collect();
        let [m, s] = mean_and_sd(&factors);
        assert!((m - 0.8).abs() < 1e-3 && (s - 0.2 / 12f64.sqrt()).abs() < 1e-3, "{m} {s}");
        assert!(factors.iter().all(|f| (0.7..=0.9).contains(f)));
    }

    #[test]
    fn a_seed_gives_the_same_bits_however_many_are_drawn() {
        let plan = plan();
        let all = |n: u32, seed| (0..n).map(|k| plan.draw(k, seed)).collect::<Vec<_>>();
        assert_eq!(all(5, 3), all(9, 3)[..5]);
        assert_ne!(all(5, 3), all(5, 4));
        let first = &plan.draw(2, 3);
        let threads: Vec<_> = (0..4)
            .map(|_| {
                std::thread::spawn({
                    let plan = plan.clone();
                    move || plan.draw(2, 3)
                })
            })
            .collect();
        assert!(threads.into_iter().all(|t| t.join().unwrap() == *first));
    }

    #[test]
    fn no_joint_leaves_its_range_at_any_scale() {
        let skeleton = column(2);
        let mut plan = PosturePlan { scale: 6.0, ..plan() };
        plan.joints[2].range[0] = [-1.0, 3.0];
        let mut held = 0;
        for n in 0..256 {
            let drawn = plan.draw(n, 1);
            let values = sixes(&drawn.pose);
            assert!((-1.0..=3.0).contains(&values[2][0]) && (-10.0..=10.0).contains(&values[1][0]), "{values:?}");
            assert!(skeleton.excess(&drawn.pose)[1].is_zero());
            held += drawn.held;
        }
        assert!(held > 50, "{held}");
        assert_eq!((0..64).map(|n| self::plan().draw(n, 1).held).sum::<usize>(), 0);
    }
}
