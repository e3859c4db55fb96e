//! The scene that is timed: the phantom on the thesis's grid, its skeleton, its true motion, and a field.

use super::Task;
use crate::body;
use crate::chainmail::{ChainmailOptions, Initiators, Lattice, Organs, Tissue, propagate};
use crate::error::{Error, Result};
use crate::evaluate::{CellKinds, jacobian};
use crate::field::{InvertOptions, PullField, PushField, invert};
use crate::io::{self, Stored, WriteOptions};
use crate::phantom::{Phantom, PhantomOptions};
use crate::progress::Silent;
use crate::refine::{Images, Kind, RefineOptions, Scan};
use crate::volume::Mask;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// How large the scene is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SceneSize {
    /// The thesis's scan: 512 x 512 x 126 voxels of 0.98 x 0.98 x 3 mm.
    Full,
    /// Half the voxels along i and j.
    Half,
    /// A quarter of the voxels along i and j.
    Quarter,
    /// The phantom of tests, 5 x 5 x 6 mm.
    Tiny,
}

impl SceneSize {
    /// The phantom's options.
    pub fn phantom(self) -> PhantomOptions {
        let full = PhantomOptions::thesis_scale();
        let by = |n: usize| PhantomOptions {
            size: [full.size[0] / n, full.size[1] / n, full.size[2]],
            spacing_mm: [full.spacing_mm[0] * n as f64, full.spacing_mm[1] * n as f64, full.spacing_mm[2]],
            ..full.clone()
        };
        match self {
            Self::Full => by(1),
            Self::Half => by(2),
            Self::Quarter => by(4),
            Self::Tiny => PhantomOptions::coarse(),
        }
    }
}

/// Everything that the tasks work on.
pub struct Scene {
    /// Images, labels, skeleton and true motion.
    pub phantom: Phantom,
    /// Voxels that take part in the chain mail.
    pub active: usize,
    /// The motion that the default propagation finds without images.
    pub push: PushField,
    /// Its inverse on the fraction grid.
    pub pull: PullField,
    bone_of_label: Vec<Option<u16>>,
    centroids: Vec<Point3<f64>>,
    /// Elements at every voxel, for the tasks that need them.
    pub(super) lattice: Option<Lattice>,
    /// What the cells of the planning grid hold, for the tasks that need it.
    pub(super) cells: Option<CellKinds>,
    /// The patient in the fraction CT, for the tasks that need him.
    pub(super) fraction_body: Option<Mask>,
    /// The planning CT as a file.
    pub(super) planning_file: PathBuf,
    /// Where the field is written.
    pub(super) field_file: PathBuf,
    folder: PathBuf,
}

impl Drop for Scene {
    fn drop(&mut self) {
        // Nothing depends on it: the system's folder for temporary files is cleared anyway.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

impl Scene {
    /// Makes the scene with what these tasks need.
    ///
    /// # Errors
    /// When the folder for temporary files cannot be written to.
    pub fn new(size: SceneSize, tasks: &[Task]) -> Result<Self> {
        let phantom = Phantom::new(&size.phantom())?;
        let mut bone_of_label = vec![None; usize::from(u16::MAX) + 1];
        for (b, bone) in phantom.skeleton.bones.iter().enumerate() {
            bone_of_label[usize::from(bone.label)] = Some(b as u16);
        }
        let centroids: Vec<Point3<f64>> = phantom.skeleton.bones.iter().map(|b| b.centroid).collect();
        let folder = std::env::temp_dir().join(format!("aventail-bench-{}", std::process::id()));
        let refuse = |e: std::io::Error| Error::write(&folder, e.to_string(), "set TMPDIR to a folder with room");
        std::fs::create_dir(&folder).map_err(refuse)?;
        let planning_file = folder.join("planning_ct.nii.gz");
        io::write_image(&planning_file, &phantom.planning, Stored::Int16, &WriteOptions::default())?;
        let options = ChainmailOptions::default();
        let (tissue, bones) = parts(&phantom, &bone_of_label, &centroids, &options);
        let push = propagate(&tissue, &bones, &options, None, &Silent)?.push;
        let (pull, _) = invert(&push, phantom.fraction.grid(), None, &InvertOptions::default())?;
        let needs = |wanted: &[Task]| tasks.iter().any(|t| wanted.contains(t));
        let lattice = needs(&[Task::Prioritised, Task::Superposition])
            .then(|| Lattice::new(&tissue, &options.material, &Organs::default(), 0.0));
        let patient = || body::find(&phantom.fraction, None, &body::BodyOptions::default());
        let fraction_body = needs(&[Task::PropagationWithImages]).then(patient).transpose()?;
        let cells = needs(&[Task::Characteristics]).then(|| find_cells(&phantom));
        let active = (0..phantom.planning.grid().len()).filter(|&v| tissue.active(v)).count();
        let field_file = folder.join("planning_to_fraction.nii.gz");
        Ok(Self {
            phantom,
            active,
            push,
            pull,
            bone_of_label,
            centroids,
            lattice,
            cells,
            fraction_body,
            planning_file,
            field_file,
            folder,
        })
    }

    /// What the chain mail works on.
    pub(super) fn chainmail(&self, options: &ChainmailOptions) -> (Tissue<'_>, Initiators<'_>) {
        parts(&self.phantom, &self.bone_of_label, &self.centroids, options)
    }

    /// What the cells of the planning grid hold.
    pub(super) fn find_cells(&self) -> CellKinds {
        find_cells(&self.phantom)
    }

    /// Both images, as the pipeline prepares them; nothing is kept from one run to the next.
    pub(super) fn images(&self) -> Option<Images<'_>> {
        let planning = Scan { ct: &self.phantom.planning, body: &self.phantom.body };
        let fraction = |body| Scan { ct: &self.phantom.fraction, body };
        let of = |body| Images::new(planning, fraction(body), Kind::default(), &RefineOptions::default(), None, None);
        self.fraction_body.as_ref().map(of)
    }
}

fn find_cells(phantom: &Phantom) -> CellKinds {
    let inside = jacobian::tissue(&phantom.body, &phantom.planning);
    CellKinds::new(&inside, &phantom.bones, &phantom.skeleton.labels_and_names(), &[])
}

fn parts<'a>(
    phantom: &'a Phantom,
    bone_of_label: &'a [Option<u16>],
    centroids: &'a [Point3<f64>],
    options: &ChainmailOptions,
) -> (Tissue<'a>, Initiators<'a>) {
    let tissue = Tissue {
        ct: &phantom.planning,
        body: &phantom.body,
        labels: &phantom.bones,
        bone_of_label,
        lung: None,
        sliding: None,
        least_hu: options.least_hu,
    };
    (tissue, Initiators { transforms: &phantom.transforms, centroids })
}
