//! Characteristics of a Jacobian map (thesis Tab. 2).

use serde::{Deserialize, Serialize};

/// The five characteristics of thesis Tab. 2 over a set of cells.
///
/// Cells with any negative tetrahedron count as folded (-1); the other four describe the positive cells.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct JacobianStats {
    /// Number of cells.
    pub cells: usize,
    /// Number of folded cells.
    pub folded: usize,
    /// Folded cells in percent.
    pub folded_percent: f64,
    /// Positive cells that more than double their volume, percent.
    pub above_2_percent: f64,
    /// Positive cells that shrink to less than half, percent.
    pub below_half_percent: f64,
    /// Mean over positive cells.
    pub mean: f64,
    /// Greatest value.
    pub max: f64,
}

/// Jacobian characteristics of a whole run. Cells are tissue cells: all 8 corners body above -500 HU.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct JacobianReport {
    /// All tissue cells, contact cells left out.
    pub body: JacobianStats,
    /// Tissue cells with no bone corner.
    pub soft_tissue: JacobianStats,
    /// Contact cells: corners in two or more bones; where rigid bones slide or meet even the truth folds.
    pub contact: JacobianStats,
    /// Cells wholly inside one bone, by bone name.
    pub bones: Vec<(String, JacobianStats)>,
    /// Soft-tissue cells that fail the stricter digital criterion (any of 10 finite-difference determinants <= 0).
    pub digital_folded: usize,
    /// Pairs of neighbouring body cells whose Jacobians differ by more than 10 (thesis 2.3.2).
    pub jumps_above_10: usize,
}
