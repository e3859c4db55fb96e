//! Bones that an image of another modality does not place, placed by the skin around them.

use super::PlanningScan;
use super::couch::Couch;
use super::fraction::Fraction;
use super::moved::{Moved, bones_alone};
use super::planning::Resting;
use crate::chainmail::ChainMail;
use crate::config::Config;
use crate::error::Result;
use crate::fit::{BeyondRange, DeterminedBy, FitResult, SkinPoint, Stop, TurnedBySkin, turn_by_skin};
use crate::geometry::Rigid;
use crate::skeleton::Skeleton;
use crate::view::View;
use crate::volume::signed::{measured_depth, within_edges};
use crate::volume::{Mask, Volume, trilinear_vector};
use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};
use rayon::prelude::*;

/// A turn whose effect on the skin is looked at, degrees.
const TRIED_DEG: f64 = 5.0;
/// Distances to the fraction's skin are known up to this one, mm.
const KNOWN_MM: f64 = 40.0;
/// Points of the skin at most.
const POINTS: usize = 20_000;
/// Nearer to an end of planning its outline is a cut, mm.
const EDGE_MM: f64 = 3.0;
/// A turn by less than this needs no second look at its effect, degrees; looks at most.
const SETTLED_DEG: f64 = 5.0;
const ROUNDS: usize = 3;
/// Less skin in view does not place a bone, mm^2, nor does skin that lies farther off than this afterwards, or hardly nearer than
/// before, mm (docs/decisions/mr.md).
const LEAST_MM2: f64 = 2000.0;
const MOST_OFF_MM: f64 = 4.0;
const LEAST_NEARER_MM: f64 = 0.3;

/// A patient with the bones as the image places them.
pub(super) struct Unplaced<'a> {
    pub(super) scan: &'a PlanningScan,
    pub(super) skeleton: &'a Skeleton,
    pub(super) body: &'a Mask,
    pub(super) resting: &'a Resting,
    pub(super) config: &'a Config,
}

