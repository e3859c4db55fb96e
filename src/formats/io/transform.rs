//! Rigid transforms: ITK's text files (`.tfm`, `.txt`), a plain 4x4, JSON as `bone_transforms.json`, or DICOM. LPS mm.

use super::dicom::registration;
use super::json::is_json;
use super::points::Space;
use super::text::read_text;
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::{Rigid, rigid_from_matrix};
use nalgebra::{Matrix3, Matrix4, Quaternion, Rotation3, UnitQuaternion, Vector3, Vector4};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

/// Extensions of transform files.
const ENDS: [&str; 4] = ["tfm", "txt", "mat", "json"];

/// Whether a path is a transform, not a field: by its extension, or a DICOM Spatial Registration.
pub fn is_transform(path: &Path) -> bool {
    path.extension().is_some_and(|e| ENDS.iter().any(|end| e.eq_ignore_ascii_case(end))) || is_registration(path)
}

fn is_registration(path: &Path) -> bool {
    registration::kind_of(path) == Some(registration::Kind::Rigid)
}

/// Reads a rigid transform that takes points (LPS mm, column vectors) of one frame to another.
///
/// - `.tfm`, `.txt` of ITK (`#Insight Transform File V1.0`) with one rigid transform: it takes points of its *fixed* image
///   to its *moving* image;
/// - `.txt`, `.mat`: sixteen numbers, rows of a 4x4, of points in the coordinates `space`, which the file does not tell;
/// - `.json`: a 4x4 in the coordinates `space`, or `{"name": [[4], [4], [4], [4]], ...}`, LPS as `bone_transforms.json`;
///   `entry` chooses one where there are several;
/// - a DICOM Spatial Registration (PS3.3 C.20.2); `entry` is a source Frame of Reference UID where it holds several.
///
/// # Errors
/// [`Error::Read`] when the file cannot be parsed; [`Error::Input`] when it holds several transforms, an unknown kind, a
/// matrix that is not rigid, or one whose space nobody tells.
pub fn read_rigid(path: impl AsRef<Path>, entry: Option<&str>, space: Option<Space>) -> Result<Rigid> {
    read_rigid_between(path, entry, space).map(|(rigid, _)| rigid)
}

/// [`read_rigid`], also with the frames of reference (DICOM UIDs) whose points it takes and where they arrive, where the
/// file is a Spatial Registration.
///
/// # Errors
/// As [`read_rigid`].
pub fn read_rigid_between(
    path: impl AsRef<Path>,
    entry: Option<&str>,
    space: Option<Space>,
) -> Result<(Rigid, Option<[String; 2]>)> {
    let path = path.as_ref();
    if !is_registration(path) {
        return of_text(path, entry, space).map(|rigid| (rigid, None));
    }
    let mut all = registration::read_rigid(path)?;
    all.retain(|r| entry.is_none_or(|e| r.from == e));
    if let [_] = all.as_slice()
        && let Some(one) = all.pop()
    {
        return Ok((one.rigid, Some([one.from, one.to])));
    }
    let sources: Vec<String> = registration::read_rigid(path)?.into_iter().map(|r| r.from).collect();
    let problem = match entry {
        Some(entry) => format!("it holds {} transforms from the frame of reference {entry}", all.len()),
        None => format!("it holds {} transforms", all.len()),
    };
    let remedy =
        format!("name the frame of reference of one after the file: FILE#UID, with one of {}", sources.join(", "));
    Err(Error::input(path.display().to_string(), problem, remedy))
}

