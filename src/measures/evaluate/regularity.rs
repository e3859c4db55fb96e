//! How regular one field is, on its own grid: Jacobian characteristics and volumes, the digital-fold certificate, curl.

use super::cell::CellKinds;
use super::curl::{self, CurlReport};
use super::interface::border;
use super::jacobian::{self, JacobianReport, JacobianStats};
use crate::field::PushField;
use crate::stats::Summary;
use crate::volume::{LabelMap, Mask, Spans, Volume};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Lower edges of the bins of a Jacobian-volume histogram: from 0 by 0.05 to 3; folded cells are counted apart.
pub const BIN: f64 = 0.05;
/// Number of bins; the last one holds everything above 3.
pub const BINS: usize = 61;

/// Volume by Jacobian of one structure, as a dose-volume histogram shows volume by dose.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct JacobianHistogram {
    /// Name of the structure.
    pub name: String,
    /// Cells that hold a folded tetrahedron, ml.
    pub folded_ml: f64,
    /// Volume in each bin of [`BIN`], ml; the last one is open.
    pub ml: Vec<f64>,
}

impl JacobianHistogram {
    fn of(name: &str, values: &[f32], cell_ml: f64) -> Self {
        let mut histogram = Self { name: name.to_owned(), folded_ml: 0.0, ml: vec![0.0; BINS] };
        for j in values {
            if *j <= 0.0 {
                histogram.folded_ml += cell_ml;
            } else {
                histogram.ml[((f64::from(*j) / BIN) as usize).min(BINS - 1)] += cell_ml;
            }
        }
        histogram
    }

    /// Share (0 to 1) of the volume whose Jacobian is at least that of each bin's lower edge.
    pub fn cumulative(&self) -> Vec<f64> {
        let total = (self.folded_ml + self.ml.iter().sum::<f64>()).max(f64::MIN_POSITIVE);
        let mut sum = 0.0;
        let mut out: Vec<f64> = self
            .ml
            .iter()
            .rev()
            .map(|v| {
                sum += v;
                sum / total
            })
            .collect();
        out.reverse();
        out
    }
}

/// Whether a field is one-to-one on the grid: the 10 finite-difference determinants of Liu et al. 2024 are positive.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct FoldCertificate {
    /// Tissue cells checked, bone contact and sliding interfaces left out.
    pub cells: usize,
    /// Of those, cells where any of the 10 determinants is not positive.
    pub folded: usize,
    /// Their undeformed volume, ml: the non-diffeomorphic volume.
    pub folded_ml: f64,
    /// Folded cells of bone contact, where rigid bones slide or meet: counted apart.
    pub folded_contact: usize,
    /// Folded cells of declared sliding interfaces: counted apart.
    pub folded_interface: usize,
}

/// Regularity of one field.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Regularity {
    /// Length of the displacement over the tissue, mm.
    pub displacement_mm: Summary,
    /// Jacobian characteristics: V_after / V_before of each cell in the field's own direction.
    pub jacobian: JacobianReport,
    /// The same per structure, cells wholly inside.
    pub structures: Vec<(String, JacobianStats)>,
    /// Jacobian-volume histograms: all tissue first, then each structure.
    pub histograms: Vec<JacobianHistogram>,
    /// Digital folds.
    pub folds: FoldCertificate,
    /// Curl.
    pub curl: CurlReport,
}

/// Regularity of `field` and its Jacobian map.
///
/// `tissue`, `bones` and `structures` lie on the field's grid; `rigid` lists label and name of each rigid bone,
/// `sliding` pairs of labels that slide on each other, with their reach in mm. `region` slides along its border.
pub fn evaluate(
    field: &PushField,
    tissue: &Mask,
    bones: &LabelMap,
    rigid: &[(u16, String)],
    (sliding, region): (&[([u16; 2], f64)], Option<&Mask>),
    structures: Option<&LabelMap>,
) -> (Regularity, Spans<f32>) {
    let cells = CellKinds::with_region(tissue, bones, rigid, sliding, [region; 2]);
    let (map, report, digital) = jacobian::with_folds(field, &cells);
    let cell_ml = map.grid().voxel_volume() / 1000.0;
    let body = jacobian::of_body(&map, &cells);
    let folded = digital.soft + digital.bone;
    let folds = FoldCertificate {
        cells: body.len(),
        folded,
        folded_ml: folded as f64 * cell_ml,
        folded_contact: digital.contact,
        folded_interface: digital.interface,
    };
    let mut histograms = vec![JacobianHistogram::of("tissue", &body, cell_ml)];
    let measured: Vec<_> = structures
        .map(|s| cells_by_structure(&map, s))
        .unwrap_or_default()
        .into_par_iter()
        .map(|(name, values)| (JacobianHistogram::of(&name, &values, cell_ml), (name, jacobian::stats(&[&values]))))
        .collect();
    let (of_structures, per_structure): (Vec<_>, Vec<_>) = measured.into_iter().unzip();
    histograms.extend(of_structures);
    let length = |u: &[f32; 3]| (u[0] * u[0] + u[1] * u[1] + u[2] * u[2]).sqrt();
    let lengths: Vec<f32> =
        field.displacement.data().iter().zip(tissue.data()).filter(|(_, t)| **t).map(|(u, _)| length(u)).collect();
    let regularity = Regularity {
        displacement_mm: Summary::of_singles(&[&lengths]),
        jacobian: report,
        structures: per_structure,
        histograms,
        folds,
        curl: match region {
            None => curl::evaluate(&field.displacement, tissue),
            Some(region) => curl::evaluate(&field.displacement, &off_border(tissue, region)),
        },
    };
    (regularity, map)
}

