//! Which of the candidates belong together: exact message passing on the tree of joints (pictorial structures, Felzenszwalb and
//! Huttenlocher 2005).

use crate::skeleton::Skeleton;
use rayon::prelude::*;

/// Costs of the bones' states, and of the joints between them.
pub struct Tree<'a> {
    /// The tree.
    pub skeleton: &'a Skeleton,
    /// Cost of each state of each bone.
    pub own: Vec<Vec<f64>>,
    /// Cost of a joint: child, state of the parent, state of the child.
    pub joint: &'a (dyn Fn(usize, usize, usize) -> f64 + Sync),
}

/// What the tree makes of its states.
pub struct Marginals {
    /// Least cost of the whole skeleton with each bone in each of its states.
    pub costs: Vec<Vec<f64>>,
    /// For each bone but the root and each state of its parent, the bone's best state.
    down: Vec<Vec<usize>>,
    /// For each bone but the root and each of its states, the parent's best state.
    up: Vec<Vec<usize>>,
}

/// The least of a list, and where; the first of equal ones.
pub fn least(values: impl Iterator<Item = f64>) -> (usize, f64) {
    values.enumerate().fold((0, f64::INFINITY), |best, (n, v)| if v < best.1 { (n, v) } else { best })
}

impl Tree<'_> {
    /// Least costs of all states.
    pub fn solve(&self) -> Marginals {
        let bones = &self.skeleton.bones;
        let n = bones.len();
        // What hangs on a bone, the bone included, for each of its states.
        let mut below = self.own.clone();
        let (mut down, mut up) = (vec![Vec::new(); n], vec![Vec::new(); n]);
        let mut message = vec![Vec::new(); n];
        for b in (1..n).rev() {
            let Some(p) = bones[b].parent else { continue };
            let to = |s: usize| least(below[b].iter().enumerate().map(|(t, c)| c + (self.joint)(b, s, t)));
            let found: Vec<(usize, f64)> = (0..self.own[p].len()).into_par_iter().map(to).collect();
            (down[b], message[b]) = found.into_iter().unzip();
            below[p].iter_mut().zip(&message[b]).for_each(|(c, m)| *c += m);
        }
        let mut costs = below.clone();
        for b in 1..n {
            let Some(p) = bones[b].parent else { continue };
            // All but what hangs on the bone, for each state of its parent.
            let rest: Vec<f64> = costs[p].iter().zip(&message[b]).map(|(c, m)| c - m).collect();
            let from = |t: usize| least(rest.iter().enumerate().map(|(s, c)| c + (self.joint)(b, s, t)));
            let found: Vec<(usize, f64)> = (0..self.own[b].len()).into_par_iter().map(from).collect();
            costs[b].iter_mut().zip(&found).for_each(|(c, f)| *c += f.1);
            up[b] = found.into_iter().map(|f| f.0).collect();
        }
        Marginals { costs, down, up }
    }
}

impl Marginals {
    /// The best states of all bones with one of them held.
    pub fn states(&self, skeleton: &Skeleton, bone: usize, state: usize) -> Vec<usize> {
        let mut out = vec![usize::MAX; skeleton.bones.len()];
        out[bone] = state;
        let mut at = bone;
        while let Some(p) = skeleton.bones[at].parent {
            out[p] = self.up[at][out[at]];
            at = p;
        }
        for (b, bone) in skeleton.bones.iter().enumerate() {
            if let Some(p) = bone.parent.filter(|_| out[b] == usize::MAX) {
                out[b] = self.down[b][out[p]];
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::hanging::hanging;
    use super::*;

    #[test]
    fn each_state_costs_what_the_best_skeleton_with_it_costs() {
        let parents = [None, Some(0), Some(1), Some(1), Some(0)];
        let skeleton = hanging(&parents);
        let mixed = |n: usize| ((n * 7919 + 13) % 97) as f64 / 10.0;
        let own: Vec<Vec<f64>> = (0..5).map(|b| (0..3).map(|s| mixed(5 * b + s)).collect()).collect();
        let joint = |b: usize, s: usize, t: usize| mixed(31 * b + 11 * s + 5 * t + 400);
        let tree = Tree { skeleton: &skeleton, own: own.clone(), joint: &joint };
        let found = tree.solve();
        let cost = |states: &[usize]| -> f64 {
            let joints = parents.iter().enumerate().filter_map(|(b, p)| Some(joint(b, states[(*p)?], states[b])));
            joints.sum::<f64>() + states.iter().enumerate().map(|(b, &s)| own[b][s]).sum::<f64>()
        };
        let all: Vec<Vec<usize>> = (0..243).map(|n: usize| (0..5).map(|b| n / 3usize.pow(b) % 3).collect()).collect();
        for b in 0..5 {
            for s in 0..3 {
                let best =
                    all.iter().filter(|states| states[b] == s).map(|states| cost(states)).fold(f64::MAX, f64::min);
                assert!((found.costs[b][s] - best).abs() < 1e-9, "{b} {s}: {} for {best}", found.costs[b][s]);
                let states = found.states(&skeleton, b, s);
                assert!(states[b] == s && (cost(&states) - best).abs() < 1e-9);
            }
        }
    }
}
