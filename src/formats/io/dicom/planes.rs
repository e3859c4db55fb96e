//! Contours of a structure set on common parallel planes.

use super::keyhole::opened;
use crate::error::{Error, Result};
use crate::findings;
use crate::volume::contour::{Contours, Polygon, Structure};
use nalgebra::{Matrix3, Vector3};

/// How far a point may lie off its contour's plane, mm.
const FLAT_MM: f64 = 0.1;
/// Normals closer to an axis than this are that axis.
const STRAIGHT: f64 = 1e-3;

/// A structure as it is stored.
pub(super) struct Drawing {
    pub(super) name: String,
    pub(super) colour: Option<[u8; 3]>,
    /// Points, LPS mm.
    pub(super) contours: Vec<Vec<[f64; 3]>>,
}

/// Area vector of a closed contour (Newell's sum): along its normal, as long as its area.
fn area(points: &[[f64; 3]]) -> Vector3<f64> {
    let Some(first) = points.first() else { return Vector3::zeros() };
    let from = |p: &[f64; 3]| Vector3::from(*p) - Vector3::from(*first);
    let next = points.iter().cycle().skip(1);
    points.iter().zip(next).map(|(a, b)| from(a).cross(&from(b))).sum::<Vector3<f64>>() * 0.5
}

/// In-plane axes and normal of the largest contour; its dominant component is positive.
fn axes(drawings: &[Drawing]) -> Matrix3<f64> {
    let all = drawings.iter().flat_map(|d| &d.contours).map(|c| area(c));
    let largest = all.max_by(|a, b| a.norm().total_cmp(&b.norm()));
    let Some(mut normal) = largest.filter(|a| a.norm() > 0.0).map(|a| a.normalize()) else {
        return Matrix3::identity();
    };
    let main = normal.iamax();
    normal *= normal[main].signum();
    if (normal[main] - 1.0).abs() < STRAIGHT * STRAIGHT {
        normal = Vector3::zeros();
        normal[main] = 1.0;
    }
    // Axial planes get the patient's left and back, others what comes next.
    let along = if main == 0 { Vector3::y() } else { Vector3::x() };
    let row = (along - normal * along.dot(&normal)).normalize();
    Matrix3::from_columns(&[row, normal.cross(&row), normal])
}

/// Contours with common planes.
///
/// # Errors
/// [`Error::Input`] naming a structure whose contours do not lie on planes parallel to those of the
/// others.
pub(super) fn planes(what: &str, drawings: &[Drawing]) -> Result<Contours> {
    let axes = axes(drawings);
    let to_plane = axes.transpose();
    let mut structures = Vec::with_capacity(drawings.len());
    for d in drawings {
        let mut polygons = Vec::with_capacity(d.contours.len());
        for (n, points) in d.contours.iter().enumerate() {
            let flat: Vec<Vector3<f64>> = points.iter().map(|p| to_plane * Vector3::from(*p)).collect();
            let height = flat.iter().map(|p| p.z).sum::<f64>() / flat.len() as f64;
            let off = flat.iter().map(|p| (p.z - height).abs()).fold(0.0, f64::max);
            if off > FLAT_MM {
                let normal = area(points);
                let angle = normal.normalize().dot(&axes.column(2)).abs().min(1.0).acos().to_degrees();
                let problem = format!(
                    "contours do not lie on parallel planes: contour {} of {:?} reaches {off:.2} mm out of them, turned by \
                     {angle:.1} degrees",
                    n + 1,
                    d.name
                );
                let remedy = "leave out this structure, or draw it on the planes of the others";
                return Err(Error::refused(findings::STRUCTURES_PLANES, what, problem, remedy));
            }
            let mut points: Vec<[f64; 2]> = flat.iter().map(|p| [p.x, p.y]).collect();
            // Some writers repeat the first point at the end.
            if points.len() > 3 && points.first() == points.last() {
                points.pop();
            }
            polygons.extend(opened(points).into_iter().map(|points| Polygon { height, points }));
        }
        structures.push(Structure { name: d.name.clone(), colour: d.colour, polygons });
    }
    Ok(Contours { axes, structures })
}
