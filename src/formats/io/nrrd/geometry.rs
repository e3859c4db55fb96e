//! The grid of an NRRD header, LPS mm, by space directions or by spacings.

use super::fields::Fields;
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Grid;
use crate::warning::Warning;
use nalgebra::{Matrix3, Matrix4, Point3, Vector3};

/// How far `axis maxs` may lie from what spacings and sizes say, in spacings.
const MAXS_TOLERANCE: f64 = 1e-3;

/// A grid, and what the header says of its axes.
pub(super) struct Placed {
    pub(super) grid: Grid,
    /// The stored axis that holds the components.
    pub(super) range_axis: Option<usize>,
    /// Whether the header's world is LPS.
    pub(super) is_lps: bool,
}

/// The grid of a header.
pub(super) fn place(fields: &Fields<'_>, sizes: &[usize], warnings: &mut Vec<Warning>) -> Result<Placed> {
    let (flip, is_lps) = space(fields, warnings)?;
    units(fields)?;
    let (grid, range_axis) = match fields.get("spacedirections") {
        Some(text) => with_directions(fields, text, sizes, flip, warnings)?,
        None => (without_directions(fields, sizes)?, None),
    };
    kinds(fields, sizes.len(), range_axis)?;
    Ok(Placed { grid, range_axis, is_lps })
}

/// Factors that turn the file's axes into LPS, and whether they are LPS already.
fn space(fields: &Fields<'_>, warnings: &mut Vec<Warning>) -> Result<([f64; 3], bool)> {
    if let Some(dimension) = fields.integer("spacedimension")?.filter(|d| *d != 3) {
        return Err(fields.refuse(format!("its space dimension is {dimension}, not 3")));
    }
    match fields.word("space").as_deref() {
        Some("left-posterior-superior" | "lps") => Ok(([1.0; 3], true)),
        Some("right-anterior-superior" | "ras") => Ok(([-1.0, -1.0, 1.0], false)),
        Some("left-anterior-superior" | "las") => Ok(([1.0, -1.0, 1.0], false)),
        None => {
            let message = "the header names no space; its axes are taken as left, posterior, superior";
            warnings.push(Warning::new(findings::NO_ORIENTATION, message));
            Ok(([1.0; 3], true))
        }
        Some(other) => Err(fields.refuse(format!("space {other:?} is no 3-D patient space"))),
    }
}

/// Refuses lengths in other units than mm.
fn units(fields: &Fields<'_>) -> Result<()> {
    for key in ["spaceunits", "units"] {
        let millimetres = |u: &str| {
            let u = u.to_ascii_lowercase();
            matches!(
                u.as_str(),
                "" | "mm" | "millimeter" | "millimetre" | "millimeters" | "millimetres" | "???" | "none"
            )
        };
        if let Some(unit) = fields.quoted(key).iter().find(|u| !millimetres(u)) {
            return Err(fields.field(format!("its unit of length is {unit:?}, not mm"), "convert its geometry to mm"));
        }
    }
    Ok(())
}

/// Refuses axes whose kind says that they are no directions in space.
fn kinds(fields: &Fields<'_>, axes: usize, range_axis: Option<usize>) -> Result<()> {
    let Some(text) = fields.word("kinds") else { return Ok(()) };
    let kinds: Vec<&str> = text.split_whitespace().collect();
    if kinds.len() != axes {
        return Err(fields.field(format!("{} kinds for {axes} axes", kinds.len()), "correct the header"));
    }
    let domain = |kind: &str| matches!(kind, "domain" | "space" | "???" | "none");
    match kinds.iter().enumerate().find(|(a, kind)| Some(*a) != range_axis && !domain(kind)) {
        Some((a, kind)) => Err(fields.field(
            format!("its axis {} is of kind {kind}, no direction in space", a + 1),
            "give a 3-D image or a field of vectors",
        )),
        None => Ok(()),
    }
}

/// `(x,y,z)`.
pub(super) fn vector(text: &str) -> Option<Vector3<f64>> {
    let numbers: Option<Vec<f64>> =
        text.trim().strip_prefix('(')?.strip_suffix(')')?.split(',').map(|n| n.trim().parse().ok()).collect();
    let numbers: [f64; 3] = numbers?.try_into().ok()?;
    Some(numbers.into())
}

/// Vectors and `none`, apart by blanks; blanks within parentheses are legal.
pub(super) fn vectors(text: &str) -> Option<Vec<Option<Vector3<f64>>>> {
    let mut words = vec![String::new()];
    let mut inside = false;
    for c in text.chars() {
        inside = (inside || c == '(') && c != ')';
        if !c.is_whitespace() {
            words.last_mut()?.push(c);
        } else if !inside {
            words.push(String::new());
        }
    }
    let word = |w: &String| {
        if w.eq_ignore_ascii_case("none") {
            return Some(None);
        }
        // Components that are not known say the same as `none`.
        vector(w).map(|v| (!v.iter().all(|c| c.is_nan())).then_some(v))
    };
    words.iter().filter(|w| !w.is_empty()).map(word).collect()
}

