//! The phantom as what is registered.

use super::Phantom;
use crate::evaluate::jacobian::tissue;
use crate::evaluate::landmark::Landmark;
use crate::pipeline::Case;

/// The phantom as its files would be read: its skeleton is left to be built.
impl From<Phantom> for Case {
    fn from(phantom: Phantom) -> Self {
        let mut case = Self::new(phantom.planning, phantom.bones, phantom.fraction);
        case.fraction.landmarks = phantom.landmarks;
        case
    }
}

/// Points whose true motion tells the error on a phantom.
const POINTS: usize = 20_000;

/// The phantom as a case whose landmarks are points all over its soft tissue with their true positions.
pub fn phantom_case(phantom: Phantom) -> Case {
    let grid = phantom.planning.grid();
    let soft = tissue(&phantom.body, &phantom.planning);
    let is_soft = |&v: &usize| soft.data()[v] && phantom.bones.volume.data()[v] == 0;
    let all: Vec<usize> = (0..grid.len()).filter(is_soft).collect();
    let every = (all.len() / POINTS).max(1);
    let fraction = phantom.fraction.grid();
    let landmark = |&v: &usize| {
        let planning = grid.centre(grid.voxel(v));
        Landmark { name: v.to_string(), planning, fraction: phantom.push(&planning) }
    };
    let seen = |l: &Landmark| fraction.contains(&fraction.index(&l.fraction));
    let landmarks = all.iter().step_by(every).map(landmark).filter(seen).collect();
    let mut case = Case::from(phantom);
    case.fraction.landmarks = landmarks;
    case
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phantom::PhantomOptions;
    use crate::pipeline;
    use aventail_base::runtime::Runtime;
    use aventail_registration::config::Config;
    use aventail_tissue::refine::RefineOptions;

    #[test]
    fn the_error_is_that_of_the_settings_and_not_of_the_points() {
        let case = phantom_case(Phantom::new(&PhantomOptions::coarse()).unwrap());
        assert!(case.fraction.landmarks.len() > 10_000);
        let runtime = Runtime::silent().unwrap();
        // Nothing that comes after the images plays a part here.
        let mut by_images = Config::default();
        by_images.consistency.rounds = 0;
        by_images.output.uncertainty = false;
        let by_bones =
            Config { refine: RefineOptions { weight: 0.0, ..RefineOptions::default() }, ..by_images.clone() };
        let [with, without] =
            [&by_images, &by_bones].map(|config| pipeline::measure(&case, None, config, &runtime).unwrap());
        assert!(with.error_mm.mean > 0.0 && with.error_mm.mean < without.error_mm.mean, "{with:?} {without:?}");
        assert!(with.seconds > 0.0 && with.stages.len() > 5);
        let mut blind = case;
        blind.fraction.landmarks.clear();
        assert_eq!(pipeline::measure(&blind, None, &Config::default(), &runtime).unwrap_err().exit_code(), 4);
    }
}