impl Unplaced<'_> {
    /// Places bones that follow far-turning joints, and what hangs on them, by the skin of the fraction.
    ///
    /// # Errors
    /// As the chain mail.
    pub(super) fn by_skin(&self, fit: &mut FitResult, fraction: &Fraction<'_>) -> Result<()> {
        let Some(chain_mail) = self.resting.chain_mail.as_deref() else { return Ok(()) };
        let groups = groups(self.skeleton, fit);
        if groups.is_empty() {
            return Ok(());
        }
        let couch = Couch::of(fit, self.scan.ct.grid(), self.config.chainmail.variant.carry);
        let skin = measured_depth(&fraction.body, |n| !fraction.ct.data()[n].is_nan(), KNOWN_MM);
        let (points, area) = outline(self.body, View::of_ends(&self.scan.ct).measured());
        let seen = Seen { chain_mail, couch: &couch, skin: couch.volume(skin), points, area };
        for group in groups {
            if let Some((transforms, turned)) = self.turned(fit, group[0], &seen)? {
                self.place(fit, &group, transforms, &turned, fraction);
            }
        }
        Ok(())
    }

    /// The motions of all bones after the joint of a group's first bone, `root`, has turned, where the skin tells how.
    fn turned(&self, fit: &FitResult, root: usize, seen: &Seen<'_>) -> Result<Option<(Vec<Rigid>, TurnedBySkin)>> {
        let Self { scan, skeleton, body, resting, config } = *self;
        let carried = |transforms: &[Rigid]| {
            let transforms = seen.couch.transforms(transforms);
            bones_alone(seen.chain_mail, &Moved { scan, skeleton, body, transforms: &transforms, resting, config })
        };
        let (mut transforms, mut before) = (fit.transforms.clone(), None);
        for round in 1..=ROUNDS {
            let as_is = carried(&transforms)?;
            let by_axis = |axis: usize| {
                let turn = Vector3::ith(axis, TRIED_DEG);
                carried(&with_turn(skeleton, &transforms, root, &turn))
            };
            let by_axis = [by_axis(0)?, by_axis(1)?, by_axis(2)?];
            let point = |at: &Point3<f64>| {
                let u = |field: &Volume<[f32; 3]>| trilinear_vector(field, &field.grid().index_within(at));
                let now = u(&as_is)?;
                let mut by_turn = Matrix3::zeros();
                for (axis, field) in by_axis.iter().enumerate() {
                    by_turn.set_column(axis, &((u(field)? - now) / TRIED_DEG));
                }
                Some(SkinPoint { place: at + now, by_turn })
            };
            let points: Vec<SkinPoint> = seen.points.par_iter().filter_map(point).collect();
            let now = Vector3::from(skeleton.pose_of(&transforms).joints[root].rotation).map(f64::to_degrees);
            let Some(found) = turn_by_skin(&points, &seen.skin, seen.area, now)? else { return Ok(None) };
            transforms = with_turn(skeleton, &transforms, root, &found.by_deg);
            let off = *before.get_or_insert(found.off_mm[0]);
            if round == ROUNDS || found.by_deg.norm() < SETTLED_DEG {
                let told = found.seen as f64 * seen.area >= LEAST_MM2
                    && found.off_mm[1] <= MOST_OFF_MM
                    && found.off_mm[1] <= off - LEAST_NEARER_MM;
                return Ok(told.then_some((transforms, found)));
            }
        }
        Ok(None)
    }

    /// Enters a group's place into the fit.
    fn place(
        &self,
        fit: &mut FitResult,
        group: &[usize],
        transforms: Vec<Rigid>,
        turned: &TurnedBySkin,
        fraction: &Fraction<'_>,
    ) {
        let root = &self.skeleton.bones[group[0]];
        let centre = transforms[group[0]] * root.joint.centre;
        let parent = root.parent.map_or_else(UnitQuaternion::identity, |parent| transforms[parent].rotation);
        let axes = parent.to_rotation_matrix() * root.joint.axes;
        let sd_deg = turned.covariance.symmetric_eigenvalues().max().max(0.0).sqrt();
        let pose = self.skeleton.pose_of(&transforms);
        let excess = self.skeleton.excess(&pose);
        for &b in group {
            let bone = &self.skeleton.bones[b];
            // What a turn about each axis does to the bone's middle, mm per degree.
            let lever = transforms[b] * bone.centroid - centre;
            let by_turn = Matrix3::from_columns(&[0, 1, 2].map(|a| axes.column(a).cross(&lever) * 1f64.to_radians()));
            let open = by_turn * turned.covariance * by_turn.transpose();
            let open_mm = open.symmetric_eigenvalues().max().max(0.0).sqrt();
            let told = &mut fit.bones[b];
            told.visible = in_view(self.scan, bone.label, &transforms[b], fraction);
            told.similarity_after = None;
            told.stop = Stop::Other("placed by the skin".into());
            told.unsettled_mm = 0.0;
            told.rotation_sd_deg = sd_deg;
            // What the turn leaves of the skin's distance is no better known of the bone.
            told.position_sd_mm = open_mm.hypot(turned.off_mm[1]);
            told.beyond_range = BeyondRange::of(&excess[b]);
            told.motion_mm = (transforms[b] * bone.centroid - bone.centroid).norm();
            told.transform = transforms[b];
            told.determined_by = DeterminedBy::Skin;
        }
        (fit.pose, fit.transforms) = (pose, transforms);
    }
}

/// What the skin is compared with.
struct Seen<'a> {
    chain_mail: &'a ChainMail,
    couch: &'a Couch,
    /// Signed distance to the fraction's skin, mm, in the frame of the couch.
    skin: Volume<f32>,
    /// Points of planning's skin, and the area that each stands for, mm^2.
    points: Vec<Point3<f64>>,
    area: f64,
}

/// Bones that follow a joint which turns far, each with all that hangs on it; none where the image places a part of that.
fn groups(skeleton: &Skeleton, fit: &FitResult) -> Vec<Vec<usize>> {
    let lost = |b: usize| fit.bones[b].determined_by == DeterminedBy::Joint;
    let mut out: Vec<Vec<usize>> = Vec::new();
    for (b, bone) in skeleton.bones.iter().enumerate() {
        let taken = out.iter().any(|group| group.contains(&b));
        if taken || bone.parent.is_none() || !lost(b) || !bone.joint.turns_far() {
            continue;
        }
        let group = skeleton.with_what_hangs_on(b);
        if group.iter().all(|&b| lost(b)) {
            out.push(group);
        }
    }
    out
}

/// The motions of all bones after the joint of a bone has turned farther about its axes, degrees.
fn with_turn(skeleton: &Skeleton, transforms: &[Rigid], bone: usize, by_deg: &Vector3<f64>) -> Vec<Rigid> {
    let mut pose = skeleton.pose_of(transforms);
    let rotation = &mut pose.joints[bone].rotation;
    (0..3).for_each(|a| rotation[a] += by_deg[a].to_radians());
    skeleton.transforms(&pose)
}