fn of_text(path: &Path, entry: Option<&str>, space: Option<Space>) -> Result<Rigid> {
    match parsed(path, entry)? {
        Parsed::Lps(rigid) => Ok(rigid),
        Parsed::Bare(matrix) => {
            let own = match entry {
                None => None,
                Some(e) if e.eq_ignore_ascii_case("ras") => Some(Space::Ras),
                Some(e) if e.eq_ignore_ascii_case("lps") => Some(Space::Lps),
                Some(other) => {
                    let problem = format!("it holds one matrix, none of the name {other:?}");
                    let remedy = "leave #NAME out, or tell the space of its coordinates: FILE#ras or FILE#lps";
                    return Err(Error::input(path.display().to_string(), problem, remedy));
                }
            };
            let space = own.or(space).ok_or_else(|| unknown_space(path))?;
            // Negates x and y, before and after.
            let flip = match space {
                Space::Lps => Matrix4::identity(),
                Space::Ras => Matrix4::from_diagonal(&Vector4::new(-1.0, -1.0, 1.0, 1.0)),
            };
            rigid(path, flip * matrix * flip)
        }
    }
}

/// Whether a file holds a bare matrix, which does not tell the space of its coordinates.
///
/// # Errors
/// As [`read_rigid`].
pub fn is_bare(path: impl AsRef<Path>) -> Result<bool> {
    let path = path.as_ref();
    if is_registration(path) {
        return Ok(false);
    }
    let text = read_text(path)?;
    Ok(if is_json(path) { matches!(parse_json(path, &text)?, Json::One(_)) } else { !is_itk(&text) })
}

fn unknown_space(path: &Path) -> Error {
    Error::refused(
        findings::SPACE_UNKNOWN,
        path.display().to_string(),
        "it is a bare 4x4 matrix, which does not say whether it takes LPS or RAS coordinates",
        "say it with --space ras (greedy, c3d, ITK-SNAP, NiftyReg, Slicer's text matrices) or --space lps (ITK, aventail), or of one \
         file as FILE#ras or FILE#lps. FSL's FLIRT writes scaled voxels, neither of them: convert its matrix with \
         `c3d_affine_tool -ref FIXED -src MOVING IN.mat -fsl2ras -o OUT.mat`, which is RAS",
    )
}

/// What a file holds.
enum Parsed {
    /// A transform, LPS.
    Lps(Rigid),
    /// A matrix of unknown space.
    Bare(Matrix4<f64>),
}

fn is_itk(text: &str) -> bool {
    text.starts_with("#Insight Transform File")
}

fn parsed(path: &Path, entry: Option<&str>) -> Result<Parsed> {
    let text = &read_text(path).map_err(|e| match e {
        // A zero byte is no text, but may be one of UTF-8.
        Error::Read { problem, .. } if problem.contains("UTF-8") => {
            Error::read(path, "it is no text", "save the transform as text: ITK's .tfm or .txt, not its binary .mat")
        }
        other => other,
    })?;
    if is_json(path) {
        return json(path, text, entry);
    }
    if is_itk(text) {
        return itk(path, text).map(Parsed::Lps);
    }
    let numbers = text.split(|c: char| c.is_whitespace() || c == ',').filter(|w| !w.is_empty()).map(str::parse::<f64>);
    let numbers: Option<[f64; 16]> = numbers.collect::<Result<Vec<_>, _>>().ok().and_then(|n| n.try_into().ok());
    let numbers = numbers.ok_or_else(|| {
        let problem = "it is neither an ITK transform file nor sixteen numbers";
        Error::read(path, problem, "give the rows of a 4x4 matrix, mm, or an ITK .tfm text file")
    })?;
    Ok(Parsed::Bare(Matrix4::from_row_slice(&numbers)))
}

/// Reads `{name: 4x4}`, rows of each matrix from planning to fraction, LPS mm: the `bone_transforms.json` of a run.
///
/// # Errors
/// [`Error::Read`] when the file is missing or not of this form; [`Error::Input`], naming the bone, when a matrix is not rigid.
pub fn read_bone_transforms(path: impl AsRef<Path>) -> Result<BTreeMap<String, Rigid>> {
    let path = path.as_ref();
    let rows: BTreeMap<String, [[f64; 4]; 4]> = serde_json::from_str(&read_text(path)?).map_err(|e| {
        Error::read(
            path,
            format!("it is no list of bone transforms ({e})"),
            "give a bone_transforms.json: {\"skull\": [[...4 numbers...], ...4 rows...], ...}",
        )
    })?;
    let own = |(name, rows): (String, [[f64; 4]; 4])| {
        let matrix = Matrix4::from_fn(|r, c| rows[r][c]);
        rigid(path, matrix).map(|t| (name.clone(), t)).map_err(|_| {
            Error::input(
                path.display().to_string(),
                format!("the matrix of {name} is no rotation with a shift: {rows:?}"),
                "bones are rigid: give a rotation in the upper left 3x3 block, a shift in mm, last row 0 0 0 1",
            )
        })
    };
    rows.into_iter().map(own).collect()
}

