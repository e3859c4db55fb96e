//! sform and qform of a NIfTI header to a grid in LPS mm, and back.

use super::super::raster::GeometrySource;
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Grid;
use crate::warning::Warning;
use nalgebra::{Matrix3, Matrix4, Quaternion, Rotation3, UnitQuaternion, Vector3};

/// Disagreement of sform and qform, at the grid's corners, that is worth a warning: mm, beyond the qform's own rounding.
const DISAGREEMENT_MM: f64 = 0.1;

/// Difference of sform and pixdim, as a share of the spacing, that no rounding explains.
const SPACING_SHARE: f64 = 0.01;

/// The geometry fields of a header, RAS.
#[derive(Debug, Clone)]
pub(super) struct Fields {
    pub(super) size: [usize; 3],
    pub(super) pixdim: [f32; 4],
    pub(super) sform_code: i16,
    pub(super) qform_code: i16,
    pub(super) quaternion: [f32; 3],
    pub(super) offset: [f32; 3],
    pub(super) rows: [[f32; 4]; 3],
}

/// A grid with where it came from.
#[derive(Debug)]
pub(super) struct Placed {
    pub(super) grid: Grid,
    pub(super) source: GeometrySource,
    pub(super) disagreement_mm: Option<f64>,
    pub(super) warnings: Vec<Warning>,
}

/// Negates the first two rows: RAS to LPS and back.
fn flip_ras_lps(mut m: Matrix4<f64>) -> Matrix4<f64> {
    m.row_mut(0).neg_mut();
    m.row_mut(1).neg_mut();
    m
}

impl Fields {
    /// Index to RAS by the sform.
    fn sform(&self) -> Matrix4<f64> {
        Matrix4::from_fn(|r, c| if r < 3 { f64::from(self.rows[r][c]) } else { f64::from(u8::from(c == 3)) })
    }

    /// Index to RAS by the qform (nifti1.h, method 2), with the scalar part of its quaternion.
    fn qform(&self) -> (Matrix4<f64>, f64) {
        let [b, c, d] = self.quaternion.map(f64::from);
        let rest = 1.0 - (b * b + c * c + d * d);
        let a = rest.max(0.0).sqrt();
        let rotation = UnitQuaternion::new_normalize(Quaternion::new(a, b, c, d)).to_rotation_matrix();
        let handed = if self.pixdim[0] < 0.0 { -1.0 } else { 1.0 };
        let [_, dx, dy, dz] = self.pixdim.map(f64::from);
        let linear = rotation.matrix() * Matrix3::from_diagonal(&Vector3::new(dx, dy, handed * dz));
        let mut m = Matrix4::identity();
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(&linear);
        m.fixed_view_mut::<3, 1>(0, 3).copy_from(&Vector3::from(self.offset.map(f64::from)));
        (m, a)
    }

    /// The grid, LPS mm.
    ///
    /// # Errors
    /// When the geometry in use is sheared, singular or not finite; `what` names the file.
    pub(super) fn place(&self, what: &str) -> Result<Placed> {
        let refuse = |name: &str, remedy: &str| {
            let (what, remedy) = (what.to_owned(), remedy.to_owned());
            let name = name.to_owned();
            move |e: Error| match e {
                Error::Input { problem, .. } => Error::input(what, format!("{name}: {problem}"), remedy),
                other => other,
            }
        };
        if let Some(a) = (1..4).find(|&a| self.pixdim[a] < 0.0) {
            // nifti1.h forbids it, and readers differ: its own library takes 1, ITK the value without its sign.
            let problem = format!("pixdim[{a}] is {}: spacings are positive", self.pixdim[a]);
            let remedy = "write the file again; a mirrored axis belongs into sform and qform";
            return Err(Error::refused(findings::HEADER_FIELD, what, problem, remedy));
        }
        let (qform, scalar) = self.qform();
        let by_qform = Grid::from_affine(self.size, &flip_ras_lps(qform));
        let mut warnings = Vec::new();
        if self.sform_code > 0 {
            let remedy = if self.qform_code > 0 && by_qform.is_ok() {
                "resample the image to orthogonal axes; if the sform is wrong and the qform right, copy the qform over it"
            } else {
                "resample the image to orthogonal axes"
            };
            let grid = Grid::from_affine(self.size, &flip_ras_lps(self.sform())).map_err(refuse("sform", remedy))?;
            self.compare_spacing(what, &grid, &mut warnings)?;
            let disagreement_mm = self.compare(&grid, by_qform.as_ref().ok(), scalar, &mut warnings);
            return Ok(Placed { grid, source: GeometrySource::Sform, disagreement_mm, warnings });
        }
        if self.qform_code > 0 {
            let grid = by_qform.map_err(refuse("qform", "correct the header's pixdim and quaternion"))?;
            return Ok(Placed { grid, source: GeometrySource::Qform, disagreement_mm: None, warnings });
        }
        // As ITK takes such files; nibabel centres the grid and turns y the other way.
        let spacing = [self.pixdim[1], self.pixdim[2], self.pixdim[3]].map(f64::from);
        let grid = Grid::axis_aligned(self.size, spacing, [0.0; 3])
            .map_err(refuse("pixdim", "correct the header's pixdim"))?;
        let message = "neither sform nor qform is set, so that position and left and right are unknown; the axes are taken as left, \
            posterior, superior from (0, 0, 0), as ITK does. Export the image again with its geometry";
        warnings.push(Warning::new(findings::NO_ORIENTATION, message));
        Ok(Placed { grid, source: GeometrySource::Pixdim, disagreement_mm: None, warnings })
    }