/// The grid of a header with a direction for each axis, and which stored axis holds the components.
fn with_directions(
    fields: &Fields<'_>,
    text: &str,
    sizes: &[usize],
    flip: [f64; 3],
    warnings: &mut Vec<Warning>,
) -> Result<(Grid, Option<usize>)> {
    let axes = vectors(text)
        .ok_or_else(|| fields.refuse(format!("space directions {text} are not vectors (x,y,z) or none")))?;
    if axes.len() != sizes.len() {
        return Err(fields.refuse(format!("{} space directions for {} axes", axes.len(), sizes.len())));
    }
    let none: Vec<usize> = (0..axes.len()).filter(|&a| axes[a].is_none()).collect();
    for key in ["spacings", "axismins", "axismaxs"] {
        let both = fields
            .per_axis(key, axes.len())?
            .is_some_and(|n| (0..n.len()).any(|a| axes[a].is_some() && !n[a].is_nan()));
        if both {
            let problem = format!("it has {key} beside space directions, which may contradict each other");
            return Err(fields.field(problem, "leave one of them out: space directions and space origin tell all"));
        }
    }
    let kept: Vec<(usize, Vector3<f64>)> = axes.iter().zip(sizes).filter_map(|(v, &n)| v.map(|v| (n, v))).collect();
    let [(nx, x), (ny, y), (nz, z)] = kept[..] else {
        return Err(fields.refuse(format!("{} of its axes have a space direction, not 3", kept.len())));
    };
    let origin = match fields.get("spaceorigin") {
        Some(text) => vector(text).ok_or_else(|| fields.refuse(format!("space origin {text} is not (x,y,z)")))?,
        None => {
            let message = "the header has no space origin; the first voxel is taken to lie at (0, 0, 0), as ITK does";
            warnings.push(Warning::new(findings::NO_ORIENTATION, message));
            Vector3::zeros()
        }
    };
    if !matches!(none[..], [] | [0] | [3]) {
        return Err(fields.refuse("its components are neither the first nor the last axis".into()));
    }
    let mut affine = Matrix4::identity();
    let lps = Matrix3::from_diagonal(&Vector3::from(flip));
    for (column, v) in [x, y, z, origin].into_iter().enumerate() {
        affine.fixed_view_mut::<3, 1>(0, column).copy_from(&(lps * v));
    }
    let grid = Grid::from_affine([nx, ny, nz], &affine).map_err(|e| named(fields, e))?;
    Ok((grid, none.first().copied()))
}

/// A grid's refusal, with the file's name.
fn named(fields: &Fields<'_>, error: Error) -> Error {
    match error {
        Error::Input { problem, remedy, .. } => Error::input(fields.path.display().to_string(), problem, remedy),
        other => other,
    }
}

/// The grid of a header with plain spacings: axes along x, y, z from `axis mins` on.
fn without_directions(fields: &Fields<'_>, sizes: &[usize]) -> Result<Grid> {
    let rank = sizes.len();
    let spacings = fields.per_axis("spacings", rank)?;
    let (Some(&[x, y, z]), &[nx, ny, nz]) = (spacings.as_deref(), sizes) else {
        return Err(fields.refuse("its header has neither space directions nor three spacings".into()));
    };
    for (key, name) in
        [("spaceorigin", "a space origin"), ("space", "a space"), ("spacedimension", "a space dimension")]
    {
        if fields.get(key).is_some() {
            return Err(fields.field(
                format!("it has {name} but spacings instead of space directions, so its axes are unknown"),
                "write space directions, for example (1,0,0) (0,1,0) (0,0,3), instead of spacings",
            ));
        }
    }
    let node: Vec<bool> = match fields.word("centers") {
        None => vec![false; rank],
        Some(text) => {
            let words: Vec<&str> = text.split_whitespace().collect();
            if words.len() != rank || words.iter().any(|w| !matches!(*w, "cell" | "node" | "???" | "none")) {
                return Err(
                    fields.field(format!("centers: {text} are not {rank} times cell or node"), "correct the header")
                );
            }
            words.iter().map(|w| *w == "node").collect()
        }
    };
    let (spacing, size) = ([x, y, z], [nx, ny, nz]);
    let (mins, maxs) = (fields.per_axis("axismins", rank)?, fields.per_axis("axismaxs", rank)?);
    let known = |values: &Option<Vec<f64>>, a: usize| values.as_ref().map(|v| v[a]).filter(|v| !v.is_nan());
    let mut origin = [0.0; 3];
    for a in 0..3 {
        let min = known(&mins, a);
        if let Some(max) = known(&maxs, a) {
            let steps = (size[a] - usize::from(node[a])) as f64;
            let off = min.map(|min| (min + steps * spacing[a] - max).abs() / spacing[a]);
            if off.is_none_or(|off| off.is_nan() || off > MAXS_TOLERANCE) {
                let problem = format!("axis maxs {max} is not axis mins and {steps} spacings of {}", spacing[a]);
                return Err(fields.field(problem, "correct one of them, or leave axis maxs out"));
            }
        }
        // A minimum is the border of the first cell, or the first node.
        origin[a] = min.map_or(0.0, |min| if node[a] { min } else { min + 0.5 * spacing[a] });
    }
    Grid::new(size, spacing, Point3::from(origin), Matrix3::identity()).map_err(|e| named(fields, e))
}
