//! What is drawn over the pixels of a picture, and how it looks.

/// Red, green, blue.
pub(super) type Rgb = [u8; 3];

/// Where a text sits relative to its anchor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Align {
    Left,
    Centre,
    Right,
}

/// How a text looks. Its anchor is at half its height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pen {
    /// Height of a line of text, pixels.
    pub(super) size: f64,
    pub(super) colour: Rgb,
    /// Colour of a rim that keeps the text legible over an image.
    pub(super) halo: Option<Rgb>,
    pub(super) align: Align,
}

/// Something drawn over the pixels of a picture; places in pixels.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Shape {
    /// A line with round ends.
    Line { ends: [[f64; 2]; 2], width: f64, colour: Rgb },
    /// An arrow to the second end.
    Arrow { ends: [[f64; 2]; 2], width: f64, colour: Rgb },
    /// A circle line.
    Ring { centre: [f64; 2], radius: f64, width: f64, colour: Rgb },
    /// A filled rectangle.
    Rectangle { corners: [[f64; 2]; 2], colour: Rgb },
    /// Letters.
    Text { text: String, at: [f64; 2], pen: Pen },
}

impl Shape {
    /// The same `by` pixels further right and down.
    pub(super) fn moved(&self, by: [f64; 2]) -> Self {
        let to = |p: [f64; 2]| [p[0] + by[0], p[1] + by[1]];
        let mut moved = self.clone();
        match &mut moved {
            Self::Line { ends, .. } | Self::Arrow { ends, .. } => *ends = ends.map(to),
            Self::Ring { centre, .. } => *centre = to(*centre),
            Self::Rectangle { corners, .. } => *corners = corners.map(to),
            Self::Text { at, .. } => *at = to(*at),
        }
        moved
    }
}
