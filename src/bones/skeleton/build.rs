//! From a label map to a kinematic tree, with no hand work.

use super::anatomy::{self, Kind, SACRUM, SKULL};
use super::centres::Anatomy;
use super::shape::{self, Shape};
use super::{Bone, Joint, Skeleton, check, spine};
use crate::error::{Error, Result};
use crate::findings;
use crate::volume::LabelMap;
use crate::warning::Warning;
use nalgebra::Matrix3;
use std::collections::BTreeMap;

/// What [`build`] makes.
#[derive(Debug, Clone)]
pub struct Built {
    /// The skeleton.
    pub skeleton: Skeleton,
    /// Legal but unusual findings.
    pub warnings: Vec<Warning>,
    /// Names of labels that occur and are not bones of the skeleton, in order of label.
    pub ignored: Vec<String>,
    /// Number of voxels of each bone, in the order of the skeleton's bones.
    pub voxels: Vec<usize>,
}

/// The kinematic tree of all bones in a label map.
///
/// The root is the lowest bone of the axis (sacrum to skull). Every other bone hangs on the nearest present bone
/// on its way to the sacrum ([`Kind::carrier`]); ranges of the joints in between add up. S1 and sacrum are joined
/// without motion. Joint centres come from the labels' shapes, joint axes from LPS and the spine's local direction.
/// A bone with no carrier at all hangs on the nearest bone, with a warning.
///
/// # Errors
/// When no label is a bone, or two labels have one name.
pub fn build(labels: &LabelMap) -> Result<Built> {
    let counts = labels.counts();
    let mut wanted: BTreeMap<u16, Kind> = BTreeMap::new();
    let mut ignored = Vec::new();
    for label in counts.keys() {
        let name = labels.names.get(label);
        match name.and_then(|n| Kind::of(n)) {
            Some(kind) => {
                if let Some((twin, _)) = wanted.iter().find(|(_, k)| **k == kind) {
                    return Err(Error::input(
                        "label map",
                        format!("labels {twin} and {label} are both named {}", labels.names[label]),
                        "give each bone one label",
                    ));
                }
                wanted.insert(*label, kind);
            }
            None => ignored.push(name.map_or_else(|| format!("label {label} (no name)"), Clone::clone)),
        }
    }
    if wanted.is_empty() {
        return Err(Error::input(
            "label map",
            format!("no label is a bone; found {} labels: {}", counts.len(), listed(&ignored)),
            "use TotalSegmentator's names (skull, mandible, vertebrae_C1, ...) in the header or in the labels file",
        ));
    }
    let shapes = shape::shapes(labels, &wanted);
    let mut warnings = check::warnings(labels, &shapes);
    let tree = Tree::grow(&shapes, &mut warnings);
    let levels: BTreeMap<u8, &Shape> = shapes
        .iter()
        .filter_map(|s| match s.kind {
            Kind::Spine(level) => Some((level, s)),
            _ => None,
        })
        .collect();
    let vertebrae = spine::vertebrae(&levels, labels.volume.grid());
    let bones = tree.bones(&Anatomy { shapes: &shapes, vertebrae }, labels.volume.grid().voxel_volume());
    let voxels = tree.order.iter().map(|&n| shapes[n].voxels).collect();
    Ok(Built { skeleton: Skeleton { bones }, warnings, ignored, voxels })
}

/// At most ten names.
fn listed(names: &[String]) -> String {
    match names {
        [] => "none".into(),
        few if few.len() <= 10 => few.join(", "),
        many => format!("{}, and {} more", many[..10].join(", "), many.len() - 10),
    }
}

/// Who hangs on whom, by positions in the list of shapes.
struct Tree {
    /// Parent, and the bones whose joints this one bridges (the child first); `None` for the root.
    parents: Vec<Option<(usize, Vec<Kind>)>>,
    /// Positions in parent-first order.
    order: Vec<usize>,
}

impl Tree {
    fn grow(shapes: &[Shape], warnings: &mut Vec<Warning>) -> Self {
        let at: BTreeMap<Kind, usize> = shapes.iter().enumerate().map(|(n, s)| (s.kind, n)).collect();
        let root = root(shapes, &at);
        let mut parents: Vec<Option<(usize, Vec<Kind>)>> = vec![None; shapes.len()];
        for (n, shape) in shapes.iter().enumerate().filter(|(n, _)| *n != root) {
            parents[n] = carrier(shape.kind, &at);
        }
        // Bones are placed as soon as their parent is; what then is left has no way to the root.
        let mut order = vec![root];
        let mut waiting: Vec<usize> = at.values().copied().filter(|&n| n != root).collect();
        while !waiting.is_empty() {
            let ready = waiting.iter().position(|&n| parents[n].as_ref().is_some_and(|(p, _)| order.contains(p)));
            let next = ready.unwrap_or_else(|| {
                let (next, parent) = nearest_pair(shapes, &waiting, &parents, &order);
                let n = waiting[next];
                warnings.push(Warning::new(
                    findings::BONE_WITHOUT_PARENT,
                    format!(
                        "{}: none of the bones that carry it is labelled; it hangs on the nearest bone, {}. Set \
                         bones.{}.parent in skeleton.toml to change that.",
                        shapes[n].name, shapes[parent].name, shapes[n].name
                    ),
                ));
                parents[n] = Some((parent, vec![shapes[n].kind]));
                next
            });
            order.push(waiting.remove(next));
        }
        Self { parents, order }
    }

