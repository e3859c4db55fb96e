//! A made-up run for the tests of this room: an ellipsoid head with two bones under a smooth known field.

use super::{OutputFile, Run};
use crate::chainmail::{LinkReport, Pruning};
use crate::config::InputRole;
use crate::evaluate::contact::{BoneOverlap, ContactReport, JointGap};
use crate::evaluate::couch::{CouchMatch, CouchResidual};
use crate::evaluate::{CellKinds, jacobian as jacobians, landmark, rigidity};
use crate::field::{ConsistencyReport, InverseReport, PullField, PushField};
use crate::findings;
use crate::fit::{BoneFit, DeterminedBy, Stop};
use crate::geometry::{Grid, Rigid, about};
use crate::pipeline::{Case, GuideReached, Outcome, OutlineAgreement, VolumeReached};
use crate::provenance::InputFile;
use crate::runtime::StageTime;
use crate::skeleton::{Bone, Joint, Skeleton};
use crate::stats::Summary;
use crate::volume::{LabelMap, Volume, trilinear};
use crate::warning::Warning;
use nalgebra::{Matrix3, Point3, Vector3};
use serde_json::json;
use std::collections::BTreeMap;

/// How the scene is stored.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layout {
    /// Voxels along each axis.
    pub(super) size: [usize; 3],
    /// Spacing, mm.
    pub(super) spacing: [f64; 3],
    /// World shift of the fraction's scanner origin, mm.
    pub(super) offset: [f64; 3],
}

/// A small scene, quick to draw.
pub(super) fn small() -> (Case, Outcome, Run) {
    scene(Layout { size: [60, 48, 30], spacing: [4.0, 4.0, 6.0], offset: [0.0; 3] })
}

const TURN_CENTRE: Point3<f64> = Point3::new(0.0, 20.0, -40.0);

/// The upper bone turns about [`TURN_CENTRE`], the lower one stays; in between the turn fades.
fn motion(p: &Point3<f64>) -> Rigid {
    let share = ((p.z + 40.0) / 60.0).clamp(0.0, 1.0);
    about(&TURN_CENTRE, Vector3::new(0.12, 0.0, 0.08) * share, Vector3::zeros())
}

/// A head: skin, an off-centre cavity, two box-shaped bones and a nose towards the front (-y).
fn head(p: &Point3<f64>) -> (f32, u16, bool) {
    let skin = (p.x / 85.0).powi(2) + (p.y / 75.0).powi(2) + (p.z / 80.0).powi(2);
    let nose = p.x.abs() < 12.0 && p.y > -88.0 && p.y < -60.0 && p.z.abs() < 14.0;
    let inside = skin < 1.0 || nose;
    let label = match (p.x.abs() < 22.0 && (p.y - 25.0).abs() < 18.0, p.z) {
        (true, z) if (20.0..60.0).contains(&z) => 1,
        (true, z) if (-66.0..-40.0).contains(&z) => 2,
        _ => 0,
    };
    let cavity = (p - Point3::new(-30.0, -25.0, 10.0)).norm() < 14.0;
    let hu = match (inside, label, cavity) {
        (false, ..) => -1000.0,
        (_, 1 | 2, _) => 800.0,
        (.., true) => -950.0,
        _ => 40.0 - 120.0 * f64::from(skin > 0.85) + 0.3 * p.x,
    };
    (hu as f32, label, inside)
}

/// The couch shift of the scene, matched on its vertebra.
fn couch(offset: Vector3<f64>) -> CouchMatch {
    let left = |bone: &str, matched, shift_mm, rotation_mm| CouchResidual {
        bone: bone.to_owned(),
        matched,
        shift_mm,
        rotation_mm,
    };
    CouchMatch {
        on: vec!["vertebrae_C4".into()],
        chosen: "bones of the spine nearest the middle of what both scans show".into(),
        shift_mm: offset.into(),
        rotation_deg: [1.0, 0.0, -0.5],
        centre: [0.0; 3],
        residuals: vec![left("skull", false, 4.25, 3.75), left("vertebrae_C4", true, 0.75, 0.25)],
    }
}

