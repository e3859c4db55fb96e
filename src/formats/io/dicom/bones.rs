//! Names of structures to names of bones: ours are TotalSegmentator's, clinics use TG-263's (AAPM
//! report 263) and their own.

use super::structures::{StructureSet, some_names};
use crate::error::{Error, Result};
use crate::findings;
use crate::geometry::Grid;
use crate::skeleton::anatomy::Kind;
use crate::volume::contour::{Contours, Structure};
use crate::volume::{LabelMap, Outline, Volume};
use crate::warning::Warning;
use rayon::prelude::*;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::Path;

/// Spellings of the two sides.
const LEFT: [&str; 5] = ["left", "l", "lt", "li", "links"];
const RIGHT: [&str; 5] = ["right", "r", "rt", "re", "rechts"];
/// Spellings of bones that have no side.
const MIDDLE: [(&str, &[&str]); 5] = [
    ("mandible", &["mandible", "mandibula", "jaw", "lowerjaw", "unterkiefer"]),
    ("hyoid", &["hyoid", "hyoidbone", "oshyoideum", "zungenbein"]),
    ("sternum", &["sternum", "breastbone", "brustbein"]),
    ("sacrum", &["sacrum", "ossacrum", "kreuzbein"]),
    ("skull", &["skull", "cranium", "schädel", "schaedel"]),
];
/// Spellings of bones of which there are two; of some only the end next to the trunk is usually
/// drawn.
const PAIRED: [(&str, &[&str]); 7] = [
    ("clavicula", &["clavicula", "clavicle", "schlüsselbein", "schluesselbein"]),
    ("scapula", &["scapula", "shoulderblade", "schulterblatt"]),
    ("humerus", &["humerus", "humerushead", "humeralhead", "humeruskopf"]),
    ("ulna", &["ulna"]),
    ("radius", &["radius"]),
    ("hip", &["hip", "hipbone", "ilium", "oscoxae", "hemipelvis"]),
    ("femur", &["femur", "femurhead", "femoralhead", "femurkopf", "hüftkopf", "hueftkopf"]),
];
/// What stands before the level of a vertebra.
const VERTEBRA: [&str; 6] = ["", "vb", "vertebra", "vertebrae", "vert", "vertebralbody"];
/// Spellings of the parts of the spine, by their letter.
const SPINE: [(char, &[&str]); 4] =
    [('C', &["c", "hwk", "hw"]), ('T', &["t", "th", "bwk", "bw"]), ('L', &["l", "lwk", "lw"]), ('S', &["s"])];

/// Letters and digits of a name, lower case: case and separators do not matter.
pub(in crate::io) fn plain(name: &str) -> String {
    name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

/// Names of a clinic: structure to bone, in its spelling without case and separators.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct BoneNames(BTreeMap<String, Option<String>>);

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    bones: BTreeMap<String, String>,
}

impl BoneNames {
    /// Reads names from a TOML file: under `[bones]` the structure's name and TotalSegmentator's
    /// name of the bone, which is empty for a structure that is no bone.
    ///
    /// # Errors
    /// [`Error::Read`] when it is no such file; [`Error::Input`] for a bone that the skeleton does
    /// not know.
    pub fn read(path: &Path) -> Result<Self> {
        let text = super::super::text::read_text(path)?;
        let file: File = toml::from_str(&text).map_err(|e| {
            let remedy = "give a TOML file: [bones], then lines such as \"Unterkiefer\" = \"mandible\"";
            Error::read(path, format!("it holds no names of bones ({})", e.message()), remedy)
        })?;
        let mut names = BTreeMap::new();
        for (structure, bone) in file.bones {
            if !bone.is_empty() && Kind::of(&bone).is_none() {
                let problem = format!("{structure:?} is said to be {bone:?}, which is no bone of the skeleton");
                let remedy =
                    "use TotalSegmentator's names, for example vertebrae_C1, clavicula_left; empty for no bone";
                return Err(Error::input(path.display().to_string(), problem, remedy));
            }
            names.insert(plain(&structure), Some(bone).filter(|b| !b.is_empty()));
        }
        Ok(Self(names))
    }

    /// The bone of a structure's name: by these names, else by common spellings; `None` for what is
    /// no bone.
    pub fn bone(&self, name: &str) -> Option<String> {
        if let Some(own) = self.0.get(&plain(name)) {
            return own.clone();
        }
        if Kind::of(name).is_some() {
            return Some(name.to_owned());
        }
        let whole = plain(name);
        common(&whole).or_else(|| whole.strip_prefix("bone").and_then(common))
    }
}

/// The bone of a common spelling.
fn common(name: &str) -> Option<String> {
    if let Some((bone, _)) = MIDDLE.iter().find(|(_, spelt)| spelt.contains(&name)) {
        return Some((*bone).to_owned());
    }
    match name {
        "atlas" => return Some("vertebrae_C1".into()),
        "axis" => return Some("vertebrae_C2".into()),
        _ => {}
    }
    vertebra(name).or_else(|| sided(name))
}

