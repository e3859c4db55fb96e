//! Where labels and contours may be, by samples of the registration that carries them.

use super::super::beside::map_beside;
use super::super::links::LinkArg;
use super::args::WarpArgs;
use super::report::WarpReport;
use crate::error::{Error, Result};
use crate::field::Chain;
use crate::geometry::Grid;
use crate::io::checksum::sha256_file;
use crate::io::samples::{self, SAMPLES};
use crate::io::{self, Stored, WriteOptions};
use crate::pipeline::{CarriedStructure, polygons_above};
use crate::sampling::SampleSet;
use crate::volume::contour::{Contours, Structure};
use crate::volume::{LabelMap, Volume};
use nalgebra::{Point3, Vector3};
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Share of a small box on a contour that counts over this width, mm.
const SOFT_MM: f64 = 0.5;
/// Pixels of the planes on which contours are drawn, mm, at most.
const PIXEL_MM: f64 = 1.0;
/// Shares of the samples whose contours are drawn, percent.
const DRAWN: [u32; 3] = [5, 50, 95];

/// Refuses what samples do not go with, before anything is read.
pub(super) fn check(args: &WarpArgs) -> Result<()> {
    if args.samples.is_none() {
        return Ok(());
    }
    let wrong = |problem: &str, remedy: &str| Err(Error::usage(problem, remedy));
    if (args.from.as_str(), args.to.as_str()) != ("planning", "fraction") || args.field.len() != 1 {
        let problem = "--samples carry labels or contours of planning to its fraction, through one field";
        return wrong(problem, "give --from planning --to fraction and the --field of the run");
    }
    match args.kind {
        None | Some(super::VolumeKind::Labels) => Ok(()),
        Some(_) => {
            wrong("--samples with an image or a dose", "give --kind labels, or see `aventail dose map --samples`")
        }
    }
}

/// The samples that are asked for.
pub(super) fn of(args: &WarpArgs) -> Result<Option<SampleSet>> {
    match (&args.samples, args.field.first()) {
        (Some(folder), Some(field)) => read(folder, field).map(Some),
        _ => Ok(None),
    }
}

/// Reads the samples, which must be those of the field.
fn read(folder: &Path, field: &LinkArg) -> Result<SampleSet> {
    let (about, set) = samples::read(folder)?;
    about.require_of(folder, &field.path(), &sha256_file(field.path())?)?;
    Ok(set)
}

/// The file that tells of the samples.
pub(super) fn file(args: &WarpArgs) -> Option<PathBuf> {
    args.samples.as_ref().map(|folder| folder.join(SAMPLES))
}

/// Adds to each structure the contours that 5, 50 and 95 % of the samples keep within.
pub(super) fn contours(
    before: &Contours,
    after: &mut Contours,
    back: &Chain<'_>,
    grid: &Grid,
    samples: &SampleSet,
    report: &mut WarpReport,
) -> Result<()> {
    let mut more = Vec::new();
    let spacing = grid.spacing();
    let fine = &refined(grid)?;
    for (old, new) in before.structures.iter().zip(&after.structures) {
        let gap = before.spacing_of(old, spacing[2]);
        let solid = before.solid(old, gap);
        let inside = |p: &Point3<f64>| solid.share(p, SOFT_MM, gap);
        let points = new.polygons.iter().flat_map(|p| p.points.iter().map(|q| fine.index(&after.world(*q, p.height))));
        let around = bounds(points.map(|index| index.into()), fine);
        let carried = CarriedStructure { inside: &inside, back, samples };
        let Some(share) = carried.probability(fine, &around)? else { continue };
        let mut volumes = Vec::new();
        for percent in DRAWN {
            let polygons = polygons_above(&share, f64::from(percent) / 100.0, &after.axes);
            let one = Structure { name: format!("{} {percent} %", old.name), colour: new.colour, polygons };
            volumes.push(format!("{:.2} cm3 in {percent} %", one.volume(spacing[2]) / 1000.0));
            more.push(one);
        }
        report.notes.push(format!("{}: of the samples {}", old.name, volumes.join(", ")));
    }
    after.structures.extend(more);
    Ok(())
}

