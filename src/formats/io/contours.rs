//! Contours: closed planar polygons per structure, LPS mm, as JSON (docs/formats.md) or from a DICOM structure set.

use super::dicom;
use super::text::read_text;
use crate::error::{Error, Result};
use crate::volume::contour::{Contours, Polygon, Structure};
use crate::warning::Warning;
use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Version of the format.
const VERSION: u32 = 1;
/// How far a point may lie off its polygon's plane, mm.
const FLAT_MM: f64 = 0.1;

/// The file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    aventail_contours: u32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    frame: Option<String>,
    #[serde(default = "axial")]
    orientation: [f64; 6],
    structures: Vec<FileStructure>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileStructure {
    name: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    colour: Option<[u8; 3]>,
    contours: Vec<Vec<[f64; 3]>>,
}

fn axial() -> [f64; 6] {
    [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
}

/// Contours with what their file says of them.
#[derive(Debug, Clone)]
pub struct ContourFile {
    /// The contours, LPS mm.
    pub contours: Contours,
    /// The frame that they lie in by a contour JSON: `planning`, `fraction`.
    pub frame: Option<String>,
    /// What the file is, or the one in the folder that was given.
    pub path: PathBuf,
    /// What was left out, and what is missing.
    pub warnings: Vec<Warning>,
}

/// Reads contours from a contour JSON, from a DICOM structure set, or from a folder with one structure set.
///
/// # Errors
/// As [`read_contours`], and as [`dicom::read_structure_set`]. Structures without contours are left out of the result.
pub fn read_contour_file(path: impl AsRef<Path>) -> Result<ContourFile> {
    let path = path.as_ref();
    if dicom::is_place(path) {
        let mut set = dicom::read_structure_set(path)?;
        set.contours.structures.retain(|s| !s.polygons.is_empty());
        return Ok(ContourFile { contours: set.contours, frame: None, path: set.path, warnings: set.warnings });
    }
    let (contours, frame) = read_json(path)?;
    Ok(ContourFile { contours, frame, path: path.into(), warnings: Vec::new() })
}

/// Reads contours; also the frame that the file says they lie in. [`read_contour_file`] also tells what was left out.
///
/// # Errors
/// [`Error::Read`] when it is no such JSON; [`Error::Input`], naming structure and contour, for fewer than three points,
/// numbers that are not finite, points off their plane, names that repeat, and when there is no contour at all.
pub fn read_contours(path: impl AsRef<Path>) -> Result<(Contours, Option<String>)> {
    read_contour_file(path).map(|file| (file.contours, file.frame))
}

fn read_json(path: &Path) -> Result<(Contours, Option<String>)> {
    parse_contours(&read_text(path)?, path)
}

/// Contours of a contour JSON's text, and the frame that it says they lie in; `path` is its name in messages.
///
/// # Errors
/// As [`read_contours`].
pub fn parse_contours(text: &str, path: impl AsRef<Path>) -> Result<(Contours, Option<String>)> {
    let path = path.as_ref();
    let file: File = serde_json::from_str(text).map_err(|e| {
        let remedy = "give aventail's contour JSON, as docs/formats.md describes it";
        Error::read(path, format!("it is no contour file ({e})"), remedy)
    })?;
    let refuse = |problem: String, remedy: &str| Err(Error::input(path.display().to_string(), problem, remedy));
    if file.aventail_contours != VERSION {
        return refuse(format!("its version is {}, not {VERSION}", file.aventail_contours), "use a newer aventail");
    }
    let o = file.orientation;
    let (row, column) = (Vector3::new(o[0], o[1], o[2]), Vector3::new(o[3], o[4], o[5]));
    let off = (row.norm() - 1.0).abs().max((column.norm() - 1.0).abs()).max(row.dot(&column).abs());
    if off.is_nan() || off > 1e-4 {
        return refuse(format!("its orientation {o:?} is no pair of perpendicular unit vectors"), "correct it");
    }
    let column = (column - row * row.dot(&column)).normalize();
    let axes = Matrix3::from_columns(&[row, column, row.cross(&column)]);
    let mut structures: Vec<Structure> = Vec::new();
    for s in file.structures {
        if structures.iter().any(|other| other.name == s.name) {
            return refuse(format!("two structures are named {:?}", s.name), "give each structure one entry");
        }
        let mut polygons = Vec::new();
        for (n, points) in s.contours.iter().enumerate() {
            match polygon(&axes, points) {
                Ok(polygon) => polygons.push(polygon),
                Err(problem) => {
                    let problem = format!("structure {:?}, contour {}: {problem}", s.name, n + 1);
                    return refuse(problem, "give closed polygons on planes that `orientation` spans, LPS mm");
                }
            }
        }
        structures.push(Structure { name: s.name, colour: s.colour, polygons });
    }
    if structures.iter().all(|s| s.polygons.is_empty()) {
        return refuse("it holds no contour".into(), "give at least one structure with a contour");
    }
    Ok((Contours { axes, structures }, file.frame))
}

/// A polygon in its plane, or what is wrong with it.
/// No scanner's coordinates lie farther out, mm.
const FARTHEST_MM: f64 = 1e6;

fn polygon(axes: &Matrix3<f64>, points: &[[f64; 3]]) -> Result<Polygon, String> {
    if let Some(p) = points.iter().find(|p| p.iter().any(|c| !c.is_finite() || c.abs() > FARTHEST_MM)) {
        return Err(format!("{p:?} is no place in a scanner"));
    }
    let mut flat: Vec<Vector3<f64>> = points.iter().map(|p| axes.transpose() * Vector3::from(*p)).collect();
    // Some writers repeat the first point at the end.
    if flat.len() > 1 && (flat[0] - flat[flat.len() - 1]).norm() < 1e-6 {
        flat.pop();
    }
    if flat.len() < 3 {
        return Err(format!("{} points make no polygon", flat.len()));
    }
    // From the first: points of one height have it as their mean, to the last digit, however many there are.
    let first = flat[0].z;
    let height = first + flat.iter().map(|p| p.z - first).sum::<f64>() / flat.len() as f64;
    if let Some(p) = flat.iter().find(|p| (p.z - height).abs() > FLAT_MM) {
        return Err(format!("its points are {:.2} mm off one plane", (p.z - height).abs()));
    }
    Ok(Polygon { height, points: flat.iter().map(|p| [p.x, p.y]).collect() })
}

/// Writes contours that lie in frame `frame`.
///
/// # Errors
/// [`Error::Write`] when the file cannot be written.
pub fn write_contours(path: impl AsRef<Path>, contours: &Contours, frame: &str) -> Result<()> {
    let text = contour_json(contours, frame)?;
    super::write_file(path, |out| out.write_all(&text))
}

/// The text of a contour JSON, for contours that lie in frame `frame`.
///
/// # Errors
/// [`Error::Internal`] when a value has no JSON.
pub fn contour_json(contours: &Contours, frame: &str) -> Result<Vec<u8>> {
    // A tenth of a micrometre.
    let short = |v: f64| (v * 1e4).round() / 1e4 + 0.0;
    let structures = contours
        .structures
        .iter()
        .map(|s| FileStructure {
            name: s.name.clone(),
            colour: s.colour,
            contours: s
                .polygons
                .iter()
                .map(|p| p.points.iter().map(|q| contours.world(*q, p.height).coords.map(short).into()).collect())
                .collect(),
        })
        .collect();
    let axis = |a: usize| contours.axes.column(a);
    let orientation = [axis(0)[0], axis(0)[1], axis(0)[2], axis(1)[0], axis(1)[1], axis(1)[2]];
    let file = File { aventail_contours: VERSION, frame: Some(frame.into()), orientation, structures };
    serde_json::to_vec(&file).map_err(|e| Error::Internal(format!("contours as JSON: {e}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<(Contours, Option<String>)> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("contours.json");
        std::fs::write(&path, text).unwrap();
        read_contours(&path)
    }

    #[test]
    fn contours_of_one_plane_have_one_height() {
        // Slices are told apart by it: a mean that depends on the number of points tears a structure with two contours apart.
        let ring = |n: usize| (0..n).map(|k| [(k as f64).cos(), (k as f64).sin(), -111.1465]).collect::<Vec<_>>();
        let heights = (3..300).map(|n| polygon(&Matrix3::identity(), &ring(n)).unwrap().height);
        assert!(heights.into_iter().all(|height| height.to_bits() == (-111.1465_f64).to_bits()));
    }

    #[test]
    fn oblique_contours_come_back() {
        let (sin, cos) = 0.3f64.sin_cos();
        let axes = Matrix3::from_columns(&[Vector3::x(), Vector3::new(0.0, cos, sin), Vector3::new(0.0, -sin, cos)]);
        let polygon = Polygon { height: -17.5, points: vec![[1.0, 2.0], [10.25, 2.0], [5.0, 40.0]] };
        let structure = Structure { name: "a, \"b\"".into(), colour: Some([1, 2, 3]), polygons: vec![polygon] };
        let contours = Contours { axes, structures: vec![structure] };
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("c.json");
        write_contours(&path, &contours, "planning").unwrap();
        let (back, frame) = read_contours(&path).unwrap();
        assert_eq!(frame.as_deref(), Some("planning"));
        assert_eq!((&back.structures[0].name, back.structures[0].colour), (&"a, \"b\"".to_owned(), Some([1, 2, 3])));
        let (a, b) = (&back.structures[0].polygons[0], &contours.structures[0].polygons[0]);
        assert!((a.height - b.height).abs() < 1e-4);
        assert!(a.points.iter().flatten().zip(b.points.iter().flatten()).all(|(p, q)| (p - q).abs() < 2e-4));
    }

    #[test]
    fn refusals_name_structure_and_contour() {
        let file = |contour: &str| {
            format!(r#"{{"aventail_contours": 1, "structures": [{{"name": "cord", "contours": [{contour}]}}]}}"#)
        };
        for (text, word) in [
            (file("[[0,0,0],[1,0,0],[1,1,0.5]]"), "off one plane"),
            (file("[[0,0,0],[1,0,0],[0,0,0]]"), "\"cord\", contour 1: 2 points"),
            (file(""), "no contour"),
            (file("[[0,0],[1,0],[1,1]]"), "no contour file"),
            (r#"{"aventail_contours": 2, "structures": []}"#.into(), "version is 2"),
            (r#"{"aventail_contours": 1, "colour": 3, "structures": []}"#.into(), "colour"),
            (r#"{"aventail_contours": 1, "orientation": [1,0,0,1,0,0], "structures": []}"#.into(), "perpendicular"),
            (
                r#"{"aventail_contours": 1, "structures": [{"name":"a","contours":[]},{"name":"a","contours":[]}]}"#
                    .into(),
                "two structures",
            ),
        ] {
            let error = read(&text).unwrap_err().to_string();
            assert!(error.contains(word) && error.contains("contours.json"), "{error}");
        }
    }
}