    fn bones(&self, anatomy: &Anatomy, voxel: f64) -> Vec<Bone> {
        let mut place = vec![0; self.order.len()];
        for (n, &s) in self.order.iter().enumerate() {
            place[s] = n;
        }
        let bone = |&n: &usize| {
            let shape = &anatomy.shapes[n];
            let (parent, joint) = match &self.parents[n] {
                Some((p, path)) => (Some(place[*p]), joint(anatomy, n, *p, path)),
                None => (None, root_joint(shape)),
            };
            Bone {
                name: shape.name.clone(),
                label: shape.label,
                parent,
                joint,
                centroid: shape.centroid,
                volume_mm3: shape.voxels as f64 * voxel,
            }
        };
        self.order.iter().map(bone).collect()
    }
}

/// The lowest bone of the axis; without any, the largest bone that no other present bone carries.
fn root(shapes: &[Shape], at: &BTreeMap<Kind, usize>) -> usize {
    let axis = (SACRUM..=SKULL).find_map(|level| at.get(&Kind::Spine(level)).copied());
    let free = (0..shapes.len()).filter(|&n| carrier(shapes[n].kind, at).is_none());
    axis.or_else(|| free.max_by_key(|&n| (shapes[n].voxels, std::cmp::Reverse(n)))).unwrap_or(0)
}

/// The nearest present bone on the way to the sacrum, and the bones on the way whose joints are bridged. Where the
/// way along the axis finds none, the nearest level above it.
fn carrier(kind: Kind, at: &BTreeMap<Kind, usize>) -> Option<(usize, Vec<Kind>)> {
    let mut path = vec![kind];
    let mut next = kind.carrier();
    while let Some(bone) = next {
        if let Some(&n) = at.get(&bone) {
            return Some((n, path));
        }
        path.push(bone);
        next = bone.carrier();
    }
    if matches!(kind, Kind::Spine(_)) {
        return None;
    }
    let joins = path.iter().position(|k| matches!(k, Kind::Spine(_)))?;
    let Kind::Spine(level) = path[joins] else { return None };
    let above = (level..=SKULL).find(|&l| at.contains_key(&Kind::Spine(l)))?;
    path.truncate(joins);
    path.extend((level + 1..=above).map(Kind::Spine));
    Some((at[&Kind::Spine(above)], path))
}

/// Among the waiting bones that have no parent, the one nearest to a placed bone: its position in `waiting`, and
/// that bone.
fn nearest_pair(
    shapes: &[Shape],
    waiting: &[usize],
    parents: &[Option<(usize, Vec<Kind>)>],
    placed: &[usize],
) -> (usize, usize) {
    let mut best = (f64::INFINITY, 0, placed[0]);
    for (w, &n) in waiting.iter().enumerate().filter(|(_, n)| parents[**n].is_none()) {
        for &p in placed {
            let gap = shape::contact(&shapes[n].surface, &shapes[p].surface).map_or(f64::INFINITY, |c| c.gap);
            if gap < best.0 {
                best = (gap, w, p);
            }
        }
    }
    (best.1, best.2)
}

fn joint(anatomy: &Anatomy, child: usize, parent: usize, path: &[Kind]) -> Joint {
    let (c, p) = (anatomy.shapes[child].kind, anatomy.shapes[parent].kind);
    let ranges = anatomy::bridged(path);
    Joint {
        name: c.joint_name(p),
        centre: anatomy.centre(child, parent),
        axes: anatomy.axes(child, parent),
        rotation_range_deg: ranges.rotation_deg,
        translation_range_mm: ranges.translation_mm,
        source: ranges.source,
    }
}

fn root_joint(shape: &Shape) -> Joint {
    let free = anatomy::unlimited();
    Joint {
        name: "root".into(),
        centre: shape.centroid,
        axes: Matrix3::identity(),
        rotation_range_deg: free.rotation_deg,
        translation_range_mm: free.translation_mm,
        source: free.source,
    }
}