/// The grid with pixels of a millimetre or less on the same planes, on which small structures have a shape.
fn refined(grid: &Grid) -> Result<Grid> {
    let (size, spacing) = (grid.size(), grid.spacing());
    let parts = [0, 1].map(|a| (spacing[a] / PIXEL_MM).ceil().max(1.0));
    let first = Vector3::new(0.5 / parts[0] - 0.5, 0.5 / parts[1] - 0.5, 0.0);
    Grid::new(
        [size[0] * parts[0] as usize, size[1] * parts[1] as usize, size[2]],
        [spacing[0] / parts[0], spacing[1] / parts[1], spacing[2]],
        grid.world(&first),
        *grid.direction(),
    )
}

/// Writes a map of each label beside `out`: the share of the samples in which it is at each voxel.
pub(super) fn labels(
    before: &LabelMap,
    after: &LabelMap,
    back: &Chain<'_>,
    samples: &SampleSet,
    out: &Path,
    report: &mut WarpReport,
) -> Result<()> {
    let grid = after.volume.grid();
    let own = before.volume.grid();
    let mut boxes: BTreeMap<u16, [Range<usize>; 3]> = BTreeMap::new();
    for (l, label) in after.volume.data().iter().enumerate().filter(|(_, label)| **label != 0) {
        let voxel = grid.voxel(l);
        let around = boxes.entry(*label).or_insert_with(|| voxel.map(|v| v..v + 1));
        (0..3).for_each(|a| around[a] = around[a].start.min(voxel[a])..around[a].end.max(voxel[a] + 1));
    }
    for (label, around) in boxes {
        let inside =
            |p: &Point3<f64>| own.voxel_at(p).map_or(0.0, |v| f64::from(u8::from(*before.volume.at(v) == label)));
        let carried = CarriedStructure { inside: &inside, back, samples };
        let Some(share) = carried.probability(grid, &around)? else { continue };
        let name = before.names.get(&label).cloned().unwrap_or_else(|| label.to_string());
        let path = share_beside(out, &name);
        let description = format!("aventail: share of {} samples with {name}", samples.number());
        let options = WriteOptions { description, ..WriteOptions::default() };
        io::write_image(&path, &whole(&share, grid)?, Stored::Float32, &options)?;
        let ml =
            |least: f32| share.data().iter().filter(|v| **v >= least).count() as f64 * grid.voxel_volume() / 1000.0;
        report.notes.push(format!(
            "{name}: {:.2} cm3 in 95 % of the samples, {:.2} in half, {:.2} in 5 %: {}",
            ml(0.95),
            ml(0.5),
            ml(0.05),
            path.display()
        ));
    }
    Ok(())
}

/// The map of a label beside the labels; letters that a file name should not have became `_`.
fn share_beside(out: &Path, name: &str) -> PathBuf {
    let plain: String = name.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect();
    map_beside(out, &format!("share_{plain}"))
}

/// A part on the whole grid, 0 around it.
fn whole(part: &Volume<f32>, grid: &Grid) -> Result<Volume<f32>> {
    let first = grid.voxel_at(&part.grid().centre([0; 3])).unwrap_or_default();
    let size = part.grid().size();
    let mut out = Volume::filled(grid.clone(), 0f32);
    for k in 0..size[2] {
        for j in 0..size[1] {
            let (from, to) = (part.grid().linear([0, j, k]), grid.linear([first[0], first[1] + j, first[2] + k]));
            out.data_mut()[to..to + size[0]].copy_from_slice(&part.data()[from..from + size[0]]);
        }
    }
    Ok(out)
}

/// The voxels around points, by their index.
fn bounds(points: impl Iterator<Item = [f64; 3]>, grid: &Grid) -> [Range<usize>; 3] {
    let start = [[f64::MAX; 3], [f64::MIN; 3]];
    let [low, high] = points.fold(start, |[low, high], p| {
        [std::array::from_fn(|a| low[a].min(p[a])), std::array::from_fn(|a| high[a].max(p[a]))]
    });
    std::array::from_fn(|a| {
        let end = (high[a].ceil() + 1.0).clamp(0.0, grid.size()[a] as f64) as usize;
        let first = low[a].floor().max(0.0) as usize;
        first.min(end)..end
    })
}
