//! One plane of one kind of picture, for papers and slides.

use super::super::canvas::Canvas;
use super::super::plane::{Kind, Region};
use super::super::svg::svg;
use super::{PictureScene, displacement, fusion, jacobian, uncertainty};
use crate::error::{Error, Result};
use crate::pipeline::{Case, Outcome};

/// What a figure shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FigureKind {
    /// Planning CT deformed and fraction CT by colour, outlines of bones before and after; in the fraction.
    Fusion,
    /// Where planning tissue goes, as arrows; in planning.
    Displacement,
    /// Volume after over before; in planning.
    Jacobian,
    /// One standard deviation, mm; in planning.
    Uncertainty,
}

/// A figure, to be written.
#[derive(Debug)]
pub struct FigureOf {
    canvas: Canvas,
    title: String,
}

/// Width of a figure on paper, mm: a column and a half of a journal.
const WIDTH_MM: f64 = 120.0;

/// A plane of this kind through the coordinate `at` (LPS mm, across the plane; the middle of the scan without), drawn as in
/// the report.
///
/// # Errors
/// [`Error::Usage`] when the place lies outside the scan, or the run has no map of uncertainty.
pub fn figure(case: &Case, outcome: &Outcome, kind: FigureKind, plane: Kind, at: Option<f64>) -> Result<FigureOf> {
    let (which, grid) = match kind {
        FigureKind::Fusion => ("fraction", case.fraction.ct.grid()),
        _ => ("planning", case.planning.ct.grid()),
    };
    let (region, axis) = (Region::of(grid), plane.across());
    let at = at.unwrap_or_else(|| grid.middle()[axis]);
    if !(region.low[axis]..=region.high[axis]).contains(&at) {
        return Err(Error::usage(
            format!("--at {at} mm lies outside the {which} scan"),
            format!("give a coordinate from {:.1} to {:.1} mm (LPS)", region.low[axis], region.high[axis]),
        ));
    }
    let scene = PictureScene::single(case, outcome, plane, at);
    let plate = match (kind, &outcome.uncertainty) {
        (FigureKind::Fusion, _) => fusion::after(&scene),
        (FigureKind::Displacement, _) => displacement::draw(&scene),
        (FigureKind::Jacobian, _) => jacobian::draw(&scene),
        (FigureKind::Uncertainty, Some((map, _))) => uncertainty::draw(&scene, map),
        (FigureKind::Uncertainty, None) => {
            return Err(Error::usage(
                "the run has no map of uncertainty",
                "register again with output.uncertainty = true and a fraction CT",
            ));
        }
    };
    Ok(FigureOf { canvas: plate.canvas, title: format!("{}, {} plane at {at:.1} mm", plate.title, plane.name()) })
}

impl FigureOf {
    /// As SVG: the pixels of the scans, and lines, arrows and letters as such.
    ///
    /// # Errors
    /// [`Error::Internal`] when the pixels cannot be encoded.
    pub fn svg(&self) -> Result<Vec<u8>> {
        let text = svg(&self.canvas, &self.title, WIDTH_MM).map_err(|e| Error::Internal(format!("figure: {e}")))?;
        Ok(text.into_bytes())
    }

    /// As PNG, no colour changed.
    ///
    /// # Errors
    /// [`Error::Internal`] when the pixels cannot be encoded.
    pub fn png(&self) -> Result<Vec<u8>> {
        let mut png = Vec::new();
        let drawn = self.canvas.with_shapes_drawn();
        drawn.write_whole_png(&mut png).map_err(|e| Error::Internal(format!("figure: {e}")))?;
        Ok(png)
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::example;
    use super::*;

    #[test]
    fn every_kind_is_drawn_at_its_place_in_both_formats() {
        let (case, outcome, _) = example::small();
        for kind in [FigureKind::Fusion, FigureKind::Displacement, FigureKind::Jacobian] {
            for plane in [Kind::Axial, Kind::Coronal, Kind::Sagittal] {
                let made = figure(&case, &outcome, kind, plane, Some(10.0)).unwrap();
                let (svg, png) = (made.svg().unwrap(), made.png().unwrap());
                let text = String::from_utf8(svg).unwrap();
                assert!(text.contains("= 10.0 mm") && text.contains(plane.name()), "{kind:?} {plane:?}");
                assert!(text.starts_with("<svg") && png.starts_with(b"\x89PNG") && png.len() > 10_000);
            }
        }
        let arrows = figure(&case, &outcome, FigureKind::Displacement, Kind::Axial, None).unwrap();
        assert!(String::from_utf8(arrows.svg().unwrap()).unwrap().matches("<path").count() > 50);
    }

    #[test]
    fn what_cannot_be_shown_is_refused_with_the_remedy() {
        let (case, mut outcome, _) = example::small();
        let far = figure(&case, &outcome, FigureKind::Fusion, Kind::Axial, Some(9999.0)).unwrap_err();
        assert!(far.to_string().contains("outside the fraction scan") && far.exit_code() == 2, "{far}");
        outcome.uncertainty = None;
        let none = figure(&case, &outcome, FigureKind::Uncertainty, Kind::Axial, None).unwrap_err();
        assert!(none.to_string().contains("output.uncertainty"), "{none}");
    }
}