/// A matrix as a rigid transform.
fn rigid(path: &Path, matrix: Matrix4<f64>) -> Result<Rigid> {
    let bottom = matrix.row(3);
    let square = bottom.iter().zip([0.0, 0.0, 0.0, 1.0]).all(|(a, b)| (a - b).abs() < 1e-9);
    rigid_from_matrix(&matrix).filter(|_| square).ok_or_else(|| {
        Error::input(
            path.display().to_string(),
            format!("its matrix is not rigid: determinant {:.4}", matrix.fixed_view::<3, 3>(0, 0).determinant()),
            "give a rotation and a translation; turn an affine transform into a displacement field with its own tool",
        )
    })
}

/// One matrix, or several by name.
#[derive(Deserialize)]
#[serde(untagged)]
enum Json {
    One([[f64; 4]; 4]),
    Named(BTreeMap<String, [[f64; 4]; 4]>),
}

fn parse_json(path: &Path, text: &str) -> Result<Json> {
    serde_json::from_str(text).map_err(|_| {
        let remedy = "write {\"couch\": [[1, 0, 0, 5], ...]}; a field is NIfTI, MetaImage or NRRD";
        Error::read(path, "it is no 4x4 matrix and no table of such by name", remedy)
    })
}

fn json(path: &Path, text: &str, entry: Option<&str>) -> Result<Parsed> {
    let parsed = parse_json(path, text)?;
    let refuse = |problem: String, names: Vec<&str>| {
        let remedy = format!("name one after the file: FILE#NAME, with NAME one of {}", names.join(", "));
        Err(Error::input(path.display().to_string(), problem, remedy))
    };
    let rows = match (&parsed, entry) {
        (Json::One(rows), _) => return Ok(Parsed::Bare(Matrix4::from_fn(|r, c| rows[r][c]))),
        (Json::Named(all), Some(name)) => match all.get(name) {
            Some(rows) => rows,
            None => return refuse(format!("it holds no transform {name:?}"), all.keys().map(String::as_str).collect()),
        },
        (Json::Named(all), None) => match all.first_key_value() {
            Some((_, rows)) if all.len() == 1 => rows,
            _ => return refuse(format!("it holds {} transforms", all.len()), all.keys().map(String::as_str).collect()),
        },
    };
    rigid(path, Matrix4::from_fn(|r, c| rows[r][c])).map(Parsed::Lps)
}