    /// Holds pixdim against the sform's columns: ITK takes the spacing from the one, other readers from the other.
    fn compare_spacing(&self, what: &str, grid: &Grid, warnings: &mut Vec<Warning>) -> Result<()> {
        for a in 0..3 {
            let (by_sform, by_pixdim, size) = (grid.spacing()[a], f64::from(self.pixdim[a + 1]), grid.size()[a]);
            let apart = (by_sform - by_pixdim).abs();
            // One slice has no spacing.
            if size == 1 || apart * size as f64 <= DISAGREEMENT_MM {
                continue;
            }
            let problem = format!("pixdim says {by_pixdim:.4} mm along axis {}, the sform {by_sform:.4} mm", a + 1);
            if apart.is_nan() || apart > SPACING_SHARE * by_sform {
                let remedy = "find out which is right (the slice distance of the series) and write the file again";
                return Err(Error::refused(findings::PIXDIM_SFORM_DISAGREE, what, problem, remedy));
            }
            let message = format!("{problem}: {:.2} mm over the image; the sform is used", apart * size as f64);
            warnings.push(Warning::new(findings::PIXDIM_SFORM_DISAGREE, message));
        }
        Ok(())
    }

    /// Largest corner distance between sform and qform where both are set, with a warning where it matters.
    fn compare(&self, sform: &Grid, qform: Option<&Grid>, scalar: f64, warnings: &mut Vec<Warning>) -> Option<f64> {
        if self.qform_code <= 0 {
            return None;
        }
        let Some(qform) = qform else {
            warnings.push(Warning::new(
                findings::QFORM_INVALID,
                "the qform is set but is no valid geometry; the sform is used",
            ));
            return None;
        };
        let (a, b) = (sform.corners(), qform.corners());
        let distance = a.iter().zip(&b).map(|(p, q)| (p - q).norm()).fold(0.0, f64::max);
        // Near half turns the scalar part, which the file leaves out, is lost in the rounding of the other three.
        let angle = 2.0 * ((scalar * scalar + f64::from(f32::EPSILON)).sqrt() - scalar);
        let rounding = angle * (a[7] - a[0]).norm();
        if distance > DISAGREEMENT_MM + rounding {
            let message = format!(
                "sform (code {}) and qform (code {}) disagree by {distance:.2} mm at the image's corners; the sform is used, other \
                 tools may use the qform",
                self.sform_code, self.qform_code
            );
            warnings.push(Warning::new(findings::SFORM_QFORM_DISAGREE, message));
        }
        Some(distance)
    }

    /// The fields that describe a grid: sform and qform alike, code 1.
    pub(super) fn of_grid(grid: &Grid) -> Self {
        let ras = flip_ras_lps(grid.affine());
        let spacing = grid.spacing();
        let mut axes = Matrix3::from_fn(|r, c| ras[(r, c)] / spacing[c]);
        let handed = if axes.determinant() < 0.0 { -1.0 } else { 1.0 };
        axes.column_mut(2).scale_mut(handed);
        // The nearest rotation: a header's rounding may have left the axes slightly off square.
        let svd = axes.svd(true, true);
        let nearest = svd.u.zip(svd.v_t).map_or(axes, |(u, v)| u * v);
        let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(nearest));
        let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
        // Adding zero turns -0 into 0.
        let single = |v: f64| v as f32 + 0.0;
        Self {
            size: grid.size(),
            pixdim: [single(handed), single(spacing[0]), single(spacing[1]), single(spacing[2])],
            sform_code: 1,
            qform_code: 1,
            quaternion: [q.i, q.j, q.k].map(|v| single(sign * v)),
            offset: std::array::from_fn(|r| single(ras[(r, 3)])),
            rows: std::array::from_fn(|r| std::array::from_fn(|c| single(ras[(r, c)]))),
        }
    }
}
