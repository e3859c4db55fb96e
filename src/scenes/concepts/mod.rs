//! Rank 9: the concept figures of the thesis (chapter 5), as numbers: 2-D scenes that the chain mail itself deforms, on
//! lattices one element thick. `report` draws them.

mod initiators;
mod material;
mod order;
mod rotation;
mod sheet;
mod structures;

pub use material::transfer_functions;

use crate::error::Result;
use crate::progress::Progress;

/// One figure: panels side by side.
#[derive(Debug, Clone)]
pub struct Figure {
    /// File name without folder and ending, for example `fig14_processing_order`.
    pub name: &'static str,
    /// What it is about.
    pub title: &'static str,
    /// How to read it.
    pub caption: &'static str,
    /// Left to right.
    pub panels: Vec<Panel>,
}

/// One part of a figure.
#[derive(Debug, Clone)]
pub struct Panel {
    /// Short heading.
    pub title: String,
    /// What is drawn.
    pub content: Content,
}

/// What a panel shows. Lengths in mm, x to the right, y upwards.
#[derive(Debug, Clone)]
pub enum Content {
    /// Deformed elements.
    Mesh(Mesh),
    /// A value per element, drawn at rest.
    Heat(Heat),
    /// Lines over one variable.
    Curves(Curves),
}

/// A deformed sheet of elements.
#[derive(Debug, Clone)]
pub struct Mesh {
    /// Elements along x and y.
    pub size: [usize; 2],
    /// Deformed place of each element, x fastest.
    pub place: Vec<[f64; 2]>,
    /// Whether each element is a bone or rigid tissue.
    pub rigid: Vec<bool>,
    /// Outlines of bones and rigid tissue before the deformation, as segments.
    pub outline: Vec<[[f64; 2]; 2]>,
    /// Initiating elements where that are single ones: before and after.
    pub points: Vec<[[f64; 2]; 2]>,
    /// What is shown: lower left and upper right corner.
    pub window: [[f64; 2]; 2],
}

/// A value per element.
#[derive(Debug, Clone)]
pub struct Heat {
    /// Elements along x and y.
    pub size: [usize; 2],
    /// From 0 to 1; `None` is left blank. x fastest.
    pub value: Vec<Option<f64>>,
    /// Outlines of bones and rigid tissue, as segments.
    pub outline: Vec<[[f64; 2]; 2]>,
}

/// Lines over one variable.
#[derive(Debug, Clone)]
pub struct Curves {
    /// Name and unit of the horizontal axis.
    pub x: String,
    /// Name and unit of the vertical axis.
    pub y: String,
    /// The lines.
    pub series: Vec<Series>,
}

/// One line of a plot.
#[derive(Debug, Clone)]
pub struct Series {
    /// Its name in the key; empty for none.
    pub name: String,
    /// Its colour, a number that the drawing maps; lines that belong together share one.
    pub colour: usize,
    /// Points from left to right.
    pub points: Vec<[f64; 2]>,
    /// Whether each point is marked.
    pub marks: bool,
}

impl Panel {
    fn new(title: impl Into<String>, content: Content) -> Self {
        Self { title: title.into(), content }
    }
}

/// Makes every figure, in the order of the thesis.
///
/// # Errors
/// [`crate::error::Error::Internal`] when the phantom has no vertebra where the last figure looks for it.
pub fn figures(progress: &dyn Progress) -> Result<Vec<Figure>> {
    type Make = fn() -> Result<Figure>;
    let makes: [(&str, Make); 10] = [
        ("transfer functions", || Ok(material::figure())),
        ("processing order", || Ok(order::heat_maps())),
        ("deformed grids", || Ok(order::grids())),
        ("angle decay", || Ok(rotation::decay())),
        ("rotated grids", || Ok(rotation::grids())),
        ("weights", || Ok(initiators::weights())),
        ("two initiators", || Ok(initiators::grids())),
        ("L-shape", || Ok(structures::l_shape())),
        ("U-shape", || Ok(structures::u_shape())),
        ("vertebra", structures::vertebra),
    ];
    makes
        .iter()
        .enumerate()
        .map(|(n, (name, make))| {
            progress.step(n, makes.len(), name);
            make()
        })
        .collect()
}
