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
/// Cosine of the angle within which planes are parallel: 1 degree, which rounding gives small contours.
const PARALLEL: f64 = 0.999_85;

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

/// Normal of the largest contour of a structure, with that contour's area; its dominant component is positive.
fn normal(drawing: &Drawing) -> Option<(Vector3<f64>, f64)> {
    let largest = drawing.contours.iter().map(|c| area(c)).max_by(|a, b| a.norm().total_cmp(&b.norm()))?;
    let size = largest.norm();
    let normal = (size > 0.0).then(|| largest.normalize())?;
    Some((normal * normal[normal.iamax()].signum(), size))
}

/// In-plane axes and normal of the planes that most structures lie on; of as many, those that are most upright.
fn axes(drawings: &[Drawing]) -> Matrix3<f64> {
    let mut kinds: Vec<(Vector3<f64>, f64, usize)> = Vec::new();
    for (normal, size) in drawings.iter().filter_map(normal) {
        match kinds.iter_mut().find(|k| k.0.dot(&normal) > PARALLEL) {
            Some(kind) => {
                kind.2 += 1;
                if size > kind.1 {
                    (kind.0, kind.1) = (normal, size);
                }
            }
            None => kinds.push((normal, size, 1)),
        }
    }
    let most = kinds.iter().max_by(|a, b| a.2.cmp(&b.2).then(a.0.z.abs().total_cmp(&b.0.z.abs())));
    let Some(mut normal) = most.map(|k| k.0) else { return Matrix3::identity() };
    let main = normal.iamax();
    if (normal[main] - 1.0).abs() < STRAIGHT * STRAIGHT {
        normal = Vector3::zeros();
        normal[main] = 1.0;
    }
    // Axial planes get the patient's left and back, others what comes next.
    let along = if main == 0 { Vector3::y() } else { Vector3::x() };
    let row = (along - normal * along.dot(&normal)).normalize();
    Matrix3::from_columns(&[row, normal.cross(&row), normal])
}

/// Contours with common planes, and what is left out of them, by name: structures that lie on other planes.
///
/// # Errors
/// [`Error::Input`] when no structure is left.
pub(super) fn planes(what: &str, drawings: &[Drawing]) -> Result<(Contours, Vec<String>)> {
    let axes = axes(drawings);
    let mut structures = Vec::with_capacity(drawings.len());
    let mut left = Vec::new();
    for d in drawings {
        let polygons = polygons(d, &axes).unwrap_or_else(|why| {
            left.push(format!("{:?} ({why})", d.name));
            Vec::new()
        });
        structures.push(Structure { name: d.name.clone(), colour: d.colour, polygons });
    }
    if !left.is_empty() && structures.iter().all(|s| s.polygons.is_empty()) {
        let problem = format!("contours do not lie on parallel planes: {}", left.join(", "));
        let remedy = "draw the structures on parallel planes";
        return Err(Error::refused(findings::STRUCTURES_PLANES, what, problem, remedy));
    }
    Ok((Contours { axes, structures }, left))
}

/// A structure's contours in planes, or why they do not lie in them.
fn polygons(d: &Drawing, axes: &Matrix3<f64>) -> Result<Vec<Polygon>, String> {
    let to_plane = axes.transpose();
    let mut polygons = Vec::with_capacity(d.contours.len());
    for (n, points) in d.contours.iter().enumerate() {
        let flat: Vec<Vector3<f64>> = points.iter().map(|p| to_plane * Vector3::from(*p)).collect();
        let height = flat.iter().map(|p| p.z).sum::<f64>() / flat.len() as f64;
        let off = flat.iter().map(|p| (p.z - height).abs()).fold(0.0, f64::max);
        if off > FLAT_MM {
            let normal = area(points);
            let angle = normal.normalize().dot(&axes.column(2)).abs().min(1.0).acos().to_degrees();
            let n = n + 1;
            return Err(format!("contour {n} reaches {off:.2} mm out of the planes, turned by {angle:.1} degrees"));
        }
        let mut points: Vec<[f64; 2]> = flat.iter().map(|p| [p.x, p.y]).collect();
        // Some writers repeat the first point at the end.
        if points.len() > 3 && points.first() == points.last() {
            points.pop();
        }
        polygons.extend(opened(points).into_iter().map(|points| Polygon { height, points }));
    }
    Ok(polygons)
}
