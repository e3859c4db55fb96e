//! Surface meshes: Wavefront OBJ as text whose vertices are replaced, STL through `stl_io`. Both may carry Slicer's
//! `SPACE=LPS` or `SPACE=RAS` in their comments. Normals are left out or computed again, since they turn.

use super::{File, PointContent, PointFile, Space, digits};
use crate::error::{Error, Result};
use nalgebra::{Point3, Vector3};
use std::io::Cursor;
use stl_io::{IndexedMesh, Normal, Triangle, Vertex};

/// Bytes of a binary STL's header.
const STL_HEADER: usize = 80;
/// Bytes of a triangle of a binary STL.
const STL_TRIANGLE: u64 = 50;

/// Slicer's note on the space of a mesh.
fn noted_space(text: &str) -> Option<Space> {
    let word = text.split_once("SPACE=")?.1;
    Space::of(word.get(..3)?)
}

/// An OBJ file: its lines; those of vertices hold what follows the position.
pub(super) struct Obj {
    lines: Vec<MeshLine>,
}

enum MeshLine {
    Vertex(String),
    Other(String),
}

pub(super) fn read_obj(file: &File<'_>) -> Result<PointFile> {
    let (mut points, mut lines, mut own) = (Vec::new(), Vec::new(), None);
    for (n, text) in file.text()?.lines().enumerate() {
        let mut words = text.split_whitespace();
        match words.next() {
            Some("v") => {
                let [x, y, z] = [(); 3].map(|()| file.number(words.next(), n + 1));
                points.push(Point3::new(x?, y?, z?));
                let rest: Vec<&str> = words.collect();
                // A lone fourth number is a weight that the position is divided by; more are colours.
                if let [weight] = rest[..]
                    && weight.parse::<f64>().is_ok_and(|w| (w - 1.0).abs() > 1e-9)
                {
                    let problem = format!("line {}: its vertex has the weight {weight}", n + 1);
                    return Err(file.refuse(problem, "export the mesh with plain vertices"));
                }
                lines.push(MeshLine::Vertex(rest.iter().map(|w| format!(" {w}")).collect()));
            }
            Some("vn") => {}
            Some("f") => lines.push(MeshLine::Other(format!("f{}", words.map(without_normal).collect::<String>()))),
            _ => {
                if text.starts_with('#') {
                    own = own.or(noted_space(text));
                }
                lines.push(MeshLine::Other(text.into()));
            }
        }
    }
    let space = file.space(own)?;
    let points = points.into_iter().map(|p| space.convert(p)).collect();
    Ok(PointFile { names: Vec::new(), points, space, content: PointContent::Obj(Obj { lines }) })
}

/// A corner of a face, `vertex/texture/normal`, without its normal.
fn without_normal(corner: &str) -> String {
    let mut parts = corner.split('/');
    let vertex = parts.next().unwrap_or_default();
    match parts.next() {
        Some(texture) if !texture.is_empty() => format!(" {vertex}/{texture}"),
        _ => format!(" {vertex}"),
    }
}

impl Obj {
    pub(super) fn write(&self, points: &[Point3<f64>]) -> Result<Vec<u8>, String> {
        let mut points = points.iter();
        let mut out = String::new();
        for line in &self.lines {
            match line {
                MeshLine::Other(text) => out.push_str(text),
                MeshLine::Vertex(rest) => {
                    let p = points.next().ok_or("a vertex is missing")?;
                    out.push_str(&format!("v {} {} {}{rest}", digits(p.x), digits(p.y), digits(p.z)));
                }
            }
            out.push('\n');
        }
        Ok(out.into_bytes())
    }
}

/// An STL file: its triangles, and the text of its header.
pub(super) struct Stl {
    mesh: IndexedMesh,
    header: Vec<u8>,
}

pub(super) fn read_stl(file: &File<'_>) -> Result<PointFile> {
    whole_stl(file)?;
    let mesh = stl_io::read_stl(&mut Cursor::new(&file.bytes))
        .map_err(|e| Error::read(file.path, format!("it is no STL mesh ({e})"), "export the mesh again"))?;
    let mut header = file.bytes[..file.bytes.len().min(STL_HEADER)].to_vec();
    // A text STL's first line; a binary header must not begin as one.
    if header.starts_with(b"solid") {
        let line = header.iter().position(|b| *b == b'\n').unwrap_or(header.len());
        header = header[b"solid".len()..line].to_vec();
    }
    let space = file.space(noted_space(&String::from_utf8_lossy(&header)))?;
    let points =
        mesh.vertices.iter().map(|v| space.convert(Point3::new(v[0].into(), v[1].into(), v[2].into()))).collect();
    Ok(PointFile { names: Vec::new(), points, space, content: PointContent::Stl(Stl { mesh, header }) })
}

/// Refuses a binary STL whose number of triangles is not what the file holds.
fn whole_stl(file: &File<'_>) -> Result<()> {
    let Some(count) = file.bytes.get(STL_HEADER..STL_HEADER + 4).and_then(|b| b.first_chunk::<4>()) else {
        return Ok(());
    };
    if file.bytes.starts_with(b"solid") {
        return Ok(());
    }
    let (count, held) = (u32::from_le_bytes(*count), file.bytes.len() - STL_HEADER - 4);
    if u64::from(count) * STL_TRIANGLE == held as u64 {
        return Ok(());
    }
    let problem = format!("its header promises {count} triangles, but {held} bytes of {STL_TRIANGLE} each follow");
    Err(Error::read(file.path, problem, "copy or export the mesh again"))
}

impl Stl {
    /// Binary, whatever was read.
    pub(super) fn write(&self, points: &[Point3<f64>]) -> Result<Vec<u8>, String> {
        let triangles: Vec<Triangle> =
            self.mesh.faces.iter().map(|face| triangle(face.vertices.map(|n| points[n]))).collect();
        let mut out = Cursor::new(Vec::new());
        stl_io::write_stl(&mut out, triangles.iter()).map_err(|e| e.to_string())?;
        let mut bytes = out.into_inner();
        let header = bytes.get_mut(..STL_HEADER).ok_or("the header is missing")?;
        header.fill(b' ');
        header[..self.header.len()].copy_from_slice(&self.header);
        Ok(bytes)
    }
}

/// A triangle with its normal by the right-hand rule.
fn triangle(corners: [Point3<f64>; 3]) -> Triangle {
    let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0])).try_normalize(0.0).unwrap_or_default();
    let single = |v: Vector3<f64>| [v.x as f32, v.y as f32, v.z as f32];
    Triangle { normal: Normal::new(single(normal)), vertices: corners.map(|p| Vertex::new(single(p.coords))) }
}
