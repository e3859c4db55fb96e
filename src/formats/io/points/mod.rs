//! Files of positions: points and landmarks (CSV, Slicer's `.mrk.json` and `.fcsv`, elastix's `.txt`) and surface meshes
//! (`.obj`, `.stl`). Only the positions change; names, order and everything else of a file stay.

mod elastix;
mod mesh;
mod slicer;
mod table;

use super::bytes::read_bytes;
use super::kinds;
use super::text::BYTE_ORDER_MARK;
use crate::error::{Error, Result};
use crate::findings;
use nalgebra::Point3;
use std::path::Path;

/// Frame that a file's coordinates are written in, mm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Space {
    /// Left, posterior, superior: DICOM, ITK.
    Lps,
    /// Right, anterior, superior: NIfTI, older Slicer files.
    Ras,
}

impl Space {
    /// To LPS, or from it.
    fn convert(self, p: Point3<f64>) -> Point3<f64> {
        match self {
            Self::Lps => p,
            Self::Ras => Point3::new(-p.x, -p.y, p.z),
        }
    }

    /// The space that a word names, as Slicer spells them.
    fn of(word: &str) -> Option<Self> {
        match word.trim() {
            "LPS" | "1" => Some(Self::Lps),
            "RAS" | "0" => Some(Self::Ras),
            _ => None,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Lps => "LPS",
            Self::Ras => "RAS",
        }
    }
}

/// A file of positions, with all that stays when they move.
pub struct PointFile {
    /// Name of each point; meshes have none.
    pub names: Vec<String>,
    /// Positions, LPS mm.
    pub points: Vec<Point3<f64>>,
    space: Space,
    content: PointContent,
}

enum PointContent {
    Table(table::Table),
    Markups(slicer::Markups),
    Fiducials(slicer::Fiducials),
    Elastix,
    Obj(mesh::Obj),
    Stl(mesh::Stl),
}

/// Extensions of files of positions.
const ENDS: [&str; 6] = [".csv", ".mrk.json", ".fcsv", ".txt", ".obj", ".stl"];

/// The extension among those of files of positions that a path has.
pub fn point_extension(path: &Path) -> Option<&'static str> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    ENDS.into_iter().find(|end| name.ends_with(end))
}

/// Reads a file of positions that lie in the frame `frame`; the extension tells the format.
///
/// A CSV has columns `x`, `y`, `z`, or `FRAME_x`, ... as `register --landmarks` takes them, LPS mm. `space` is what the
/// user says of files that do not tell their frame of coordinates (meshes, old `.fcsv`).
///
/// # Errors
/// [`Error::Read`] when the file cannot be parsed; [`Error::Input`] when a coordinate is no finite number, when it holds no
/// point, when its space is unknown or not what the user says, or when it cannot be mapped point by point.
pub fn read_points(path: impl AsRef<Path>, frame: &str, space: Option<Space>) -> Result<PointFile> {
    let path = path.as_ref();
    let end = point_extension(path).ok_or_else(|| {
        let problem = format!("{}: the extension names no format of points or meshes", path.display());
        Error::usage(problem, format!("use one of {}", ENDS.join(", ")))
    })?;
    let mut bytes = read_bytes(path)?;
    if bytes.starts_with(BYTE_ORDER_MARK) {
        bytes.drain(..BYTE_ORDER_MARK.len());
    }
    if let Some(other) = kinds::told(&bytes) {
        return Err(Error::read(path, format!("it is {}", other.what), other.remedy));
    }
    let file = File { path, bytes, said: space };
    let read = match end {
        ".csv" => table::read(&file, frame),
        ".mrk.json" => slicer::read_markups(&file),
        ".fcsv" => slicer::read_fiducials(&file),
        ".txt" => elastix::read(&file),
        ".obj" => mesh::read_obj(&file),
        _ => mesh::read_stl(&file),
    }?;
    if read.points.is_empty() {
        return Err(file.refuse("it holds no point", "give a file with points"));
    }
    if let Some(n) = read.points.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
        return Err(file.refuse(format!("point {} is not finite: {:?}", n + 1, read.points[n]), "correct it"));
    }
    Ok(read)
}