/// The scene with a perfect registration, but for landmarks that are off by up to 1 mm.
#[expect(clippy::too_many_lines, reason = "one scene, spelled out")]
pub(super) fn scene(layout: Layout) -> (Case, Outcome, Run) {
    let grid = |offset: [f64; 3]| {
        let origin = std::array::from_fn(|a| offset[a] - (layout.size[a] - 1) as f64 * layout.spacing[a] / 2.0);
        Grid::axis_aligned(layout.size, layout.spacing, origin).unwrap()
    };
    let offset = Vector3::from(layout.offset);
    let (grid, fraction_grid) = (grid([0.0; 3]), grid(layout.offset));
    let at = |l: usize| grid.centre(grid.voxel(l));
    let planning = Volume::from_fn(grid.clone(), |l| head(&at(l)).0);
    let body = Volume::from_fn(grid.clone(), |l| head(&at(l)).2);
    let names = BTreeMap::from([(1, "skull".to_owned()), (2, "vertebrae_C4".to_owned())]);
    let bones = LabelMap { volume: Volume::from_fn(grid.clone(), |l| head(&at(l)).1), names };
    let forward = |p: &Point3<f64>| motion(p) * p + offset;
    let displacement = Volume::from_fn(grid.clone(), |l| (forward(&at(l)) - at(l)).map(|c| c as f32).into());
    let push = PushField { displacement, computed: Volume::filled(grid.clone(), true) };
    let backward = |y: Point3<f64>| (0..20).fold(y - offset, |x, _| x + (y - forward(&x)));
    let to = |l: usize| fraction_grid.centre(fraction_grid.voxel(l));
    let pull = PullField {
        displacement: Volume::from_fn(fraction_grid.clone(), |l| (backward(to(l)) - to(l)).map(|c| c as f32).into()),
        inside: Volume::filled(fraction_grid.clone(), true),
    };
    let planning_on_fraction = Volume::from_fn(fraction_grid.clone(), |l| {
        trilinear(&planning, &grid.index(&backward(to(l)))).unwrap_or(-1000.0) as f32
    });
    let fraction = Volume::from_fn(fraction_grid.clone(), |l| head(&backward(to(l))).0);
    let bones_on_fraction = LabelMap {
        volume: Volume::from_fn(fraction_grid.clone(), |l| head(&backward(to(l))).1),
        names: bones.names.clone(),
    };
    let landmarks = landmarks(forward);
    let rigid = [(1, "skull".to_owned()), (2, "vertebrae_C4".to_owned())];
    let tissue = jacobians::tissue(&body, &planning);
    let (map, mut jacobian_report) = jacobians::evaluate(&push, &CellKinds::new(&tissue, &bones, &rigid, &[]));
    let contact = [0.9, -1.0, 1.1];
    jacobian_report.contact = jacobians::stats(&[&contact]);
    jacobian_report.all = jacobians::stats(&[map.to_volume().data(), &contact]);
    let outcome = Outcome {
        skeleton: Skeleton { bones: skeleton() },
        pose: Default::default(),
        common_shift: offset,
        couch: couch(offset),
        posterior: None,
        agreement: None,
        kind: None,
        bone_fits: fits(offset),
        weighed: Default::default(),
        body,
        pull,
        planning_on_fraction,
        bones_on_fraction: bones_on_fraction.into(),
        jacobian: map,
        jacobian_report,
        rigidity: rigidity::evaluate(&push, &bones, &rigid),
        contact: ContactReport {
            overlaps: vec![BoneOverlap {
                bones: ["skull".into(), "vertebrae_C4".into()],
                depth_mm: 1.34,
                at: TURN_CENTRE,
            }],
            joints: vec![JointGap {
                bones: ["skull".into(), "vertebrae_C4".into()],
                planning_mm: 1.25,
                fraction_mm: 2.5,
                play_mm: 3.0,
            }],
            ..ContactReport::default()
        },
        skin_contact: None,
        volume_changes: vec![VolumeReached { organ: "parotid_left".into(), factor: 0.8, reached: Some(0.81) }],
        guides: vec![GuideReached {
            name: "bladder".into(),
            planning_ml: 120.0,
            fraction_ml: 180.0,
            before: Some(OutlineAgreement { dice: 0.81, mean_mm: 3.2, p95_mm: 7.5 }),
            after: Some(OutlineAgreement { dice: 0.97, mean_mm: 0.4, p95_mm: 1.1 }),
            images: Some([0.7, 0.9]),
            folded: 0,
        }],
        uncertainty: None,
        pruning: Some(Pruning { waves: 3, of: 42, each_percent: 0.024, together_percent: 0.073, most_mm: 0.02 }),
        links: LinkReport {
            links: 400_000,
            violated: 1200,
            violated_percent: 0.3,
            mean_excess_mm: 0.05,
            p95_excess_mm: 0.2,
            max_excess_mm: 0.7,
        },
        inverse: InverseReport {
            residual_mm: Summary::of(&[0.001, 0.004, 0.01]),
            voxels: fraction_grid.len(),
            ..Default::default()
        },
        consistency: ConsistencyReport {
            there_and_back_mm: Summary::of(&[0.01, 0.02, 0.3]),
            beyond: 0,
            beyond_before: 40,
            moved_mm: 0.9,
        },
        landmarks: Some(landmark::evaluate(&push, &landmarks)),
        push,
        warnings: vec![Warning::new(findings::BONE_IN_PIECES, "skull: 2 pieces, <largest> 98 %; check the label map")],
        regions: None,
    };
    let inputs = [(InputRole::Planning, "01"), (InputRole::Bones, "23"), (InputRole::Fraction, "45")]
        .map(|(role, digits)| InputFile::new(role, format!("case/{role}.nii.gz").into(), digits.repeat(32)));
    let mut case = Case::new(planning, bones, fraction);
    case.fraction.landmarks = landmarks;
    let outputs = vec![OutputFile {
        name: "planning_to_fraction.nii.gz".into(),
        what: "push field on the planning grid, LPS mm".into(),
        sha256: "0".repeat(64),
    }];
    let run = Run {
        command: "aventail register --planning case/planning.nii.gz".into(),
        settings: json!({"fit": {"levels": 3}}),
        inputs: inputs.into(),
        threads: 2,
        stages: [("read", 0.9), ("body", 1.4), ("fit skeleton", 12.5), ("propagate", 8.2), ("invert", 2.1)]
            .map(|(stage, seconds)| StageTime { stage: stage.into(), seconds, processor_seconds: None })
            .into(),
        outputs,
        limits: Default::default(),
    };
    (case, outcome, run)
}

