//! Organs that shrink or grow by a known factor: their links' rest lengths change, and the chain mail carries it on.
//!
//! An elastic surrounding holds an organ back, so that rest lengths of cbrt(factor) alone give only part of the change. The
//! rest lengths are therefore adapted until the organ's mean Jacobian is the factor (Eshelby 1957 gives the share that
//! a uniform surrounding lets through; ours is neither uniform nor free).

use super::super::lattice::Node;
use super::super::lattice::material::organ_label;
use super::super::lattice::{Lattice, Tissue};
use crate::error::Result;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A known change of an organ's volume.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VolumeChange {
    /// Name of its label; no bone.
    pub organ: String,
    /// Volume in the fraction over volume in planning.
    pub factor: f64,
}

/// Factors that make sense: an organ neither vanishes nor grows without end.
pub const FACTORS: std::ops::RangeInclusive<f64> = 0.2..=3.0;

impl VolumeChange {
    /// What is wrong with it, if anything.
    pub fn problem(&self) -> Option<String> {
        let (Self { organ, factor }, low, high) = (self, FACTORS.start(), FACTORS.end());
        (!FACTORS.contains(factor))
            .then(|| format!("chainmail.volume_change, {organ}: factor is {factor}: it must lie in [{low}, {high}]"))
    }
}

/// How often rest lengths are adapted at each spacing.
/// The elements then reach the wanted volume to 0.1 %.
const ADAPTATIONS: usize = 6;
/// Change of a rest length per change of volume, logarithms: of an organ that nothing holds, and at most.
const RATES: [f64; 2] = [1.0 / 3.0, 1.2];
/// Natural logarithm of the greatest change of a rest length: a factor of 3 either way.
const GREATEST: f64 = 1.1;

/// The organs of a run with the rest lengths that they have come to.
pub(in crate::chainmail) struct Growth {
    organs: Vec<Organ>,
}

struct Organ {
    label: u16,
    /// Logarithm of the wanted relative volume.
    wanted: f64,
    /// Logarithm of the relative rest length.
    strain: f64,
    /// The last rest length on the present lattice and the volume that came of it, logarithms of relative values.
    before: Option<[f64; 2]>,
    /// Nodes of the present lattice and the organ's share of each.
    nodes: Vec<(u32, f32)>,
    /// Lowest corners of its cells; the organ's voxels in each, and the sum of their places in it.
    cells: BTreeMap<usize, (usize, Vector3<f64>)>,
}

impl Growth {
    /// Finds the organs.
    ///
    /// # Errors
    /// [`crate::error::Error::Usage`] when a name is no label's, or a bone's.
    pub(in crate::chainmail) fn new(changes: &[VolumeChange], tissue: &Tissue<'_>) -> Result<Self> {
        let is_bone = |l: u16| tissue.bone_of_label[usize::from(l)].is_some();
        let organ = |c: &VolumeChange| {
            let label = organ_label("chainmail.volume_change", &c.organ, tissue.labels, is_bone)?;
            let wanted = c.factor.ln();
            Ok(Organ { label, wanted, strain: wanted / 3.0, before: None, nodes: Vec::new(), cells: BTreeMap::new() })
        };
        Ok(Self { organs: changes.iter().map(organ).collect::<Result<_>>()? })
    }

    /// Goes over to another lattice.
    pub(in crate::chainmail) fn enter(&mut self, lattice: &Lattice, tissue: &Tissue<'_>) {
        let fine = tissue.ct.grid();
        let voxels: f64 = (0..3).map(|a| lattice.grid.spacing()[a] / fine.spacing()[a]).product();
        for organ in &mut self.organs {
            let mut count = vec![0u32; lattice.node.len()];
            organ.cells.clear();
            organ.before = None;
            for (v, _) in tissue.labels.volume.data().iter().enumerate().filter(|(_, l)| **l == organ.label) {
                let at = lattice.grid.index(&fine.centre(fine.voxel(v)));
                let size = lattice.grid.size();
                let node = [0, 1, 2].map(|a| (at[a].round().max(0.0) as usize).min(size[a] - 1));
                let cell = [0, 1, 2].map(|a| (at[a].floor().max(0.0) as usize).min(size[a] - 2));
                let (voxels, places) = organ.cells.entry(lattice.grid.linear(cell)).or_default();
                *voxels += 1;
                *places += at - Vector3::from(cell.map(|c| c as f64));
                count[lattice.grid.linear(node)] += 1;
            }
            let share = |n: &u32| (f64::from(count[*n as usize]) / voxels).min(1.0) as f32;
            let soft = |n: &u32| lattice.node[*n as usize] == Node::Soft && count[*n as usize] > 0;
            organ.nodes = lattice.active.iter().filter(|n| soft(n)).map(|n| (*n, share(n))).collect();
        }
    }

    /// How often the relaxation is to run with adapted rest lengths: once where no organ changes.
    pub(in crate::chainmail) fn passes(&self) -> usize {
        if self.organs.is_empty() { 1 } else { ADAPTATIONS }
    }

    /// Relative rest length of each node's links; `None` where no organ changes.
    pub(in crate::chainmail) fn scale(&self, nodes: usize) -> Option<Vec<f32>> {
        if self.organs.is_empty() {
            return None;
        }
        let mut scale = vec![1.0; nodes];
        for organ in &self.organs {
            for (n, share) in &organ.nodes {
                scale[*n as usize] *= (organ.strain * f64::from(*share)).exp() as f32;
            }
        }
        Some(scale)
    }

