//! Pictures of a library, made posture by posture, so that no more than one is held.

use super::super::canvas::{Canvas, Rgb, mix};
use super::super::colour::{BLUE, ORANGE, grey, heat, tone};
use super::super::plane::{Plane, Region, nearest, planes};
use crate::error::{Error, Result};
use crate::skeleton::Skeleton;
use crate::skeleton::anatomy::{Kind as Bone, SKULL};
use crate::volume::{LabelMap, Mask, Volume};
use nalgebra::{Point3, Vector3};

/// Rim around the patient, mm.
const RIM_MM: f64 = 12.0;
/// Thumbnails are this much smaller than the large pictures.
const SMALLER: f64 = 0.3;
/// Opacity of one posture's outline: the less, the more there are.
const FAINTEST: f64 = 0.2;

/// The pictures while they are made.
pub struct Gallery {
    views: Vec<GalleryView>,
    /// Labels of bones.
    bones: Vec<bool>,
    count: usize,
    opacity: f64,
    /// Each posture's name and its thumbnail, a PNG.
    pub(super) thumbnails: Vec<(String, Vec<u8>)>,
}

/// One plane.
struct GalleryView {
    plane: Plane,
    small: Plane,
    /// The planning CT, dimmed, under all outlines.
    overlay: Canvas,
    planning: Vec<u16>,
    /// Sums of HU and of their squares.
    sums: Vec<[f64; 2]>,
}

/// A finished picture.
pub(super) struct GalleryShown {
    pub(super) title: &'static str,
    pub(super) caption: &'static str,
    pub(super) png: Vec<u8>,
}

/// Labels at the pixels of a plane; 0 for what is no bone.
fn labels(plane: &Plane, map: &LabelMap, bones: &[bool]) -> Vec<u16> {
    let bone = |l: u16| if bones.get(usize::from(l)).copied().unwrap_or(false) { l } else { 0 };
    plane.each(|p| bone(nearest(&map.volume, p).unwrap_or(0)))
}

/// Draws the borders between labels.
fn outline(canvas: &mut Canvas, plane: &Plane, labels: &[u16], colour: Rgb, opacity: f64) {
    plane.borders(canvas, labels, colour, [opacity, 0.0]);
}

impl Gallery {
    /// Begins with the patient in planning: the sagittal plane through the spine and the coronal one through the vertebrae;
    /// `total` postures are to come.
    pub fn new(ct: &Volume<f32>, map: &LabelMap, body: &Mask, skeleton: &Skeleton, total: usize) -> Self {
        let mut bones = vec![false; usize::from(u16::MAX) + 1];
        skeleton.bones.iter().for_each(|b| bones[usize::from(b.label)] = true);
        let grid = ct.grid();
        let every = (0..grid.len()).step_by(7).filter(|&n| body.data()[n]).map(|n| grid.centre(grid.voxel(n)));
        let region = Region::around(every).map_or(Region::of(grid), |r| r.grown(RIM_MM).within(Region::of(grid)));
        let spine = |b: &&crate::skeleton::Bone| matches!(Bone::of(&b.name), Some(Bone::Spine(l)) if l < SKULL);
        let axis: Vec<Vector3<f64>> = skeleton.bones.iter().filter(spine).map(|b| b.centroid.coords).collect();
        let middle = if axis.is_empty() {
            grid.middle()
        } else {
            Point3::from(axis.iter().sum::<Vector3<f64>>() / axis.len() as f64)
        };
        let [_, coronal, sagittal] = planes(&[region; 3], &middle);
        let view = |plane: Plane| {
            let hu = plane.hu(ct);
            let mut overlay = plane.paint(|_, n| grey(0.75 * tone(f64::from(hu[n]))));
            let planning = labels(&plane, map, &bones);
            outline(&mut overlay, &plane, &planning, BLUE, 1.0);
            let sums = vec![[0.0; 2]; hu.len()];
            GalleryView { small: plane.scaled(SMALLER), overlay, planning, sums, plane }
        };
        let views = [sagittal, coronal].map(view).into();
        let opacity = (1.4 / (total as f64).max(1.0).sqrt()).clamp(FAINTEST, 0.9);
        Self { views, bones, count: 0, opacity, thumbnails: Vec::new() }
    }