/// Points of the patient's outline in the planes of the slices, where these were measured, evenly chosen, and the area that each
/// stands for, mm^2.
fn outline(body: &Mask, measured: Option<&Mask>) -> (Vec<Point3<f64>>, f64) {
    let grid = body.grid();
    let (size, strides) = (grid.size(), grid.strides());
    let at_skin = |n: &usize| {
        let at = grid.voxel(*n);
        let beside = |a: usize| {
            at[a] == 0 || at[a] + 1 == size[a] || !body.data()[n - strides[a]] || !body.data()[n + strides[a]]
        };
        let known = measured.is_none_or(|m| m.data()[*n]);
        body.data()[*n] && known && (beside(0) || beside(1)) && within_edges(grid, &grid.centre(at)) >= EDGE_MM
    };
    let all: Vec<usize> = (0..grid.len()).into_par_iter().filter(at_skin).collect();
    let every = all.len().div_ceil(POINTS).max(1);
    let area = grid.voxel_volume().powf(2.0 / 3.0) * every as f64;
    (all.into_iter().step_by(every).map(|n| grid.centre(grid.voxel(n))).collect(), area)
}

/// Share of a bone's voxels that lie where the fraction was measured.
fn in_view(scan: &PlanningScan, label: u16, motion: &Rigid, fraction: &Fraction<'_>) -> f64 {
    let (labels, there) = (&scan.bones.volume, fraction.ct.grid());
    let own = labels.data().iter().enumerate().filter(|(_, l)| **l == label);
    let seen = |n: usize| {
        let place = motion * labels.grid().centre(labels.grid().voxel(n));
        there.voxel_at(&place).is_some_and(|voxel| !fraction.ct.at(voxel).is_nan())
    };
    let (all, seen) = own.fold((0usize, 0usize), |(all, some), (n, _)| (all + 1, some + usize::from(seen(n))));
    seen as f64 / all.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::super::small;
    use super::*;
    use crate::chainmail::Carry;
    use crate::config::Modality;
    use crate::geometry::{Grid, about};
    use crate::runtime::Runtime;
    use crate::view::ViewReport;
    use crate::volume::LabelMap;
    use std::borrow::Cow;

    /// A trunk with a shoulder, LPS mm.
    fn inside(p: &Point3<f64>) -> bool {
        let ball = |x: f64, [a, b, c]: [f64; 3]| ((p.x - x) / a).powi(2) + (p.y / b).powi(2) + (p.z / c).powi(2) < 1.0;
        ball(0.0, [60.0, 45.0, 80.0]) || ball(70.0, [65.0, 32.0, 34.0])
    }

    /// Planning with a vertebra and a clavicle that hangs on it.
    fn planning() -> (PlanningScan, Skeleton, Mask) {
        let grid = Grid::axis_aligned([62, 34, 44], [4.0; 3], [-82.0, -66.0, -86.0]).unwrap();
        let at = |n: usize| grid.centre(grid.voxel(n));
        let label = |n: usize| {
            let p = at(n);
            let within =
                |low: f64, high: f64, half: f64| (low..high).contains(&p.x) && p.y.abs() < half && p.z.abs() < half;
            if within(-14.0, 14.0, 14.0) { 1 } else { 2 * u16::from(within(22.0, 110.0, 8.0)) }
        };
        let names = [(1, "vertebrae_T1".to_owned()), (2, "clavicula_left".to_owned())];
        let labels = LabelMap { volume: Volume::from_fn(grid.clone(), label), names: names.into_iter().collect() };
        let body = Volume::from_fn(grid.clone(), |n| inside(&at(n)));
        let ct = Volume::from_fn(grid.clone(), |n| if body.data()[n] { 40.0 } else { -1000.0 });
        let mut skeleton = Skeleton {
            bones: vec![
                small::bone(1, "vertebrae_T1", Point3::origin()),
                small::bone(2, "clavicula_left", Point3::new(66.0, 0.0, 0.0)),
            ],
        };
        skeleton.bones[1].parent = Some(0);
        skeleton.bones[1].joint.centre = Point3::new(16.0, 0.0, 0.0);
        skeleton.bones[1].joint.rotation_range_deg = [[-50.0, 50.0]; 3];
        (PlanningScan::new(ct, labels), skeleton, body)
    }

    /// Where a fit has the bones, of a clavicle that is not found, after `turn` (degrees) at its joint in truth; `weight` is that of
    /// the images in soft tissue.
    fn placed(turn: Vector3<f64>, weight: f64) -> (FitResult, Rigid) {
        let (scan, skeleton, body) = planning();
        let mut config = Config::default();
        config.fraction.modality = Modality::Mr;
        config.refine.weight = weight;
        let runtime = Runtime::silent().unwrap();
        let resting = Resting::new(&scan, &skeleton, &body, false, &config, &runtime).unwrap();
        let common = Rigid::translation(30.0, -6.0, 11.0);
        let mut fit = small::fit([common; 2], common);
        fit.bones[1].name = "clavicula_left".into();
        fit.bones[1].determined_by = DeterminedBy::Joint;
        let truth = common * about(&skeleton.bones[1].joint.centre, turn.map(f64::to_radians), Vector3::zeros());
        let couch = Couch::of(&fit, scan.ct.grid(), Carry::Rigid);
        let transforms = couch.transforms(&[common, truth]);
        let moved = Moved {
            scan: &scan,
            skeleton: &skeleton,
            body: &body,
            transforms: &transforms,
            resting: &resting,
            config: &config,
        };
        let field = bones_alone(resting.chain_mail.as_deref().unwrap(), &moved).unwrap();
        // The patient there, by fixed points of the field's inverse; the first slices are blank.
        let there = scan.ct.grid().shifted(&common.translation.vector);
        let known = |n: usize| there.voxel(n)[2] > 1;
        let patient = |n: usize| {
            let y = there.centre(there.voxel(n)) - common.translation.vector;
            let mut x = y;
            for _ in 0..20 {
                x = y - trilinear_vector(&field, &field.grid().index_within(&x)).unwrap_or_default();
            }
            known(n) && inside(&x)
        };
        let body_there = Volume::from_fn(there.clone(), patient);
        let ct = Volume::from_fn(there.clone(), |n| match (known(n), body_there.data()[n]) {
            (false, _) => f32::NAN,
            (_, true) => 40.0,
            _ => -1000.0,
        });
        let view = ViewReport::default();
        let fraction = Fraction { ct: Cow::Owned(ct), body: body_there, view, mr: None, guides: Vec::new() };
        let unplaced = Unplaced { scan: &scan, skeleton: &skeleton, body: &body, resting: &resting, config: &config };
        unplaced.by_skin(&mut fit, &fraction).unwrap();
        (fit, truth)
    }

    #[test]
    fn a_clavicle_that_the_image_does_not_show_turns_with_its_shoulder() {
        let (fit, truth) = placed(Vector3::new(0.0, 7.0, -4.0), 1.0);
        let end = Point3::new(100.0, 0.0, 0.0);
        let [off, before] = [fit.transforms[1], fit.transforms[0]].map(|t| (t * end - truth * end).norm());
        assert!(before > 11.0 && off < 1.5, "{off} for {before}");
        let bone = &fit.bones[1];
        assert_eq!((bone.determined_by, bone.similarity_after), (DeterminedBy::Skin, None));
        assert!((bone.transform.translation.vector - fit.transforms[1].translation.vector).norm() < 1e-12);
        assert!(bone.visible > 0.95 && (0.5..4.0).contains(&bone.position_sd_mm), "{bone:?}");
        let turned = Vector3::from(fit.pose.joints[1].rotation).map(f64::to_degrees);
        assert!((turned - Vector3::new(0.0, 7.0, -4.0)).norm() < 1.5, "{turned}");
        assert_eq!(fit.bones[0].determined_by, DeterminedBy::Image);
    }

    #[test]
    fn skin_that_lies_where_the_joint_has_it_leaves_it_there() {
        // Whether images draw tissue or not.
        for weight in [1.0, 0.0] {
            let (fit, truth) = placed(Vector3::zeros(), weight);
            assert_eq!(fit.bones[1].determined_by, DeterminedBy::Joint);
            assert!((fit.transforms[1].translation.vector - truth.translation.vector).norm() < 1e-12);
        }
    }

    #[test]
    fn what_hangs_on_a_lost_joint_goes_with_it_unless_the_image_places_it() {
        let mut skeleton = planning().1;
        skeleton.bones.push(small::bone(3, "scapula_left", Point3::new(90.0, 10.0, 0.0)));
        skeleton.bones[2].parent = Some(1);
        let mut fit = small::fit([Rigid::identity(); 2], Rigid::identity());
        fit.bones.push(fit.bones[1].clone());
        let by = |fit: &mut FitResult, by: [DeterminedBy; 3]| {
            fit.bones.iter_mut().zip(by).for_each(|(bone, by)| bone.determined_by = by);
            groups(&skeleton, fit)
        };
        let [image, joint] = [DeterminedBy::Image, DeterminedBy::Joint];
        assert_eq!(by(&mut fit, [image, joint, joint]), [vec![1, 2]]);
        assert!(by(&mut fit, [image, joint, image]).is_empty() && by(&mut fit, [joint, image, image]).is_empty());
        // The scapula's own joint turns by 15 degrees only.
        assert!(by(&mut fit, [image, image, joint]).is_empty());
    }
}