    /// Adapts rest lengths to what came of them.
    pub(in crate::chainmail) fn adapt(&mut self, lattice: &Lattice, u: impl FnOnce() -> Vec<[f32; 3]>) {
        if self.organs.is_empty() {
            return;
        }
        let u = u();
        for organ in &mut self.organs {
            if let Some(reached) = organ.relative_volume(lattice, &u).map(f64::ln) {
                // The secant's rate, once there are two answers: what surrounds an organ holds it back.
                let rate =
                    organ.before.map_or(RATES[0], |[strain, volume]| (organ.strain - strain) / (reached - volume));
                let rate = if rate.is_finite() { rate.clamp(RATES[0], RATES[1]) } else { RATES[0] };
                organ.before = Some([organ.strain, reached]);
                organ.strain = (organ.strain + rate * (organ.wanted - reached)).clamp(-GREATEST, GREATEST);
            }
        }
    }
}

impl Organ {
    /// Mean relative volume of the organ's voxels, by the slope of the field at their middle in each of the lattice's cells; cells
    /// with a corner outside tissue are left out.
    fn relative_volume(&self, lattice: &Lattice, u: &[[f32; 3]]) -> Option<f64> {
        let corners = lattice.grid.cell_corners();
        let (mut sum, mut weight) = (0.0, 0.0);
        for (first, (voxels, places)) in &self.cells {
            let share = *voxels as f64;
            let place = places / share;
            let nodes = corners.map(|o| first + o);
            if nodes.iter().any(|&n| lattice.node[n] == Node::Outside) {
                continue;
            }
            // The trilinear field's slope: the four edges along each axis, weighted by their nearness.
            let at = |c: usize| Vector3::from(u[nodes[c]].map(f64::from));
            let part = |c: usize, a: usize| if c >> a & 1 == 1 { place[a] } else { 1.0 - place[a] };
            let column = |a: usize| {
                let near = |c: usize| part(c, (a + 1) % 3) * part(c, (a + 2) % 3);
                (0..8).map(|c| at(c) * if c >> a & 1 == 1 { near(c) } else { -near(c) }).sum::<Vector3<f64>>()
            };
            let slope = Matrix3::from_columns(&[column(0), column(1), column(2)]) * lattice.grid.inverse_step();
            sum += share * (Matrix3::identity() + slope).determinant();
            weight += share;
        }
        (weight > 0.0 && sum > 0.0).then(|| sum / weight)
    }
}

#[cfg(test)]
mod tests {
    use crate::chainmail::*;
    use crate::evaluate::jacobian::relative_volume;
    use crate::field::jacobian;
    use crate::geometry::{Grid, Rigid, about};
    use crate::volume::{LabelMap, Mask, Volume};
    use nalgebra::{Point3, Vector3};

    /// A block of water of 96 x 80 x 80 mm with a bone at either end and a ball of 13 mm radius between them.
    fn run(factor: f64, turn: f64) -> (f64, usize, f64) {
        let grid = Grid::axis_aligned([48, 40, 40], [2.0; 3], [-20.0, 30.0, 5.0]).unwrap();
        let middle = grid.world(&Vector3::new(22.0, 20.0, 18.0));
        let volume = Volume::from_fn(grid.clone(), |l| {
            let v = grid.voxel(l);
            match v[0] {
                0..=4 => 1,
                43..=47 => 2,
                _ if (grid.centre(v) - middle).norm() < 13.0 => 9,
                _ => 0u16,
            }
        });
        let names = [(1, "a"), (2, "b"), (9, "gland")].map(|(l, n)| (l, n.to_owned())).into();
        let labels = LabelMap { volume, names };
        let mut bone_of_label = vec![None; 1 << 16];
        (bone_of_label[1], bone_of_label[2]) = (Some(0), Some(1));
        let (ct, body) = (Volume::filled(grid.clone(), 20.0f32), Mask::filled(grid.clone(), true));
        let tissue = Tissue {
            ct: &ct,
            body: &body,
            labels: &labels,
            bone_of_label: &bone_of_label,
            lung: None,
            sliding: None,
            least_hu: -500.0,
        };
        let motion = about(&middle, Vector3::new(0.0, 0.0, turn), Vector3::zeros());
        let transforms = [Rigid::identity(), motion];
        let bones = Initiators { transforms: &transforms, centroids: &[Point3::origin(); 2] };
        let change = VolumeChange { organ: "gland".into(), factor };
        let options = ChainmailOptions { volume_change: vec![change], ..ChainmailOptions::default() };
        let p = propagate(&tissue, &bones, &options, None, &crate::progress::Silent).unwrap();
        let map = jacobian(&p.push);
        let bone = |l: usize| match labels.volume.data()[l] {
            1 => Some(0),
            2 => Some(1),
            _ => None,
        };
        let off = (0..grid.len()).filter_map(|l| {
            let x = grid.centre(grid.voxel(l));
            let u = Vector3::from(p.push.displacement.data()[l].map(f64::from));
            Some((transforms[bone(l)? as usize] * x - (x + u)).norm())
        });
        let folded = map.to_volume().data().iter().filter(|j| **j <= 0.0).count();
        (relative_volume(&map, &labels, 9).unwrap(), folded, off.fold(0.0, f64::max))
    }

    #[test]
    fn an_organ_takes_its_volume_and_bones_stay_rigid() {
        for (factor, turn) in [(0.7, 0.0), (0.8, 0.15), (1.4, 0.0)] {
            let (reached, folded, off) = run(factor, turn);
            assert!((reached / factor - 1.0).abs() < 0.03, "{reached} for {factor}");
            assert!(folded == 0 && off < 1e-4, "{folded} {off}");
        }
    }

    #[test]
    fn factors_without_sense_are_refused() {
        for factor in [0.0, -1.0, f64::NAN, 10.0] {
            assert!(VolumeChange { organ: "a".into(), factor }.problem().is_some());
        }
        assert_eq!(VolumeChange { organ: "a".into(), factor: 0.8 }.problem(), None);
    }
}