impl PointFile {
    /// Writes the file with other positions (LPS mm, as many as there are), in the format and space of the one read.
    ///
    /// # Errors
    /// [`Error::Usage`] when the extension is another, [`Error::Write`] when the file cannot be written,
    /// [`Error::Internal`] when the number of positions differs.
    pub fn write(&self, path: impl AsRef<Path>, moved: &[Point3<f64>]) -> Result<()> {
        let path = path.as_ref();
        let own = self.content.extension();
        if point_extension(path) != Some(own) {
            let problem = format!("{}: the points were read from a {own} file", path.display());
            return Err(Error::usage(problem, format!("name the output *{own}")));
        }
        if moved.len() != self.points.len() {
            return Err(Error::Internal(format!("{} positions for {} points", moved.len(), self.points.len())));
        }
        let stored: Vec<Point3<f64>> = moved.iter().map(|p| self.space.convert(*p)).collect();
        let bytes = match &self.content {
            PointContent::Table(table) => table.write(&self.names, &stored),
            PointContent::Markups(markups) => markups.write(&stored),
            PointContent::Fiducials(fiducials) => fiducials.write(&stored),
            PointContent::Elastix => elastix::write(&stored),
            PointContent::Obj(obj) => obj.write(&stored),
            PointContent::Stl(stl) => stl.write(&stored),
        }
        .map_err(|problem| Error::write(path, problem, "report this with the input file"))?;
        super::write_file(path, |out| out.write_all(&bytes))
    }
}

impl PointContent {
    fn extension(&self) -> &'static str {
        match self {
            Self::Table(_) => ".csv",
            Self::Markups(_) => ".mrk.json",
            Self::Fiducials(_) => ".fcsv",
            Self::Elastix => ".txt",
            Self::Obj(_) => ".obj",
            Self::Stl(_) => ".stl",
        }
    }
}

/// A file on its way in.
struct File<'a> {
    path: &'a Path,
    bytes: Vec<u8>,
    /// The space that the user says it is in.
    said: Option<Space>,
}

impl File<'_> {
    fn text(&self) -> Result<&str> {
        std::str::from_utf8(&self.bytes)
            .map_err(|e| Error::read(self.path, format!("it is no UTF-8 text ({e})"), "export it again as text"))
    }

    fn refuse(&self, problem: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::input(self.path.display().to_string(), problem, remedy)
    }

    /// The space of the coordinates: the file's word, which the user's must not contradict, else the user's.
    fn space(&self, own: Option<Space>) -> Result<Space> {
        match (own, self.said) {
            (Some(own), Some(said)) if own != said => Err(self.refuse(
                format!("it says that its coordinates are {}, --space says {}", own.name(), said.name()),
                "leave --space out, or correct the file",
            )),
            (Some(space), _) | (None, Some(space)) => Ok(space),
            (None, None) => Err(Error::refused(
                findings::SPACE_UNKNOWN,
                self.path.display().to_string(),
                "it does not say whether its coordinates are LPS or RAS",
                "say it with --space lps or --space ras; a wrong choice mirrors left and right",
            )),
        }
    }

    /// A coordinate of a line.
    fn number(&self, text: Option<&str>, line: usize) -> Result<f64> {
        let text = text.unwrap_or_default().trim();
        text.parse::<f64>().ok().filter(|v| v.is_finite()).ok_or_else(|| {
            self.refuse(
                format!("line {line}: {text:?} is no finite number"),
                "give coordinates in mm with a decimal point",
            )
        })
    }
}

/// Coordinates with as many digits as a tenth of a nanometre needs, without trailing zeros.
fn digits(value: f64) -> String {
    let text = format!("{value:.7}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.into() }
}

#[cfg(test)]
mod tests;