/// Points around the head, each off by a known small amount.
fn landmarks(forward: impl Fn(&Point3<f64>) -> Point3<f64>) -> Vec<landmark::Landmark> {
    let spot = |i: usize| {
        let a = i as f64 * 2.4;
        Point3::new(50.0 * a.cos(), 40.0 * a.sin(), i as f64 * 9.0 - 50.0)
    };
    (0..12)
        .map(|i| landmark::Landmark {
            name: format!("landmark_{i}"),
            planning: spot(i),
            fraction: forward(&spot(i)) + Vector3::new(0.0, 0.0, i as f64 / 11.0),
        })
        .collect()
}

fn skeleton() -> Vec<Bone> {
    let bone = |name: &str, label, parent, z| Bone {
        name: name.into(),
        label,
        parent,
        joint: Joint {
            name: "neck".into(),
            centre: TURN_CENTRE,
            axes: Matrix3::identity(),
            rotation_range_deg: [[-30.0, 30.0]; 3],
            translation_range_mm: [2.0; 3],
            source: "made up".into(),
        },
        centroid: Point3::new(0.0, 25.0, z),
        volume_mm3: 5e4,
    };
    vec![bone("vertebrae_C4", 2, None, -53.0), bone("skull", 1, Some(0), 40.0)]
}

fn fits(offset: Vector3<f64>) -> Vec<BoneFit> {
    let fit = |name: &str, p: Point3<f64>, visible: f64, determined_by: DeterminedBy| {
        let transform = about(&p, Vector3::zeros(), offset) * motion(&p);
        BoneFit {
            name: name.into(),
            transform,
            visible,
            similarity_before: Some(0.41),
            similarity_after: Some(0.93),
            stop: Stop::Converged,
            position_sd_mm: 0.08,
            unsettled_mm: 0.0002,
            rotation_sd_deg: 0.11,
            beyond_range: Default::default(),
            motion_mm: (transform * p - p).norm(),
            determined_by,
        }
    };
    vec![
        fit("vertebrae_C4", Point3::new(0.0, 25.0, -53.0), 1.0, DeterminedBy::Image),
        fit("skull", Point3::new(0.0, 25.0, 40.0), 0.85, DeterminedBy::Image),
    ]
}