    /// Adds a posture.
    ///
    /// # Errors
    /// [`Error::Internal`] when a picture cannot be encoded.
    pub fn add(&mut self, name: &str, ct: &Volume<f32>, map: &LabelMap) -> Result<()> {
        self.count += 1;
        let mut small: Vec<Canvas> = Vec::new();
        for view in &mut self.views {
            let hu = view.plane.hu(ct);
            for (sum, hu) in view.sums.iter_mut().zip(&hu) {
                // Beyond the image there is air.
                let hu = f64::from(hu.max(-1000.0));
                *sum = [sum[0] + hu, sum[1] + hu * hu];
            }
            let moved = labels(&view.plane, map, &self.bones);
            outline(&mut view.overlay, &view.plane, &moved, ORANGE, self.opacity);
            let hu = view.small.hu(ct);
            let mut thumbnail = view.small.paint(|_, n| grey(tone(f64::from(hu[n]))));
            outline(&mut thumbnail, &view.small, &labels(&view.small, map, &self.bones), ORANGE, 0.9);
            small.push(thumbnail);
        }
        self.thumbnails.push((name.into(), png(&beside(&small))?));
        Ok(())
    }

    /// The large pictures: outlines, mean, standard deviation.
    pub(super) fn shown(&self) -> Result<Vec<GalleryShown>> {
        let n = (self.count as f64).max(1.0);
        let mut overlays = Vec::new();
        let (mut means, mut deviations) = (Vec::new(), Vec::new());
        for view in &self.views {
            let mut overlay = view.overlay.clone();
            outline(&mut overlay, &view.plane, &view.planning, BLUE, 0.8);
            overlays.push(overlay);
            let mean = |k: usize| view.sums[k][0] / n;
            means.push(view.plane.paint(|_, k| grey(tone(mean(k)))));
            deviations.push(view.plane.paint(|_, k| {
                let sd = (view.sums[k][1] / n - mean(k).powi(2)).max(0.0).sqrt();
                mix(grey(0.5 * tone(mean(k))), heat(sd / GREATEST_SD), (sd / 60.0).min(1.0))
            }));
        }
        let shown = |title, caption, parts: &[Canvas]| Ok(GalleryShown { title, caption, png: full(&beside(parts))? });
        Ok(vec![
            shown(
                "Bones of all postures",
                "Planning CT with its bones outlined in blue, and the bones of every posture in orange, on the sagittal plane \
                 through the spine and the coronal plane through the vertebrae.",
                &overlays,
            )?,
            shown("Mean of all postures", "HU on the mean; what stays sharp does not move.", &means)?,
            shown(
                "Spread of all postures",
                "Standard deviation of HU over the mean image, bright at 500 HU and above: edges that move.",
                &deviations,
            )?,
        ])
    }
}

/// HU that are as bright as it gets.
const GREATEST_SD: f64 = 500.0;

/// Pictures side by side on black.
fn beside(parts: &[Canvas]) -> Canvas {
    let wide = parts.iter().map(Canvas::width).sum::<usize>() + 8 * parts.len().saturating_sub(1);
    let high = parts.iter().map(Canvas::height).max().unwrap_or(1);
    let mut canvas = Canvas::new(wide.max(1), high.max(1), [0; 3]);
    let mut x = 0;
    for part in parts {
        canvas.paste(part, x, 0);
        x += part.width() + 8;
    }
    canvas
}

fn full(canvas: &Canvas) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    canvas.write_png(&mut out).map_err(|e| Error::Internal(format!("a picture of the library: {e}")))?;
    Ok(out)
}

/// Of few colours: there are many of them.
fn png(canvas: &Canvas) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    canvas.write_small_png(&mut out).map_err(|e| Error::Internal(format!("a picture of the library: {e}")))?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::super::super::example;
    use super::super::super::plane::Kind;
    use super::*;

    #[test]
    fn a_library_of_one_still_posture_spreads_nowhere() {
        let (case, outcome, _) = example::small();
        let mut gallery = Gallery::new(&case.planning.ct, &case.planning.bones, &outcome.body, &outcome.skeleton, 2);
        gallery.add("posture_001", &case.planning.ct, &case.planning.bones).unwrap();
        let view = &gallery.views[0];
        assert!(view.plane.kind == Kind::Sagittal && view.planning.iter().any(|l| *l > 0));
        assert!(view.sums.iter().all(|[a, b]| (b - a * a).abs() < 1e-6 * b.abs().max(1.0)));
        assert_eq!(gallery.shown().unwrap().len(), 3);
        assert_eq!(gallery.thumbnails.len(), 1);
        // Of a moved posture some outline is orange where planning has none.
        gallery.add("posture_002", &outcome.planning_on_fraction, &outcome.bones_on_fraction.to_map()).unwrap();
        let canvas = &gallery.views[0].overlay;
        let orange = (0..canvas.width() * canvas.height())
            .map(|n| canvas.pixel(n % canvas.width(), n / canvas.width()))
            .filter(|[r, _, b]| i16::from(*r) - i16::from(*b) > 40)
            .count();
        assert!(orange > 50, "{orange}");
    }
}
