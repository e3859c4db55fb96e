//! Rank 5: simpler ways to carry the bones' motion to the voxels, to compare the chain mail with (thesis 4.2.3).

mod control_points;
mod nearest;
mod thin_plate;

pub use control_points::{ControlPoint, control_points};
pub use nearest::nearest_bone;
pub use thin_plate::{ThinPlate, thin_plate};

use crate::chainmail::Tissue;
use crate::error::Result;
use crate::field::PushField;
use crate::volume::Volume;

/// A push field from its displacements: computed where tissue takes part, as the chain mail's.
fn push_field(tissue: &Tissue<'_>, displacement: Vec<[f32; 3]>) -> Result<PushField> {
    let displacement = Volume::new(tissue.ct.grid().clone(), displacement)?;
    Ok(PushField { displacement, computed: tissue.computed() })
}