fn itk(path: &Path, text: &str) -> Result<Rigid> {
    let values = |key: &str| {
        text.lines().filter_map(|l| l.strip_prefix(key)?.strip_prefix(':')).map(str::trim).collect::<Vec<_>>()
    };
    let kinds = values("Transform");
    let [kind] = kinds[..] else {
        let problem = format!("it holds {} transforms", kinds.len());
        return Err(Error::input(
            path.display().to_string(),
            problem,
            "give each transform of a chain as its own file",
        ));
    };
    let numbers = |key: &str| -> Result<Vec<f64>> {
        let words = values(key).first().copied().unwrap_or_default().split_whitespace();
        words
            .map(str::parse)
            .collect::<Result<_, _>>()
            .map_err(|e| Error::read(path, format!("its {key} are damaged ({e})"), "save the transform again"))
    };
    let (p, fixed) = (numbers("Parameters")?, numbers("FixedParameters")?);
    let name = kind.split('_').next().unwrap_or_default();
    let vector = |v: &[f64], at: usize| Vector3::new(v[at], v[at + 1], v[at + 2]);
    let (matrix, shift): (Matrix3<f64>, Vector3<f64>) = match (name, p.len()) {
        ("IdentityTransform", _) => (Matrix3::identity(), Vector3::zeros()),
        ("TranslationTransform", 3) => (Matrix3::identity(), vector(&p, 0)),
        ("Euler3DTransform", 6) => {
            let [x, y, z] = [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()];
            let [rx, ry, rz] = [(x, p[0]), (y, p[1]), (z, p[2])].map(|(a, t)| Rotation3::from_axis_angle(&a, t));
            let zyx = fixed.get(3).is_some_and(|flag| *flag != 0.0);
            (if zyx { rz * ry * rx } else { rz * rx * ry }.into_inner(), vector(&p, 3))
        }
        ("VersorRigid3DTransform", 6) => {
            let v = vector(&p, 0);
            let q = Quaternion::from_parts((1.0 - v.norm_squared()).max(0.0).sqrt(), v);
            (UnitQuaternion::new_normalize(q).to_rotation_matrix().into_inner(), vector(&p, 3))
        }
        ("AffineTransform" | "MatrixOffsetTransformBase", 12) => (Matrix3::from_row_slice(&p[..9]), vector(&p, 9)),
        _ => {
            let problem = format!("its transform is {kind} with {} parameters", p.len());
            let remedy =
                "give an Euler3D, VersorRigid3D, Translation or rigid Affine transform, or a displacement field";
            return Err(Error::input(path.display().to_string(), problem, remedy));
        }
    };
    let centre = if fixed.len() >= 3 { vector(&fixed, 0) } else { Vector3::zeros() };
    let mut m = Matrix4::identity();
    m.fixed_view_mut::<3, 3>(0, 0).copy_from(&matrix);
    m.fixed_view_mut::<3, 1>(0, 3).copy_from(&(centre + shift - matrix * centre));
    rigid(path, m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn read(name: &str, text: &str, entry: Option<&str>) -> Result<Rigid> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(name);
        std::fs::write(&path, text).unwrap();
        read_rigid(&path, entry, Some(Space::Lps))
    }

    fn itk_text(kind: &str, parameters: &str, fixed: &str) -> String {
        format!(
            "#Insight Transform File V1.0\n#Transform 0\nTransform: {kind}_double_3_3\nParameters: {parameters}\nFixedParameters: {fixed}\n"
        )
    }

    #[test]
    fn reads_rigid_matrices_and_names_the_bone_of_others() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("t.json");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            read_bone_transforms(&path)
        };
        let all = read(r#"{"skull": [[0,-1,0,5],[1,0,0,6],[0,0,1,7],[0,0,0,1]]}"#).unwrap();
        assert!(
            (all["skull"] * nalgebra::Point3::new(1.0, 0.0, 0.0) - nalgebra::Point3::new(5.0, 7.0, 7.0)).norm() < 1e-12
        );
        for (bad, name) in [
            (r#"{"skull": [[2,0,0,5],[0,1,0,6],[0,0,1,7],[0,0,0,1]]}"#, "skull"),
            (r#"{"skull": [[1,0,0,5],[0,1,0,6],[0,0,1,7],[1,0,0,1]]}"#, "skull"),
            (r#"{"skull": [[1,0,0],[0,1,0]]}"#, "t.json"),
            ("[]", "t.json"),
        ] {
            let error = read(bad).unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
        }
    }

    #[test]
    fn itk_transforms_as_simpleitk_applies_them() {
        // Points by SimpleITK 2.5.7 for (10, 20, 30).
        let cases = [
            ("Euler3DTransform", "0.1 -0.2 0.3 1 2 3", "5 6 7 0", [2.8938883105, 19.1610646001, 34.8149694168]),
            ("Euler3DTransform", "0.1 -0.2 0.3 1 2 3", "5 6 7 1", [2.6346444328, 19.1367662383, 34.7920717097]),
            ("VersorRigid3DTransform", "0.1 0.2 -0.15 1 2 3", "5 6 7", [23.1501113905, 14.0352851133, 30.4804544114]),
            ("TranslationTransform", "1 2 3", "", [11.0, 22.0, 33.0]),
        ];
        for (kind, parameters, fixed, expected) in cases {
            let t = read("t.tfm", &itk_text(kind, parameters, fixed), None).unwrap();
            let got = t * Point3::new(10.0, 20.0, 30.0);
            assert!((got - Point3::from(expected)).norm() < 1e-6, "{kind} {fixed}: {got}");
        }
    }

    #[test]
    fn rows_of_a_matrix_and_named_ones() {
        let p = Point3::new(1.0, 2.0, 3.0);
        let turned = read("m.txt", "0 -1 0 5\n1 0 0 6\n0 0 1 7\n0 0 0 1\n", None).unwrap() * p;
        assert!((turned - Point3::new(3.0, 7.0, 10.0)).norm() < 1e-12);
        let table = r#"{"skull": [[1,0,0,1],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "hyoid": [[1,0,0,2],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}"#;
        assert!((read("b.json", table, Some("hyoid")).unwrap() * p - Point3::new(3.0, 2.0, 3.0)).norm() < 1e-12);
        let error = read("b.json", table, None).unwrap_err().to_string();
        assert!(error.contains("2 transforms") && error.contains("hyoid, skull"), "{error}");
        assert!(read("b.json", table, Some("C1")).unwrap_err().to_string().contains("\"C1\""));
    }

    #[test]
    fn a_bare_matrix_needs_its_space() {
        let dir = tempfile::tempdir().unwrap();
        let (mat, json) = (dir.path().join("greedy.mat"), dir.path().join("m.json"));
        std::fs::write(&mat, "\u{feff}0 -1 0 8\n1 0 0 -12\n0 0 1 4\n0 0 0 1\n").unwrap();
        std::fs::write(&json, "[[0,-1,0,8],[1,0,0,-12],[0,0,1,4],[0,0,0,1]]").unwrap();
        let p = Point3::new(1.0, 2.0, 3.0);
        for path in [&mat, &json] {
            assert!(is_bare(path).unwrap());
            let error = read_rigid(path, None, None).unwrap_err();
            assert!(error.code() == "space-unknown" && error.to_string().contains("--space"), "{error}");
            let ras = Point3::new(-(2.0 + 8.0), -(-1.0 - 12.0), 7.0);
            for (entry, space, expected) in [
                (None, Some(Space::Lps), Point3::new(6.0, -11.0, 7.0)),
                (None, Some(Space::Ras), ras),
                (Some("ras"), Some(Space::Lps), ras),
            ] {
                assert!((read_rigid(path, entry, space).unwrap() * p - expected).norm() < 1e-12);
            }
        }
        // aventail's own table and ITK's text are LPS.
        std::fs::write(&json, r#"{"couch": [[1,0,0,1],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}"#).unwrap();
        assert!(!is_bare(&json).unwrap() && read_rigid(&json, None, None).is_ok());
        std::fs::write(&mat, itk_text("TranslationTransform", "1 2 3", "")).unwrap();
        assert!(!is_bare(&mat).unwrap() && read_rigid(&mat, None, None).is_ok());
        std::fs::write(&mat, b"\x89HDF\r\n\x1a\n").unwrap();
        assert!(read_rigid(&mat, None, None).unwrap_err().to_string().contains("HDF5"));
    }

    #[test]
    fn what_is_not_rigid_is_refused() {
        let affine = itk_text("AffineTransform", "1.1 0 0 0 1 0 0 0 1 0 0 0", "0 0 0");
        for (name, text, word) in [
            ("a.tfm", affine.as_str(), "not rigid"),
            ("s.tfm", &itk_text("BSplineTransform", "1 2 3", ""), "BSplineTransform"),
            ("c.tfm", &[affine.as_str(), affine.as_str()].concat(), "2 transforms"),
            ("n.txt", "1 2 3", "sixteen"),
            ("p.txt", "1 0 0 0 0 1 0 0 0 0 1 0 0 0 1 1", "not rigid"),
        ] {
            let error = read(name, text, None).unwrap_err().to_string();
            assert!(error.contains(word) && error.contains(name), "{error}");
        }
    }
}