/// The voxels of a mask that do not touch the border of a region on the same grid: of whose 26 neighbours none lies on the other side.
pub(super) fn off_border(mask: &Mask, region: &Mask) -> Mask {
    let border = border(region, mask.grid());
    Volume::from_fn(mask.grid().clone(), |l| mask.data()[l] && !border[l])
}

/// Jacobians of the cells whose 8 corners all lie in one structure, by its name.
fn cells_by_structure(map: &Spans<f32>, structures: &LabelMap) -> Vec<(String, Vec<f32>)> {
    let grid = map.grid();
    let [ni, nj, nk] = grid.size();
    let [sx, sy, sz] = grid.strides();
    let corners = [sx, sy, sx + sy, sz, sz + sx, sz + sy, sz + sx + sy];
    let labels = structures.volume.data();
    let planes: Vec<BTreeMap<u16, Vec<f32>>> = (0..nk - 1)
        .into_par_iter()
        .map(|k| {
            let mut found: BTreeMap<u16, Vec<f32>> = BTreeMap::new();
            for j in 0..nj - 1 {
                for i in 0..ni - 1 {
                    let l = grid.linear([i, j, k]);
                    let label = labels[l];
                    if label > 0 && corners.iter().all(|c| labels[l + c] == label) {
                        found.entry(label).or_default().push(map.at([i, j, k]));
                    }
                }
            }
            found
        })
        .collect();
    let mut by_label: BTreeMap<u16, Vec<f32>> = BTreeMap::new();
    for (label, values) in planes.into_iter().flatten() {
        by_label.entry(label).or_default().extend(values);
    }
    let name = |label: u16| structures.names.get(&label).cloned().unwrap_or_else(|| label.to_string());
    by_label.into_iter().map(|(label, values)| (name(label), values)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Grid;

    #[test]
    fn where_tissue_slides_the_field_may_jump() {
        let grid = Grid::axis_aligned([14, 12, 6], [1.0; 3], [0.0; 3]).unwrap();
        let region = Volume::from_fn(grid.clone(), |l| l % 14 > 6);
        let displacement = region.map(|inside| if *inside { [-1.5, 7.0, 0.0] } else { [0.0; 3] });
        let all = Volume::filled(grid.clone(), true);
        let none = LabelMap { volume: Volume::filled(grid, 0), names: BTreeMap::new() };
        let field = PushField { displacement, computed: all.clone() };
        let told = |region| {
            let r = evaluate(&field, &all, &none, &[], (&[], region), None).0;
            (r.jacobian.body.folded, r.folds.folded, r.curl.magnitude.max)
        };
        let (folded, digital, curl) = told(None);
        assert!(folded > 0 && digital > 0 && curl > 1.0, "{folded} {digital} {curl}");
        assert_eq!(told(Some(&region)), (0, 0, 0.0));
    }

    #[test]
    fn volumes_and_folds_by_hand() {
        let grid = Grid::axis_aligned([12, 6, 6], [2.0, 2.0, 2.5], [0.0; 3]).unwrap();
        // x doubles up to plane 6, then runs back over itself.
        let x = |i: usize| if i <= 6 { 2.0 * i as f32 } else { 12.0 - (i - 6) as f32 };
        let u = Volume::from_fn(grid.clone(), |l| [2.0 * (x(grid.voxel(l)[0]) - grid.voxel(l)[0] as f32), 0.0, 0.0]);
        let field = PushField { displacement: u, computed: Volume::filled(grid.clone(), true) };
        let none = LabelMap { volume: Volume::filled(grid.clone(), 0), names: BTreeMap::new() };
        let left = Volume::from_fn(grid.clone(), |l| u16::from(grid.voxel(l)[0] < 4));
        let structures = LabelMap { volume: left, names: [(1, "left".to_owned())].into() };
        let (r, map) = evaluate(&field, &Volume::filled(grid, true), &none, &[], (&[], None), Some(&structures));
        assert_eq!((r.folds.cells, r.folds.folded, r.folds.folded_contact), (11 * 25, 5 * 25, 0));
        assert!((r.folds.folded_ml - 125.0 * 0.01).abs() < 1e-9);
        assert_eq!(r.structures[0].0, "left");
        assert!((r.structures[0].1.mean - 2.0).abs() < 1e-6 && r.structures[0].1.cells == 75);
        assert!((map.at([0, 0, 0]) - 2.0).abs() < 1e-6);
        let h = &r.histograms[0];
        assert!((h.folded_ml - 1.25).abs() < 1e-9 && (h.ml.iter().sum::<f64>() - 1.5).abs() < 1e-9);
        let cumulative = r.histograms[1].cumulative();
        assert!(
            (cumulative[0] - 1.0).abs() < 1e-12 && (cumulative[38] - 1.0).abs() < 1e-12 && cumulative[42].abs() < 1e-12
        );
    }
}
