//! Parts of the anatomy: solids built from shapes, and what fills them.

use super::shape::{Bounds, Shape, V3};
use super::texture::{self, smoothstep};

/// What a shape does in its solid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SolidRole {
    /// Joined to the solid.
    Add,
    /// Taken out of what was added.
    Cut,
    /// Joined after cutting.
    Extra,
    /// Teeth: joined last and dense.
    Tooth,
}

/// A solid: union of shapes, less the cut ones, and those that stay whatever was cut.
#[derive(Debug, Clone, Default)]
pub(super) struct Solid {
    /// Shapes with their roles.
    pub(super) parts: Vec<(SolidRole, Shape)>,
}

/// Distances of one solid while its shapes are visited.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gather {
    add: f64,
    cut: f64,
    extra: f64,
    tooth: f64,
}

impl Default for Gather {
    fn default() -> Self {
        Self { add: f64::MAX, cut: f64::MAX, extra: f64::MAX, tooth: f64::MAX }
    }
}

impl Gather {
    /// Takes in one shape's distance.
    pub(super) fn visit(&mut self, role: SolidRole, d: f64) {
        let slot = match role {
            SolidRole::Add => &mut self.add,
            SolidRole::Cut => &mut self.cut,
            SolidRole::Extra => &mut self.extra,
            SolidRole::Tooth => &mut self.tooth,
        };
        *slot = slot.min(d);
    }
    /// Signed distance of the whole.
    pub(super) fn distance(&self) -> f64 {
        self.add.max(-self.cut).min(self.extra).min(self.tooth)
    }
    /// Signed distance of the teeth alone.
    pub(super) fn teeth(&self) -> f64 {
        self.tooth
    }
}

impl Solid {
    /// The solid with more shapes in a role.
    pub(super) fn with(mut self, role: SolidRole, shapes: impl IntoIterator<Item = Shape>) -> Self {
        self.parts.extend(shapes.into_iter().map(|s| (role, s)));
        self
    }

    /// A plain union.
    pub(super) fn of(shapes: impl IntoIterator<Item = Shape>) -> Self {
        Self::default().with(SolidRole::Add, shapes)
    }

    /// Signed distance over all shapes, mm.
    pub(super) fn distance(&self, p: &V3) -> f64 {
        let mut g = Gather::default();
        for (role, s) in &self.parts {
            g.visit(*role, s.distance(p));
        }
        g.distance()
    }

    /// A box that holds the solid.
    pub(super) fn bounds(&self) -> Bounds {
        let start = [V3::repeat(f64::MAX), V3::repeat(f64::MIN)];
        self.parts.iter().filter(|(r, _)| *r != SolidRole::Cut).fold(start, |[lo, hi], (_, s)| {
            let [a, b] = s.bounds();
            [lo.inf(&a), hi.sup(&b)]
        })
    }
}

/// One rigid bone.
#[derive(Debug, Clone)]
pub(super) struct BoneSolid {
    /// TotalSegmentator v2 name.
    pub(super) name: String,
    /// Its shape.
    pub(super) solid: Solid,
    /// Thickness of the compact shell, mm.
    pub(super) cortex_mm: f64,
    /// HU of the compact shell.
    pub(super) cortex_hu: f64,
    /// HU of the marrow.
    pub(super) marrow_hu: f64,
}

impl BoneSolid {
    /// A bone of typical density.
    pub(super) fn new(name: impl Into<String>, solid: Solid) -> Self {
        Self { name: name.into(), solid, cortex_mm: 1.8, cortex_hu: 1050.0, marrow_hu: 300.0 }
    }

    /// With its own shell and marrow.
    pub(super) fn filled(self, cortex_mm: f64, cortex_hu: f64, marrow_hu: f64) -> Self {
        Self { cortex_mm, cortex_hu, marrow_hu, ..self }
    }

    /// HU at a point whose depth below the surface is `depth` mm and below a tooth's surface `tooth` mm.
    pub(super) fn hu(&self, p: &V3, depth: f64, tooth: f64) -> f64 {
        if tooth > 0.0 {
            return 1900.0 + 300.0 * smoothstep(0.5, 2.0, tooth);
        }
        let t = texture::trabecular(p);
        let shell = 1.0 - smoothstep(self.cortex_mm - 0.9, self.cortex_mm + 0.9, depth + 0.5 * t);
        let marrow = self.marrow_hu + 130.0 * t;
        marrow + (self.cortex_hu + 90.0 * t - marrow) * shell
    }
}

/// What a soft part is filled with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Fill {
    /// Air in a cavity.
    Air,
    /// Muscle; neighbouring muscles are parted by thin fat planes.
    Muscle,
    /// Fat.
    Fat,
    /// Lung with vessels.
    Lung,
    /// Brain with folds near its surface.
    Brain,
    /// Gland or organ of this mean HU, lobulated.
    Organ(f64),
    /// Uniform stuff of this HU: fluids, contrast, cartilage, plastic.
    Even(f64),
}

/// One soft part.
#[derive(Debug, Clone)]
pub(super) struct SolidTissue {
    /// What it is filled with.
    pub(super) fill: Fill,
    /// Its shape.
    pub(super) solid: Solid,
}

impl Fill {
    /// HU at a point `depth` mm below the part's surface.
    pub(super) fn hu(&self, p: &V3, depth: f64) -> f64 {
        match *self {
            Self::Air => -990.0,
            Self::Muscle => 52.0 + 14.0 * texture::fibres(p),
            Self::Fat => texture::fat(p),
            Self::Lung => texture::lung(p),
            Self::Brain => texture::brain(p, depth),
            Self::Organ(hu) => hu + 16.0 * texture::lobules(p),
            Self::Even(hu) => hu,
        }
    }
}
