//! What a phantom is, and the command that registers it.

use crate::volume::{LabelMap, Volume};
use crate::warning::counted;
use std::path::Path;

/// What was made, and how to register it: with its organs, where there are some.
pub(super) fn text(
    out: &Path,
    bones: &LabelMap,
    landmarks: usize,
    [planning, fraction]: [&Volume<f32>; 2],
    organs: bool,
) -> String {
    let (planning, fraction) = (planning.grid().size(), fraction.grid().size());
    let out = out.display();
    let organs = if organs { format!(" --organs {out}/organs.nii.gz") } else { String::new() };
    format!(
        "{}, {landmarks} landmarks, planning {planning:?} voxels, fraction {fraction:?} voxels\nRegister it with\n  aventail register --planning {out}/planning_ct.nii.gz --bones {out}/bones.nii.gz{organs} --fraction {out}/fraction_ct.nii.gz --landmarks {out}/landmarks.csv --out {out}/result",
        counted(bones.names.len(), "bone", "bones")
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn a_chest_is_registered_with_its_organs() {
        let grid = Grid::axis_aligned([2; 3], [1.0; 3], [0.0; 3]).unwrap();
        let (ct, labels) = (Volume::filled(grid.clone(), 0.0), Volume::filled(grid, 0));
        let bones = LabelMap { volume: labels, names: [(1, "sternum".to_owned())].into() };
        let told = |organs| text(Path::new("chest"), &bones, 12, [&ct, &ct], organs);
        assert!(
            told(true).contains("--bones chest/bones.nii.gz --organs chest/organs.nii.gz --fraction"),
            "{}",
            told(true)
        );
        assert!(
            !told(false).contains("--organs") && told(false).starts_with("1 bone, 12 landmarks"),
            "{}",
            told(false)
        );
    }
}