fn vertebra(name: &str) -> Option<String> {
    let digits = name.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    let (head, number) = name.split_at_checked(digits)?;
    let number: u8 = number.parse().ok()?;
    VERTEBRA.iter().filter_map(|v| head.strip_prefix(v)).find_map(|part| {
        let (letter, _) = SPINE.iter().find(|(_, spelt)| spelt.contains(&part))?;
        Some(format!("vertebrae_{letter}{number}")).filter(|bone| Kind::of(bone).is_some())
    })
}

fn sided(name: &str) -> Option<String> {
    for (side, spelt) in [("left", LEFT), ("right", RIGHT)] {
        for s in spelt {
            for rest in [name.strip_suffix(s), name.strip_prefix(s)].into_iter().flatten() {
                if let Some((bone, _)) = PAIRED.iter().find(|(_, spelt)| spelt.contains(&rest)) {
                    return Some(format!("{bone}_{side}"));
                }
                let number = |text: &str| text.parse::<u8>().ok();
                let rib = |rest: &str| number(rest.strip_prefix("rib").or_else(|| rest.strip_prefix("rippe"))?);
                if let Some(n) = rib(rest) {
                    return Some(format!("rib_{side}_{n}")).filter(|bone| Kind::of(bone).is_some());
                }
            }
            // The side between bone and number.
            let inner = name.strip_prefix("rib").and_then(|r| r.strip_prefix(s)).and_then(|n| n.parse::<u8>().ok());
            if let Some(n) = inner {
                return Some(format!("rib_{side}_{n}")).filter(|bone| Kind::of(bone).is_some());
            }
        }
    }
    None
}

/// Bones of a structure set on a grid.
#[derive(Debug, Clone)]
pub struct BoneLabels {
    /// The bones, by TotalSegmentator's names. Where two are drawn over each other, a voxel is of
    /// the one whose surface is farther.
    pub map: LabelMap,
    /// Structures with contours whose names are no bone's.
    pub unrecognised: Vec<String>,
    /// What was found.
    pub warnings: Vec<Warning>,
}

/// The bones of a structure set on `grid`, LPS mm: a voxel is in a bone when its centre is in its
/// contours.
///
/// # Errors
/// [`Error::Input`] when no structure is a bone, or no voxel of the grid lies in one.
pub fn labels_from_structures(set: &StructureSet, grid: &Grid, names: &BoneNames) -> Result<BoneLabels> {
    let what = set.path.display().to_string();
    let mut bones: BTreeMap<String, Vec<&Structure>> = BTreeMap::new();
    let mut unrecognised = Vec::new();
    for (roi, structure) in set.drawn() {
        match names.bone(&roi.name) {
            Some(bone) => bones.entry(bone).or_default().push(structure),
            None => unrecognised.push(roi.name.clone()),
        }
    }
    let remedy = "name the structures as TG-263 or TotalSegmentator do, or give a TOML file with --labels: [bones], then \
        lines such as \"Unterkiefer\" = \"mandible\"";
    if bones.is_empty() {
        let problem = format!("none of its structures has the name of a bone: {}", some_names(&unrecognised));
        return Err(Error::refused(findings::BONES_UNNAMED, what, problem, remedy));
    }
    let mut warnings = Vec::new();
    if !unrecognised.is_empty() {
        let message = format!("{what}: structures that are no bone by their names: {}", some_names(&unrecognised));
        warnings.push(Warning::new(findings::BONES_UNNAMED, message));
    }
    let joined: Vec<&str> = bones.iter().filter(|b| b.1.len() > 1).map(|b| b.0.as_str()).collect();
    if !joined.is_empty() {
        let message = format!("{what}: several structures are one bone: {}", some_names(&joined));
        warnings.push(Warning::new(findings::LABELS_JOINED, message));
    }
    let map = drawn(&set.contours, bones, grid)?;
    let counts = map.counts();
    let gone: Vec<&str> = map.names.iter().filter(|n| !counts.contains_key(n.0)).map(|n| n.1.as_str()).collect();
    if counts.is_empty() {
        let problem = "none of its bones lies in the image";
        return Err(Error::refused(
            findings::BONES_UNNAMED,
            what,
            problem,
            "give the structure set of this planning CT",
        ));
    }
    if !gone.is_empty() {
        let message = format!("{what}: bones without a voxel in the image: {}", some_names(&gone));
        warnings.push(Warning::new(findings::BONES_OUTSIDE, message));
    }
    Ok(BoneLabels { map, unrecognised, warnings })
}

/// Named structures as labels on `grid`: a voxel is of the one in which it lies deepest.
fn drawn(all: &Contours, named: BTreeMap<String, Vec<&Structure>>, grid: &Grid) -> Result<LabelMap> {
    let mut labels = vec![0u16; grid.len()];
    let mut deepest = vec![0.0f32; grid.len()];
    let mut names = BTreeMap::new();
    for (label, (name, structures)) in (1u16..).zip(named) {
        for structure in structures {
            draw(all, structure, grid, label, &mut labels, &mut deepest);
        }
        names.insert(label, name);
    }
    Ok(LabelMap { volume: Volume::new(grid.clone(), labels)?, names })
}

/// The structures of these names on `grid`, LPS mm, by the names that are asked for: spellings may
/// differ in case and separators. A voxel belongs to the one in which it lies deepest. Names that no
/// structure has are left out.
///
/// # Errors
/// [`Error::Input`] when no structure has one of the names, or no voxel of the grid lies in one.
pub fn organs_from_structures(set: &StructureSet, grid: &Grid, wanted: &[String]) -> Result<LabelMap> {
    let mut organs: BTreeMap<String, Vec<&Structure>> = BTreeMap::new();
    let mut others = Vec::new();
    for (roi, structure) in set.drawn() {
        match wanted.iter().find(|w| plain(w) == plain(&roi.name)) {
            Some(name) => organs.entry(name.clone()).or_default().push(structure),
            None => others.push(roi.name.clone()),
        }
    }
    if organs.is_empty() {
        let problem = format!(
            "none of its structures is an organ that the settings name ({}): {}",
            some_names(wanted),
            some_names(&others)
        );
        let remedy = "name organs as the structure set does, in --volume-change, chainmail.organs or \
            chainmail.slip.organs; or leave --organs out";
        return Err(Error::input(set.path.display().to_string(), problem, remedy));
    }
    let map = drawn(&set.contours, organs, grid)?;
    if map.counts().is_empty() {
        let names: Vec<&str> = map.names.values().map(String::as_str).collect();
        let problem = format!("no voxel of the planning grid lies in {}", some_names(&names));
        let remedy = "give the structure set of this planning CT, with contours of these organs";
        return Err(Error::input(set.path.display().to_string(), problem, remedy));
    }
    Ok(map)
}

/// Each structure of a set by itself on `grid`, LPS mm, under its own name; and the names of those without a voxel there.
///
/// # Errors
/// [`Error::Internal`] when no volume can be made of the grid.
pub fn outlines_from_structures(set: &StructureSet, grid: &Grid) -> Result<(Vec<Outline>, Vec<String>)> {
    let (mut outlines, mut empty) = (Vec::new(), Vec::new());
    for (roi, structure) in set.drawn() {
        let one = drawn(&set.contours, [(roi.name.clone(), vec![structure])].into(), grid)?;
        match Outline::of(&roi.name, &one.volume, |label| label == 1) {
            Some(outline) => outlines.push(outline),
            None => empty.push(roi.name.clone()),
        }
    }
    Ok((outlines, empty))
}

/// Gives the voxels in a structure its label, where none lies deeper in another.
fn draw(all: &Contours, structure: &Structure, grid: &Grid, label: u16, labels: &mut [u16], deepest: &mut [f32]) {
    let spacing = all.spacing_of(structure, grid.spacing()[2]);
    let solid = all.solid(structure, spacing);
    let Some([i, j, k]) = around(all, structure, grid, spacing) else { return };
    let slice = grid.strides()[2];
    let planes = labels.par_chunks_mut(slice).zip(deepest.par_chunks_mut(slice)).enumerate();
    planes.filter(|(z, _)| k.contains(z)).for_each(|(z, (labels, deepest))| {
        for y in j.clone() {
            for x in i.clone() {
                let depth = solid.depth(&grid.centre([x, y, z])) as f32;
                let at = x + y * grid.size()[0];
                if depth > deepest[at] {
                    (labels[at], deepest[at]) = (label, depth);
                }
            }
        }
    });
}

/// The voxels among which a structure's are, along each axis.
fn around(all: &Contours, s: &Structure, grid: &Grid, spacing: f64) -> Option<[RangeInclusive<usize>; 3]> {
    let mut low = [f64::MAX; 3];
    let mut high = [f64::MIN; 3];
    for p in &s.polygons {
        for (point, end) in p.points.iter().flat_map(|q| [(q, -spacing), (q, spacing)]) {
            let index = grid.index(&all.world(*point, p.height + end));
            for a in 0..3 {
                low[a] = low[a].min(index[a]);
                high[a] = high[a].max(index[a]);
            }
        }
    }
    let range = |a: usize| {
        let last = grid.size()[a] as f64 - 1.0;
        let (from, to) = (low[a].floor().max(0.0), high[a].ceil().min(last));
        (from <= to).then_some(from as usize..=to as usize)
    };
    Some([range(0)?, range(1)?, range(2)?])
}
